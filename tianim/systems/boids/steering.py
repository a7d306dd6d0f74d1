"""The kernel of the steering behaviours; `behaviours.py` has the laws.

One pass over the boids; each goes through the rows of its species in order. Members of a target
species are found through `slot`, where each id is stored.
"""

from tianim.lang import f32_1d, f32_2d, i32_1d, i32_2d, ti
from tianim.math.random import smooth_direction
from tianim.spatial.bodies import signed_distance, surface_velocity
from tianim.spatial.neighbor_lists import nearest_image
from tianim.systems.boids.flocking import TINY, spend
from tianim.systems.boids.tables import (
    ARRIVAL,
    AVOID,
    BUDGET,
    CELLULAR,
    CONTAIN,
    COUNT,
    CRUISE,
    EXTRA,
    FIRST,
    FLEE,
    FLOW,
    KIND,
    LEADER,
    MAX_ACCELERATION,
    MAX_SPEED,
    PATH,
    ROOST,
    SEEK,
    SPECIES,
    TARGET,
    TARGET_VELOCITY,
    VORTEX,
    WANDER,
    WEIGHT,
)

FAR2 = 1e30  # square of a distance beyond every boid [m2]
PATH_LOOK_AHEAD = 0.5  # whoever follows a path minds where it will be then [s]


@ti.func
def column(array: ti.template(), i):
    """Column i of a (3, n) array."""
    return ti.Vector([array[0, i], array[1, i], array[2, i]])


@ti.func
def triple(table: ti.template(), row, first: ti.template()):
    """Three floats of a row."""
    return ti.Vector([table[row, first], table[row, first + 1], table[row, first + 2]])


@ti.func
def unit(d):
    """D / |d|, zero for zero."""
    return d * ti.rsqrt(d.dot(d) + TINY)


@ti.func
def shortest(periodic: ti.template(), d, box: ti.template()):
    """The difference d [m], in periodic bounds the shortest way round; `box`: its lengths [m]."""
    way = d
    if ti.static(periodic):
        for c in ti.static(range(3)):
            way[c] = nearest_image(d[c], box[c])
    return way


@ti.func
def nearest_member(
    periodic: ti.template(),
    table: ti.template(),
    row,
    i,
    slot: ti.template(),
    x: ti.template(),
    box: ti.template(),
):
    """Where the nearest boid of the row's target species is stored, -1 for none."""
    found, best = -1, FAR2
    first = ti.cast(table[row, FIRST], ti.i32)
    at = column(x, i)
    for q in range(first, first + ti.cast(table[row, COUNT], ti.i32)):
        j = slot[q]
        r2 = shortest(periodic, column(x, j) - at, box).norm_sqr()
        if r2 < best and j != i:
            best = r2
            found = j
    return found


@ti.func
def path_point(table: ti.template(), row, path: ti.template(), at):
    """Distance to the path, and the point `ahead` further along it than the nearest."""
    first, corners = ti.cast(table[row, EXTRA + 2], ti.i32), ti.cast(table[row, EXTRA + 3], ti.i32)
    best, along, best_along, length = FAR2, 0.0, 0.0, 0.0
    for k in range(first, first + corners - 1):
        p = ti.Vector([path[k, 0], path[k, 1], path[k, 2]])
        e = ti.Vector([path[k + 1, 0], path[k + 1, 1], path[k + 1, 2]]) - p
        size = e.norm()
        u = ti.min(ti.max((at - p).dot(e) / ti.max(size * size, TINY), 0.0), 1.0)
        r2 = (at - p - u * e).norm_sqr()
        if r2 < best:
            best = r2
            best_along = along + u * size
        along += size
    length = along
    goal = best_along + table[row, EXTRA + 1]
    if table[row, EXTRA + 4] > 0.5:
        goal -= ti.floor(goal / ti.max(length, TINY)) * length
    goal = ti.min(goal, length)
    point = at
    along = 0.0
    for k in range(first, first + corners - 1):
        p = ti.Vector([path[k, 0], path[k, 1], path[k, 2]])
        e = ti.Vector([path[k + 1, 0], path[k + 1, 1], path[k + 1, 2]]) - p
        size = e.norm()
        if along <= goal:
            point = p + ti.min((goal - along) / ti.max(size, TINY), 1.0) * e
        along += size
    return ti.Vector([point.x, point.y, point.z, ti.sqrt(best)])


@ti.func
def flow_velocity(table: ti.template(), row, at):
    """Velocity of the row's field [m/s]."""
    kind = ti.cast(table[row, EXTRA], ti.i32)
    u = triple(table, row, EXTRA + 1)
    if kind == VORTEX:
        axis = triple(table, row, EXTRA + 4)
        arm = at - triple(table, row, EXTRA + 1)
        arm -= arm.dot(axis) * axis
        q = arm / table[row, EXTRA + 7]
        u = table[row, EXTRA + 8] * axis.cross(q) * ti.exp(0.5 * (1.0 - q.dot(q)))
    elif kind == CELLULAR:
        p, q = table[row, EXTRA + 1] * at.x, table[row, EXTRA + 1] * at.y
        u = table[row, EXTRA + 2] * ti.Vector([ti.sin(p) * ti.cos(q), -ti.cos(p) * ti.sin(q), 0.0])
    return u


@ti.func
def contain(table: ti.template(), row, at, velocity):
    """Inward direction times how deep the point ahead is in the margin."""
    p = at + table[row, EXTRA + 1] * velocity - triple(table, row, EXTRA + 2)
    half = triple(table, row, EXTRA + 5)
    margin = table[row, EXTRA]
    wish = ti.Vector([0.0, 0.0, 0.0])
    if half.y < 0.0:
        r = p.norm()
        wish = -p / ti.max(r, TINY) * ti.max(r - half.x + margin, 0.0) / margin
    else:
        for c in ti.static(range(3)):
            over = ti.max(ti.abs(p[c]) - half[c] + ti.min(margin, half[c]), 0.0) / margin
            wish[c] = -ti.select(p[c] > 0.0, over, -over)
    return wish


@ti.func
def avoid(table: ti.template(), row, at, velocity, bodies: ti.template(), samples: ti.template(), body_count):
    """Out of the margins of the bodies, looked at here and along the way ahead."""
    margin, ahead = table[row, EXTRA], table[row, EXTRA + 1]
    wish = ti.Vector([0.0, 0.0, 0.0])
    for b in range(body_count):
        relative = velocity - surface_velocity(bodies, samples, b, at)
        worst, here, normal = 0.0, 0.0, ti.Vector([0.0, 0.0, 0.0])
        for k in range(3):
            hit = signed_distance(bodies, samples, b, at + 0.5 * k * ahead * relative)
            depth = ti.min((margin - hit.w) / margin, 1.0)
            if k == 0:
                here = ti.max(depth, 0.0)
            if depth > worst:
                worst = depth
                normal = hit.xyz
        # Round it, not back: sideways to the way; straight out only as far as it is near now.
        way = unit(relative)
        wish += worst * unit(normal - normal.dot(way) * way) + here * normal
    return wish


@ti.kernel
def find_slots(n: ti.i32, identity: i32_2d, slot: i32_1d):
    """slot[id] = where the boid is stored."""
    for i in range(n):
        slot[identity[0, i]] = i


@ti.kernel
def steer(
    dimension: ti.template(),
    periodic: ti.template(),
    n: ti.i32,
    first: ti.i32,
    last: ti.i32,
    time: ti.f32,
    seed: ti.u32,
    table: f32_2d,
    rules: f32_2d,
    path: f32_2d,
    species: i32_2d,
    identity: i32_2d,
    slot: i32_1d,
    x: f32_2d,
    v: f32_2d,
    box: f32_1d,
    bodies: f32_2d,
    samples: f32_1d,
    body_count: ti.i32,
    acceleration: f32_2d,
):
    """Add behaviours `first` to `last` (excluded) to `acceleration` (4, capacity) [m/s2]."""
    for i in range(n):
        at, velocity = column(x, i), column(v, i)
        kind_of = species[0, i]
        top = rules[kind_of, MAX_SPEED]
        a = ti.Vector([0.0, 0.0, 0.0, 0.0])
        for c in ti.static(range(4)):
            a[c] = acceleration[c, i]
        for row in range(first, last):
            if ti.cast(table[row, SPECIES], ti.i32) != kind_of:
                continue
            kind = ti.cast(table[row, KIND], ti.i32)
            target, target_velocity = triple(table, row, TARGET), triple(table, row, TARGET_VELOCITY)
            there = True
            if table[row, COUNT] > 0.5:
                j = nearest_member(periodic, table, row, i, slot, x, box)
                there = j >= 0
                if there:
                    target, target_velocity = column(x, j), column(v, j)
            if ti.static(periodic):
                target = at + shortest(periodic, target - at, box)
            wish = ti.Vector([0.0, 0.0, 0.0])
            if kind == SEEK or kind == FLEE:
                distance = (target - at).norm()
                target += ti.min(table[row, EXTRA], distance / ti.max(top, TINY)) * target_velocity
                way = unit(target - at)
                if kind == SEEK:
                    wish = top * way - velocity
                elif distance < table[row, EXTRA + 1]:
                    wish = -top * way - velocity
            elif kind == ARRIVAL or kind == LEADER:
                if kind == LEADER:
                    target -= table[row, EXTRA + 1] * unit(target_velocity)
                d = target - at
                speed = top * ti.min(d.norm() / table[row, EXTRA], 1.0)
                wish = speed * unit(d) - velocity
            elif kind == WANDER:
                wish = smooth_direction(
                    seed, identity[0, i], time, table[row, EXTRA], row, ti.static(dimension)
                )
            elif kind == CRUISE:
                wish = (table[row, EXTRA] - velocity.norm()) * unit(velocity)
            elif kind == PATH:
                point = path_point(table, row, path, at + PATH_LOOK_AHEAD * velocity)
                if point.w > table[row, EXTRA]:
                    wish = top * unit(point.xyz - at) - velocity
            elif kind == FLOW:
                wish = flow_velocity(table, row, at) - velocity
            elif kind == ROOST:
                d = shortest(periodic, triple(table, row, EXTRA) - at, box)
                level = ti.Vector([d.x, 0.0, d.z])
                outside = ti.min(ti.max(level.norm() / table[row, EXTRA + 3] - 1.0, 0.0), 1.0)
                wish = outside * unit(level) + ti.Vector([0.0, table[row, EXTRA + 4] * d.y, 0.0])
            elif kind == CONTAIN:
                wish = rules[kind_of, MAX_ACCELERATION] * contain(table, row, at, velocity)
            elif kind == AVOID:
                wish = rules[kind_of, MAX_ACCELERATION] * avoid(
                    table, row, at, velocity, bodies, samples, body_count
                )
            if ti.static(dimension == 2):
                wish.z = 0.0
            if there:
                spend(a, table[row, WEIGHT] * wish, rules[kind_of, BUDGET])
        for c in ti.static(range(4)):
            acceleration[c, i] = a[c]
