"""Springs: cloth, ropes, jelly and the teaching scenes of masses and springs.

    m a = sum of springs + bending + gravity + air + what is pushed,    places held by pins

What a piece is made into: `built.py`, by whom: `pieces.py`; the ways to step: `explicit.py`, `projective.py`,
`strands.py` and `xpbd.py`; what bodies do: `contact.py`.

Limits: pieces pass through each other and through themselves unless `contact.self_collision` is on. It knows
surfaces (`self_contact.py`), or, where the solver is `strands`, ropes and strands (`strand_contact.py`), not
a rope and a cloth.
"""

import logging
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tianim.errors import BlowupError, SceneError
from tianim.frame import Lines, Mesh, Part
from tianim.system import World
from tianim.systems.springs.air import Sails
from tianim.systems.springs.arrays import constant
from tianim.systems.springs.assembly import assemble
from tianim.systems.springs.clearance import refuse_inside
from tianim.systems.springs.contact import Walls
from tianim.systems.springs.curvature import Curvature
from tianim.systems.springs.explicit import ExplicitSolver
from tianim.systems.springs.limits import Limits
from tianim.systems.springs.params import SpringsParams, refuse_substeps
from tianim.systems.springs.pins import Pins
from tianim.systems.springs.points import Points, push, set_external
from tianim.systems.springs.projective import ProjectiveSolver
from tianim.systems.springs.report import Report
from tianim.systems.springs.self_contact import SelfContact
from tianim.systems.springs.strand_contact import StrandContact
from tianim.systems.springs.strands import StrandSolver
from tianim.systems.springs.xpbd import XpbdSolver

LOG = logging.getLogger("tianim")

# Beyond this [m], or faster than this [m/s], nothing is meant.
ESCAPE = 1e6
UNITS = {"velocity": "m/s", "tension": "N", "strain": ""}


class SpringSystem:
    """The system `kind: springs`.

    Arrays: position, velocity (n, 3) [m], [m/s], mass (n,) [kg].
    """

    def __init__(self, name: str, params: SpringsParams, world: World) -> None:
        self.name, self.params, self.world = name, params, world
        self.whole = assemble(params)
        self.count = self.whole.count
        self.points = Points(self.whole)
        self.pins = Pins(params, self.whole, world.bodies)
        refuse_inside(
            self.whole, self.pins.held_from_the_start(), world.bodies, world.bounds, params.contact.thickness
        )
        self._pushes = [
            (key, self.whole.chosen(f"pushes.{key}", push)) for key, push in params.pushes.items()
        ]
        self._pushed = [constant(which) for _, which in self._pushes]
        self.walls = walls = Walls(params.contact, world.bodies, world.bounds)
        self.solver = self._chosen_solver(walls)
        self.curvature = Curvature(self.whole)
        self.folds = self._chosen_contact(walls)
        self.sails = Sails(self.whole, world.seed)
        self.limits = Limits(params, self.whole, self.points, self.solver.name != "strands")
        self.report = Report(self.whole, params, self.limits)
        self._was_pushed = [False] * len(self._pushes)
        self._time = 0.0

    def _chosen_contact(self, walls: Walls) -> SelfContact | StrandContact | None:
        """Contact of pieces with each other, where the scene asks for it and they can."""
        contact, whole, points = self.params.contact, self.whole, self.points
        thickness = contact.self_thickness or contact.thickness
        if not contact.self_collision:
            return None
        if isinstance(self.solver, StrandSolver):
            return StrandContact(whole, points, walls, thickness, contact.friction)
        if any(len(piece.triangles) for piece in whole.pieces.values()):
            return SelfContact(whole, points, walls, thickness, contact.friction, self.solver)
        return None

    def _chosen_solver(self, walls: Walls) -> ExplicitSolver | ProjectiveSolver | StrandSolver | XpbdSolver:
        """The solver that the scene names, or the one that suits."""
        params, whole, points = self.params, self.whole, self.points
        chosen = params.chosen_solver()
        if params.solver == "auto":
            step = params.explicit_step
            LOG.info("%s: solver %s (explicit steps would be %.3g s)", self.name, chosen, step)
        if chosen == "strands":
            return StrandSolver(params, whole, points, walls)
        tears = any(piece.tear_strain is not None for piece in params.pieces.values())
        if chosen == "xpbd":
            return XpbdSolver(whole, points, walls, params.xpbd.iterations, tears)
        if chosen == "projective":
            return ProjectiveSolver(
                whole, points, walls, params.projective.scheme, params.projective.iterations, tears
            )
        return ExplicitSolver(whole, points, walls, params.explicit.integrator, params.explicit.safety)

    def max_step(self) -> float:
        """Largest step [s]: what is stable, or what is asked for."""
        return min(self.solver.longest, self.params.time_step.asked(self.solver.name))

    def check_substeps(self, substeps: int) -> None:
        """SceneError where a frame needs more steps than it may."""
        try:
            refuse_substeps(substeps, self.params.time_step, self.max_step(), self.solver.name)
        except ValueError as error:
            raise SceneError(f"{self.name}: {error}") from None

    def step(self, time: float, dt: float) -> None:
        """Go on from `time` [s] by `dt` [s]."""
        points = self.points
        self._force(time)
        if self.pins.update(time, dt, points):
            self.solver.hold(self.pins.held)
        if self.folds is not None:
            self.folds.begin()
        self.solver.step(time, dt)
        self.pins.settle(points)
        self.limits.apply(dt)
        if self.folds is not None:
            self.folds.end(dt)
        self._time = time + dt

    def _force(self, time: float) -> None:
        """Gravity, drag, air, pushes."""
        points, now = self.points, self.params.at(time)
        points.weight = float(np.linalg.norm(now.gravity))
        set_external(self.count, *now.gravity, now.air.drag, points.v, points.external)
        if self.solver.name != "xpbd":  # which knows what is bent
            self.curvature.push(points)
        self.sails.blow(time, now.air, points)
        pushed = [any(now.pushes[key].force) for key, _ in self._pushes]
        for (key, which), array, pushes in zip(self._pushes, self._pushed, pushed, strict=True):
            if pushes:
                push(len(which), *now.pushes[key].force, array, points.inverse_mass, points.external)
        if pushed != self._was_pushed:  # what two steps say of a force that begins or ends is wrong
            self._was_pushed = pushed
            self.solver.forget()

    def snapshot(self) -> tuple[Part, ...]:
        """Each piece: sheets, meshes and blocks as triangles, ropes and networks as lines."""
        x = self.points.read(self.points.x)
        v = self.points.read(self.points.v)
        wants = self.world.wants
        parts: list[Part] = []
        strain, tension = self.report.strains(x) if wants("strain") or wants("tension") else (None, None)
        for key, piece in self.whole.pieces.items():
            first = self.whole.first[key]
            own = slice(first, first + len(piece.mass))
            name = self.name if len(self.whole.pieces) == 1 else f"{self.name}_{key}"
            data: dict[str, NDArray[Any]] = {}
            if wants("velocity"):
                data["velocity"] = v[own].astype(np.float32)
            if wants("id"):
                data["id"] = np.arange(own.start, own.stop, dtype=np.int32)
            data |= {field: values for field, values in piece.data.items() if wants(field)}
            position = x[own].astype(np.float32)
            springs = self.report.span(key)
            if len(piece.triangles):
                if strain is not None and wants("strain"):
                    data["strain"] = self.report.of_points(key, strain[springs], x)
                triangles = piece.triangles[self.report.whole_triangles(key)]
                if piece.shown is not None:
                    place = piece.shown.place
                    position, data = position[place], {field: values[place] for field, values in data.items()}
                    triangles = piece.shown.triangles[self.report.whole_triangles(key)]
                    if piece.shown.uv is not None and wants("uv"):
                        data["uv"] = piece.shown.uv
                parts.append(Mesh(name, position, triangles, data, units=_units(data)))
                continue
            cells: dict[str, NDArray[Any]] = {}
            if strain is not None and tension is not None:
                both = {"tension": tension[springs], "strain": strain[springs]}
                cells = {key: values.astype(np.float32) for key, values in both.items() if wants(key)}
            ends = piece.springs.ends
            parts.append(Lines(name, position, ends, data, cells, _units({**data, **cells})))
        return tuple(parts)

    def diagnostics(self) -> dict[str, float]:
        """Energies, momenta, strains, contacts."""
        points = self.points
        found = self.report.measure(points.read(points.x), points.read(points.v), self._time)
        found["contacts"] = float(self.walls.touching(points))
        return found if self.folds is None else {**found, **self.folds.diagnostics()}

    def check(self) -> None:
        """BlowupError for the first point that is not finite or beyond ESCAPE."""
        x, v = self.points.read(self.points.x), self.points.read(self.points.v)
        # Neither holds where something is not a number.
        if np.abs(x).max(initial=0.0) < ESCAPE and np.abs(v).max(initial=0.0) < ESCAPE:
            return
        finite = np.isfinite(x).all(axis=1) & np.isfinite(v).all(axis=1)
        if not finite.all():
            raise BlowupError(self.name, int(np.argmin(finite)), "position or velocity is not finite")
        near = (np.abs(x) < ESCAPE).all(axis=1) & (np.abs(v) < ESCAPE).all(axis=1)
        if not near.all():
            raise BlowupError(
                self.name, int(np.argmin(near)), f"farther than {ESCAPE:g} m from the origin, or faster"
            )

    def state(self) -> dict[str, NDArray[Any]]:
        """Places, velocities, and what solver and pins remember."""
        points = self.points
        own = {"position": points.read(points.x), "velocity": points.read(points.v)}
        own |= {"time": np.array([self._time]), "pushed": np.array(self._was_pushed, np.bool_)}
        folds = self.folds.state() if isinstance(self.folds, SelfContact) else {}
        return own | self.solver.state() | self.pins.state() | self.limits.state() | folds

    def restore(self, state: Mapping[str, NDArray[Any]]) -> None:
        """Take over what `state` gave."""
        points = self.points
        points.write(points.x, np.asarray(state["position"], np.float64))
        points.write(points.v, np.asarray(state["velocity"], np.float64))
        self._time = float(state["time"][0])
        self._was_pushed = [bool(pushed) for pushed in state["pushed"]]
        self.pins.restore(state, points)
        self.solver.hold(self.pins.held)
        self.solver.restore(state)
        self.limits.restore(state)
        if isinstance(self.folds, SelfContact):
            self.folds.restore(state)

    def arrays(self) -> tuple[str, ...]:
        """Places and velocities can be set, mass can only be read."""
        return ("position", "velocity", "mass")

    def read(self, name: str) -> NDArray[Any]:
        """An array, (n, 3) or (n,)."""
        self._known(name)
        if name == "mass":
            return np.array(self.whole.mass)
        return self.points.read(self.points.x if name == "position" else self.points.v)

    def write(self, name: str, values: NDArray[Any]) -> None:
        """Set position or velocity; SceneError for what cannot be set."""
        if self._known(name) == "mass":
            raise SceneError(f"{self.name}.mass: cannot be set; position and velocity can")
        given = np.asarray(values, np.float64)
        if given.shape != (self.count, 3):
            raise SceneError(f"{self.name}.{name}: has shape {given.shape}, must be {(self.count, 3)}")
        array = self.points.x if name == "position" else self.points.v
        if not np.array_equal(given, self.points.read(array)):
            self.points.write(array, given)
            self.solver.forget()
            if isinstance(self.folds, SelfContact):
                self.folds.forget()

    def _known(self, name: str) -> str:
        if name not in self.arrays():
            raise SceneError(f"{self.name}: no array {name!r}; there are {', '.join(self.arrays())}")
        return name


def _units(data: Mapping[str, Any]) -> dict[str, str]:
    return {name: UNITS[name] for name in data if UNITS.get(name)}
