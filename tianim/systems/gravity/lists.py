"""What a group of stars has met on its walk: lists of stars and of cubes, filled and summed.

Places in the lists are float32 relative to the middle of the group, in sides of the cube that holds all
stars; masses are in the total mass. Each task has a page of every list; c0 and s0 say where the pages of
cubes and stars begin. Lists end on whole vectors, filled up with what weighs nothing.
"""

from tianim.lang import ti
from tianim.spatial.nodes import BEGIN, CENTRE, END, MASS, SECOND, offset
from tianim.systems.gravity.softening import PLUMMER, pair

# Squared distances, in sides of the cube, that are as good as none.
TINY_SINGLE = 1e-24
# Entries of the lists; a list that may not hold the next cube's children is summed and emptied.
CELLS, STARS = 1024, 3072
CELL_PAGE, STAR_PAGE = CELLS + 80, STARS + 80  # staggered
# Numbers of nodes: a page of those to open, then to sum as cubes, then of leaves to copy.
PAGE = CELLS + 80
LANES = 8
FAR = 1e6  # where the filling stands, in sides of the cube
# Rows of the list of cubes: place, mass, 3 S - T 1 (S second moments, T their trace), 2.5 T eps^2.
XX, XY, XZ, YY, YZ, ZZ, SOFT = 4, 5, 6, 7, 8, 9, 10
CELL_ROWS = 11


@ti.func
def rounded(count):
    """`count` rounded up to whole vectors."""
    return (count + (LANES - 1)) & ~(LANES - 1)


@ti.func
def copy_stars(
    begin, end, at, cx, cy, cz, lattice: ti.template(), weight: ti.template(), stars: ti.template()
):
    """Stars begin ... end - 1 relative to (cx, cy, cz) into the list from `at` on."""
    move = at - begin
    for i in range(begin, end):
        stars[0, i + move], stars[1, i + move], stars[2, i + move] = offset(lattice, 0, i, cx, cy, cz)
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
    kind: ti.template(), f0, n_cells, c0, cx, cy, cz, reach, found: ti.template(), link: ti.template(),
    moment: ti.template(), cells: ti.template(),
):  # fmt: skip
    """The cubes found, relative to (cx, cy, cz), with traceless quadrupoles."""
    soft = 0.0
    if ti.static(kind == PLUMMER):
        soft = 2.5 * reach * reach
    for j in range(n_cells):
        q, k = found[f0 + PAGE + j], c0 + j
        xx, yy, zz = moment[SECOND, q], moment[SECOND + 3, q], moment[SECOND + 5, q]
        trace = xx + yy + zz
        cells[0, k], cells[1, k], cells[2, k] = offset(link, CENTRE, q, cx, cy, cz)
        cells[3, k] = moment[MASS, q]
        cells[XX, k], cells[YY, k], cells[ZZ, k] = 3.0 * xx - trace, 3.0 * yy - trace, 3.0 * zz - trace
        cells[XY, k] = 3.0 * moment[SECOND + 1, q]
        cells[XZ, k] = 3.0 * moment[SECOND + 2, q]
        cells[YZ, k] = 3.0 * moment[SECOND + 4, q]
        cells[SOFT, k] = soft * trace
    for k in range(c0 + n_cells, c0 + rounded(n_cells)):
        cells[0, k] = FAR
        for c in range(1, CELL_ROWS):
            cells[c, k] = 0.0


@ti.func
def sum_stars(
    kind: ti.template(), with_phi: ti.template(), s0, n_stars, px, py, pz, reach, stars: ti.template()
):
    """Pull (three) and depth of all stars of the list at (px, py, pz)."""
    sx, sy, sz, deep = 0.0, 0.0, 0.0, 0.0
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
    return sx, sy, sz, deep


@ti.func
def sum_cells(
    kind: ti.template(), with_phi: ti.template(), c0, n_cells, px, py, pz, reach, depth, cells: ti.template()
):
    """Pull (three) of all cubes of the list at (px, py, pz) with their quadrupoles; `depth` and theirs."""
    eps2 = 0.0
    if ti.static(kind == PLUMMER):
        eps2 = reach * reach
    sx, sy, sz, deep = 0.0, 0.0, 0.0, depth
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
        sx += w * dx - u5 * qx
        sy += w * dy - u5 * qy
        sz += w * dz - u5 * qz
        if ti.static(with_phi):
            deep += cells[3, j] * u + (0.5 * along - 0.2 * cells[SOFT, j]) * u5
    return sx, sy, sz, deep


@ti.func
def sum_lists(
    kind: ti.template(), with_phi: ti.template(), begin, end, held, s0, n_stars, c0, n_cells, t0, cx, cy, cz,
    reach, lattice: ti.template(), weight: ti.template(), stars: ti.template(), cells: ti.template(),
    total: ti.template(),
):  # fmt: skip
    """Add what both lists pull to the sums of stars begin ... end - 1, which stand in `total` from t0 on.

    held   whether the list of stars begins with these stars; none pulls itself
    """
    for i in range(begin, end):
        px, py, pz = offset(lattice, 0, i, cx, cy, cz)
        own = s0 + i - begin
        if held:
            stars[3, own] = 0.0
        sx, sy, sz, near = sum_stars(kind, with_phi, s0, n_stars, px, py, pz, reach, stars)
        if held:
            stars[3, own] = weight[i]
        ux, uy, uz, deep = sum_cells(kind, with_phi, c0, n_cells, px, py, pz, reach, near, cells)
        k = t0 + i - begin
        total[0, k] = total[0, k] + sx + ux
        total[1, k] = total[1, k] + sy + uy
        total[2, k] = total[2, k] + sz + uz
        if ti.static(with_phi):
            total[3, k] = total[3, k] + deep
