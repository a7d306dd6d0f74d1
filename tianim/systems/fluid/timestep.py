"""How long a step of a fluid may be, and what says so.

flow       cfl d: the way that the fastest goes in a step, |v| dt + |g| dt^2
spray      2.5 cfl d: the same for particles with next to no neighbours, which only walls can meet
pressed    PRESSED d / sqrt((5 mean (P / rho)^4)^(1/4)), by dfsph: layers under pressure swing against each
           other, and the deeper the fluid the faster; for a pool at rest it is PRESSED d / sqrt(g H)
depth      what pbf allows itself in deep fluid, see pbf.py
capillary  CAPILLARY sqrt(rho d^3 / (2 pi sigma)): the shortest ripple (Brackbill et al. 1992)
acoustic   COURANT h / (c + |v|): where the method has a speed of sound (weakly compressible SPH)
viscous    EXPLICIT d^2 / nu: no limit, for beyond it the viscosity is found implicitly
largest    `time_step.largest`
"""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from tianim.errors import SceneError
from tianim.lang import f32_1d, f32_2d, i32_2d, ti, workers
from tianim.spatial.tubes import share
from tianim.systems.fluid.params import CURES, FluidParams, capillary_limit
from tianim.systems.fluid.particles import Particles

# Below this relative density a particle is spray, which nothing but a wall can meet, and walls follow its
# path. One alone has 0.32 (0.37 in two dimensions), the corner of a block 0.6. The density, unlike the
# neighbours, is in a checkpoint.
SPRAY = 0.55
SPRAY_WAY = 2.5
# By dimension. Measured on columns of 80 layers that begin to fall apart: steps 1.2 times as long stir their
# corners, 1.6 times as long burst them. Pools at rest of 40 to 80 layers bear steps three times as long.
PRESSED = {2: 0.2, 3: 0.3}
RANGES = 64  # of particles, over which is summed, so that the number of threads changes nothing
# Part of the time that sound takes through the support radius (Monaghan 1992).
COURANT = 0.4


@ti.kernel
def survey(
    n: ti.i32,
    tasks: ti.i32,
    stride: ti.i32,
    density: f32_1d,
    pressure: f32_1d,
    rho: f32_1d,
    phase: i32_2d,
    v: f32_2d,
    out: f32_2d,
):
    """Of range k: largest squared speeds, of the bulk and of all, and the sum of (P / rho)^4 [m8/s8]."""
    for block in range(tasks * stride):
        if block % stride == 0:
            k = block // stride
            while k < RANGES:
                bulk, every, pressed = 0.0, 0.0, 0.0
                for i in range(share(n, k, RANGES), share(n, k + 1, RANGES)):
                    s = v[0, i] * v[0, i] + v[1, i] * v[1, i] + v[2, i] * v[2, i]
                    every = ti.max(every, s)
                    # Before the first step no density is known, and all is bulk.
                    alone = (density[i] > 0.0) & (density[i] < SPRAY)
                    bulk = ti.max(bulk, ti.select(alone, 0.0, s))
                    pressed += (ti.max(pressure[i], 0.0) / rho[phase[0, i]]) ** 4
                out[0, k], out[1, k], out[2, k] = bulk, every, pressed
                k += tasks


@dataclass(frozen=True)
class Limit:
    """A step [s] and what limits it."""

    step: float
    name: str


def time_for(way: float, speed: float, acceleration: float) -> float:
    """Time [s] in which speed dt + acceleration dt^2 is `way` [m]; infinite at rest."""
    root = speed + math.sqrt(speed * speed + 4.0 * acceleration * way)
    return 2.0 * way / root if root > 0.0 else math.inf


class StepLimits:
    """The limits of one fluid.

    gravity      its magnitude in the last step [m/s2]
    sound_speed  [m/s], set by a method that has one
    depth        [s], set by a method that has such a limit
    flow         limit of the flow when it was last asked for [s]
    binding      what limited the step when it was last asked for
    """

    def __init__(self, params: FluidParams, particles: Particles) -> None:
        self._params, self._particles = params, particles
        self.gravity = float(np.linalg.norm(params.at(0.0).gravity))
        self.sound_speed = 0.0
        self.depth = math.inf
        self.flow = params.time_step.largest
        self.binding = Limit(params.time_step.largest, "largest")
        self._capillary = capillary_limit(particles.lightest, params.spacing, params.surface_tension)
        self._tasks, self._stride = workers()
        self._found: Any = ti.ndarray(ti.f32, (3, RANGES))

    def limits(self) -> dict[str, float]:
        """Every limit by name [s]; the smallest one binds."""
        params, step = self._params, self._params.time_step
        bulk, every, pressed = self._survey()
        way = params.cfl * params.spacing
        found = {
            "largest": step.largest,
            "flow": time_for(way, bulk, self.gravity),
            "spray": time_for(SPRAY_WAY * way, every, self.gravity),
            "capillary": self._capillary,
            "depth": self.depth,
        }
        if params.method == "dfsph" and pressed > 0.0:
            found["pressed"] = PRESSED[params.dimension] * params.spacing / math.sqrt(pressed)
        if self.sound_speed > 0.0:
            found["acoustic"] = COURANT * params.support_radius / (self.sound_speed + every)
        return found

    def largest(self) -> Limit:
        """The largest step that all limits allow. SceneError where `time_step.smallest` is longer."""
        found = self.limits()
        self.flow = found["flow"]
        name = min(found, key=lambda key: found[key])
        self.binding = Limit(found[name], name)
        smallest = self._params.time_step.smallest
        # Not finite is reported as such elsewhere, with the particle.
        if found[name] < smallest:
            raise SceneError(
                f"needs a step of {found[name]:.3g} s ({name}), shorter than time_step.smallest, "
                f"{smallest:g} s: {CURES[name]}"
            )
        return self.binding

    def _survey(self) -> tuple[float, float, float]:
        """Speeds [m/s] of the fastest with neighbours and of all; P / rho of the deep [m2/s2]."""
        particles = self._particles
        if not particles.count:
            return 0.0, 0.0, 0.0
        survey(
            particles.count, self._tasks, self._stride, particles.density, particles.pressure,
            particles.rest_density, particles["phase"], particles["velocity"], self._found,
        )  # fmt: skip
        found = self._found.to_numpy().astype(np.float64)
        bulk, every = np.sqrt(found[:2].max(axis=1))
        return float(bulk), float(every), float((5.0 * found[2].sum() / particles.count) ** 0.25)
