"""What strands touch: which points may reach a wall in a step, and the end of it, in length and outside.

A wall's distance is looked up once a step, at the place x where the point begins. In the frame of the nearest
wall the point goes w = dx - b s, s the velocity of the wall at x; no wall is met while

    (1 + a) |w|  <=  d - |b s' - b s| - a / 2 (|b s'| + |b V|) - thickness      for each wall d, s'

a = b |omega| being the angle that a wall turns in the step, V the velocity of its origin. Few points of hair
are nearer than that, and only these follow their way (`contact.py`), by steps as long as that allows: what
rides on a wall, however fast, goes its way in one.
"""

from tianim.lang import ti
from tianim.spatial.bodies import FAR, SPIN, VELOCITY, signed_distance, surface_velocity
from tianim.systems.springs.arrays import triple
from tianim.systems.springs.contact import met_from, wall_gap

# Columns of what is known of a point: its nearest wall's normal, distance and number, what that moves in the
# step, the room there is, 1 + a, and how far walls come by themselves.
NORMAL, GAP, WHICH, WAY, ROOM, SWING, COME, KNOWN = 0, 3, 4, 5, 8, 9, 10, 12
# Distances of meshes are up to 5 % too far (`bodies.py`).
NEARLY = 0.95
# Turns of length and wall about a point at the end: each undoes a little of the other where walls are curved.
SETTLE = 5
# What is no deeper than this, in thicknesses, is moved out a last time.
ENOUGH = 1e-3


@ti.func
def look(
    table: ti.template(), samples: ti.template(), count, bounds: ti.template(), thickness, b, x,
    known: ti.template(), at,
):  # fmt: skip
    """Write down what walls a point may meet that begins at x."""
    side = wall_gap(bounds, x)
    hit, first = side, count
    way = ti.Vector([0.0, 0.0, 0.0])
    for k in range(count):
        other = signed_distance(table, samples, k, x)
        if other.w < hit.w:
            hit, first = other, k
            way = b * surface_velocity(table, samples, k, x)
    room, swing = side.w - way.norm(), 1.0
    come = ti.select(side.w < FAR, way.norm(), 0.0)
    for k in range(count):
        angle = b * ti.Vector([table[k, SPIN], table[k, SPIN + 1], table[k, SPIN + 2]]).norm()
        drift = b * ti.Vector([table[k, VELOCITY], table[k, VELOCITY + 1], table[k, VELOCITY + 2]]).norm()
        gap, own = hit.w, way
        if k != first:
            gap = signed_distance(table, samples, k, x).w
            own = b * surface_velocity(table, samples, k, x)
        turned = 0.5 * angle * (own.norm() + drift)
        room = ti.min(room, NEARLY * gap - (own - way).norm() - turned)
        come = ti.max(come, (own - way).norm() + 2.0 * turned)
        swing = ti.max(swing, 1.0 + angle)
    for c in ti.static(range(4)):
        known[at, NORMAL + c] = hit[c]
    for c in ti.static(range(3)):
        known[at, WAY + c] = way[c]
    known[at, WHICH], known[at, ROOM] = first, room - thickness
    known[at, SWING], known[at, COME] = swing, come


@ti.func
def met(
    table: ti.template(), samples: ti.template(), count, bounds: ti.template(), thickness, b, begin, end,
    known: ti.template(), at,
):  # fmt: skip
    """What a point meets on its way: normal, distance less the thickness, number; 0 where it meets none."""
    hit, which = ti.Vector([0.0, 0.0, 0.0, 0.0]), count
    way = ti.Vector([known[at, WAY], known[at, WAY + 1], known[at, WAY + 2]])
    far = (end - begin - way).norm() * known[at, SWING]
    if far > known[at, ROOM]:
        before = ti.Vector([known[at, 0], known[at, 1], known[at, 2], known[at, GAP]])
        first = ti.cast(known[at, WHICH], ti.i32)
        hit, which = met_from(
            before, first, way, far + known[at, COME], table, samples, count, bounds, thickness, b, begin, end
        )  # fmt: skip
        hit.w = ti.min(hit.w - thickness, 0.0)
    return hit, which


@ti.func
def of_length(d, least, most):
    """D, but no shorter and no longer."""
    length = ti.max(d.norm(), 1e-20)
    return d * (ti.min(ti.max(length, least), most) / length)


@ti.func
def out_of(d, n, depth, least, most):
    """The arm d, its end moved out by `depth` along n, and about its foot where that is too long or short."""
    moved = d + depth * n
    kept = of_length(moved, least, most)
    height, length = moved.dot(n), kept.norm()
    if ti.abs(moved.norm() - length) > 0.0 and ti.abs(height) < length:
        flat = moved - height * n
        wide = ti.sqrt(length * length - height * height)
        kept = height * n + flat * (wide / ti.max(flat.norm(), 1e-20))
    else:
        kept = moved
    return kept


@ti.func
def settle(
    touching: ti.template(), strand, b, limit, first: ti.template(), back: ti.template(), row: ti.template(),
    inverse_mass: ti.template(), base: ti.template(), x: ti.template(), v: ti.template(), thickness,
    table: ti.template(), samples: ti.template(), count, bounds: ti.template(), known: ti.template(), shift,
):  # fmt: skip
    """From the root on, no segment is longer or shorter than the limit, and none is in a body; velocities."""
    h = ti.cast(b, ti.f32)
    for i in range(first[strand], first[strand + 1]):
        if inverse_mass[i] > 0.0:
            least, most = ti.cast(0.0, ti.f64), ti.cast(1e30, ti.f64)
            foot = triple(x, i)
            d = ti.Vector([0.0, 0.0, 0.0], ti.f64)
            if i > first[strand]:
                rest = ti.cast(row[back[i], 1], ti.f64)
                least, most = rest * (1.0 - limit), rest * (1.0 + limit)
                foot = triple(x, i - 1)
                d = of_length(triple(x, i) - foot, least, most)
            if ti.static(touching):
                turn = 0
                while turn < SETTLE:
                    begin, end = ti.cast(triple(base, i), ti.f32), ti.cast(foot + d, ti.f32)
                    hit, _which = met(
                        table, samples, count, bounds, thickness, h, begin, end, known, i - shift
                    )  # fmt: skip
                    turn = ti.select(hit.w < -ENOUGH * thickness, turn + 1, SETTLE)
                    if hit.w < 0.0:
                        d = out_of(d, ti.cast(hit.xyz, ti.f64), ti.cast(-hit.w, ti.f64), least, most)
            for c in ti.static(range(3)):
                x[i, c] = foot[c] + d[c]
                v[i, c] = (x[i, c] - base[i, c]) / b
