"""The columns of the small tables by which parameters reach the kernels, evaluated once a step."""

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tianim.spatial.bodies import Bodies
from tianim.system import Bounds
from tianim.systems.boids import behaviours as b
from tianim.systems.boids.params import MAIN, BoidsParams, Interaction, Rule, Species

Table = NDArray[np.float32]

# A species' row.
SEPARATION, ALIGNMENT, COHESION = 0, 3, 6  # each: radius squared, weight, view (see `view_bound`)
MAX_SPEED, MIN_SPEED, MAX_ACCELERATION, BUDGET, MAX_TURN_RATE, MAX_LEAN, BANK_TIME = range(9, 16)
SPECIES_WIDTH = 16

# A behaviour's row.
KIND, SPECIES, WEIGHT, FIRST, COUNT = range(5)  # FIRST and COUNT: ids of the target species, COUNT 0: a place
TARGET, TARGET_VELOCITY, EXTRA = 5, 8, 11  # three floats each, then the behaviour's own
BEHAVIOUR_WIDTH = 24

# Kinds of behaviour as the kernel knows them; pursuit and evasion are seek and flee with a horizon.
SEEK, FLEE, ARRIVAL, WANDER, CRUISE, PATH, FLOW, LEADER, ROOST, CONTAIN, AVOID = range(11)
UNIFORM, VORTEX, CELLULAR = range(3)

# Stands for "no limit" where a float32 must stay finite when squared.
UNLIMITED = 1e18


def view_bound(angle: float) -> float:
    """C |c| with c = cos(angle / 2): d is in view where f |f| >= c |c| d.d, f = heading . d.

    For the full circle it is below -1, so that rounding cannot blind a boid straight behind.
    """
    if angle >= 360.0:
        return -2.0
    c = math.cos(math.radians(angle) / 2)
    return c * abs(c)


def _rule(rule: Rule) -> tuple[float, float, float]:
    return rule.radius**2, rule.weight, view_bound(rule.field_of_view)


def species_row(species: Species) -> list[float]:
    """The row of a species whose channels are evaluated."""
    limits = species.limits
    return [
        *_rule(species.separation),
        *_rule(species.alignment),
        *_rule(species.cohesion),
        limits.max_speed,
        min(limits.min_speed, limits.max_speed),
        limits.max_acceleration,
        limits.max_acceleration if limits.allocation == "prioritised" else UNLIMITED,
        math.radians(limits.max_turn_rate),
        math.tan(math.radians(limits.max_bank)),
        limits.bank_time,
    ]


def largest_radius(params: BoidsParams, bounds: Bounds) -> float:
    """Reach of the neighbour search [m]; where every rule is off, one that the bounds have room for."""
    species = params.all_species().values()
    largest = max(r.radius for s in species for r in (s.separation, s.alignment, s.cohesion))
    if largest > 0.0 or bounds.lower is None or bounds.upper is None:
        return largest or 1.0
    return float(np.subtract(bounds.upper, bounds.lower).min()) / 4


def is_sighted(params: BoidsParams) -> bool:
    """Whether any rule sees less than the full circle, which costs the pair loop a fifth."""
    species = params.all_species().values()
    return any(r.field_of_view < 360.0 for s in species for r in (s.separation, s.alignment, s.cohesion))


def is_alike(params: BoidsParams) -> bool:
    """Whether the three rules of each species have the same radius and view: one test a pair for all."""
    return all(
        len({(r.radius, r.field_of_view) for r in (s.separation, s.alignment, s.cohesion)}) == 1
        for s in params.all_species().values()
    )


def interaction_table(params: BoidsParams) -> Table:
    """Factors (separation, alignment, cohesion) of species pair s * n + other, shape (n * n, 3)."""
    names = list(params.all_species())
    rows = []
    for who in names:
        for other in names:
            given, own = params.interactions.get(who, {}).get(other, Interaction()), float(who == other)
            alignment = own if given.alignment is None else given.alignment
            cohesion = own if given.cohesion is None else given.cohesion
            rows.append((given.separation, alignment, cohesion))
    return np.array(rows, np.float32)


class BehaviourTables:
    """Behaviours of all species as rows, the urgent ones first, and the paths they follow."""

    def __init__(self, params: BoidsParams, bounds: Bounds, bodies: Bodies) -> None:
        self.params, self.bounds, self.bodies = params, bounds, bodies
        names = list(params.all_species())
        self.counts = {name: species.boid_count() for name, species in params.all_species().items()}
        listed = [
            (name, k)
            for name, species in params.all_species().items()
            for k in range(len(species.behaviours))
            if self._has_target(params, (name, k))
        ]
        urgent = [
            key for kind in b.URGENT for key in listed if isinstance(self._behaviour(params, key), kind)
        ]
        self.keys = urgent + [key for key in listed if key not in urgent]
        self.urgent = len(urgent)
        self.count = len(self.keys)
        self.species_index = {name: k for k, name in enumerate(names)}
        self.paths, self._path_start = self._collect_paths(params)
        ids = np.cumsum([0, *(s.boid_count() for s in params.all_species().values())])
        self.first_id = {name: int(ids[k]) for k, name in enumerate(names)}
        # Bodies move by themselves: rows that aim at one are packed anew each step.
        self.follows_bodies = any(
            isinstance(getattr(self._behaviour(params, key), "target", None), b.BodyTarget)
            for key in self.keys
        )
        self.needs_slots = any(self._target_species(params, key) for key in self.keys)

    @staticmethod
    def _behaviour(params: BoidsParams, key: tuple[str, int]) -> Any:
        return params.all_species()[key[0]].behaviours[key[1]]

    def _has_target(self, params: BoidsParams, key: tuple[str, int]) -> bool:
        """Not where the target is a species without members: who minds it minds nothing."""
        other = self._target_species(params, key)
        return other is None or self.counts[other] > 0

    def _target_species(self, params: BoidsParams, key: tuple[str, int]) -> str | None:
        behaviour = self._behaviour(params, key)
        if isinstance(behaviour, b.LeaderFollowing):
            return behaviour.leaders
        target = getattr(behaviour, "target", None)
        return target.name if isinstance(target, b.SpeciesTarget) else None

    def _collect_paths(self, params: BoidsParams) -> tuple[Table, dict[tuple[str, int], int]]:
        points: list[tuple[float, float, float]] = []
        start: dict[tuple[str, int], int] = {}
        for key in self.keys:
            behaviour = self._behaviour(params, key)
            if isinstance(behaviour, b.PathFollowing):
                start[key] = len(points)
                points += [*behaviour.points, *behaviour.points[:1]] if behaviour.loop else behaviour.points
        return np.array(points or [(0.0, 0.0, 0.0)], np.float32), start

    def rows(self, params: BoidsParams, time: float, dt: float) -> Table:
        """The table at `time`, from parameters whose channels are evaluated: (count, width)."""
        table = np.zeros((max(self.count, 1), BEHAVIOUR_WIDTH), np.float32)
        for row, key in zip(table, self.keys, strict=False):
            behaviour = self._behaviour(params, key)
            row[SPECIES], row[WEIGHT] = self.species_index[key[0]], behaviour.weight
            other = self._target_species(params, key)
            if other is not None:
                row[FIRST], row[COUNT] = self.first_id[other], self.counts[other]
            elif hasattr(behaviour, "target"):
                place, velocity = self._place(self._behaviour(self.params, key).target, time, dt)
                row[TARGET : TARGET + 3], row[TARGET_VELOCITY : TARGET_VELOCITY + 3] = place, velocity
                row[COUNT] = 0
            kind, extra = self._own(behaviour, key)
            row[KIND] = kind
            row[EXTRA : EXTRA + len(extra)] = extra
        return table

    def _place(self, target: b.Point | b.BodyTarget, time: float, dt: float) -> tuple[Any, Any]:
        """Where a target is and how it moves, from its keyframes where it has some."""
        thing = target if isinstance(target, b.Point) else self.bodies.params[target.name]
        now, later = (np.array(thing.at(t).position) for t in (time, time + dt))
        return now, (later - now) / dt

    def _own(self, behaviour: b.Behaviour, key: tuple[str, int]) -> tuple[int, list[float]]:
        """Kind and own floats of a behaviour."""
        match behaviour:
            case b.Seek():
                return SEEK, [0.0]
            case b.Pursuit():
                return SEEK, [behaviour.horizon]
            case b.Flee():
                return FLEE, [0.0, behaviour.radius]
            case b.Evasion():
                return FLEE, [behaviour.horizon, behaviour.radius]
            case b.Arrival():
                return ARRIVAL, [behaviour.slowing_radius]
            case b.Wander():
                return WANDER, [behaviour.rate]
            case b.Cruise():
                return CRUISE, [behaviour.speed]
            case b.PathFollowing():
                corners = len(behaviour.points) + behaviour.loop
                return PATH, [
                    behaviour.radius,
                    behaviour.ahead,
                    self._path_start[key],
                    corners,
                    behaviour.loop,
                ]
            case b.FlowFollowing():
                return FLOW, _flow(behaviour.field)
            case b.LeaderFollowing():
                return LEADER, [behaviour.slowing_radius, behaviour.distance]
            case b.Roost():
                return ROOST, [*behaviour.centre, behaviour.radius, behaviour.vertical]
            case b.Containment():
                return CONTAIN, self._region(behaviour)
            case b.ObstacleAvoidance():
                return AVOID, [behaviour.margin, behaviour.look_ahead]

    def _region(self, behaviour: b.Containment) -> list[float]:
        """Margin, look ahead, centre, half lengths of a box or (radius, -1, -1) of a ball."""
        size, centre = behaviour.size, behaviour.centre
        if size is None:
            assert self.bounds.lower is not None
            assert self.bounds.upper is not None
            lower, upper = np.array(self.bounds.lower), np.array(self.bounds.upper)
            centre, half = tuple((lower + upper) / 2), tuple((upper - lower) / 2)
        elif isinstance(size, tuple):
            half = tuple(length / 2 for length in size)
        else:
            half = (size, -1.0, -1.0)
        return [behaviour.margin, behaviour.look_ahead, *centre, *half]


def _flow(field: b.Flow) -> list[float]:
    match field:
        case b.Uniform():
            return [UNIFORM, *field.velocity]
        case b.Vortex():
            axis = np.array(field.axis) / np.linalg.norm(field.axis)
            return [VORTEX, *field.centre, *axis, field.radius, field.speed]
        case b.Cellular():
            return [CELLULAR, math.pi / field.size, field.speed]


def all_tables(params: BoidsParams, names: list[str]) -> Table:
    """Rows of all species, shape (species, width)."""
    species = params.all_species()
    return np.array([species_row(species[name]) for name in names], np.float32)


__all__ = ["MAIN", "BehaviourTables", "all_tables", "interaction_table", "largest_radius"]
