"""DFSPH: the pressure solve at the heart of an accurate step (see pressure.py for its equations).

    neighbours, walls -> v += dt (g + forces), viscosity -> pressures: v free of divergence
    -> pressures: drift of the density taken from the places -> contact with walls -> x += dt v

Limits: the step follows the fastest flow, at `cfl` spacings a step.
"""

from collections.abc import Mapping
from typing import Any

from numpy.typing import NDArray

from tianim.lang import f32_1d, f32_2d, ti
from tianim.system import Bounds
from tianim.systems.fluid.forces import Forces
from tianim.systems.fluid.gauge_params import ForceGauge
from tianim.systems.fluid.motion import LARGEST_DRIFT, kick, limited, move_on
from tianim.systems.fluid.pairs import Pairs
from tianim.systems.fluid.params import FluidParams
from tianim.systems.fluid.particles import Particles
from tianim.systems.fluid.pressure import DRIFT, MOTION, PressureSolver, Solved
from tianim.systems.fluid.walls import LEAST, Walls

# A fluid at rest is solved to this part of the error asked for, for what it leaves is added up in the places;
# a fast one to more, in proportion to its speed.
MOTION_SHARE = 0.2
# Longest time [s] for which a divergence is thought to act.
LONGEST = 0.005


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
    """Move x by dt^2 push, at most `most` [m], no nearer to a wall than `least` or than it is."""
    for i in range(n):
        way = limited(dt * dt * ti.Vector([push[0, i], push[1, i], push[2, i]]), most)
        wall = ti.Vector([normal[0, i], normal[1, i], normal[2, i]])
        room = ti.max(distance[i] - least, 0.0)
        way += ti.max(-way.dot(wall) - room, 0.0) * wall
        for c in ti.static(range(3)):
            x[c, i] += way[c]


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
        self._pressure = PressureSolver(particles, pairs, walls, pairs.is_full)
        self.solved: tuple[Solved, Solved] = (Solved(0, 0.0, 0.0), Solved(0, 0.0, 0.0))
        self._watched = any(isinstance(gauge, ForceGauge) for gauge in params.gauges.values())
        self.clamped = 0

    @staticmethod
    def pairs_for(params: FluidParams, particles: Particles, bounds: Bounds) -> Pairs:
        """Rows for particles that move on by a good part of a spacing: they serve one step."""
        return Pairs(particles, bounds)

    def step(self, time: float, dt: float) -> None:
        """Go on from `time` [s] by `dt` [s]."""
        self.find()
        self.accelerate(time, dt)
        self.solve(dt)
        self.move(dt)

    def find(self) -> None:
        """Neighbours and walls of each particle, and its density."""
        self.pairs.build()
        particles = self._particles
        self._walls.measure(particles.count, particles["position"], particles.density)

    def accelerate(self, time: float, dt: float) -> None:
        """All forces but pressure."""
        particles = self._particles
        self._forces.accelerate(time, dt)
        kick(particles.count, dt, particles.acceleration, particles["velocity"])
        self._forces.relax(dt)

    def solve(self, dt: float) -> None:
        """Pressures: velocities, and the drift of the places."""
        params, solve = self._params, self._pressure.solve
        least, most = params.least_iterations, params.most_iterations
        # A divergence acts for the time that the flow takes through a spacing, however short the steps.
        flow = min(self._forces.limits.flow, LONGEST)
        tolerance = min(MOTION_SHARE * LONGEST / flow, 1.0) * min(dt / flow, 1.0)
        tolerance *= params.divergence_error
        motion = solve(MOTION, dt, tolerance, least, most)
        self.solved = (motion, solve(DRIFT, dt, params.density_error, 0, most))

    def move(self, dt: float) -> None:
        """Places, kept out of the walls; what the walls bear."""
        particles, walls, pairs = self._particles, self._walls, self.pairs
        n, x, v = particles.count, particles["position"], particles["velocity"]
        if self._watched:
            walls.push(n, x, particles.pressure, dt)
        if self.solved[1].iterations:
            drift_places(
                n, dt, LARGEST_DRIFT * particles.spacing, LEAST * particles.spacing, self._pressure.push,
                walls.distance, walls.normal, x,
            )  # fmt: skip
        walls.hold(n, x, v, dt)
        move_on(n, dt, particles, walls, pairs)
        self.clamped = walls.clamp(n, x, v)

    def diagnostics(self) -> dict[str, float]:
        """Iterations of the last step, and the mean compression that the solves left."""
        motion, drift = self.solved
        return {
            "iterations": float(motion.iterations),
            "drift_iterations": float(drift.iterations),
            "solver_error": drift.error,
        }

    def state(self) -> dict[str, NDArray[Any]]:
        """Nothing: a step depends on the columns alone."""
        return {}

    def restore(self, state: Mapping[str, NDArray[Any]]) -> None:
        """Nothing to take over."""
