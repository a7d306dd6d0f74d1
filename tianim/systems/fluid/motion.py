"""Motion: how velocities and places of a fluid go on in a step, whatever the method."""

from tianim.lang import f32_1d, f32_2d, ti
from tianim.systems.fluid.pairs import Pairs
from tianim.systems.fluid.particles import Particles
from tianim.systems.fluid.walls import Walls


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
    pressure: f32_1d,
    distance: f32_1d,
    acceleration: f32_2d,
    lower: f32_1d,
    length: f32_1d,
    x: f32_2d,
    v: f32_2d,
):
    """Move x by dt v, brought back into a periodic box.

    What flies free, without pressure and farther from walls than `clear` [m], follows its parabola: it
    began the step at v - dt a.
    """
    for i in range(n):
        free = ti.select((pressure[i] == 0.0) & (distance[i] > clear), 0.5 * dt * dt, 0.0)
        for c in ti.static(range(3)):
            y = x[c, i] + dt * v[c, i] - free * acceleration[c, i]
            turns = ti.floor((y - lower[c]) / ti.max(length[c], 1e-30))
            x[c, i] = y - ti.select(length[c] > 0.0, turns * length[c], 0.0)


def move_on(n: int, dt: float, particles: Particles, walls: Walls, pairs: Pairs) -> None:
    """Places after a step of dt [s], with the velocities that are there."""
    advect(
        n, dt, 2.0 * particles.spacing, particles.pressure, walls.distance, particles.acceleration,
        pairs.lower, pairs.length, particles["position"], particles["velocity"],
    )  # fmt: skip
