"""What a node of the octree holds, and its moments: from its stars, or from its children's.

`link` i32 (6, nodes) and `moment` f32 (9, nodes) have the rows named here. All lengths are in the side
of the cube, all masses in the total mass; places in lattice steps (see morton.py).
"""

from tianim.lang import ti
from tianim.spatial import morton

# Rows of `link`: run of stars, children (first * 8 + number - 1, NONE for a leaf), centre of mass.
BEGIN, END, CHILDREN, CENTRE = 0, 1, 2, 3
LINK_ROWS = 6
# HEAP instead of NONE: a leaf of more than LEAF stars.
NONE, HEAP = -1, -2
# Rows of `moment`: mass, squared radius around the centre of mass, B^(2/5) with B the third moment of
# distance (the sum of m r^3), second moments xx xy xz yy yz zz, all about the centre of mass.
MASS, RADIUS2, SPAN, SECOND = 0, 1, 2, 3
MOMENT_ROWS = 9
STEP = 1.0 / morton.LATTICE  # side of the cube a lattice step
# No node has a smaller radius^2, so that none is taken as a whole where 1/d^5 would leave float32.
LEAST_RADIUS2 = 1e-14


@ti.func
def offset(places: ti.template(), row: ti.template(), i, cx, cy, cz):
    """Place i (rows `row` to `row` + 2, lattice steps) from (cx, cy, cz), in sides of the cube."""
    dx = ti.cast(places[row, i] - cx, ti.f32) * STEP
    dy = ti.cast(places[row + 1, i] - cy, ti.f32) * STEP
    dz = ti.cast(places[row + 2, i] - cz, ti.f32) * STEP
    return dx, dy, dz


@ti.func
def set_moments(q, lattice: ti.template(), weight: ti.template(), link: ti.template(), moment: ti.template()):
    """Mass, centre of mass, radius and moments of node q from its stars."""
    begin, end = link[BEGIN, q], link[END, q]
    set_centre(q, begin, end, True, lattice, weight, link, moment)
    cx, cy, cz = link[CENTRE, q], link[CENTRE + 1, q], link[CENTRE + 2, q]
    xx, xy, xz, yy, yz, zz, third, radius2 = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, LEAST_RADIUS2
    for i in range(begin, end):
        w = weight[i]
        dx, dy, dz = offset(lattice, 0, i, cx, cy, cz)
        r2 = dx * dx + dy * dy + dz * dz
        radius2 = ti.max(radius2, r2)
        third += w * r2 * ti.sqrt(r2)
        xx += w * dx * dx
        xy += w * dx * dy
        xz += w * dx * dz
        yy += w * dy * dy
        yz += w * dy * dz
        zz += w * dz * dz
    moment[RADIUS2, q], moment[SPAN, q] = radius2, ti.pow(third, 0.4)
    moment[SECOND, q], moment[SECOND + 1, q], moment[SECOND + 2, q] = xx, xy, xz
    moment[SECOND + 3, q], moment[SECOND + 4, q], moment[SECOND + 5, q] = yy, yz, zz


@ti.func
def join_moments(
    q, lattice: ti.template(), weight: ti.template(), link: ti.template(), moment: ti.template()
):
    """The same from its children's moments: radius and third moment become upper bounds."""
    first = link[CHILDREN, q] >> 3
    last = first + (link[CHILDREN, q] & 7) + 1
    set_centre(q, first, last, False, lattice, weight, link, moment)
    cx, cy, cz = link[CENTRE, q], link[CENTRE + 1, q], link[CENTRE + 2, q]
    xx, xy, xz, yy, yz, zz, third, radius = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for c in range(first, last):
        w = moment[MASS, c]
        dx, dy, dz = offset(link, CENTRE, c, cx, cy, cz)
        d = ti.sqrt(dx * dx + dy * dy + dz * dz)
        radius = ti.max(radius, d + ti.sqrt(moment[RADIUS2, c]))
        # The cube root of a sum of m |x|^3 is a norm: the triangle's inequality bounds it.
        bound = ti.pow(moment[SPAN, c], 5 / 6) + ti.pow(w, 1 / 3) * d
        third += bound * bound * bound
        xx += moment[SECOND, c] + w * dx * dx
        xy += moment[SECOND + 1, c] + w * dx * dy
        xz += moment[SECOND + 2, c] + w * dx * dz
        yy += moment[SECOND + 3, c] + w * dy * dy
        yz += moment[SECOND + 4, c] + w * dy * dz
        zz += moment[SECOND + 5, c] + w * dz * dz
    moment[RADIUS2, q], moment[SPAN, q] = radius * radius, ti.pow(third, 0.4)
    moment[SECOND, q], moment[SECOND + 1, q], moment[SECOND + 2, q] = xx, xy, xz
    moment[SECOND + 3, q], moment[SECOND + 4, q], moment[SECOND + 5, q] = yy, yz, zz


@ti.func
def set_centre(
    q, first, last, of_stars: ti.template(), lattice: ti.template(), weight: ti.template(),
    link: ti.template(), moment: ti.template(),
):  # fmt: skip
    """Mass and centre of mass of node q from stars first ... last - 1, or from its children so numbered."""
    # In lattice steps from the first, so that nothing is lost but the centre's own rounding.
    x0, y0, z0, _ = member(first, of_stars, lattice, weight, link, moment)
    m, sx, sy, sz, gx, gy, gz = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for i in range(first, last):
        x, y, z, w = member(i, of_stars, lattice, weight, link, moment)
        dx, dy, dz = ti.cast(x - x0, ti.f32), ti.cast(y - y0, ti.f32), ti.cast(z - z0, ti.f32)
        m += w
        sx += w * dx
        sy += w * dy
        sz += w * dz
        gx += dx
        gy += dy
        gz += dz
    # Massless stars have a middle too.
    over = 1.0 / ti.select(m > 0.0, m, ti.cast(last - first, ti.f32))
    moment[MASS, q] = m
    link[CENTRE, q] = x0 + ti.cast(ti.round(ti.select(m > 0.0, sx, gx) * over), ti.i32)
    link[CENTRE + 1, q] = y0 + ti.cast(ti.round(ti.select(m > 0.0, sy, gy) * over), ti.i32)
    link[CENTRE + 2, q] = z0 + ti.cast(ti.round(ti.select(m > 0.0, sz, gz) * over), ti.i32)


@ti.func
def member(
    i, of_stars: ti.template(), lattice: ti.template(), weight: ti.template(), link: ti.template(),
    moment: ti.template(),
):  # fmt: skip
    """Place in lattice steps and mass of star i, or of node i."""
    x, y, z, w = 0, 0, 0, 0.0
    if ti.static(of_stars):
        x, y, z, w = lattice[0, i], lattice[1, i], lattice[2, i], weight[i]
    else:
        x, y, z, w = link[CENTRE, i], link[CENTRE + 1, i], link[CENTRE + 2, i], moment[MASS, i]
    return x, y, z, w
