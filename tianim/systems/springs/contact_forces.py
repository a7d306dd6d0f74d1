"""Contact within the iterations of the implicit solve: forces that make points lack nothing.

    lambda_i += (m / b^2 + s_i) e_i,  in the cone of friction
    applied_i = lambda_i + n sum_j k_ij (e_i - e_j) . n

e is what a point lacks: its depth along the normal n less what it slid in this step; the sum is over the
neighbours in contact. Where a whole patch lacks the same, nothing but its mass resists, and lambda does it in
one iteration; where points lack differently, the springs between them resist, and the sum does it in one: it
pulls some and pushes others, and is gone when nothing is lacking. At the edge of a patch the rest is drawn
along, as far as waves come in a step: as stiff as s_i = sum sqrt(k_ij m / b^2) over the neighbours that do
not touch. All are at most as stiff as the patch itself, so that little is overshot. lambda goes on from step
to step.

What is then still too near goes to its distance, along the normal.
"""

from tianim.lang import f32_1d, f32_2d, f64_1d, f64_2d, i32_1d, ti
from tianim.systems.springs.contact import met_wall, wall_velocity

# Part of s_i that is taken: a straight edge has several such neighbours a point.
DRAWN = 0.7


@ti.kernel
def begin_from(n: ti.i32, force: f32_2d, applied: f32_2d):
    """Apply the contact forces of the step before."""
    for i in range(n):
        for c in ti.static(range(3)):
            applied[i, c] = force[i, c]


@ti.kernel
def part(
    n: ti.i32, dt: ti.f32, thickness: ti.f32, table: f32_2d, samples: f32_1d, count: ti.i32, bounds: f32_2d,
    inverse_mass: f64_1d, x_before: f64_2d, force: f32_2d, x: f64_2d, v: f64_2d, touched: i32_1d,
):  # fmt: skip
    """What is still too near to a wall goes no nearer; what touches moves as it moved in this step."""
    for i in range(n):
        touched[i] = 0
        if inverse_mass[i] > 0.0:
            start = ti.cast(ti.Vector([x_before[i, 0], x_before[i, 1], x_before[i, 2]]), ti.f32)
            end = ti.cast(ti.Vector([x[i, 0], x[i, 1], x[i, 2]]), ti.f32)
            hit, _ = met_wall(table, samples, count, bounds, thickness, dt, start, end)
            pressed = ti.Vector([force[i, 0], force[i, 1], force[i, 2]]).norm_sqr() > 0.0
            lack = ti.max(thickness - hit.w, 0.0)
            if pressed or lack > 0.0:
                touched[i] = 1
                for c in ti.static(range(3)):
                    x[i, c] += lack * hit[c]
                    v[i, c] = (x[i, c] - x_before[i, c]) / dt


@ti.func
def lack_at(
    thickness, dt, table: ti.template(), samples: ti.template(), count, bounds: ti.template(),
    friction: ti.template(), x_before: ti.template(), x: ti.template(), force: ti.template(),
    lack: ti.template(), normal: ti.template(), i,
):  # fmt: skip
    """What point i lacks, depth and slide, and the normal; `lack[i, 3]` is mu, -1 without contact."""
    start = ti.cast(ti.Vector([x_before[i, 0], x_before[i, 1], x_before[i, 2]]), ti.f32)
    end = ti.cast(ti.Vector([x[i, 0], x[i, 1], x[i, 2]]), ti.f32)
    hit, which = met_wall(table, samples, count, bounds, thickness, dt, start, end)
    pressed = ti.Vector([force[i, 0], force[i, 1], force[i, 2]]).norm_sqr() > 0.0
    depth = thickness - hit.w
    lack[i, 3] = -1.0
    if depth > 0.0 or pressed:
        slid = end - start - dt * wall_velocity(table, samples, count, which, end)
        slid -= slid.dot(hit.xyz) * hit.xyz
        for c in ti.static(range(3)):
            lack[i, c] = depth * hit[c] - slid[c]
            normal[i, c] = hit[c]
        lack[i, 3] = friction[which]


@ti.func
def within_cone(f, n, mu):
    """The force in the cone of friction about n that is nearest along and across."""
    fn = ti.max(f.dot(n), 0.0)
    ft = f - f.dot(n) * n
    return fn * n + ft * ti.min(1.0, mu * fn / ti.max(ft.norm(), 1e-20))


@ti.func
def press(
    b, start: ti.template(), neighbour: ti.template(), row: ti.template(), inverse_mass: ti.template(),
    lack: ti.template(), normal: ti.template(), force: ti.template(), applied: ti.template(), i,
):  # fmt: skip
    """The next lambda_i, and what is applied with it."""
    f, g = ti.Vector([0.0, 0.0, 0.0]), ti.Vector([0.0, 0.0, 0.0])
    if lack[i, 3] >= 0.0:
        e = ti.Vector([lack[i, 0], lack[i, 1], lack[i, 2]])
        n = ti.Vector([normal[i, 0], normal[i, 1], normal[i, 2]])
        heavy = ti.cast(1.0 / (inverse_mass[i] * b * b), ti.f32)
        uneven, gain = 0.0, heavy
        for k in range(start[i], start[i + 1]):
            j = neighbour[k]
            stiff = row[k, 0] + row[k, 2] / ti.cast(b, ti.f32)
            if lack[j, 3] >= 0.0:
                uneven += stiff * (e - ti.Vector([lack[j, 0], lack[j, 1], lack[j, 2]])).dot(n)
            else:
                gain += DRAWN * ti.sqrt(heavy * stiff)
        f = within_cone(ti.Vector([force[i, 0], force[i, 1], force[i, 2]]) + gain * e, n, lack[i, 3])
        g = f + uneven * n
    for c in ti.static(range(3)):
        force[i, c] = f[c]
        applied[i, c] = g[c]
