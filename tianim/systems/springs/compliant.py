"""What one constraint of XPBD does to its points: springs, bending, hinges, walls (`xpbd.py`).

    dlambda = (-k h^2 C - lambda - c h dC) / ((k h^2 + c h) sum_i w_i |grad_i C|^2 + 1)
    x_i += w_i dlambda grad_i C

C is what a constraint is off, dC by how much C has changed since the step began, k its stiffness and c its
damper, w = 1 / m. This is equation 26 of Macklin, Mueller and Chentanez 2016 with alpha = 1 / (k h^2),
multiplied by k h^2, so that a torn spring, k = c = 0, does nothing. As dC is a change of length or of
angle, not grad C . dx, dampers leave what turns alone. Springs in a line share points with the next and the
one before only: their equations are a matrix of three diagonals, solved in one go (as Han and Harada 2013 do
for strands, doi:10.2312/PE.vriphys.vriphys13.011-016). One by one they would pass a pull on from spring to
spring, a step each.

    spring    C = |x_b - x_a| - l, all of a line at once
    bending   C = S x - r S x / |S x|, three numbers: a second difference S, its length r at rest
    hinge     C = theta - theta_0
    wall      x_i goes out of it, and back along it by as much as friction holds
"""

from tianim.lang import ti
from tianim.systems.springs.arrays import triple
from tianim.systems.springs.contact import met_wall, wall_velocity
from tianim.systems.springs.hinges import opening, turned_by

# Columns of `sweep` behind a spring's direction.
UPPER, REST = 3, 4


@ti.func
def move(x: ti.template(), i, by):
    """Add to a row of x; `+=` on an array would be atomic."""
    for c in ti.static(range(3)):
        x[i, c] = x[i, c] + by[c]


@ti.func
def solve_line(
    h, first, line: ti.template(), link: ti.template(), entry: ti.template(), row: ti.template(),
    inverse_mass: ti.template(), start: ti.template(), x: ti.template(), multiplier: ti.template(),
    sweep: ti.template(), m,
):  # fmt: skip
    """All springs of line m at once, by elimination from its first to its last; `first`: lambda counts as 0.

    sweep  of each spring its direction n, then what row s has become: dlambda_s = rest - upper dlambda_s+1
    """
    begin, end = line[m], line[m + 1]
    before = ti.Vector([0.0, 0.0, 0.0], ti.f64)
    rest, passed = ti.cast(0.0, ti.f64), ti.cast(0.0, ti.f64)
    for s in range(begin, end):
        a, b, e = link[s, 0], link[s, 1], entry[s]
        k, c = row[e, 0] * h * h, row[e, 2] * h
        wa, wb = inverse_mass[a], inverse_mass[b]
        n = triple(x, b) - triple(x, a)
        length = n.norm()
        n /= ti.max(length, 1e-30)
        off = -k * (length - row[e, 1])
        if c > 0.0:
            off -= c * (length - (triple(start, b) - triple(start, a)).norm())
        if first == 0:
            off -= multiplier[s]
        turn = before.dot(n)
        upper = passed * turn  # of the spring before
        if s > begin:
            sweep[s - 1, UPPER] = upper
        lower = -(k + c) * wa * turn
        pivot = 1.0 / ((k + c) * (wa + wb) + 1.0 - lower * upper)
        rest, passed, before = (off - lower * rest) * pivot, -(k + c) * wb * pivot, n
        for d in ti.static(range(3)):
            sweep[s, d] = n[d]
        sweep[s, REST] = rest
    change = ti.cast(0.0, ti.f64)
    for back in range(end - begin):
        s = end - 1 - back
        next_one = ti.select(back > 0, sweep[s, UPPER] * change, 0.0)  # nothing follows the last
        change = sweep[s, REST] - next_one
        multiplier[s] = ti.select(first == 1, 0.0, multiplier[s]) + change
        by, a, b = change * triple(sweep, s), link[s, 0], link[s, 1]
        move(x, a, -inverse_mass[a] * by)
        move(x, b, inverse_mass[b] * by)


@ti.func
def solve_bend(
    h, first, corner: ti.template(), coefficient: ti.template(), strength: ti.template(),
    inverse_mass: ti.template(), x: ti.template(), multiplier: ti.template(), m,
):  # fmt: skip
    """One second difference."""
    S, give = ti.Vector([0.0, 0.0, 0.0], ti.f64), ti.cast(0.0, ti.f64)
    for p in ti.static(range(4)):
        i, s = corner[m, p], coefficient[m, p]
        S += s * triple(x, i)
        give += s * s * inverse_mass[i]
    k = strength[m, 0] * h * h
    off = -k * (1.0 - strength[m, 1] / ti.max(S.norm(), 1e-30)) * S
    before = ti.Vector([0.0, 0.0, 0.0], ti.f64)
    if first == 0:
        before = triple(multiplier, m)
    change = (off - before) / (k * give + 1.0)
    for c in ti.static(range(3)):
        multiplier[m, c] = before[c] + change[c]
    for p in ti.static(range(4)):
        i, s = corner[m, p], coefficient[m, p]
        move(x, i, s * inverse_mass[i] * change)


@ti.func
def solve_hinge(
    h, first, points: ti.template(), given: ti.template(), inverse_mass: ti.template(), start: ti.template(),
    x: ti.template(), multiplier: ti.template(), m,
):  # fmt: skip
    """One hinge."""
    pa, pb, pc, pd = points[m, 0], points[m, 1], points[m, 2], points[m, 3]
    theta, ga, gb, gc, gd = opening(triple(x, pa), triple(x, pb), triple(x, pc), triple(x, pd))
    k, c = given[m, 0] * h * h, given[m, 2] * h
    off = -k * turned_by(theta, given[m, 1])
    if c > 0.0:
        old, _a, _b, _c, _d = opening(
            triple(start, pa), triple(start, pb), triple(start, pc), triple(start, pd)
        )
        off -= c * turned_by(theta, old)
    wa, wb, wc, wd = inverse_mass[pa], inverse_mass[pb], inverse_mass[pc], inverse_mass[pd]
    give = wa * ga.norm_sqr() + wb * gb.norm_sqr() + wc * gc.norm_sqr() + wd * gd.norm_sqr()
    before = ti.select(first == 1, 0.0, multiplier[m])
    change = (off - before) / ((k + c) * give + 1.0)
    multiplier[m] = before + change
    move(x, pa, wa * change * ga)
    move(x, pb, wb * change * gb)
    move(x, pc, wc * change * gc)
    move(x, pd, wd * change * gd)


@ti.func
def solve_wall(
    h, first, thickness, table: ti.template(), samples: ti.template(), count, bounds: ti.template(),
    friction: ti.template(), inverse_mass: ti.template(), start: ti.template(), x: ti.template(),
    relief: ti.template(), i,
):  # fmt: skip
    """A point and the wall that it met on its way from `start`.

    What it is pushed beyond its own approach, as it began in the wall, is `relief`: no velocity comes of it.
    """
    if inverse_mass[i] > 0.0:
        begin, end = ti.cast(triple(start, i), ti.f32), ti.cast(triple(x, i), ti.f32)
        hit, which = met_wall(table, samples, count, bounds, thickness, ti.cast(h, ti.f32), begin, end)
        extra = ti.Vector([0.0, 0.0, 0.0], ti.f64)
        if first == 0:
            extra = triple(relief, i)
        if hit.w < thickness:
            n = ti.cast(hit.xyz, ti.f64)
            carried = h * ti.cast(wall_velocity(table, samples, count, which, end), ti.f64)
            d = triple(x, i) - triple(start, i) - carried
            came, out = ti.max(-d.dot(n), 0.0), ti.cast(thickness - hit.w, ti.f64)
            along = d - d.dot(n) * n
            held = ti.min(1.0, friction[which] * ti.min(came, out) / ti.max(along.norm(), 1e-30))
            move(x, i, out * n - held * along)
            extra += ti.max(out - came, 0.0) * n
        for c in ti.static(range(3)):
            relief[i, c] = extra[c]
