"""The walk of groups of stars through the octree; see tree.py for the idea, lists.py for what it fills.

A group is the run begin ... end - 1 of stars in Morton order, (cx, cy, cz) the middle of its box in lattice
steps, (hx, hy, hz) half the box's sides. t0, s0, c0 and f0 say where a task's pages of sums, stars,
cubes and numbers of nodes begin.
"""

from tianim.lang import f32_1d, f32_2d, f64_1d, f64_2d, i32_1d, i32_2d, ti
from tianim.spatial.nodes import BEGIN, CENTRE, CHILDREN, END, MASS, NONE, RADIUS2, SPAN, STEP, offset
from tianim.spatial.octree import LEAF
from tianim.systems.gravity.lists import (
    CELL_PAGE,
    CELLS,
    PAGE,
    STAR_PAGE,
    STARS,
    TINY_SINGLE,
    copy_cells,
    copy_leaves,
    copy_stars,
    sum_lists,
)
from tianim.systems.gravity.softening import PLUMMER

GROUP = 96  # stars that walk together, at most
GROUPS_A_TURN = 4
# Squared distance over squared radius from which a rough walk takes a cube as a whole.
ROUGH = 1.0
# A group whose stars feel less than this of what was thought walks again, with what they feel.
TOO_STRONG = 0.4
ATTEMPTS = 3


@ti.func
def box_of(begin, end, lattice: ti.template()):
    """Middle of a group's box (three, lattice steps) and half its sides (three, in sides of the cube)."""
    x0, x1 = lattice[0, begin], lattice[0, begin]
    y0, y1 = lattice[1, begin], lattice[1, begin]
    z0, z1 = lattice[2, begin], lattice[2, begin]
    for i in range(begin, end):
        x0, x1 = ti.min(x0, lattice[0, i]), ti.max(x1, lattice[0, i])
        y0, y1 = ti.min(y0, lattice[1, i]), ti.max(y1, lattice[1, i])
        z0, z1 = ti.min(z0, lattice[2, i]), ti.max(z1, lattice[2, i])
    cx, cy, cz = x0 + (x1 - x0) // 2, y0 + (y1 - y0) // 2, z0 + (z1 - z0) // 2
    hx, hy, hz = (
        ti.cast(x1 - cx, ti.f32) * STEP,
        ti.cast(y1 - cy, ti.f32) * STEP,
        ti.cast(z1 - cz, ti.f32) * STEP,
    )
    return cx, cy, cz, hx, hy, hz


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
            dx, dy, dz = offset(link, CENTRE, q, cx, cy, cz)
            radius2 = moment[RADIUS2, q]
            r2 = dx * dx + dy * dy + dz * dz
            whole = link[CHILDREN, q] < 0 or radius2 < (ROUGH * ROUGH) * r2
            s = r2 + radius2 + TINY_SINGLE
            w = ti.select(whole, moment[MASS, q] / (s * ti.sqrt(s)), 0.0)
            ax += w * dx
            ay += w * dy
            az += w * dz
            found[f0 + sp] = q
            sp += 1 - ti.cast(whole, ti.i32)
    return ti.sqrt(ax * ax + ay * ay + az * az)


@ti.func
def fits(
    kind: ti.template(), q, narrow, guard, reach, cx, cy, cz, hx, hy, hz, link: ti.template(),
    moment: ti.template(),
):  # fmt: skip
    """1 where node q is far enough from the group's box to be taken as a whole, else 0."""
    dx, dy, dz = offset(link, CENTRE, q, cx, cy, cz)
    ex = ti.max(ti.abs(dx) - hx, 0.0)
    ey = ti.max(ti.abs(dy) - hy, 0.0)
    ez = ti.max(ti.abs(dz) - hz, 0.0)
    radius2 = moment[RADIUS2, q]
    least = ti.max(moment[SPAN, q] * narrow, radius2 * guard)
    if ti.static(kind != PLUMMER):
        # Softened stars are not Newtonian: no cube may hold one.
        whole = ti.sqrt(radius2) + reach
        least = ti.max(least, whole * whole)
    return ti.cast(ex * ex + ey * ey + ez * ez > least, ti.i32)


@ti.func
def sort_children(
    kind: ti.template(), children, narrow, guard, reach, cx, cy, cz, hx, hy, hz, f0, sp, n_cells, n_leaves,
    link: ti.template(), moment: ti.template(), found: ti.template(),
):  # fmt: skip
    """Each child of a node to the cubes, the leaves or the nodes to open; returns how many each has then.

    Without branches: each is written to all three lists, and kept in one.
    """
    cells, leaves, to_open = n_cells, n_leaves, sp
    first = children >> 3
    for q in range(first, first + (children & 7) + 1):
        far = fits(kind, q, narrow, guard, reach, cx, cy, cz, hx, hy, hz, link, moment)
        leaf = ti.cast(link[CHILDREN, q] == NONE, ti.i32)
        found[f0 + PAGE + cells] = q
        cells += far
        found[f0 + 2 * PAGE + leaves] = q
        leaves += (1 - far) & leaf
        found[f0 + to_open] = q
        to_open += (1 - far) & (1 - leaf)
    return cells, leaves, to_open


@ti.func
def copy_heap(
    node, done, room, begin, end, s0, n_stars, cx, cy, cz, link: ti.template(), lattice: ti.template(),
    weight: ti.template(), stars: ti.template(),
):  # fmt: skip
    """Copy stars of one place (or of a tree that is one leaf), but for the first `done`; returns how many.

    As many as there is `room` for. Those of the group itself are in the list already and weigh nothing here.
    """
    b = link[BEGIN, node] + done
    e = ti.min(link[END, node], b + room)
    copy_stars(b, e, s0 + n_stars, cx, cy, cz, lattice, weight, stars)
    for i in range(ti.max(b, begin), ti.min(e, end)):
        stars[3, s0 + n_stars + i - b] = 0.0
    return e - b


@ti.func
def sum_group(
    kind: ti.template(), with_phi: ti.template(), begin, end, narrow, guard, reach, cx, cy, cz, hx, hy, hz,
    t0, s0, c0, f0, link: ti.template(), moment: ti.template(), lattice: ti.template(),
    weight: ti.template(), found: ti.template(), cells: ti.template(), stars: ti.template(),
    total: ti.template(),
):  # fmt: skip
    """Walk the tree once with a group; the sums of its stars into `total`."""
    for k in range(t0, t0 + end - begin):
        for c in ti.static(range(4)):
            total[c, k] = 0.0
    # Its own stars come first: star i then stands at i - begin.
    copy_stars(begin, end, s0, cx, cy, cz, lattice, weight, stars)
    n_stars, n_cells, n_leaves, done = end - begin, 0, 0, 0
    held = True  # whether the list begins with the group's own stars
    found[f0] = 0
    sp = 1
    while sp > 0:
        sp -= 1
        node = found[f0 + sp]
        children = link[CHILDREN, node]
        if children < 0:
            copied = copy_heap(
                node, done, STARS - n_stars - n_leaves * LEAF, begin, end, s0, n_stars, cx, cy, cz, link,
                lattice, weight, stars,
            )  # fmt: skip
            n_stars += copied
            done += copied
            if link[BEGIN, node] + done < link[END, node]:
                sp += 1  # the rest when the list is empty
            else:
                done = 0
        elif link[BEGIN, node] < begin or link[END, node] > end:
            n_cells, n_leaves, sp = sort_children(
                kind, children, narrow, guard, reach, cx, cy, cz, hx, hy, hz, f0, sp, n_cells, n_leaves,
                link, moment, found,
            )  # fmt: skip
        full = n_cells + 8 > CELLS or n_stars + (n_leaves + 8) * LEAF > STARS
        if full or sp == 0:
            n_stars = copy_leaves(
                f0, n_leaves, begin, end, s0, n_stars, cx, cy, cz, found, link, lattice, weight, stars
            )
            copy_cells(kind, f0, n_cells, c0, cx, cy, cz, reach, found, link, moment, cells)
            sum_lists(
                kind, with_phi, begin, end, held, s0, n_stars, c0, n_cells, t0, cx, cy, cz, reach,
                lattice, weight, stars, cells, total,
            )  # fmt: skip
            held = False
            n_stars, n_cells, n_leaves = 0, 0, 0


@ti.func
def mean_strength(t0, number, total: ti.template()):
    """Mean length of the accelerations of a group."""
    mean = 0.0
    for k in range(t0, t0 + number):
        mean += ti.cast(ti.sqrt(total[0, k] ** 2 + total[1, k] ** 2 + total[2, k] ** 2), ti.f32)
    return mean / ti.cast(number, ti.f32)


@ti.func
def attract(
    kind: ti.template(), with_phi: ti.template(), begin, end, alpha, guard, reach, t0, s0, c0, f0,
    link: ti.template(), moment: ti.template(), lattice: ti.template(), weight: ti.template(),
    found: ti.template(), cells: ti.template(), stars: ti.template(), total: ti.template(),
):  # fmt: skip
    """The sums of a group's stars into `total`, by a second walk where they feel less than was thought."""
    cx, cy, cz, hx, hy, hz = box_of(begin, end, lattice)
    strength = rough_acceleration(cx, cy, cz, link, moment, found, f0)
    attempts = 0
    while attempts < ATTEMPTS:
        narrow = ti.pow(1.0 / ti.max(alpha * strength, 1e-20), 0.4)
        sum_group(
            kind, with_phi, begin, end, narrow, guard, reach, cx, cy, cz, hx, hy, hz, t0, s0, c0, f0, link,
            moment, lattice, weight, found, cells, stars, total,
        )  # fmt: skip
        felt = mean_strength(t0, end - begin, total)
        attempts = ti.select(felt > TOO_STRONG * strength, ATTEMPTS, attempts + 1)
        strength = felt


@ti.func
def wanted(some, begin, end, order: ti.template(), active: ti.template()):
    """Whether one of stars begin ... end - 1 is active; always, unless only `some` stars are."""
    result = 1 - some
    if some:
        for i in range(begin, end):
            result |= active[order[i]]
    return result


@ti.kernel
def walk(
    kind: ti.template(),
    with_phi: ti.template(),
    some: ti.i32,
    groups: ti.i32,
    tasks: ti.i32,
    stride: ti.i32,
    alpha: ti.f32,
    guard: ti.f32,
    reach: ti.f32,
    to_a: ti.f64,
    to_phi: ti.f64,
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
    active: i32_1d,
    a: f64_2d,
    phi: f64_1d,
):
    """Each task lets one group after another walk and writes the sums of its stars.

    alpha and guard are those of the opening criterion; to_a and to_phi give the sums their units. Where
    `some`, groups without an active star stay out, and the active stars alone are written. It is no
    template: two kernels might sum in another order.
    """
    for task_block in range(tasks * stride):
        if task_block % stride == 0:
            t = task_block // stride
            c0, s0, t0, f0 = t * CELL_PAGE, t * STAR_PAGE, t * GROUP, 3 * PAGE * t
            turn = ti.atomic_add(counter[0], GROUPS_A_TURN)
            while turn < groups:
                for g in range(turn, ti.min(turn + GROUPS_A_TURN, groups)):
                    begin, end = group[0, g], group[1, g]
                    if wanted(some, begin, end, order, active):
                        attract(
                            kind, with_phi, begin, end, alpha, guard, reach, t0, s0, c0, f0, link, moment,
                            lattice, weight, found, cells, stars, total,
                        )  # fmt: skip
                        for i in range(begin, end):
                            star, k = order[i], t0 + i - begin
                            if wanted(some, i, i + 1, order, active):
                                a[0, star] = total[0, k] * to_a
                                a[1, star] = total[1, k] * to_a
                                a[2, star] = total[2, k] * to_a
                                if ti.static(with_phi):
                                    phi[star] = total[3, k] * to_phi
                turn = ti.atomic_add(counter[0], GROUPS_A_TURN)
