"""Gravity: stars that pull one another, from two bodies to colliding galaxies.

    a_i = sum_j G m_j d / (d^2 + eps^2)^(3/2) + external potentials,   d = x_j - x_i

Forces: `solver.py` (direct sum, or a tree at an asked accuracy); motion: `integrators.py` and
`timestep.py`; what is measured: `diagnostics.py`; the stars at the start: `components.py`.

Places and velocities are float64 in the units of the scene's choice; `time_scale` says how much of
the system's own time passes in a second of the scene. Space is open.

Limits: one softening for all stars; no gas, no collisions, no relativity. An energy drift is
measured from the start, or from when a script last set something.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tianim.errors import BlowupError, SceneError
from tianim.frame import Points
from tianim.lang import ti
from tianim.system import World
from tianim.systems.gravity.checks import LOG, check_start, warn_of_start
from tianim.systems.gravity.diagnostics import first_fault
from tianim.systems.gravity.external import potential_of
from tianim.systems.gravity.integrators import INTEGRATORS
from tianim.systems.gravity.params import MASS_UNITS, VELOCITY_UNITS, AdaptiveStep, BlockStep, GravityParams
from tianim.systems.gravity.report import Report
from tianim.systems.gravity.snapshots import UNITS
from tianim.systems.gravity.solver import Law
from tianim.systems.gravity.stars import Force, Stars
from tianim.systems.gravity.start import Made, make
from tianim.systems.gravity.timestep import Adaptive, Block, Fixed

Floats = NDArray[np.float64]

# Beyond this nothing is meant, in whatever units: 1e25 m is a billion light years.
ESCAPE = 1e25
SETTABLE = ("position", "velocity", "mass")
VECTORS = ("position", "velocity", "acceleration")


class Gravity:
    """The system `kind: gravity`.

    Arrays in own units: position, velocity, acceleration (n, 3), mass, potential (n,), float64.
    """

    def __init__(self, name: str, params: GravityParams, world: World) -> None:
        self.name, self.params, self.world = name, params, world
        self.law = Law(params.g, params.softening.length, params.softening.kind)
        made = self._made()
        check_start(name, made.position, made.velocity, made.mass, self.law)
        self.count = len(made.mass)
        self.component = made.component
        self.components = self._spans(made.names)
        self.stars = Stars(name, made.mass, self.law, params.solver, params.external)
        self.stars.write(self.stars.x, made.position)
        self.stars.write(self.stars.v, made.velocity)
        self.mover = self._mover()
        self._time = 0.0
        self._stale = True
        self.report = Report(name, params, self.stars, self.components, world.seed)
        self._fault = ti.ndarray(ti.i32, 2)
        self._refresh()
        warn_of_start(name, self.stars.totals(), self.stars.massive > 1 and not params.external)

    def _made(self) -> Made:
        params = self.params
        if not params.components and not params.galaxies:
            LOG.warning("%s: no components and no galaxies: there are no stars", self.name)
            return Made(np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(0), np.zeros(0, np.int32), ())
        return make(
            params.components, params.galaxies, params.external, params.g, self.law.softening,
            self.world.seed, units=UNITS.get(params.units), recentre=params.recentre,
        )  # fmt: skip

    def _spans(self, names: tuple[str, ...]) -> dict[str, tuple[int, int]]:
        """First id and count of each component."""
        edges = np.searchsorted(self.component, np.arange(len(names) + 1))
        return {
            name: (int(first), int(last - first))
            for name, first, last in zip(names, edges, edges[1:], strict=False)
        }

    @property
    def parts(self) -> dict[str, tuple[int, int]]:
        """First id and count of each part of a frame: a component each, or all where there is one."""
        if len(self.components) < 2:
            return {self.name: (0, self.count)}
        return {f"{self.name}_{component}": span for component, span in self.components.items()}

    def _mover(self) -> Fixed | Adaptive | Block:
        step, eta = self.params.time_step, self.params.eta
        self.stars.make_room(isinstance(step, AdaptiveStep), self.params.integrator == "rk4")
        if isinstance(step, BlockStep):
            return Block(self.stars, eta, step.levels)
        integrator = INTEGRATORS[self.params.integrator]
        if isinstance(step, AdaptiveStep):
            return Adaptive(self.stars, integrator, eta, step.levels)
        return Fixed(self.stars, integrator)

    def add_force(self, force: Force) -> None:
        """Add an acceleration [own units] of your own.

        `force(time, position, velocity)` gets the scene's time [s] and arrays (n, 3), and gives one.
        """
        self.stars.forces.append(force)
        self._stale = True

    def max_step(self) -> float:
        """The largest step of the parameters [s]; adaptive and block steps divide it further."""
        return self.params.largest_step()

    def step(self, time: float, dt: float) -> None:
        """Go on by dt [s] of the scene."""
        if self.count == 0:
            return
        self._time = time
        self._refresh()
        self.mover.advance(time, dt, dt * self.params.time_scale)
        self._time = time + dt
        self.report.moved = True

    def _refresh(self) -> None:
        """Accelerations and potentials of the places of now."""
        if self._stale and self.count:
            self.stars.accelerate(self._time)
        self._stale = False
        self.report.begin()

    def snapshot(self) -> tuple[Points, ...]:
        """Each component with velocity, mass, id and component, as the world wants; potential on request."""
        parts, potential = [], None
        if self._shows_potential():
            self._refresh()
            potential = self._potential()
        wants, stars = self.world.wants, self.stars
        mass = stars.read_one(stars.mass).astype(np.float32) if wants("mass") else None
        for name, (first, count) in self.parts.items():
            own = slice(first, first + count)
            data: dict[str, NDArray[Any]] = {}
            if wants("velocity"):
                data["velocity"] = stars.read_single(stars.v, first, count)
            if mass is not None:
                data["mass"] = mass[own]
            if potential is not None:
                data["potential"] = potential[own].astype(np.float32)
            if wants("id"):
                data["id"] = np.arange(first, first + count, dtype=np.int32)
            if wants("component"):
                data["component"] = np.array(self.component[own], np.int32)
            parts.append(Points(name, stars.read_single(stars.x, first, count), data, self._units(data)))
        return tuple(parts)

    def _units(self, data: Mapping[str, Any]) -> dict[str, str]:
        units = self.params.units
        known = {"velocity": VELOCITY_UNITS[units], "mass": MASS_UNITS[units]}
        return {name: unit for name, unit in known.items() if unit and name in data}

    def _shows_potential(self) -> bool:
        fields = self.world.fields
        return self.params.diagnostics.potential or (fields is not None and "potential" in fields)

    def _potential(self) -> Floats:
        """Of the other stars and of the external potentials, (n,)."""
        stars = self.stars
        total = stars.read_one(stars.phi)
        if stars.row_count and self.count:
            outside = np.empty(self.count)
            potential_of(self.count, stars.rows, stars.row_count, stars.x, outside)
            total += outside
        return total

    def diagnostics(self) -> dict[str, float]:
        """Energies, their drift, virial ratio, momenta, centre, Lagrangian radii, what was asked for."""
        self._refresh()
        found = self.report.measure()
        if not isinstance(self.mover, Fixed):
            found["steps"] = float(self.mover.steps)
        return found

    def check(self) -> None:
        """BlowupError for the lowest id that is not finite or farther than ESCAPE."""
        if self.count == 0:
            return
        first_fault(self.count, ESCAPE, self.stars.x, self.stars.v, self._fault)
        not_finite, escaped = (int(value) for value in self._fault.to_numpy())
        if not_finite < self.count:
            raise BlowupError(self.name, not_finite, "position or velocity is not finite")
        if escaped < self.count:
            raise BlowupError(self.name, escaped, f"farther than {ESCAPE:g} from the origin, or faster")

    def state(self) -> dict[str, NDArray[Any]]:
        """Places, velocities, accelerations, potentials, masses, and what the report remembers."""
        self._refresh()
        arrays = {name: np.asarray(self._read(name)) for name in (*VECTORS, "mass", "potential")}
        return arrays | {"report": self.report.state(), "steps": np.asarray(self.mover.steps)}

    def restore(self, state: Mapping[str, NDArray[Any]]) -> None:
        """Take over what `state` gave."""
        stars = self.stars
        for name, array in zip(VECTORS, (stars.x, stars.v, stars.a), strict=True):
            stars.write(array, np.asarray(state[name], np.float64))
        stars.set_mass(np.asarray(state["mass"], np.float64))
        stars.write_one(stars.phi, np.asarray(state["potential"], np.float64))
        self.report.restore(np.asarray(state["report"]))
        self.mover.steps = int(state["steps"])
        self._stale = False

    def arrays(self) -> tuple[str, ...]:
        """position, velocity and mass can be set; acceleration and potential can only be read."""
        return (*VECTORS, "mass", "potential")

    def read(self, name: str) -> NDArray[Any]:
        """An array in id order; `potential` is that of the other stars [own speed^2]."""
        self._known(name)
        if name in ("acceleration", "potential"):
            self._refresh()
        return self._read(name)

    def _read(self, name: str) -> Floats:
        stars = self.stars
        vectors = dict(zip(VECTORS, (stars.x, stars.v, stars.a), strict=True))
        if name in vectors:
            return stars.read(vectors[name])
        return stars.read_one(stars.mass if name == "mass" else stars.phi)

    def write(self, name: str, values: NDArray[Any]) -> None:
        """Set position, velocity or mass, in id order; SceneError for what cannot be set."""
        if self._known(name) not in SETTABLE:
            raise SceneError(f"{self.name}.{name}: cannot be set; {', '.join(SETTABLE)} can")
        values = np.asarray(values, np.float64)
        before = self._read(name)
        if values.shape != before.shape:
            raise SceneError(f"{self.name}.{name}: has shape {values.shape}, must be {before.shape}")
        if np.array_equal(values, before):
            return
        if name == "mass":
            if not (np.isfinite(values) & (values >= 0.0)).all():
                raise SceneError(f"{self.name}.mass: masses must be finite and not negative")
            self.stars.set_mass(values)
        else:
            self.stars.write(self.stars.x if name == "position" else self.stars.v, values)
        self._stale = True
        self.report.forget()

    def _known(self, name: str) -> str:
        if name not in self.arrays():
            raise SceneError(f"{self.name}: no array {name!r}; there are {', '.join(self.arrays())}")
        return name
