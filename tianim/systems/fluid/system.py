"""Fluid: a liquid of particles in a scene, by Position Based Fluids, DFSPH or weakly compressible SPH.

    rho (dv/dt) = -grad p + rho nu laplace v + rho g + surface tension,     d delta/dt = 0

What comes at the start: `fill`; what flows in and out: `emitters`, `sinks`; neighbours: `pairs`; walls:
`walls`; all forces but pressure: `forces`; the pressure and the motion: one of the METHODS; what is
measured: `gauges`.

Limits: one spacing for all phases, at rest densities of a ratio up to 10; the air is nothing.
"""

from collections.abc import Mapping
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from tianim.errors import BlowupError, SceneError
from tianim.frame import Points
from tianim.lang import f32_2d, i32_2d, ti
from tianim.system import World
from tianim.systems.fluid.dfsph import Dfsph
from tianim.systems.fluid.emitters import Emitters
from tianim.systems.fluid.fill import fill
from tianim.systems.fluid.forces import Forces
from tianim.systems.fluid.gauge_params import ForceGauge
from tianim.systems.fluid.gauges import Gauges, Reading
from tianim.systems.fluid.pairs import Pairs
from tianim.systems.fluid.params import FluidParams, refuse_substeps
from tianim.systems.fluid.particles import Particles
from tianim.systems.fluid.pbf import Pbf
from tianim.systems.fluid.sinks import Sinks
from tianim.systems.fluid.viscosity import may_be_implicit
from tianim.systems.fluid.walls import Walls
from tianim.systems.fluid.wcsph import Wcsph

# Beyond this a particle has escaped: no scene is that large or fast.
ESCAPE = 1e6
SETTABLE = ("position", "velocity")
# Arrays of particles that a checkpoint keeps: the next step's length and what is shown come from them.
OF_A_STEP = ("density", "moment", "pressure")


class Method(Protocol):
    """What a pressure solver offers: it moves the particles on by a step."""

    pairs: Pairs
    clamped: int

    def step(self, time: float, dt: float) -> None:
        """Go on from `time` [s] by `dt` [s]."""

    def diagnostics(self) -> dict[str, float]:
        """Numbers of the last step."""

    def state(self) -> dict[str, NDArray[Any]]:
        """What the next step depends on beside the columns."""

    def restore(self, state: Mapping[str, NDArray[Any]]) -> None:
        """Take over what `state` gave."""


METHODS: dict[str, Any] = {"dfsph": Dfsph, "pbf": Pbf, "wcsph": Wcsph}


@ti.kernel
def first_fault(n: ti.i32, limit: ti.f32, identity: i32_2d, x: f32_2d, v: f32_2d) -> ti.i32:
    """Lowest id whose place or velocity is not finite or beyond `limit`; 2^31 - 1 where there is none."""
    lowest = 2147483647
    for i in range(n):
        good = True
        for c in ti.static(range(3)):
            good &= (ti.abs(x[c, i]) <= limit) & (ti.abs(v[c, i]) <= limit)
        ti.atomic_min(lowest, ti.select(good, 2147483647, identity[0, i]))
    return lowest


class Fluid:
    """The system `kind: fluid`.

    Arrays: position, velocity (n, 3), density (relative), pressure [Pa], phase, id (n,).
    """

    def __init__(self, name: str, params: FluidParams, world: World) -> None:
        self.name, self.params, self.world = name, params, world
        filled = fill(params, world.bounds, world.bodies)
        count = len(filled.position)
        room = max(params.capacity or count + params.emitted_count(), 1)
        rest_density = np.array([phase.density for phase in params.all_phases()], np.float32)
        self.particles = Particles(
            room,
            params.dimension,
            params.spacing,
            params.support_radius / params.spacing,
            rest_density,
            may_be_implicit(params),
        )
        self.particles.columns.append(
            count,
            {
                "position": filled.position,
                "velocity": filled.velocity,
                "phase": filled.phase,
                "warm": np.stack([filled.pressure, np.zeros(count, np.float32)], axis=1),
            },
        )
        pressure = np.zeros(self.particles.pressure.shape, np.float32)
        pressure[:count] = filled.pressure
        self.particles.pressure.from_numpy(pressure)
        self.particles.moment.fill(1.0)
        self.walls = Walls(world.bodies, world.bounds, self.particles, params.walls)
        method = METHODS[params.method]
        pairs = method.pairs_for(params, self.particles, world.bounds)
        self.forces = Forces(params, self.particles, pairs, self.walls)
        self.method: Method = method(params, self.particles, pairs, self.walls, self.forces)
        self.emitters = Emitters(name, params, world.bounds, world.bodies, world.seed)
        self.sinks = Sinks(params, self.particles.columns.capacity)
        self.gauges = Gauges(params, world.bounds)
        self._watched = {one.body for one in params.gauges.values() if isinstance(one, ForceGauge)}
        self._impulse = {body: np.zeros(3) for body in self._watched}
        self._elapsed = 0.0
        self._read = False
        self._restored: dict[str, float] = {}
        self.clamped = 0

    @property
    def count(self) -> int:
        """Particles that there are now."""
        return self.particles.count

    def max_step(self) -> float:
        """The smallest of the limits of flow, viscosity, surface tension and sound [s]."""
        try:
            return self.forces.largest_step()
        except SceneError as error:
            raise SceneError(f"systems.{self.name}: {error}") from None

    def check_substeps(self, substeps: int) -> None:
        """SceneError where a frame needs more than `time_step.most_substeps`."""
        limit = self.forces.limits.binding
        try:
            refuse_substeps(substeps, self.params.time_step, limit.name, limit.step)
        except ValueError as error:
            raise SceneError(f"systems.{self.name}: {error}") from None

    def step(self, time: float, dt: float) -> None:
        """Let fluid in and out, then go on by `dt` [s]."""
        columns = self.particles.columns
        self.sinks.drain(columns, time)
        self.emitters.emit(columns, time, dt)
        if self.count:
            self._restored = {}
            self.method.step(time, dt)
            self.clamped += self.method.clamped
        self._watch(dt)

    def _watch(self, dt: float) -> None:
        """Add up what the watched bodies bear, from one frame to the next."""
        if not self._watched:
            return
        if self._read:
            self._read, self._elapsed = False, 0.0
            self._impulse = {body: np.zeros(3) for body in self._watched}
        self._elapsed += dt
        if not self.count:
            return  # the walls still have the impulses of the last step that there was
        impulses = self.walls.impulses()
        for body in self._watched:
            self._impulse[body] += impulses[body][:3]

    def snapshot(self) -> tuple[Points, ...]:
        """The particles, a part for each phase where there are several."""
        columns, wants = self.particles.columns, self.world.wants
        data: dict[str, NDArray[Any]] = {}
        if wants("velocity"):
            data["velocity"] = columns.read("velocity")
        for name in ("density", "pressure"):
            if wants(name):
                data[name] = self.read(name)
        phase = columns.read("phase")
        if wants("phase"):
            data["phase"] = phase
        data["id"] = columns.read("id")
        position = columns.read("position")
        units = {"velocity": "m/s", "pressure": "Pa"}
        spacing = self.params.spacing
        if not self.params.phases:
            return (Points(self.name, position, data, units, spacing),)
        names = (self.name, *(f"{self.name}_{phase}" for phase in self.params.phases))
        parts = []
        for number, name in enumerate(names):
            own = phase == number
            kept = {key: values[own] for key, values in data.items()}
            parts.append(Points(name, position[own], kept, units, spacing))
        return tuple(parts)

    def diagnostics(self) -> dict[str, float]:
        """Particles, compression (delta - 1: mean, 99 %, largest), fastest, solver, clamped, gauges."""
        values = {"particles": float(self.count)}
        speed = np.zeros(1)
        compression = np.zeros(1)
        if self.count:
            n = self.count
            v = self.particles["velocity"].to_numpy()[:, :n]
            speed = np.sqrt(np.einsum("ci,ci->i", v, v))
            compression = np.maximum(self.particles.density.to_numpy()[:n] - 1.0, 0.0)
        values["max_speed"] = float(speed.max())
        values["density_error_mean"] = float(compression.mean())
        values["density_error_p99"] = float(np.percentile(compression, 99))
        values["density_error_max"] = float(compression.max())
        values |= self._solver_numbers()
        values["clamped"] = float(self.clamped)
        return values | self.emitters.diagnostics() | self.sinks.diagnostics() | self._gauged()

    def _solver_numbers(self) -> dict[str, float]:
        """Of the last step, be it before the state was restored."""
        return self._restored or self.method.diagnostics() | self.forces.diagnostics()

    def _gauged(self) -> dict[str, float]:
        if not len(self.gauges):
            return {}
        self._read = True
        n = self.count
        columns = self.particles.columns
        position, velocity = (columns[name].to_numpy()[:, :n].T for name in ("position", "velocity"))
        force = {body: total / max(self._elapsed, 1e-30) for body, total in self._impulse.items()}
        phase = columns["phase"].to_numpy()[0, :n]
        shown = self.particles.shown_pressure()
        return self.gauges.read(Reading(position, velocity, shown, phase, force))

    def check(self) -> None:
        """BlowupError for the lowest id that is not finite or farther or faster than ESCAPE."""
        if not self.count:
            return
        columns = self.particles.columns
        fault = first_fault(self.count, ESCAPE, columns["id"], columns["position"], columns["velocity"])
        if fault < 2**31 - 1:
            raise BlowupError(
                self.name, fault, f"not finite, or farther than {ESCAPE:g} m or faster than {ESCAPE:g} m/s"
            )

    def state(self) -> dict[str, NDArray[Any]]:
        """The columns in storage order, and what emitters and sinks have counted."""
        counted = {
            "clamped": np.array([self.clamped]),
            "solver": np.array(list(self._solver_numbers().values())),
        }
        arrays = {name: getattr(self.particles, name).to_numpy()[: self.count] for name in OF_A_STEP}
        parts = (self.particles.columns, self.method, self.forces, self.emitters, self.sinks)
        return arrays | counted | {key: value for part in parts for key, value in part.state().items()}

    def restore(self, state: Mapping[str, NDArray[Any]]) -> None:
        """Take over what `state` gave."""
        self.particles.columns.restore(state)
        for name in OF_A_STEP:
            array = getattr(self.particles, name)
            values = np.zeros(array.shape, np.float32)
            values[: self.count] = state[name]
            array.from_numpy(values)
        for part in (self.method, self.forces, self.emitters, self.sinks):
            part.restore(state)
        self.clamped = int(state["clamped"][0])
        names = self.method.diagnostics() | self.forces.diagnostics()
        self._restored = {name: float(value) for name, value in zip(names, state["solver"], strict=True)}

    def arrays(self) -> tuple[str, ...]:
        """All by name; position and velocity can be set; density, pressure, phase and id are read."""
        return ("position", "velocity", "density", "pressure", "phase", "id")

    def read(self, name: str) -> NDArray[Any]:
        """An array in id order."""
        if name not in self.arrays():
            raise SceneError(f"{self.name}: no array {name!r}; there are {', '.join(self.arrays())}")
        if name == "density":
            return self.particles.in_id_order(self.particles.density.to_numpy()[: self.count])
        if name == "pressure":
            return self.particles.in_id_order(self.particles.shown_pressure())
        return self.particles.columns.read(name)

    def write(self, name: str, values: NDArray[Any]) -> None:
        """Set position or velocity, in id order; SceneError for what cannot be set."""
        self.read(name)
        if name not in SETTABLE:
            raise SceneError(f"{self.name}.{name}: cannot be set; {', '.join(SETTABLE)} can")
        values = np.array(values, np.float32)
        wanted = (self.count, 3)
        if values.shape != wanted:
            raise SceneError(f"{self.name}.{name}: has shape {values.shape}, must be {wanted}")
        values[:, self.params.dimension :] = 0.0
        self.particles.columns.write(name, values)
