"""All forces on a fluid but pressure: gravity, viscosity, surface tension, vorticity confinement.

A step: accelerate (gravity and what is explicit) -> v += dt a -> relax (implicit viscosity) -> pressure.
The viscosity is explicit while the step is short enough for it, else implicit, from step to step.
"""

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tianim.lang import f32_2d, ti
from tianim.systems.fluid.pairs import Pairs
from tianim.systems.fluid.params import FluidParams
from tianim.systems.fluid.particles import Particles
from tianim.systems.fluid.surface_tension import SurfaceTension
from tianim.systems.fluid.timestep import StepLimits
from tianim.systems.fluid.viscosity import Viscosity
from tianim.systems.fluid.vorticity import Vorticity

# The implicit viscosity leaves this part of its change of velocities, or stops after so many iterations.
TOLERANCE = 3e-3
MOST_ITERATIONS = 200


@ti.kernel
def accelerate_all(
    clearing: ti.template(), n: ti.i32, x: ti.f32, y: ti.f32, z: ti.f32, acceleration: f32_2d, pull: f32_2d
):
    """The same acceleration [m/s2] for all; where `clearing`, no pull of walls."""
    for i in range(n):
        acceleration[0, i] = x
        acceleration[1, i] = y
        acceleration[2, i] = z
        if ti.static(clearing):
            for c in ti.static(range(3)):
                pull[c, i] = 0.0


class Forces:
    """What acts on `particles` beside pressure.

    limits  of the time step
    pull    acceleration by walls in the last step, their pressure aside [m/s2], (3, capacity)
    """

    def __init__(self, params: FluidParams, particles: Particles, pairs: Pairs, walls: Any) -> None:
        self._params, self._particles, self._walls = params, particles, walls
        self.limits = StepLimits(params, particles)
        phases = params.all_phases()
        calmed = [
            phase.model_copy(update={"viscosity": phase.viscosity + params.calming}) for phase in phases
        ]
        self.viscosity = Viscosity(calmed, particles, pairs, walls)
        self.tension = SurfaceTension(params.surface_tension, particles, pairs, walls)
        self.vorticity = Vorticity(params.vorticity, particles, pairs)
        self._pulled = walls.count > 0 and (self.viscosity.walled or self.tension.active)
        self.pull: Any = ti.ndarray(ti.f32, (3, particles.columns.capacity if self._pulled else 1))

    def accelerate(self, time: float, dt: float) -> None:
        """Fill the particles' accelerations: gravity at `time` [s], what is explicit in a step `dt`."""
        particles = self._particles
        x, y, z = self._params.at(time).gravity
        gravity = (x, y, z if particles.dimension == 3 else 0.0)
        self.limits.gravity = math.hypot(*gravity)
        accelerate_all(self._pulled, particles.count, *gravity, particles.acceleration, self.pull)
        if self._explicit(dt):
            self.viscosity.add(self.pull)
        if self.tension.active:
            self.tension.add(self.pull)
        self.vorticity.add()

    def relax(self, dt: float) -> None:
        """Let viscosity act for `dt` [s] where it is not explicit; walls get the reaction of all."""
        particles = self._particles
        if self.viscosity.active and not self._explicit(dt):
            self.viscosity.relax(dt, TOLERANCE, MOST_ITERATIONS, self.pull)
        if self._pulled:
            self._walls.bear(particles.count, particles["position"], self.pull, dt)

    def _explicit(self, dt: float) -> bool:
        return self.viscosity.active and dt <= self.viscosity.explicit_limit

    def largest_step(self) -> float:
        """The largest step [s] that flow, surface tension and sound allow."""
        return self.limits.largest().step

    def state(self) -> dict[str, NDArray[Any]]:
        """The gravity of the last step, which limits the next."""
        return {"gravity": np.array([self.limits.gravity])}

    def restore(self, state: Mapping[str, NDArray[Any]]) -> None:
        """Take over what `state` gave."""
        self.limits.gravity = float(state["gravity"][0])

    def diagnostics(self) -> dict[str, float]:
        """Iterations of the implicit viscosity, 0 where it is explicit."""
        if not self.viscosity.active:
            return {}
        return {"viscosity_iterations": float(self.viscosity.iterations)}
