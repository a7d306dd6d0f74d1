"""Contacts with walls: no particle goes through one, however fast, thin or moving.

A particle is led along its path of a step, x + t v, in pieces too short to pass the middle of anything
thin, with the walls where they are at that time. Where it would be nearer to a wall than `least`, or than
it was at the start, it is put back along the normal, some sweeps over all walls; its velocity becomes what
leads it there. Nothing bounces. Friction takes off the tangential motion, up to the normal one times
Coulomb's coefficient.

What the particle loses the wall gets, as an impulse at the place of contact.
"""

from tianim.lang import f32_1d, f32_2d, f64_2d, i32_1d, i32_2d, ti
from tianim.spatial.bodies import (
    POSITION,
    RATE,
    SPIN,
    VELOCITY,
    distance_ahead,
    signed_distance,
    surface_velocity,
)
from tianim.spatial.neighbor_lists import wrapped
from tianim.systems.fluid.wall_shares import COULOMB, FLAT, flat

# Sweeps over all walls: a corner of three needs three, edges of grids some more.
SWEEPS = 6
# A path is followed in so many pieces at the most: 50 spacings a step past the thinnest things.
MOST_PIECES = 256
# Deeper than `least`, a particle may stay as deep as it is, less this part of `least` a step: rounding
# errors must not lead it in, and a place that it was given must not throw it out.
CREEP = 0.004


@ti.func
def _triple(table: ti.template(), b, column: ti.template()):
    return ti.Vector([table[b, column], table[b, column + 1], table[b, column + 2]])


@ti.func
def seen_ahead(table: ti.template(), samples: ti.template(), b, x, ahead):
    """Normal and distance of wall `b` from `x`, `ahead` seconds after its pose, moved as a rigid body."""
    return flat(table, b, distance_ahead(table, samples, b, x, ahead))


@ti.func
def rigid_velocity(table: ti.template(), b, x, ahead):
    """Velocity of wall `b` at `x`, `ahead` seconds after its pose."""
    velocity = _triple(table, b, VELOCITY)
    velocity += _triple(table, b, SPIN).cross(x - _triple(table, b, POSITION) - ahead * velocity)
    if table[b, FLAT] > 0.0:
        velocity.z = 0.0
    return velocity


@ti.func
def bending_speed(table: ti.template(), samples: ti.template(), b, x, hit):
    """How fast the surface of a mesh sequence comes towards `x` by its change of shape [m/s]."""
    speed = 0.0
    if table[b, RATE] != 0.0:
        bending = surface_velocity(table, samples, b, x) - rigid_velocity(table, b, x, 0.0)
        speed = bending.dot(hit.xyz)
    return speed


@ti.func
def add_impulse(table: ti.template(), sums: ti.template(), k, b, x, impulse):
    """Count `impulse` [N s] on wall `b` at `x`, in range `k` of the sums."""
    moment = (x - _triple(table, b, POSITION)).cross(impulse)
    for c in ti.static(range(3)):
        # Not +=, which would be atomic: a range belongs to one task.
        sums[k, 6 * b + c] = sums[k, 6 * b + c] + impulse[c]
        sums[k, 6 * b + 3 + c] = sums[k, 6 * b + 3 + c] + moment[c]


@ti.func
def pieces_of_path(
    table: ti.template(), samples: ti.template(), starts: ti.template(), task, count, p, u, dt, least, piece
):
    """In how many pieces the path from `p` with velocity `u` is followed; 0 where it meets no wall.

    Leaves in `starts` (tasks, 2 count) the distance of each wall from `p`, and how fast it bends closer.
    """
    longest = -1.0
    for b in range(count):
        hit = flat(table, b, signed_distance(table, samples, b, p))
        bending = bending_speed(table, samples, b, p, hit)
        starts[task, 2 * b], starts[task, 2 * b + 1] = hit.w, bending
        reach = ((u - rigid_velocity(table, b, p, 0.0)).norm() + ti.abs(bending)) * dt
        if hit.w < reach + least:
            longest = ti.max(longest, reach)
    pieces = 0
    if longest >= 0.0:
        pieces = ti.max(ti.min(ti.cast(ti.ceil(longest / piece), ti.i32), MOST_PIECES), 1)
    return pieces


@ti.func
def rubbed(motion, n, depth, coulomb):
    """What friction leaves of a sliding `motion` along a wall that pushes by `depth` along `n`."""
    along = motion - motion.dot(n) * n
    length = along.norm()
    return motion - along * ti.min(coulomb * depth / ti.max(length, 1e-20), 1.0)


@ti.func
def led_along(
    table: ti.template(), samples: ti.template(), starts: ti.template(), sums: ti.template(),
    task, count, k, p, u, dt, least, pieces, mass,
):  # fmt: skip
    """Where a particle of `mass` that leaves `p` with velocity `u` is after `dt`, and 1 where walls led it.

    They get the impulses.
    """
    at, contact = p, 0.0
    move = u * dt / pieces
    for piece in range(pieces):
        ahead = dt * (piece + 1) / pieces
        left = pieces - 1 - piece
        began = at
        at += move
        sweep = 0
        while sweep < SWEEPS:
            sweep += 1
            touched = 0
            for b in range(count):
                hit = seen_ahead(table, samples, b, at, ahead)
                n = hit.xyz
                allowed = ti.min(least, starts[task, 2 * b] + CREEP * least)
                depth = allowed - hit.w + ahead * starts[task, 2 * b + 1]
                if depth > 0.0:
                    touched, contact = 1, 1.0
                    wall = (dt / pieces) * rigid_velocity(table, b, at, ahead)
                    coulomb = table[b, COULOMB]
                    placed = began + wall + rubbed(at + depth * n - began - wall, n, depth, coulomb)
                    against = ti.max(-(move - wall).dot(n), 0.0)
                    turned = wall + rubbed(move + against * n - wall, n, against, coulomb)
                    change = placed - at + left * (turned - move)
                    add_impulse(table, sums, k, b, at, -(mass / dt) * change)
                    at, move = placed, turned
            if touched == 0:
                sweep = SWEEPS
    return ti.Vector([at.x, at.y, at.z, contact])


@ti.kernel
def hold_velocities(
    n: ti.i32,
    tasks: ti.i32,
    stride: ti.i32,
    ranges: ti.i32,
    count: ti.i32,
    dt: ti.f32,
    least: ti.f32,
    piece: ti.f32,
    fastest: ti.f32,
    slack: ti.f32,
    volume: ti.f32,
    table: f32_2d,
    samples: f32_1d,
    x: f32_2d,
    v: f32_2d,
    distance: f32_1d,
    phase: i32_2d,
    rest_density: f32_1d,
    starts: f32_2d,
    sums: f64_2d,
):
    """Velocities that lead no particle into a wall.

    No wall moves faster than `fastest` [m/s]; `distance` may be too large by `slack` [m].
    """
    size = (n + ranges - 1) // ranges
    for block in range(tasks * stride):
        if block % stride == 0:
            task = block // stride
            k = task
            while k < ranges:
                for i in range(k * size, ti.min(n, (k + 1) * size)):
                    u = ti.Vector([v[0, i], v[1, i], v[2, i]])
                    if distance[i] < least + slack + (u.norm() + fastest) * dt:
                        p = ti.Vector([x[0, i], x[1, i], x[2, i]])
                        pieces = pieces_of_path(table, samples, starts, task, count, p, u, dt, least, piece)
                        if pieces > 0:
                            mass = volume * rest_density[phase[0, i]]
                            end = led_along(
                                table, samples, starts, sums, task, count, k, p, u, dt, least, pieces, mass
                            )
                            if end.w > 0.0:
                                for c in ti.static(range(3)):
                                    v[c, i] = (end[c] - p[c]) / dt
                k += tasks


@ti.kernel
def shift_places(
    n: ti.i32,
    count: ti.i32,
    dt: ti.f32,
    least: ti.f32,
    fastest: ti.f32,
    slack: ti.f32,
    table: f32_2d,
    samples: f32_1d,
    lower: f32_1d,
    length: f32_1d,
    way: f32_2d,
    distance: f32_1d,
    x: f32_2d,
    v: f32_2d,
):
    """Move x by `way`, no nearer to a wall, `dt` after its pose, than `least` or than it is."""
    for i in range(n):
        p = ti.Vector([x[0, i], x[1, i], x[2, i]])
        end = p + ti.Vector([way[0, i], way[1, i], way[2, i]])
        u = ti.Vector([v[0, i], v[1, i], v[2, i]])
        if distance[i] < least + slack + (u.norm() + fastest) * dt:
            sweep = 0
            while sweep < SWEEPS:
                sweep += 1
                touched = 0
                for b in range(count):
                    hit = seen_ahead(table, samples, b, end, dt)
                    if hit.w < least:
                        depth = ti.min(seen_ahead(table, samples, b, p, dt).w, least) - hit.w
                        if depth > 0.0:
                            touched = 1
                            end += depth * hit.xyz
                if touched == 0:
                    sweep = SWEEPS
        for c in ti.static(range(3)):
            x[c, i] = wrapped(end[c], lower[c], length[c])


@ti.kernel
def clamp_places(
    n: ti.i32,
    count: ti.i32,
    dt: ti.f32,
    least: ti.f32,
    fastest: ti.f32,
    slack: ti.f32,
    table: f32_2d,
    samples: f32_1d,
    x: f32_2d,
    v: f32_2d,
    distance: f32_1d,
    moved: i32_1d,
):
    """Move particles that are in a wall, `dt` after its pose, to `least` before it; mark them."""
    for i in range(n):
        moved[i] = 0
        u = ti.Vector([v[0, i], v[1, i], v[2, i]])
        if distance[i] < slack + (u.norm() + fastest) * dt:
            p = ti.Vector([x[0, i], x[1, i], x[2, i]])
            sweep = 0
            while sweep < SWEEPS:
                sweep += 1
                touched = 0
                for b in range(count):
                    hit = seen_ahead(table, samples, b, p, dt)
                    inside = dt * bending_speed(table, samples, b, p, hit) - hit.w
                    if inside > 0.0:
                        touched = 1
                        moved[i] = 1
                        p += (least + inside) * hit.xyz
                        rate = u - rigid_velocity(table, b, p, dt)
                        u += ti.max(-rate.dot(hit.xyz), 0.0) * hit.xyz
                if touched == 0:
                    sweep = SWEEPS
            for c in ti.static(range(3)):
                x[c, i], v[c, i] = p[c], u[c]
