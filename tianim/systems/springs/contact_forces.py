"""Contact within the iterations of the implicit solve: forces that make points lack nothing.

    lambda_i += (m / b^2 + s_i) e_i,  in the cone of friction,      s_i = 1/2 sqrt(m / b^2 sum k_ij)

e is what a point lacks: its depth along the normal, less what it slid in this step. Where a whole patch
lacks the same, nothing but its mass resists, and lambda does it in one iteration; at its edge the rest is
drawn along as far as waves come in a step, s_i, the sum over the neighbours that do not touch. More would
be wrong: springs correct what points lack unevenly along the sheet in the same iteration, and both together
throw a cloth off the rim of a table. lambda goes on from step to step.

The plane that a point touches first stays for the step. What is then still too near goes to its distance.
"""

from tianim.lang import f32_1d, f32_2d, f64_1d, f64_2d, i32_1d, ti
from tianim.systems.springs.contact import met_wall, wall_velocity

# Part of the sum's root that is taken.
DRAWN = 0.5
# Columns of a plane: its place along the normal [m], Coulomb's coefficient, the wall's way in a step [m].
PLACE, MU, WAY, WIDTH = 0, 1, 2, 5


@ti.kernel
def forget_planes(n: ti.i32, plane: f64_2d):
    """At the start of a step none is known."""
    for i in range(n):
        plane[i, MU] = -1.0


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
    lack: ti.template(), normal: ti.template(), plane: ti.template(), i,
):  # fmt: skip
    """What point i lacks, depth and slide; `lack[i, 3]` is mu, -1 without contact."""
    pressed = ti.Vector([force[i, 0], force[i, 1], force[i, 2]]).norm_sqr() > 0.0
    if plane[i, MU] < 0.0:
        start = ti.cast(ti.Vector([x_before[i, 0], x_before[i, 1], x_before[i, 2]]), ti.f32)
        end = ti.cast(ti.Vector([x[i, 0], x[i, 1], x[i, 2]]), ti.f32)
        hit, which = met_wall(table, samples, count, bounds, thickness, dt, start, end)
        if hit.w < thickness or pressed:
            way = dt * wall_velocity(table, samples, count, which, end)
            place = ti.cast(thickness - hit.w, ti.f64)
            for c in ti.static(range(3)):
                place += x[i, c] * hit[c]
                normal[i, c] = hit[c]
                plane[i, WAY + c] = way[c]
            plane[i, PLACE], plane[i, MU] = place, friction[which]
    lack[i, 3] = -1.0
    if plane[i, MU] >= 0.0:
        n = ti.Vector([normal[i, 0], normal[i, 1], normal[i, 2]])
        depth = ti.cast(plane[i, PLACE] - x[i, 0] * n.x - x[i, 1] * n.y - x[i, 2] * n.z, ti.f32)
        if depth > 0.0 or pressed:
            slid = ti.Vector([0.0, 0.0, 0.0])
            for c in ti.static(range(3)):
                slid[c] = ti.cast(x[i, c] - x_before[i, c] - plane[i, WAY + c], ti.f32)
            slid -= slid.dot(n) * n
            for c in ti.static(range(3)):
                lack[i, c] = depth * n[c] - slid[c]
            lack[i, 3] = ti.cast(plane[i, MU], ti.f32)


@ti.func
def within_cone(f, n, mu):
    """The force in the cone of friction about n that is nearest along and across."""
    fn = ti.max(f.dot(n), 0.0)
    ft = f - f.dot(n) * n
    return fn * n + ft * ti.min(1.0, mu * fn / ti.max(ft.norm(), 1e-20))


@ti.func
def press(
    b, start: ti.template(), neighbour: ti.template(), row: ti.template(), inverse_mass: ti.template(),
    lack: ti.template(), normal: ti.template(), force: ti.template(), i,
):  # fmt: skip
    """The next lambda_i [N]."""
    f = ti.Vector([0.0, 0.0, 0.0])
    if lack[i, 3] >= 0.0:
        drawn = 0.0
        for k in range(start[i], start[i + 1]):
            if lack[neighbour[k], 3] < 0.0:
                drawn += row[k, 0] + row[k, 2] / ti.cast(b, ti.f32)
        heavy = ti.cast(1.0 / (inverse_mass[i] * b * b), ti.f32)
        gain = heavy + DRAWN * ti.sqrt(heavy * drawn)
        for c in ti.static(range(3)):
            f[c] = force[i, c] + gain * lack[i, c]
        n = ti.Vector([normal[i, 0], normal[i, 1], normal[i, 2]])
        f = within_cone(f, n, lack[i, 3])
    for c in ti.static(range(3)):
        force[i, c] = f[c]
