"""TreeSum: far stars as cubes with mass and quadrupole, near ones one by one.

Groups of neighbouring stars walk the octree together (Barnes 1990): what a group meets goes
to two lists, cubes and stars, and dense loops then run over the lists for each star of the
group, in float32 relative to the group's middle, with float64 sums over full lists.

*Opening.* A cube is taken as a whole when the octupole that is left out is small beside the group's
acceleration: B / d^5 < alpha |a|, with B the sum of m |x - centre|^3 over its stars and d the
distance of its centre from the group's box; and when it is not nearer than its own radius over
WIDEST. |a| is found by a short walk of the group's middle with monopoles only, so that forces depend on
the places alone: nothing is kept from one evaluation to the next, and a resumed run gives the same
bytes.
"""

from typing import Any

import numpy as np

from tianim.lang import f32_1d, f32_2d, f64_1d, f64_2d, i32_1d, i32_2d, ti
from tianim.spatial import octree
from tianim.spatial.octree import (
    BEGIN,
    CENTRE,
    CHILDREN,
    END,
    LEAF,
    NONE,
    RADIUS2,
    SECOND,
    SPAN,
    STEP,
    Octree,
)
from tianim.systems.gravity.sampling import Sampled
from tianim.systems.gravity.softening import PLUMMER, Law, pair

# Squared distances, in sides of the cube, that are as good as none.
TINY_SINGLE = 1e-24
GROUP = 96  # stars that walk together, at most
GROUPS_A_TURN = 4
# Entries of the lists; a list that may not hold the next cube's children is summed and emptied.
CELLS, STARS = 1024, 3072
CELL_PAGE, STAR_PAGE = CELLS + 80, STARS + 80  # staggered
LANES = 8
# Radius of a cube over its distance, at most: beyond 1 a star might stand inside.
WIDEST = 0.9
# alpha at an accuracy of 1e-3, its growth with the accuracy, and where WIDEST alone decides.
ALPHA_AT, ALPHA_POWER, LARGEST_ALPHA = 0.012, 1.9, 0.3
# The same for the walk that finds |a|.
ROUGH = 1.0
# A group whose stars feel less than this of what was thought walks again, with what they feel.
TOO_STRONG = 0.4
ATTEMPTS = 3
# Nodes found: a page of those to open, then to sum, then to copy.
PAGE = CELLS + 80
FAR = 1e6  # where the padding of the lists stands, in sides of the cube
# Rows of the list of cubes: place, mass, 3 S - T 1 (S second moments, T their trace), 2.5 T eps^2.
XX, XY, XZ, YY, YZ, ZZ, SOFT = 4, 5, 6, 7, 8, 9, 10
CELL_ROWS = 11
# Entries of the settings.
REACH, ALPHA, PULL, DEPTH, GUARD = 0, 1, 2, 3, 4


@ti.func
def rounded(count):
    """`count` rounded up to whole vectors."""
    return (count + (LANES - 1)) & ~(LANES - 1)


@ti.func
def rough_acceleration(cx, cy, cz, link: ti.template(), moment: ti.template(), found: ti.template(), f0):
    """Length of the acceleration at a point (lattice steps), by cubes without their quadrupoles."""
    ax, ay, az = 0.0, 0.0, 0.0
    found[f0] = 0
    sp = ti.cast(link[CHILDREN, 0] >= 0, ti.i32)
    while sp > 0:
        sp -= 1
        children = link[CHILDREN, found[f0 + sp]]
        first = children >> 3
        for q in range(first, first + (children & 7) + 1):
            dx = ti.cast(link[CENTRE, q] - cx, ti.f32) * STEP
            dy = ti.cast(link[CENTRE + 1, q] - cy, ti.f32) * STEP
            dz = ti.cast(link[CENTRE + 2, q] - cz, ti.f32) * STEP
            radius2 = moment[RADIUS2, q]
            r2 = dx * dx + dy * dy + dz * dz
            whole = link[CHILDREN, q] < 0 or radius2 < (ROUGH * ROUGH) * r2
            s = r2 + radius2 + TINY_SINGLE
            w = ti.select(whole, moment[octree.MASS, q] / (s * ti.sqrt(s)), 0.0)
            ax += w * dx
            ay += w * dy
            az += w * dz
            found[f0 + sp] = q
            sp += 1 - ti.cast(whole, ti.i32)
    return ti.sqrt(ax * ax + ay * ay + az * az)


@ti.func
def copy_stars(
    begin, end, at, cx, cy, cz, lattice: ti.template(), weight: ti.template(), stars: ti.template()
):
    """Stars begin ... end - 1 relative to (cx, cy, cz) into the list from `at` on."""
    move = at - begin
    for i in range(begin, end):
        stars[0, i + move] = ti.cast(lattice[0, i] - cx, ti.f32) * STEP
        stars[1, i + move] = ti.cast(lattice[1, i] - cy, ti.f32) * STEP
        stars[2, i + move] = ti.cast(lattice[2, i] - cz, ti.f32) * STEP
        stars[3, i + move] = weight[i]


@ti.func
def copy_leaves(
    f0, leaves, begin, end, s0, n_stars, cx, cy, cz, found: ti.template(), link: ti.template(),
    lattice: ti.template(), weight: ti.template(), stars: ti.template(),
):  # fmt: skip
    """The stars of the leaves found, those of the group itself left out; returns how many there are then."""
    n = n_stars
    k = 0
    while k < leaves:
        q = found[f0 + 2 * PAGE + k]
        b, e = link[BEGIN, q], link[END, q]
        k += 1
        # Leaves that stand next to each other in one go.
        while k < leaves and link[BEGIN, found[f0 + 2 * PAGE + k]] == e:
            e = link[END, found[f0 + 2 * PAGE + k]]
            k += 1
        if b < begin:
            last = ti.min(e, begin)
            copy_stars(b, last, s0 + n, cx, cy, cz, lattice, weight, stars)
            n += last - b
        b = ti.max(b, end)
        if b < e:
            copy_stars(b, e, s0 + n, cx, cy, cz, lattice, weight, stars)
            n += e - b
    for j in range(s0 + n, s0 + rounded(n)):
        stars[0, j], stars[1, j], stars[2, j], stars[3, j] = FAR, 0.0, 0.0, 0.0
    return n


@ti.func
def copy_cells(
    kind: ti.template(), f0, n_cells, c0, cx, cy, cz, setting: ti.template(), found: ti.template(),
    link: ti.template(), moment: ti.template(), cells: ti.template(),
):  # fmt: skip
    """The cubes found, relative to (cx, cy, cz), with traceless quadrupoles."""
    soft = 0.0
    if ti.static(kind == PLUMMER):
        soft = 2.5 * setting[REACH] * setting[REACH]
    for j in range(n_cells):
        q, k = found[f0 + PAGE + j], c0 + j
        xx, yy, zz = moment[SECOND, q], moment[SECOND + 3, q], moment[SECOND + 5, q]
        trace = xx + yy + zz
        cells[0, k] = ti.cast(link[CENTRE, q] - cx, ti.f32) * STEP
        cells[1, k] = ti.cast(link[CENTRE + 1, q] - cy, ti.f32) * STEP
        cells[2, k] = ti.cast(link[CENTRE + 2, q] - cz, ti.f32) * STEP
        cells[3, k] = moment[octree.MASS, q]
        cells[XX, k], cells[YY, k], cells[ZZ, k] = 3.0 * xx - trace, 3.0 * yy - trace, 3.0 * zz - trace
        cells[XY, k] = 3.0 * moment[SECOND + 1, q]
        cells[XZ, k] = 3.0 * moment[SECOND + 2, q]
        cells[YZ, k] = 3.0 * moment[SECOND + 4, q]
        cells[SOFT, k] = soft * trace
    for k in range(c0 + n_cells, c0 + rounded(n_cells)):
        cells[0, k] = FAR
        for c in range(1, CELL_ROWS):
            cells[c, k] = 0.0


@ti.kernel
def walk(
    kind: ti.template(),
    with_phi: ti.template(),
    groups: ti.i32,
    tasks: ti.i32,
    stride: ti.i32,
    setting: f32_1d,
    group: i32_2d,
    link: i32_2d,
    moment: f32_2d,
    lattice: i32_2d,
    weight: f32_1d,
    order: i32_1d,
    counter: i32_1d,
    found: i32_1d,
    cells: f32_2d,
    stars: f32_2d,
    total: f64_2d,
    a: f64_2d,
    phi: f64_1d,
):
    """Each task lets one group after another walk and writes the sums of its stars."""
    for task_block in range(tasks * stride):
        if task_block % stride == 0:
            t = task_block // stride
            c0, s0, t0, f0 = t * CELL_PAGE, t * STAR_PAGE, t * GROUP, 3 * PAGE * t
            turn = ti.atomic_add(counter[0], GROUPS_A_TURN)
            while turn < groups:
                for g in range(turn, ti.min(turn + GROUPS_A_TURN, groups)):
                    begin, end = group[0, g], group[1, g]
                    x0, x1 = lattice[0, begin], lattice[0, begin]
                    y0, y1 = lattice[1, begin], lattice[1, begin]
                    z0, z1 = lattice[2, begin], lattice[2, begin]
                    for i in range(begin, end):
                        x0, x1 = ti.min(x0, lattice[0, i]), ti.max(x1, lattice[0, i])
                        y0, y1 = ti.min(y0, lattice[1, i]), ti.max(y1, lattice[1, i])
                        z0, z1 = ti.min(z0, lattice[2, i]), ti.max(z1, lattice[2, i])
                    cx, cy, cz = x0 + (x1 - x0) // 2, y0 + (y1 - y0) // 2, z0 + (z1 - z0) // 2
                    hx = ti.cast(x1 - cx, ti.f32) * STEP
                    hy = ti.cast(y1 - cy, ti.f32) * STEP
                    hz = ti.cast(z1 - cz, ti.f32) * STEP
                    strength = rough_acceleration(cx, cy, cz, link, moment, found, f0)
                    attempts = 0
                    while attempts < ATTEMPTS:
                        narrow = ti.pow(1.0 / ti.max(setting[ALPHA] * strength, 1e-20), 0.4)
                        # Its own stars come first: star i then stands at i - begin.
                        copy_stars(begin, end, s0, cx, cy, cz, lattice, weight, stars)
                        for k in range(end - begin):
                            for c in ti.static(range(4)):
                                total[c, t0 + k] = 0.0
                        n_stars, n_cells, n_leaves, resume = end - begin, 0, 0, 0
                        held = True  # whether the list begins with the group's own stars
                        found[f0] = 0
                        sp = 1
                        walking = True
                        while walking:
                            sp -= 1
                            node = found[f0 + sp]
                            children = link[CHILDREN, node]
                            if children < 0:
                                # Stars in one place, in pieces; or a tree that is one leaf.
                                b = link[BEGIN, node] + resume
                                e = ti.min(link[END, node], b + STARS - n_stars)
                                copy_stars(b, e, s0 + n_stars, cx, cy, cz, lattice, weight, stars)
                                for i in range(ti.max(b, begin), ti.min(e, end)):
                                    stars[3, s0 + n_stars + i - b] = 0.0  # its own are there already
                                n_stars += e - b
                                resume += e - b
                                if e < link[END, node]:
                                    sp += 1
                                else:
                                    resume = 0
                            elif link[BEGIN, node] < begin or link[END, node] > end:
                                first = children >> 3
                                for q in range(first, first + (children & 7) + 1):
                                    dx = ti.cast(link[CENTRE, q] - cx, ti.f32) * STEP
                                    dy = ti.cast(link[CENTRE + 1, q] - cy, ti.f32) * STEP
                                    dz = ti.cast(link[CENTRE + 2, q] - cz, ti.f32) * STEP
                                    ex = ti.max(ti.abs(dx) - hx, 0.0)
                                    ey = ti.max(ti.abs(dy) - hy, 0.0)
                                    ez = ti.max(ti.abs(dz) - hz, 0.0)
                                    d2 = ex * ex + ey * ey + ez * ez
                                    radius2 = moment[RADIUS2, q]
                                    least = ti.max(moment[SPAN, q] * narrow, radius2 * setting[GUARD])
                                    if ti.static(kind != PLUMMER):
                                        # Softened stars are not Newtonian: no cube may hold one.
                                        whole = ti.sqrt(radius2) + setting[REACH]
                                        least = ti.max(least, whole * whole)
                                    fits = ti.cast(d2 > least, ti.i32)
                                    leaf = ti.cast(link[CHILDREN, q] == NONE, ti.i32)
                                    # Without branches: each is written to all three lists, and kept in one.
                                    found[f0 + PAGE + n_cells] = q
                                    n_cells += fits
                                    found[f0 + 2 * PAGE + n_leaves] = q
                                    n_leaves += (1 - fits) & leaf
                                    found[f0 + sp] = q
                                    sp += (1 - fits) & (1 - leaf)
                            walking = sp > 0
                            full = n_cells + 8 > CELLS or n_stars + (n_leaves + 8) * LEAF > STARS
                            if full or not walking:
                                n_stars = copy_leaves(
                                    f0, n_leaves, begin, end, s0, n_stars, cx, cy, cz, found, link, lattice,
                                    weight, stars,
                                )  # fmt: skip
                                copy_cells(
                                    kind, f0, n_cells, c0, cx, cy, cz, setting, found, link, moment, cells
                                )
                                for i in range(begin, end):
                                    px = ti.cast(lattice[0, i] - cx, ti.f32) * STEP
                                    py = ti.cast(lattice[1, i] - cy, ti.f32) * STEP
                                    pz = ti.cast(lattice[2, i] - cz, ti.f32) * STEP
                                    reach = setting[REACH]
                                    sx, sy, sz, deep = 0.0, 0.0, 0.0, 0.0
                                    own = s0 + i - begin
                                    if held:
                                        stars[3, own] = 0.0  # it does not pull itself
                                    for j in range(s0, s0 + rounded(n_stars)):
                                        dx = stars[0, j] - px
                                        dy = stars[1, j] - py
                                        dz = stars[2, j] - pz
                                        r2 = dx * dx + dy * dy + dz * dz
                                        pull, depth = pair(kind, with_phi, r2, reach, TINY_SINGLE)
                                        w = stars[3, j] * pull
                                        sx += w * dx
                                        sy += w * dy
                                        sz += w * dz
                                        if ti.static(with_phi):
                                            deep += stars[3, j] * depth
                                    if held:
                                        stars[3, own] = weight[i]
                                    ux, uy, uz = 0.0, 0.0, 0.0
                                    eps2 = 0.0
                                    if ti.static(kind == PLUMMER):
                                        eps2 = reach * reach
                                    for j in range(c0, c0 + rounded(n_cells)):
                                        dx = cells[0, j] - px
                                        dy = cells[1, j] - py
                                        dz = cells[2, j] - pz
                                        u2 = 1.0 / (dx * dx + dy * dy + dz * dz + eps2)
                                        u = ti.sqrt(u2)
                                        u3 = u2 * u
                                        u5 = u3 * u2
                                        qx = cells[XX, j] * dx + cells[XY, j] * dy + cells[XZ, j] * dz
                                        qy = cells[XY, j] * dx + cells[YY, j] * dy + cells[YZ, j] * dz
                                        qz = cells[XZ, j] * dx + cells[YZ, j] * dy + cells[ZZ, j] * dz
                                        along = dx * qx + dy * qy + dz * qz
                                        w = cells[3, j] * u3 + (2.5 * along - cells[SOFT, j]) * u5 * u2
                                        ux += w * dx - u5 * qx
                                        uy += w * dy - u5 * qy
                                        uz += w * dz - u5 * qz
                                        if ti.static(with_phi):
                                            deep += (
                                                cells[3, j] * u + (0.5 * along - 0.2 * cells[SOFT, j]) * u5
                                            )
                                    k = t0 + i - begin
                                    total[0, k] = total[0, k] + sx + ux
                                    total[1, k] = total[1, k] + sy + uy
                                    total[2, k] = total[2, k] + sz + uz
                                    if ti.static(with_phi):
                                        total[3, k] = total[3, k] + deep
                                held = False
                                n_stars, n_cells, n_leaves = 0, 0, 0
                        mean = 0.0
                        for k in range(t0, t0 + end - begin):
                            mean += ti.cast(
                                ti.sqrt(total[0, k] ** 2 + total[1, k] ** 2 + total[2, k] ** 2), ti.f32
                            )
                        mean /= ti.cast(end - begin, ti.f32)
                        attempts += 1
                        if mean > TOO_STRONG * strength:
                            attempts = ATTEMPTS
                        strength = mean
                    for i in range(begin, end):
                        star, k = order[i], t0 + i - begin
                        a[0, star] = total[0, k] * setting[PULL]
                        a[1, star] = total[1, k] * setting[PULL]
                        a[2, star] = total[2, k] * setting[PULL]
                        if ti.static(with_phi):
                            phi[star] = total[3, k] * setting[DEPTH]
                turn = ti.atomic_add(counter[0], GROUPS_A_TURN)


def alpha_for(accuracy: float) -> float:
    """The opening criterion's alpha for a median error of `accuracy`; see the table in the module's text."""
    return min(ALPHA_AT * (accuracy / 1e-3) ** ALPHA_POWER, LARGEST_ALPHA)


class TreeSum(Sampled):
    """Forces on `count` stars by the octree, with a median relative error of `accuracy` at most."""

    def __init__(self, count: int, law: Law, accuracy: float = 1e-3) -> None:
        self.count, self.law = count, law
        self.alpha, self.widest = alpha_for(accuracy), WIDEST
        self.tree = Octree(count, GROUP)
        tasks = self.tree.tasks
        self._setting = ti.ndarray(ti.f32, 8)
        self._counter = ti.ndarray(ti.i32, 4)
        self._found = ti.ndarray(ti.i32, 3 * PAGE * tasks)
        self._cells = ti.ndarray(ti.f32, (CELL_ROWS, tasks * CELL_PAGE))
        self._stars = ti.ndarray(ti.f32, (4, tasks * STAR_PAGE))
        self._total = ti.ndarray(ti.f64, (4, tasks * GROUP))
        self._nothing = ti.ndarray(ti.f64, 4)

    def evaluate(self, x: Any, mass: Any, a: Any, phi: Any = None) -> None:
        """Fill a (3, n) and, where given, phi (n,) for stars at x (3, n) with mass (n,); all float64."""
        if self.count == 0:
            return
        self.build(x, mass)
        self.walk(a, phi)

    def build(self, x: Any, mass: Any) -> None:
        """The tree of the stars at x with mass."""
        self.tree.build(x, mass)

    def walk(self, a: Any, phi: Any) -> None:
        """Sum the forces with the tree as it was built."""
        tree, law = self.tree, self.law
        scale = law.gravitational_constant * tree.mass / tree.side
        self._setting.from_numpy(
            np.array(
                [law.reach / tree.side, self.alpha, scale / tree.side, -scale, self.widest**-2, 0, 0, 0],
                np.float32,
            )
        )
        self._counter.fill(0)
        walk(
            law.code, phi is not None, tree.group_count, tree.tasks, tree.stride, self._setting, tree.groups,
            tree.link, tree.moment, tree.lattice, tree.weight, tree.order, self._counter, self._found,
            self._cells, self._stars, self._total, a, self._nothing if phi is None else phi,
        )  # fmt: skip

    def memory_bytes(self) -> int:
        """Bytes of the solver's own arrays."""
        return self.tree.memory_bytes()
