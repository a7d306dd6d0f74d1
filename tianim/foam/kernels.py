"""Kernels of the foam pass: what the fluid does around its own particles and around those of foam.

Fluid particles are in cell order (`NeighborGrid.sort`); each kernel walks the 27 cells around a place
(9 in 2D). The kernel of all sums is Ihmsen's W = 1 - r / h; sums are given as shares of what a full
neighbourhood has, S = sum W, so that thresholds hold for any support and dimension.
"""

from tianim.lang import f32_1d, f32_2d, i32_1d, ti
from tianim.math.random import unit_interval, words
from tianim.spatial.bodies import signed_distance, surface_velocity
from tianim.spatial.grid import cell_coordinate
from tianim.spatial.neighbor_lists import nearest_image
from tianim.spatial.sections import in_plane
from tianim.spatial.tubes import NX, NY, NZ

SPRAY, FOAM, BUBBLE = 0, 1, 2
# Length of the normal's sum below which a particle is within the fluid. A flat surface has 0.25, a
# jittered inside 0.1.
SURFACE = 0.12
# Cosine between velocity and normal from which a crest moves outwards (Ihmsen et al.: 0.6).
OUTWARDS = 0.6
# A wall is touched within this share of a spacing.
TOUCHING = 0.25
# Columns of the options' array.
(
    H, FULL, LOW_AIR, HIGH_AIR, LOW_CREST, HIGH_CREST, LOW_SPEED, HIGH_SPEED, AIR_RATE, CREST_RATE,
    SPRAY_BELOW, BUBBLE_ABOVE, RISE, DRAG, SPACING, GRAVITY,
) = range(16)  # fmt: skip
OPTIONS = 18  # gravity takes three


@ti.func
def ramp(value, low, high):
    """0 below `low`, 1 above `high`, linear between; a step where they are the same."""
    share = (value - low) / ti.max(high - low, 1e-12)
    return ti.min(ti.max(share, 0.0), 1.0)


@ti.func
def difference(x: ti.template(), j, at, length: ti.template()):
    """From `at` to fluid particle j, to its nearest image [m]."""
    d = ti.Vector([x[0, j] - at.x, x[1, j] - at.y, x[2, j] - at.z])
    for c in ti.static(range(3)):
        d[c] = nearest_image(d[c], length[c])
    return d


@ti.func
def cell_of(at, shape: ti.template(), geometry: ti.template()):
    """Cell coordinates of a place."""
    return ti.Vector([cell_coordinate(at[c], c, shape, geometry) for c in ti.static(range(3))])


@ti.func
def cell_beside(cell, k, shape: ti.template()):
    """Number of the cell k (0 to 26, or to 8 in 2D) around `cell`."""
    cx = (cell.x + k % 3 - 1 + shape[NX]) % shape[NX]
    cy = (cell.y + k // 3 % 3 - 1 + shape[NY]) % shape[NY]
    cz = cell.z
    if shape[NZ] > 1:
        cz = (cell.z + k // 9 - 1 + shape[NZ]) % shape[NZ]
    return (cz * shape[NY] + cy) * shape[NX] + cx


@ti.kernel
def find_normals(
    dimension: ti.template(),
    n: ti.i32,
    options: f32_1d,
    shape: i32_1d,
    geometry: f32_1d,
    length: f32_1d,
    start: i32_1d,
    x: f32_2d,
    normal: f32_2d,
):
    """Unit vector out of the fluid, n_i = -sum_j W x_ij / S, where that is a surface; 0 elsewhere."""
    for i in range(n):
        at = ti.Vector([x[0, i], x[1, i], x[2, i]])
        cell = cell_of(at, shape, geometry)
        total = ti.Vector([0.0, 0.0, 0.0])
        for k in range(ti.static(3**dimension)):
            c = cell_beside(cell, k, shape)
            for j in range(start[c], start[c + 1]):
                d = difference(x, j, at, length)
                r = d.norm()
                if r < options[H] and j != i:
                    total -= d * ((1.0 - r / options[H]) / ti.max(r, 1e-12))
        size = total.norm() / options[FULL]
        share = ti.select(size > SURFACE, 1.0 / ti.max(total.norm(), 1e-12), 0.0)
        for c in ti.static(range(3)):
            normal[c, i] = share * total[c]


@ti.kernel
def find_rates(
    dimension: ti.template(),
    n: ti.i32,
    options: f32_1d,
    shape: i32_1d,
    geometry: f32_1d,
    length: f32_1d,
    start: i32_1d,
    x: f32_2d,
    v: f32_2d,
    normal: f32_2d,
    rate: f32_2d,
):
    """Particles of foam that each particle of fluid makes [1/s], and how much it had to (0 to 1)."""
    for i in range(n):
        at = ti.Vector([x[0, i], x[1, i], x[2, i]])
        speed = ti.Vector([v[0, i], v[1, i], v[2, i]])
        out = ti.Vector([normal[0, i], normal[1, i], normal[2, i]])
        energy = ramp(speed.norm_sqr(), options[LOW_SPEED] ** 2, options[HIGH_SPEED] ** 2)
        air, crest = 0.0, 0.0
        if energy > 0.0:
            cell = cell_of(at, shape, geometry)
            for k in range(ti.static(3**dimension)):
                c = cell_beside(cell, k, shape)
                for j in range(start[c], start[c + 1]):
                    d = difference(x, j, at, length)
                    r = d.norm()
                    if r < options[H] and j != i:
                        w = 1.0 - r / options[H]
                        other = ti.Vector([v[0, j], v[1, j], v[2, j]])
                        # |v_ij| (1 - cos(v_ij, x_ij)), with v_ij = v_i - v_j and x_ij = x_i - x_j = -d.
                        closing = speed - other
                        air += w * (closing.norm() + closing.dot(d) / ti.max(r, 1e-12))
                        across = ti.Vector([normal[0, j], normal[1, j], normal[2, j]])
                        if d.dot(out) < 0.0 and across.norm_sqr() > 0.0:
                            crest += w * (1.0 - out.dot(across))
        if speed.dot(out) < OUTWARDS * speed.norm() or out.norm_sqr() == 0.0:
            crest = 0.0
        full = options[FULL]
        air = ramp(air / full, options[LOW_AIR], options[HIGH_AIR])
        crest = ramp(crest / full, options[LOW_CREST], options[HIGH_CREST])
        rate[0, i] = energy * (options[AIR_RATE] * air + options[CREST_RATE] * crest)
        rate[1, i] = energy * ti.max(air, crest)


@ti.func
def fluid_around(
    dimension: ti.template(),
    at,
    options: ti.template(),
    shape: ti.template(),
    geometry: ti.template(),
    length: ti.template(),
    start: ti.template(),
    x: ti.template(),
    v: ti.template(),
):
    """Mean velocity of the fluid near `at`, and how full its neighbourhood is (1: full)."""
    cell = cell_of(at, shape, geometry)
    total = ti.Vector([0.0, 0.0, 0.0])
    weight, near = 0.0, 0.0
    for k in range(ti.static(3**dimension)):
        c = cell_beside(cell, k, shape)
        for j in range(start[c], start[c + 1]):
            r = difference(x, j, at, length).norm() / options[H]
            if r < 1.0:
                near += 1.0
                # Cubic spline, without its constant.
                w = ti.select(r < 0.5, 1.0 - 6.0 * r * r * (1.0 - r), 2.0 * (1.0 - r) ** 3)
                weight += w
                total += w * ti.Vector([v[0, j], v[1, j], v[2, j]])
    ball = ti.static(4.1887902 if dimension == 3 else 3.1415927)  # of radius 1
    full = ball * (options[H] / options[SPACING]) ** dimension
    return total / ti.max(weight, 1e-12), near / full


@ti.func
def open_share(dimension: ti.template(), distance):
    """Share of a ball of radius 1 that is before a wall at a distance (0 to 1) of its middle."""
    u = ti.min(ti.max(distance, 0.0), 1.0)
    behind = 0.25 * (1.0 - u) ** 2 * (2.0 + u)
    if ti.static(dimension == 2):
        behind = (ti.acos(u) - u * ti.sqrt(1.0 - u * u)) / 3.1415927
    return 1.0 - behind


@ti.func
def room_around(
    dimension: ti.template(),
    at,
    reach,
    bounded,
    box: ti.template(),
    bodies,
    table: ti.template(),
    samples: ti.template(),
):
    """Share of a neighbourhood that walls and bodies leave to the fluid: as if each were flat."""
    share, least = 1.0, 0.5**dimension
    for b in range(bodies):
        hit = signed_distance(table, samples, b, at)
        if ti.static(dimension == 2):
            hit = in_plane(hit)
        share *= open_share(dimension, hit.w / reach)
    if bounded == 1:
        for c in ti.static(range(dimension)):
            share *= open_share(dimension, (at[c] - box[0, c]) / reach)
            share *= open_share(dimension, (box[1, c] - at[c]) / reach)
    return ti.max(share, least)


@ti.func
def kept_in(
    dimension: ti.template(),
    bounded,
    box: ti.template(),
    length: ti.template(),
    bodies,
    table: ti.template(),
    samples: ti.template(),
    touch,
    at,
    velocity,
):
    """(place, velocity, touches): out of all bodies and in the domain; whether a wall is within `touch`.

    `box` has the corners of the domain in its rows; `bounded` is 0 open, 1 walls, 2 periodic.
    """
    touches = 0
    for b in range(bodies):
        hit = signed_distance(table, samples, b, at)
        if ti.static(dimension == 2):
            hit = in_plane(hit)
        if hit.w < touch:
            touches = 1
        if hit.w < 0.0:
            at -= hit.w * hit.xyz
            into = (velocity - surface_velocity(table, samples, b, at)).dot(hit.xyz)
            velocity -= ti.min(into, 0.0) * hit.xyz
    for c in ti.static(range(dimension)):
        if bounded == 1:
            if at[c] < box[0, c] + touch or at[c] > box[1, c] - touch:
                touches = 1
            if at[c] < box[0, c]:
                at[c] = box[0, c]
                velocity[c] = ti.max(velocity[c], 0.0)
            if at[c] > box[1, c]:
                at[c] = box[1, c]
                velocity[c] = ti.min(velocity[c], 0.0)
        if bounded == 2:
            at[c] -= length[c] * ti.floor((at[c] - box[0, c]) / length[c])
    return at, velocity, touches


@ti.kernel
def move_foam(
    dimension: ti.template(),
    dt: ti.f32,
    options: f32_1d,
    shape: i32_1d,
    geometry: f32_1d,
    length: f32_1d,
    start: i32_1d,
    x: f32_2d,
    v: f32_2d,
    bounded: ti.i32,
    box: f32_2d,
    bodies: ti.i32,
    table: f32_2d,
    samples: f32_1d,
    position: f32_2d,
    velocity: f32_2d,
    age: f32_1d,
    life: f32_1d,
    kind: i32_1d,
):
    """Advance foam (n, 3) by dt: spray flies, foam goes with the fluid, bubbles rise to it.

    What touches a wall without being in the fluid dries as foam does.
    """
    for i in range(position.shape[0]):
        at = ti.Vector([position[i, 0], position[i, 1], position[i, 2]])
        u = ti.Vector([velocity[i, 0], velocity[i, 1], velocity[i, 2]])
        g = ti.Vector([options[GRAVITY], options[GRAVITY + 1], options[GRAVITY + 2]])
        stream, fullness = fluid_around(dimension, at, options, shape, geometry, length, start, x, v)
        fullness /= room_around(dimension, at, options[H], bounded, box, bodies, table, samples)
        what = FOAM
        if fullness < options[SPRAY_BELOW]:
            what = SPRAY
            at += dt * u + 0.5 * dt * dt * g
            u += dt * g
        elif fullness > options[BUBBLE_ABOVE]:
            what = BUBBLE
            goal = stream - options[RISE] * g / ti.max(g.norm(), 1e-12)
            u = goal + (u - goal) * ti.exp(-options[DRAG] * dt)
            at += dt * u
        else:
            u = stream
            at += dt * u
        touch = options[SPACING] * TOUCHING
        at, u, touches = kept_in(dimension, bounded, box, length, bodies, table, samples, touch, at, u)
        if what == FOAM or (what == SPRAY and touches == 1):
            life[i] -= dt
        age[i] += dt
        kind[i] = what
        for c in ti.static(range(3)):
            position[i, c] = at[c]
            velocity[i, c] = u[c]


@ti.kernel
def scatter_foam(
    dimension: ti.template(),
    seed: ti.u32,
    step: ti.u32,
    dt: ti.f32,
    radius: ti.f32,
    spread: ti.f32,
    length: f32_1d,
    bounded: ti.i32,
    box: f32_2d,
    bodies: ti.i32,
    table: f32_2d,
    samples: f32_1d,
    parent: f32_2d,
    parent_id: i32_1d,
    turn: i32_1d,
    position: f32_2d,
    velocity: f32_2d,
):
    """New foam in the cylinder that its parent (position, velocity) sweeps in dt, itself in the middle.

    `turn` numbers the foam of one parent. In 2D the cylinder is a strip.
    """
    for i in range(position.shape[0]):
        at = ti.Vector([parent[i, 0], parent[i, 1], parent[i, 2]])
        u = ti.Vector([parent[i, 3], parent[i, 4], parent[i, 5]])
        bits = words(seed, parent_id[i], step, turn[i] + 1)
        r = ti.sqrt(unit_interval(bits.x))
        angle = 6.2831853 * unit_interval(bits.y)
        along = u / ti.max(u.norm(), 1e-12)
        a = ti.Vector([-along.y, along.x, 0.0])
        b = ti.Vector([0.0, 0.0, 0.0])
        if ti.static(dimension == 3):
            axis = ti.Vector([1.0, 0.0, 0.0])
            if ti.abs(along.x) > 0.7:
                axis = ti.Vector([0.0, 1.0, 0.0])
            a = along.cross(axis).normalized()
            b = along.cross(a)
        side = r * (ti.cos(angle) * a + ti.sin(angle) * b)
        new = at + radius * side + dt * (unit_interval(bits.z) - 0.5) * u
        u += spread * u.norm() * side
        new, u, _ = kept_in(dimension, bounded, box, length, bodies, table, samples, 0.0, new, u)
        for c in ti.static(range(3)):
            position[i, c] = new[c]
            velocity[i, c] = u[c]
