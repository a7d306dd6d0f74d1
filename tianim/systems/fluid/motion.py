"""Motion: how velocities and places of a fluid go on in a step, whatever the method."""

from tianim.lang import f32_1d, f32_2d, ti
from tianim.spatial.neighbor_lists import wrapped
from tianim.systems.fluid.pairs import Pairs
from tianim.systems.fluid.particles import Particles
from tianim.systems.fluid.walls import Walls

# What bears less than this part of a layer of the lightest fluid flies free: iterations leave so much.
SLIGHT = 0.05
# A drift of places is a fraction of a percent of a spacing; where two blocks were driven into each other it
# is undone over several steps, so many spacings in each.
LARGEST_DRIFT = 0.1


@ti.kernel
def kick(n: ti.i32, dt: ti.f32, acceleration: f32_2d, v: f32_2d):
    """Add dt a to v."""
    for i in range(n):
        for c in ti.static(range(3)):
            v[c, i] += dt * acceleration[c, i]


@ti.kernel
def advect(
    n: ti.i32,
    dt: ti.f32,
    clear: ti.f32,
    slight: ti.f32,
    pressure: f32_1d,
    distance: f32_1d,
    acceleration: f32_2d,
    lower: f32_1d,
    length: f32_1d,
    x: f32_2d,
    v: f32_2d,
):
    """Move x by dt v, brought back into a periodic box.

    What flies free, with a pressure of at most |a| `slight` [Pa s2/m] and farther from walls than `clear`
    [m], follows its parabola: it began the step at v - dt a.
    """
    for i in range(n):
        a = ti.Vector([acceleration[0, i], acceleration[1, i], acceleration[2, i]])
        pressed = ti.abs(pressure[i]) > slight * a.norm()
        free = ti.select(pressed | (distance[i] <= clear), 0.0, 0.5 * dt * dt)
        for c in ti.static(range(3)):
            x[c, i] = wrapped(x[c, i] + dt * v[c, i] - free * a[c], lower[c], length[c])


@ti.func
def limited(way, most):
    """A displacement, at most `most` [m]."""
    return way * ti.min(1.0, most / ti.max(way.norm(), 1e-30))


def move_on(n: int, dt: float, particles: Particles, walls: Walls, pairs: Pairs) -> None:
    """Places after a step of dt [s], with the velocities that are there."""
    advect(
        n, dt, 2.0 * particles.spacing, SLIGHT * particles.lightest * particles.spacing,
        particles.pressure, walls.distance, particles.acceleration,
        pairs.lower, pairs.length, particles["position"], particles["velocity"],
    )  # fmt: skip
