"""DFSPH: the pressure solve at the heart of an accurate step (see pressure.py for its equations).

    neighbours, walls -> v += dt (g + forces), viscosity -> pressures: v free of divergence
    -> pressures: drift of the density taken from the places -> contact with walls -> x += dt v

Limits: the step follows the fastest flow, at `cfl` spacings a step.
"""

from typing import Any

from tianim.lang import f32_1d, f32_2d, ti
from tianim.system import Bounds
from tianim.systems.fluid.forces import Forces
from tianim.systems.fluid.pairs import Pairs
from tianim.systems.fluid.params import FluidParams
from tianim.systems.fluid.particles import Particles
from tianim.systems.fluid.pressure import DRIFT, MOTION, PressureSolver, Solved
from tianim.systems.fluid.walls import LEAST, Walls

# A drift is a fraction of a percent of a spacing; where two blocks were driven into each other it is
# undone over several steps, so many spacings in each.
LARGEST_DRIFT = 0.1


@ti.kernel
def kick(n: ti.i32, dt: ti.f32, acceleration: f32_2d, v: f32_2d):
    """v += dt a."""
    for i in range(n):
        for c in ti.static(range(3)):
            v[c, i] += dt * acceleration[c, i]


@ti.kernel
def drift_places(
    n: ti.i32,
    dt: ti.f32,
    most: ti.f32,
    least: ti.f32,
    push: f32_2d,
    distance: f32_1d,
    normal: f32_2d,
    x: f32_2d,
):
    """x += dt^2 push, at most `most` [m], and not nearer to the nearest wall than `least`, or than it is."""
    for i in range(n):
        way = dt * dt * ti.Vector([push[0, i], push[1, i], push[2, i]])
        length = way.norm()
        way *= ti.min(1.0, most / ti.max(length, 1e-30))
        wall = ti.Vector([normal[0, i], normal[1, i], normal[2, i]])
        room = ti.max(distance[i] - least, 0.0)
        way += ti.max(-way.dot(wall) - room, 0.0) * wall
        for c in ti.static(range(3)):
            x[c, i] += way[c]


@ti.kernel
def advect(
    n: ti.i32, dt: ti.f32, pressure: f32_1d, acceleration: f32_2d, lower: f32_1d, length: f32_1d, x: f32_2d,
    v: f32_2d,
):  # fmt: skip
    """x += dt v, brought back into a periodic box.

    What flies free, without pressure, follows its parabola: it began the step at v - dt a.
    """
    for i in range(n):
        free = ti.select(pressure[i] == 0.0, 0.5 * dt * dt, 0.0)
        for c in ti.static(range(3)):
            y = x[c, i] + dt * v[c, i] - free * acceleration[c, i]
            turns = ti.floor((y - lower[c]) / ti.max(length[c], 1e-30))
            x[c, i] = y - ti.select(length[c] > 0.0, turns * length[c], 0.0)


class Dfsph:
    """The method `dfsph`: steps `particles`.

    pairs   the rows of neighbours, built anew in each step
    solved  how the two solves of the last step went
    """

    def __init__(
        self, params: FluidParams, particles: Particles, pairs: Pairs, walls: Walls, forces: Forces
    ) -> None:
        self._params, self._particles, self._walls, self._forces = params.dfsph, particles, walls, forces
        self.pairs = pairs
        self._pressure = PressureSolver(particles, pairs, walls)
        self.solved: tuple[Solved, Solved] = (Solved(0, 0.0, 0.0), Solved(0, 0.0, 0.0))
        self.clamped = 0

    @staticmethod
    def pairs_for(params: FluidParams, particles: Particles, bounds: Bounds) -> Pairs:
        """Rows for particles that move on by a good part of a spacing: they serve one step."""
        return Pairs(particles, bounds)

    def step(self, time: float, dt: float) -> None:
        """Go on from `time` [s] by `dt` [s]."""
        particles, walls, forces, pairs = self._particles, self._walls, self._forces, self.pairs
        n = particles.count
        pairs.build()
        x, v = particles["position"], particles["velocity"]
        walls.measure(n, x, particles.density)
        forces.accelerate(time, dt)
        kick(n, dt, particles.acceleration, v)
        forces.relax(dt)
        self._solve(dt)
        walls.push(n, x, particles.pressure, dt)
        if self.solved[1].iterations:
            drift_places(
                n, dt, LARGEST_DRIFT * particles.spacing, LEAST * particles.spacing, self._pressure.push,
                walls.distance, walls.normal, x,
            )  # fmt: skip
        walls.hold(n, x, v, dt)
        advect(n, dt, particles.pressure, particles.acceleration, pairs.lower, pairs.length, x, v)
        self.clamped = walls.clamp(n, x, v)

    def _solve(self, dt: float) -> None:
        params, solve = self._params, self._pressure.solve
        least, most = params.least_iterations, params.most_iterations
        motion = solve(MOTION, dt, min(params.density_error, params.divergence_error), least, most)
        self.solved = (motion, solve(DRIFT, dt, params.density_error, 0, most))

    def diagnostics(self) -> dict[str, float]:
        """Iterations of the last step, and the mean compression that the solves left."""
        motion, drift = self.solved
        return {
            "iterations": float(motion.iterations),
            "drift_iterations": float(drift.iterations),
            "solver_error": drift.error,
        }
