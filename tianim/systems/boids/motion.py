"""How a boid moves on what it wants: limits, integration, walls, banking, and what is measured.

Semi-implicit Euler with limits: with a cut to its length's maximum,

    v' = v + dt a,  turned by at most max_turn_rate dt,  min_speed <= |v'| <= max_speed
    x' = x + dt v'

Periodic bounds wrap x', walls of contained bounds reflect, bodies push it out and take the inward
velocity. A boid banks so that its up axis leans into the turn: tan(bank) = a . right / (g + a . up),
low-passed; `lean` is that tangent (an angle would cost an arc tangent a step for what only a frame
shows).
"""

from tianim.lang import f32_1d, f32_2d, f64_2d, i32_1d, i32_2d, ti
from tianim.math.bits import INFINITY_BITS, size_bits
from tianim.math.quaternion import from_axes
from tianim.spatial.bodies import signed_distance, surface_velocity
from tianim.spatial.tubes import share
from tianim.systems.boids.flocking import TINY
from tianim.systems.boids.steering import column
from tianim.systems.boids.tables import (
    BANK_TIME,
    MAX_ACCELERATION,
    MAX_LEAN,
    MAX_SPEED,
    MAX_TURN_RATE,
    MIN_SPEED,
)

GRAVITY = 9.81  # against which a boid banks [m/s2]
# Sums are made over this many fixed pieces, so that they do not depend on the number of threads.
PIECES = 64
# Unit velocity (3), speed, its maximum, place (3), the bits of the largest component of either.
SUMS = 9
RUN = 256


@ti.func
def turned(old, new, angle):
    """`new`, its direction at most `angle` [rad] from `old`'s; the length is kept."""
    result = new
    a, b = old.norm(), new.norm()
    if a > TINY and b > TINY and angle < 3.14159:
        f, g = old / a, new / b
        cosine = f.dot(g)
        if cosine < ti.cos(angle):
            side = g - cosine * f
            size = side.norm()
            if size < 1e-6:
                # Straight back: any side will do, the level one is natural.
                side = ti.Vector([-f.z, 0.0, f.x])
                if ti.abs(f.y) > 0.9:
                    side = ti.Vector([1.0, 0.0, 0.0])
                if f.z == 0.0:
                    side = ti.Vector([-f.y, f.x, 0.0])
                side -= side.dot(f) * f
                size = side.norm()
            result = b * (ti.cos(angle) * f + ti.sin(angle) * side / ti.max(size, TINY))
    return result


@ti.func
def level_axes(forward):
    """Right and up of a boid that does not bank: up as near to +Y as the heading allows."""
    right = ti.Vector([forward.z, 0.0, -forward.x])
    size = right.norm()
    if size < 1e-6:
        right = ti.Vector([1.0, 0.0, 0.0])
        size = 1.0
    right /= size
    return right, forward.cross(right)


@ti.kernel
def integrate(
    dimension: ti.template(),
    n: ti.i32,
    dt: ti.f32,
    rules: f32_2d,
    species: i32_2d,
    acceleration: f32_2d,
    external: f32_2d,
    has_external: ti.i32,
    bounds: f32_2d,
    periodic: ti.i32,
    contained: ti.i32,
    bodies: f32_2d,
    samples: f32_1d,
    body_count: ti.i32,
    x: f32_2d,
    v: f32_2d,
    lean: f32_2d,
):
    """One step of every boid; `bounds` is (2, 3), lower and upper corner [m]."""
    for i in range(n):
        kind = species[0, i]
        a = column(acceleration, i)
        most = rules[kind, MAX_ACCELERATION]
        a *= ti.min(1.0, most * ti.rsqrt(a.dot(a) + TINY))
        if has_external == 1:
            a += column(external, i)
        if ti.static(dimension == 2):
            a.z = 0.0
        old = column(v, i)
        new = old + dt * a
        angle = dt * rules[kind, MAX_TURN_RATE]
        if angle < 3.14159:
            new = turned(old, new, angle)
        speed = new.norm()
        allowed = ti.min(ti.max(speed, rules[kind, MIN_SPEED]), rules[kind, MAX_SPEED])
        if speed > TINY:
            new *= allowed / speed
        if ti.static(dimension == 3):
            # a . right and g + a . up, both times the level speed: no axes to be made and divided.
            level = ti.sqrt(new.x * new.x + new.z * new.z)
            per_speed = 1.0 / ti.max(allowed, TINY)
            rise = GRAVITY * level + a.y * allowed - a.dot(new) * new.y * per_speed
            wanted = (a.x * new.z - a.z * new.x) / ti.max(rise, 1e-3 * level + TINY)
            wanted = ti.min(ti.max(wanted, -rules[kind, MAX_LEAN]), rules[kind, MAX_LEAN])
            lean[0, i] += (wanted - lean[0, i]) * dt / (dt + rules[kind, BANK_TIME])
        p = column(x, i) + dt * new
        for b in range(body_count):
            hit = signed_distance(bodies, samples, b, p)
            if hit.w < 0.0:
                p -= hit.w * hit.xyz
                inward = (new - surface_velocity(bodies, samples, b, p)).dot(hit.xyz)
                new -= ti.min(inward, 0.0) * hit.xyz
        for c in ti.static(range(dimension)):
            lower, upper = bounds[0, c], bounds[1, c]
            if periodic == 1:
                if p[c] < lower:
                    p[c] += upper - lower
                if p[c] >= upper:
                    p[c] -= upper - lower
                if p[c] < lower or p[c] >= upper:
                    p[c] = lower
            if contained == 1:
                if p[c] < lower:
                    p[c] = lower
                    new[c] = ti.abs(new[c])
                if p[c] > upper:
                    p[c] = upper
                    new[c] = -ti.abs(new[c])
        for c in ti.static(range(dimension)):
            x[c, i] = p[c]
            v[c, i] = new[c]


@ti.kernel
def orientation(n: ti.i32, identity: i32_2d, v: f32_2d, lean: f32_2d, out: f32_2d):
    """Quaternions (x, y, z, w) in id order: local +Z along the heading, +Y up, banked."""
    for i in range(n):
        forward = column(v, i)
        speed = forward.norm()
        if speed > TINY:
            forward /= speed
        else:
            forward = ti.Vector([0.0, 0.0, 1.0])
        right, up = level_axes(forward)
        c = ti.rsqrt(1.0 + lean[0, i] * lean[0, i])
        s = lean[0, i] * c
        q = from_axes(c * right - s * up, c * up + s * right, forward)
        for k in ti.static(range(4)):
            out[identity[0, i], k] = q[k]


@ti.kernel
def first_fault(n: ti.i32, bound: ti.f32, identity: i32_2d, x: f32_2d, v: f32_2d, fault: i32_1d):
    """fault[0]: the lowest id that is not finite, fault[1]: that is farther than `bound` [m]; n: none."""
    fault[0] = n
    fault[1] = n
    most = size_bits(bound)
    for i in range(n):
        worst = 0
        for c in ti.static(range(3)):
            worst = ti.max(worst, size_bits(x[c, i]), size_bits(v[c, i]))
        if worst >= INFINITY_BITS:
            ti.atomic_min(fault[0], identity[0, i])
        elif worst > most:
            ti.atomic_min(fault[1], identity[0, i])


@ti.kernel
def sums(n: ti.i32, stride: ti.i32, x: f32_2d, v: f32_2d, out: f64_2d):
    """Sums and maxima over fixed pieces of the boids, as SUMS says."""
    for block in range(PIECES * stride):
        if block % stride == 0:
            piece = block // stride
            total = ti.Vector([0.0] * SUMS, ti.f64)
            worst, begin, end = 0, share(n, piece, PIECES), share(n, piece + 1, PIECES)
            while begin < end:
                # Short runs in float32, which are vectorised, added up in float64.
                run = ti.Vector([0.0] * SUMS)
                for i in range(begin, ti.min(begin + RUN, end)):
                    velocity = column(v, i)
                    speed = velocity.norm()
                    for c in ti.static(range(3)):
                        run[c] += velocity[c] / ti.max(speed, TINY)
                        run[5 + c] += x[c, i]
                        worst = ti.max(worst, size_bits(x[c, i]), size_bits(velocity[c]))
                    run[3] += speed
                    run[4] = ti.max(run[4], speed)
                for k in ti.static(range(SUMS)):
                    total[k] = ti.max(total[k], run[k]) if k == 4 else total[k] + run[k]
                begin += RUN
            total[8] = worst
            for k in ti.static(range(SUMS)):
                out[piece, k] = total[k]
