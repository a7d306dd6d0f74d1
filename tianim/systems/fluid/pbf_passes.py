"""The passes of Position Based Fluids, on one particle each, and the kernel that runs them (see pbf.py).

A solve is a plan, known beforehand. For the motion: PREPARE, RELAX, then PUSH, RELAX for each further
iteration, with RENEW between them now and then, and FINISH. For the places: RELAX_PLACE, then PUSH_PLACE,
RELAX_PLACE for each further iteration, and PLACE.
"""

from tianim.lang import f32_1d, f32_2d, i32_1d, i32_2d, ti
from tianim.math.smoothing import spline, spline_slope
from tianim.spatial.crew import first_of, last_of, meet, pieces, take
from tianim.spatial.neighbor_lists import nearest_image
from tianim.systems.fluid.motion import limited
from tianim.systems.fluid.pairs import TINY
from tianim.systems.fluid.wall_shares import wall_terms

PREPARE, RELAX, PUSH, RENEW, FINISH, RELAX_PLACE, PUSH_PLACE, PLACE = range(8)
# The largest eigenvalue of D^-1 A is 2.8 on the lattice, 3.2 in a flow: beyond 0.6 the iterations diverge.
RELAXATION = 0.5
# Lowest pressure [Pa] of a box that is full: none.
UNBOUNDED = 1e30


@ti.func
def prepare(
    dimension: ti.template(), full: ti.template(), spreading: ti.template(), i, dt, h, spread,
    inverse_rho: ti.template(), phase: ti.template(), begin: ti.template(), end: ti.template(),
    neighbour: ti.template(), gradient: ti.template(), length: ti.template(), wall: ti.template(),
    flux: ti.template(), density: ti.template(), x: ti.template(), v: ti.template(), way: ti.template(),
    diagonal: ti.template(), source: ti.template(), excess: ti.template(),
):  # fmt: skip
    """Diagonal and source of particle i at its prediction, and the part of C that is not the motion's."""
    square = 0.0
    sx, sy, sz = 0.0, 0.0, 0.0
    ux, uy, uz = way[0, i], way[1, i], way[2, i]
    rate = ux * wall[0, i] + uy * wall[1, i] + uz * wall[2, i]
    apart = ti.Vector([0.0, 0.0, 0.0])
    for k in range(begin[i], end[i]):
        j = neighbour[k]
        gx, gy, gz = gradient[0, k], gradient[1, k], gradient[2, k]
        square += (gx * gx + gy * gy + gz * gz) * inverse_rho[phase[0, j]]
        rate += gx * (ux - way[0, j]) + gy * (uy - way[1, j]) + gz * (uz - way[2, j])
        sx += gx
        sy += gy
        sz += gz
        if ti.static(spreading):
            r2 = TINY * h * h
            for c in ti.static(range(3)):
                difference = nearest_image(x[c, i] - x[c, j], length[c])
                r2 += difference * difference
            w = spline(dimension, ti.sqrt(r2) / h)
            apart += w * w * w * w * ti.Vector([gx, gy, gz])
    g = ti.Vector([wall[0, i], wall[1, i], wall[2, i]])
    own = inverse_rho[phase[0, i]]
    diagonal[i] = square + own * (ti.Vector([sx, sy, sz]) + g).norm_sqr()
    compression = density[i] - 1.0
    moving = rate
    if ti.static(not full):
        moving = ti.min(compression, rate)
    source[i] = moving - dt * flux[i]
    excess[i] = compression - moving
    if ti.static(spreading):
        for c in ti.static(range(3)):
            v[c, i] -= spread * own / dt * apart[c]


@ti.func
def push_of(
    full: ti.template(), i, inverse_rho: ti.template(), phase: ti.template(), begin: ti.template(),
    end: ti.template(), neighbour: ti.template(), gradient: ti.template(), back: ti.template(),
    wall: ti.template(), change: ti.template(),
):  # fmt: skip
    """Acceleration [m/s2] of particle i by the pressures `change`; `full`: by its gradients and `back`."""
    p = change[i]
    x, y, z = p * wall[0, i], p * wall[1, i], p * wall[2, i]
    for k in range(begin[i], end[i]):
        q = change[neighbour[k]]
        if ti.static(full):
            x += p * gradient[0, k] + q * back[0, k]
            y += p * gradient[1, k] + q * back[1, k]
            z += p * gradient[2, k] + q * back[2, k]
        else:
            x += (p + q) * gradient[0, k]
            y += (p + q) * gradient[1, k]
            z += (p + q) * gradient[2, k]
    return -inverse_rho[phase[0, i]] * ti.Vector([x, y, z])


@ti.func
def relax(
    i, dt2, cfm, lone, lowest, begin: ti.template(), end: ti.template(), neighbour: ti.template(),
    gradient: ti.template(), wall: ti.template(), diagonal: ti.template(), source: ti.template(),
    warm: ti.template(), change: ti.template(), moved: ti.template(), density: ti.template(),
):  # fmt: skip
    """One relaxation of the pressure of particle i; gives its C before, which `density` takes down."""
    a, b, c = moved[0, i], moved[1, i], moved[2, i]
    r = source[i] + wall[0, i] * a + wall[1, i] * b + wall[2, i] * c
    for k in range(begin[i], end[i]):
        j = neighbour[k]
        r += (
            gradient[0, k] * (a - moved[0, j])
            + gradient[1, k] * (b - moved[1, j])
            + gradient[2, k] * (c - moved[2, j])
        )
    density[i] = 1.0 + r
    d = diagonal[i]
    before = warm[0, i]
    p = ti.max(before + RELAXATION * (r / (dt2 * ti.max(d, lone)) - cfm * before), lowest)
    p = ti.select(d > lone, p, 0.0)
    warm[0, i] = p
    change[i] += p - before
    return ti.select(d > lone, r, 0.0)


@ti.func
def renew(
    dimension: ti.template(), i, dt, h, scale, inverse_rho: ti.template(), phase: ti.template(),
    begin: ti.template(), end: ti.template(), neighbour: ti.template(), gradient: ti.template(),
    length: ti.template(), flux: ti.template(), share, g, x: ti.template(), v: ti.template(),
    way: ti.template(), moved: ti.template(), diagonal: ti.template(), source: ti.template(),
    excess: ti.template(), change: ti.template(),
):  # fmt: skip
    """Tangent of particle i at x + `moved`, with the walls' `share` and its gradient `g` there.

    From here on count the way in v and the pressure in `change`.
    """
    total, tangent, square = spline(dimension, 0.0), 0.0, 0.0
    sx, sy, sz = 0.0, 0.0, 0.0
    ux, uy, uz = moved[0, i], moved[1, i], moved[2, i]
    for k in range(begin[i], end[i]):
        j = neighbour[k]
        ax, ay, az = ux - moved[0, j], uy - moved[1, j], uz - moved[2, j]
        dx = nearest_image(x[0, i] - x[0, j], length[0]) + ax
        dy = nearest_image(x[1, i] - x[1, j], length[1]) + ay
        dz = nearest_image(x[2, i] - x[2, j], length[2]) + az
        r = ti.sqrt(dx * dx + dy * dy + dz * dz + TINY * h * h)
        total += spline(dimension, r / h)
        slope = scale * spline_slope(dimension, r / h) / (h * r)
        gradient[0, k] = slope * dx
        gradient[1, k] = slope * dy
        gradient[2, k] = slope * dz
        tangent += slope * (dx * ax + dy * ay + dz * az)
        square += slope * slope * r * r * inverse_rho[phase[0, j]]
        sx += slope * dx
        sy += slope * dy
        sz += slope * dz
    diagonal[i] = square + inverse_rho[phase[0, i]] * (ti.Vector([sx, sy, sz]) + g).norm_sqr()
    compression = scale * total + share - 1.0 - tangent - g.dot(ti.Vector([ux, uy, uz]))
    source[i] = compression - dt * flux[i] - excess[i]
    change[i] = 0.0
    for c in ti.static(range(3)):
        v[c, i] = (moved[c, i] + way[c, i]) / dt


@ti.kernel
def solve(
    dimension: ti.template(),
    full: ti.template(),
    spreading: ti.template(),
    first: ti.i32,
    last: ti.i32,
    n: ti.i32,
    dt: ti.f32,
    h: ti.f32,
    scale: ti.f32,
    cfm: ti.f32,
    spread: ti.f32,
    lone: ti.f32,
    limit_p99: ti.f32,
    most_drift: ti.f32,
    tasks: ti.i32,
    stride: ti.i32,
    plan: i32_1d,
    crew: i32_1d,
    sums: f32_2d,
    inverse_rho: f32_1d,
    phase: i32_2d,
    begin: i32_1d,
    end: i32_1d,
    neighbour: i32_1d,
    gradient: f32_2d,
    forward: f32_2d,
    back: f32_2d,
    length: f32_1d,
    walls: ti.i32,
    support: ti.f32,
    table: f32_2d,
    samples: f32_1d,
    shares: f32_2d,
    wall: f32_2d,
    flux: f32_1d,
    distance: f32_1d,
    density: f32_1d,
    start: f32_2d,
    x: f32_2d,
    v: f32_2d,
    way: f32_2d,
    moved: f32_2d,
    diagonal: f32_1d,
    source: f32_1d,
    excess: f32_1d,
    warm: f32_2d,
    change: f32_1d,
    own: f32_2d,
    own_change: f32_1d,
    pressure: f32_1d,
):
    """Passes `first` to `last` - 1 of the plan, between which all tasks meet.

    After the last one x is `start`, v leads on over dt to where the motion is to, and the places are to be
    corrected there by `moved`.
    way: by which the predictions are off `start`; moved, before that: the way from them.
    forward, back: the gradients for the motion; `gradient` but where `full`.
    own, own_change: pressures that correct the places.
    sums: by piece, of max(C, 0) and of the particles with C over `limit_p99` in the last RELAX_PLACE, and of
    |C| in the last RELAX.
    """
    lowest = -UNBOUNDED if ti.static(full) else 0.0
    for block in range(tasks * stride):
        if block % stride == 0:
            for turn in range(first, last):
                work = plan[turn]
                piece = take(crew, turn)
                while piece < pieces(n):
                    total, beyond = 0.0, 0.0
                    for i in range(first_of(piece), last_of(piece, n)):
                        if work == RELAX:
                            c = relax(
                                i, dt * dt, cfm, lone, lowest, begin, end, neighbour, forward, wall, diagonal,
                                source, warm, change, moved, density,
                            )  # fmt: skip
                            total += ti.select(warm[0, i] > 0.0, ti.abs(c), ti.max(c, 0.0))
                        elif work == RELAX_PLACE:
                            c = relax(
                                i, dt * dt, cfm, lone, lowest, begin, end, neighbour, gradient, wall,
                                diagonal, source, own, own_change, moved, density,
                            )  # fmt: skip
                            total += ti.max(c, 0.0)
                            beyond += ti.select(c > limit_p99, 1.0, 0.0)
                        elif work == RENEW:
                            u = ti.Vector([moved[0, i], moved[1, i], moved[2, i]])
                            near = ti.Vector([0.0, 0.0, 0.0, 0.0])
                            if distance[i] < support + u.norm():
                                p = ti.Vector([x[0, i], x[1, i], x[2, i]]) + u
                                near = wall_terms(table, samples, shares, support, walls, p)
                            wall[0, i], wall[1, i], wall[2, i] = near.x, near.y, near.z
                            renew(
                                dimension, i, dt, h, scale, inverse_rho, phase, begin, end, neighbour,
                                gradient, length, flux, near.w, near.xyz, x, v, way, moved, diagonal,
                                source, excess, change,
                            )  # fmt: skip
                        elif work == PUSH_PLACE or work == PLACE:
                            a = push_of(
                                False, i, inverse_rho, phase, begin, end, neighbour, gradient, gradient, wall,
                                own_change,
                            )  # fmt: skip
                            if work == PUSH_PLACE:
                                for c in ti.static(range(3)):
                                    moved[c, i] = dt * v[c, i] - way[c, i] + dt * dt * a[c]
                            else:
                                drift = limited(dt * dt * a, most_drift)
                                for c in ti.static(range(3)):
                                    moved[c, i], x[c, i] = drift[c], start[c, i]
                        else:
                            if work == PREPARE:
                                prepare(
                                    dimension, full, spreading, i, dt, h, spread, inverse_rho, phase, begin,
                                    end, neighbour, forward, length, wall, flux, density, x, v, way,
                                    diagonal, source, excess,
                                )  # fmt: skip
                                own[0, i], own_change[i] = 0.0, 0.0
                            a = push_of(
                                full, i, inverse_rho, phase, begin, end, neighbour, forward, back, wall,
                                change,
                            )  # fmt: skip
                            for c in ti.static(range(3)):
                                moved[c, i] = dt * v[c, i] - way[c, i] + dt * dt * a[c]
                            if work == FINISH:
                                pressure[i] = warm[0, i]
                                source[i] += excess[i]
                                for c in ti.static(range(3)):
                                    v[c, i] += dt * a[c]
                    if work == RELAX:
                        sums[2, piece] = total
                    if work == RELAX_PLACE:
                        sums[0, piece], sums[1, piece] = total, beyond
                    piece = take(crew, turn)
                if turn + 1 < last:
                    meet(crew, tasks)
