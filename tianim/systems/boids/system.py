"""Boids: a flock after Reynolds, in two or three dimensions, of one or several species.

    a = behaviours + separation + alignment + cohesion, within a budget;  v' = v + dt a;  x' = x + dt v'

The laws stand in `flocking.py` (the three rules), `behaviours.py` and `motion.py`. Sources:
C. Reynolds, Flocks, herds and schools, SIGGRAPH 1987, DOI 10.1145/37402.37406, and Steering
Behaviors For Autonomous Characters, GDC 1999; topological neighbours: M. Ballerini et al., PNAS
105 (2008), DOI 10.1073/pnas.0711437105.

Limits: rules reach at most one cell of the grid, the largest of their radii. Behaviours with a
species as target search all its members, a step costs boids times members. In periodic bounds a
target is sought the shortest way round; paths, flows and bodies as obstacles have no images there.
"""

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tianim.errors import SceneError
from tianim.lang import ti
from tianim.spatial.columns import staggered
from tianim.spatial.grid import NeighborGrid
from tianim.spatial.placement import directions, place
from tianim.system import World
from tianim.systems.boids.flocking import flock
from tianim.systems.boids.motion import integrate
from tianim.systems.boids.params import MAIN, BoidsParams, Topological
from tianim.systems.boids.steering import find_slots, steer
from tianim.systems.boids.swarm import Swarm
from tianim.systems.boids.tables import (
    BEHAVIOUR_WIDTH,
    SPECIES_WIDTH,
    BehaviourTables,
    all_tables,
    interaction_table,
    is_alike,
    is_sighted,
    largest_radius,
)

Force = Callable[[float, NDArray[Any], NDArray[Any]], NDArray[Any]]


class Boids(Swarm):
    """The system `kind: boids`.

    Arrays: position (n, 3) [m], velocity (n, 3) [m/s], lean (n,), the tangent of the bank.
    """

    def __init__(self, name: str, params: BoidsParams, world: World) -> None:
        super().__init__(name, params.particle_count(), params.dimension, world, {"species": -1})
        self.params = params
        self.names = list(params.all_species())
        self._place()
        now = params.at(0.0)
        self.grid = NeighborGrid(
            self.count,
            params.dimension,
            world.bounds,
            largest_radius(now, world.bounds),
            tagged=len(self.names) > 1,
        )
        self.behaviours = BehaviourTables(params, world.bounds, world.bodies)
        first_id, counts = self.behaviours.first_id, self.behaviours.counts
        self.parts = {
            name if species == MAIN else f"{name}_{species}": (first_id[species], counts[species])
            for species in self.names
        }
        self._forces: list[Force] = []
        self._allocate()

    def _allocate(self) -> None:
        capacity = staggered(self.count)
        self.acceleration = ti.ndarray(ti.f32, (4, capacity))
        self._rules = ti.ndarray(ti.f32, (len(self.names), SPECIES_WIDTH))
        self._interactions = ti.ndarray(ti.f32, (len(self.names) ** 2, 3))
        self._interactions.from_numpy(interaction_table(self.params))
        self._table = ti.ndarray(ti.f32, (max(self.behaviours.count, 1), BEHAVIOUR_WIDTH))
        self._path = ti.ndarray(ti.f32, self.behaviours.paths.shape)
        self._path.from_numpy(self.behaviours.paths)
        self._slot = ti.ndarray(ti.i32, capacity if self.behaviours.needs_slots else 1)
        self._external = ti.ndarray(ti.f32, (3, 1))
        self._bounds = ti.ndarray(ti.f32, (2, 3))
        self._box = ti.ndarray(ti.f32, 3)
        bounds = self.world.bounds
        if bounds.lower is not None and bounds.upper is not None:
            corners = np.array([bounds.lower, bounds.upper], np.float32)
            self._bounds.from_numpy(corners)
            length = np.where(np.arange(3) < self.dimension, corners[1] - corners[0], 0.0)
            self._box.from_numpy(length.astype(np.float32))
        self._packed: BoidsParams | None = None

    def _place(self) -> None:
        rng = np.random.default_rng(self.world.seed)
        positions, velocities, kinds = [], [], []
        for index, species in enumerate(self.params.all_species().values()):
            placed = place(species.start, species.count, rng, self.params.dimension)
            velocity = placed.velocity
            if velocity is None:
                heading = directions(species.heading, placed.position, rng, self.params.dimension)
                velocity = np.float32(species.speed) * heading
            positions.append(self.inside(placed.position))
            velocities.append(velocity)
            kinds.append(np.full(placed.count, index, np.int32))
        self.columns.write("position", np.concatenate(positions))
        self.columns.write("velocity", np.concatenate(velocities))
        self.columns.write("species", np.concatenate(kinds))

    def add_force(self, force: Force) -> None:
        """Add an acceleration [m/s2] of your own, outside the budget.

        `force(time, position, velocity)` gets and gives arrays of shape (n, 3) in id order.
        """
        self._forces.append(force)

    def max_step(self) -> float:
        """The time step of the parameters [s]."""
        return self.params.time_step

    def step(self, time: float, dt: float) -> None:
        """One step: sort, urgent behaviours, the three rules, other behaviours, motion."""
        self._measured = False
        if self.count == 0:
            return
        self._update(time, dt)
        self.sort()
        self.acceleration.fill(0.0)
        self._steer(time, 0, self.behaviours.urgent)
        self.flock()
        self._steer(time, self.behaviours.urgent, self.behaviours.count)
        self._apply_forces(time)
        self.integrate(dt)

    def _update(self, time: float, dt: float) -> None:
        """Parameters at `time` into the tables; constant ones are packed once."""
        now = self.params.at(time)
        if now is not self._packed:
            self._rules.from_numpy(all_tables(now, self.names))
            self.grid.resize(largest_radius(now, self.world.bounds))
            self._sighted, self._alike = is_sighted(now), is_alike(now)
            self._packed = now
            self._behaviours_packed = False
        if self.behaviours.count and not self._behaviours_packed:
            self._table.from_numpy(self.behaviours.rows(now, time, dt))
            self._behaviours_packed = not self.behaviours.follows_bodies

    def sort(self) -> None:
        """Into cell order."""
        self.grid.sort(self.columns)
        if self.behaviours.needs_slots:
            find_slots(self.count, self.columns["id"], self._slot)

    def flock(self) -> None:
        """The three rules onto the acceleration."""
        neighbourhood, grid, columns = self.params.neighbourhood, self.grid, self.columns
        topological = isinstance(neighbourhood, Topological)
        flock(
            self.params.dimension, len(self.names) > 1, topological, self._sighted, self._alike,
            neighbourhood.k if isinstance(neighbourhood, Topological) else 0,
            self._rules, self._interactions, columns["species"],
            grid.shape, grid.geometry, grid.start, columns["position"], columns["velocity"],
            grid.scratch, grid.offset, self.acceleration,
        )  # fmt: skip

    def _steer(self, time: float, first: int, last: int) -> None:
        if first == last:
            return
        columns, bodies = self.columns, self.world.bodies
        steer(
            self.params.dimension, self.world.bounds.kind == "periodic", self.count, first, last, time,
            self.world.seed & 0xFFFFFFFF,
            self._table, self._rules, self._path, columns["species"], columns["id"], self._slot,
            columns["position"], columns["velocity"], self._box,
            bodies.table, bodies.samples, bodies.count, self.acceleration,
        )  # fmt: skip

    def _apply_forces(self, time: float) -> None:
        if not self._forces:
            return
        position, velocity = self.columns.read("position"), self.columns.read("velocity")
        total = np.zeros_like(position)
        for force in self._forces:
            given = np.asarray(force(time, position, velocity), np.float32)
            if given.shape != total.shape:
                raise SceneError(f"{self.name}: a force gave shape {given.shape}, must be {total.shape}")
            total += given
        if self._external.shape[1] == 1:
            self._external = ti.ndarray(ti.f32, (3, staggered(self.count)))
        self.columns.scatter(total, self._external)

    def integrate(self, dt: float) -> None:
        """Limits, motion, walls, banking."""
        bounds, bodies, columns = self.world.bounds, self.world.bodies, self.columns
        integrate(
            self.params.dimension, self.count, dt, self._rules, columns["species"],
            self.acceleration, self._external, int(bool(self._forces)), self._bounds,
            int(bounds.kind == "periodic"), int(bounds.kind == "contained"),
            bodies.table, bodies.samples, bodies.count,
            columns["position"], columns["velocity"], columns["lean"],
        )  # fmt: skip
