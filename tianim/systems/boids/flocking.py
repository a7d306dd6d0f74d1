"""The three rules of Reynolds 1987 in one pass over the neighbours.

With d = x_j - x_i over the neighbours j that boid i sees (each rule its own radius and view),

    separation  a = w_s sum -d / |d|^2
    alignment   a = w_a (mean v_j - v_i)
    cohesion    a = w_c  mean d

This is the lecture's reading of a flock as an ordinary differential equation too: repulsion from
individual neighbours, attraction to their centre, alignment to their mean velocity; without
limits nothing else happens to it. Prioritised allocation spends the acceleration budget on what is
urgent, then on separation, alignment, cohesion, then on the rest, cutting what exceeds it.

Topological neighbours (the k nearest): the k-th smallest distance is found by bisection on the
number of candidates within it, which vectorises, and then bounds the three radii.
"""

from tianim.lang import f32_1d, f32_2d, i32_1d, i32_2d, ti
from tianim.spatial.tubes import (
    MOTIONS,
    NX,
    STRIDE,
    TAGGED_MOTIONS,
    TASKS,
    TURN,
    first_row,
    gather_tube,
    pieces,
    rounded,
    slice_of,
    take_turn,
)
from tianim.systems.boids.tables import ALIGNMENT, BUDGET, COHESION, SEPARATION

# Distances below this [m2] count as none: the direction from a boid to itself.
TINY = 1e-12
# Bisection ends when the count fits; 30 halvings are below float32's resolution of the radius.
BISECTIONS = 30


@ti.func
def spend(a: ti.template(), wish, budget):
    """Add `wish` to a[0:3] as far as the budget goes; a[3] is what was spent, as magnitudes."""
    size = wish.norm()
    scale = ti.min(1.0, ti.max(budget - a[3], 0.0) / ti.max(size, TINY))
    for c in ti.static(range(3)):
        a[c] += scale * wish[c]
    a[3] += scale * size


@ti.func
def candidate(dimension: ti.template(), scratch: ti.template(), j):
    """Where candidate j of a tube is [m]."""
    x, y, z = scratch[0, j], scratch[1, j], 0.0
    if ti.static(dimension == 3):
        z = scratch[2, j]
    return x, y, z


@ti.func
def nearest_bound(dimension: ti.template(), k, reach, me, begin, end, scratch: ti.template()):
    """Square of a distance [m2] within which just the k nearest candidates lie, at most `reach`."""
    xi, yi, zi = candidate(dimension, scratch, me)
    low, high, bound = 0.0, reach, reach
    for _ in range(BISECTIONS):
        inside = 0.0
        for j in range(begin, begin + rounded(end - begin)):
            xj, yj, zj = candidate(dimension, scratch, j)
            dx, dy, dz = xj - xi, yj - yi, zj - zi
            r2 = dx * dx + dy * dy + dz * dz
            inside += ti.select((j < end) & (r2 < bound), 1.0, 0.0)
        # The boid itself is among them, beside its k neighbours.
        if inside <= k + 1.5:
            low = bound
            if inside > k + 0.5 or bound >= reach:
                break
        else:
            high = bound
        bound = 0.5 * (low + high)
    return bound


@ti.func
def minded(sighted: ti.template(), rule: ti.template(), rules: ti.template(), kind, bound, r2, ahead, other):
    """Weight of a candidate at distance^2 r2 in a rule: `other`, or 0 where too far or out of view."""
    w = ti.select(r2 < ti.min(rules[kind, rule], bound), other, 0.0)
    if ti.static(sighted):
        w = ti.select(ahead >= rules[kind, rule + 2] * r2, w, 0.0)
    return w


@ti.func
def sums_over(
    dimension: ti.template(),
    species_aware: ti.template(),
    sighted: ti.template(),
    alike: ti.template(),
    kind,
    bound,
    heading,
    me,
    begin,
    end,
    rules: ti.template(),
    interactions: ti.template(),
    scratch: ti.template(),
):
    """Over the neighbours: sum of -d/|d|^2, sum of (v, 1), sum of (d, 1), each in its rule's weights."""
    kinds = rules.shape[0]
    hx, hy, hz = heading.x, heading.y, heading.z
    xi, yi, zi = candidate(dimension, scratch, me)
    sx, sy, sz = 0.0, 0.0, 0.0
    ax, ay, az, aligned = 0.0, 0.0, 0.0, 0.0
    cx, cy, cz, gathered = 0.0, 0.0, 0.0, 0.0
    for j in range(begin, begin + rounded(end - begin)):
        xj, yj, zj = candidate(dimension, scratch, j)
        dx, dy, dz = xj - xi, yj - yi, zj - zi
        r2 = dx * dx + dy * dy + dz * dz
        other = ti.select((j < end) & (j != me), 1.0, 0.0)
        ahead = 0.0
        if ti.static(sighted):
            ahead = dx * hx + dy * hy + dz * hz
            ahead *= ti.abs(ahead)
        ws = minded(sighted, SEPARATION, rules, kind, bound, r2, ahead, other)
        wa, wc = ws, ws
        if ti.static(not alike):
            wa = minded(sighted, ALIGNMENT, rules, kind, bound, r2, ahead, other)
            wc = minded(sighted, COHESION, rules, kind, bound, r2, ahead, other)
        if ti.static(species_aware):
            pair = kind * kinds + ti.cast(scratch[6, j], ti.i32)
            pair = ti.min(ti.max(pair, 0), kinds * kinds - 1)
            ws *= interactions[pair, 0]
            wa *= interactions[pair, 1]
            wc *= interactions[pair, 2]
        ws /= ti.max(r2, TINY)
        sx -= ws * dx
        sy -= ws * dy
        ax += wa * scratch[3, j]
        ay += wa * scratch[4, j]
        aligned += wa
        cx += wc * dx
        cy += wc * dy
        gathered += wc
        if ti.static(dimension == 3):
            sz -= ws * dz
            az += wa * scratch[5, j]
            cz += wc * dz
    return ti.Vector([sx, sy, sz]), ti.Vector([ax, ay, az, aligned]), ti.Vector([cx, cy, cz, gathered])


@ti.func
def spend_rules(a: ti.template(), kind, velocity, apart, along, together, rules: ti.template()):
    """Add the three rules to `a` in the order of their urgency, from the sums of `sums_over`."""
    budget = rules[kind, BUDGET]
    spend(a, rules[kind, SEPARATION + 1] * apart, budget)
    if along.w > 0.0:
        spend(a, rules[kind, ALIGNMENT + 1] * (along.xyz / along.w - velocity), budget)
    if together.w > 0.0:
        spend(a, rules[kind, COHESION + 1] / together.w * together.xyz, budget)


@ti.kernel
def flock(
    dimension: ti.template(),
    species_aware: ti.template(),
    topological: ti.template(),
    sighted: ti.template(),
    alike: ti.template(),
    k: ti.i32,
    rules: f32_2d,
    interactions: f32_2d,
    species: i32_2d,
    shape: i32_1d,
    geometry: f32_1d,
    start: i32_1d,
    x: f32_2d,
    v: f32_2d,
    scratch: f32_2d,
    offset: i32_2d,
    acceleration: f32_2d,
):
    """Add the three rules to `acceleration` (4, capacity) [m/s2], row 3 what the budget has spent."""
    nx = shape[NX]
    shape[TURN] = 0
    for block in range(shape[TASKS] * shape[STRIDE]):
        if block % shape[STRIDE] == 0:
            task = block // shape[STRIDE]
            piece = take_turn(shape)
            while piece < pieces(shape):
                for row in range(first_row(piece, shape, start), first_row(piece + 1, shape, start)):
                    if start[row * nx + nx] == start[row * nx]:
                        continue
                    gather_tube(
                        dimension, TAGGED_MOTIONS if species_aware else MOTIONS, task, row, shape, geometry,
                        start, x, v, species, scratch, offset,
                    )  # fmt: skip
                    for column in range(nx):
                        cell, s = row * nx + column, slice_of(column, nx)
                        begin, end = offset[task, s - 1], offset[task, s + 2]
                        for i in range(start[cell], start[cell + 1]):
                            me = offset[task, s] + i - start[cell]
                            kind = 0
                            if ti.static(species_aware):
                                kind = species[0, i]
                            bound = ti.max(
                                rules[kind, SEPARATION], rules[kind, ALIGNMENT], rules[kind, COHESION]
                            )
                            if ti.static(topological):
                                bound = nearest_bound(dimension, k, bound, me, begin, end, scratch)
                            velocity = ti.Vector([v[0, i], v[1, i], v[2, i]])
                            heading = velocity * ti.rsqrt(velocity.dot(velocity) + TINY)
                            apart, along, together = sums_over(
                                dimension, species_aware, sighted, alike, kind, bound, heading, me,
                                begin, end, rules, interactions, scratch,
                            )  # fmt: skip
                            a = ti.Vector([0.0, 0.0, 0.0, 0.0])
                            for c in ti.static(range(4)):
                                a[c] = acceleration[c, i]
                            spend_rules(a, kind, velocity, apart, along, together, rules)
                            for c in ti.static(range(4)):
                                acceleration[c, i] = a[c]
                piece = take_turn(shape)
