"""Parameters of the flock: species, their three rules, limits and behaviours."""

from collections.abc import Collection, Mapping
from typing import Annotated, Literal

from pydantic import Field, model_validator
from typing_extensions import Self

from tianim.params import Animated, Count, Degrees, Keyframes, Name, NonNegative, Params, Positive
from tianim.spatial.grid import NARROWEST
from tianim.spatial.placement import Ball, Heading, Placement, RandomHeading, check_start, own_count
from tianim.system import Bounds, SystemParams
from tianim.systems.boids.behaviours import (
    Behaviour,
    BodyTarget,
    Containment,
    LeaderFollowing,
    SpeciesTarget,
)

MAIN = "flock"  # name of the species that the system's own fields describe
# Pairs that a step may search for the nearest of a species: about a second on two cores.
MAX_TARGET_PAIRS = 1_000_000_000
# Ids of a target species travel to the kernel as float32, which holds every whole number up to here.
MOST_WITH_TARGETS = 1 << 24
BYTES_PER_BOID = 104
BYTES_PER_CANDIDATE = 56
# Measured at 20 neighbours in 3D; the estimate of `tianim check` scales with nothing finer.
SECONDS_PER_BOID_STEP = 0.15e-6
SECONDS_PER_STEP = 1e-3


class Rule(Params):
    """One of the three rules: whom it minds and how strongly."""

    radius: Animated[NonNegative] = Field(1.0, description="minds boids within this [m]; 0: the rule is off")
    weight: Animated[NonNegative] = Field(1.0, description="strength")
    field_of_view: Animated[Degrees] = Field(360.0, description="full angle seen, about the heading [deg]")

    def largest_radius(self) -> float:
        """The radius [m], the largest of its keys where it is keyframed."""
        if isinstance(self.radius, Keyframes):
            return max(radius for _, radius in self.radius.keys)
        return self.radius


class Metric(Params):
    """Every boid within a rule's radius counts."""

    kind: Literal["metric"] = "metric"


class Topological(Params):
    """Only the k nearest boids count (Ballerini et al. 2008), within the rules' radii."""

    kind: Literal["topological"] = "topological"
    k: Annotated[int, Field(ge=1, le=256)] = Field(7, description="how many nearest")


Neighbourhood = Annotated[Metric | Topological, Field(discriminator="kind")]


class Limits(Params):
    """What a boid can do."""

    max_speed: Animated[Positive] = Field(2.0, description="top speed [m/s]")
    min_speed: Animated[NonNegative] = Field(0.0, description="least speed [m/s]")
    max_acceleration: Animated[Positive] = Field(10.0, description="budget of all steering together [m/s2]")
    max_turn_rate: Animated[Positive] = Field(36000.0, description="fastest turn [deg/s]")
    allocation: Literal["prioritised", "weighted"] = Field(
        "prioritised",
        description="prioritised: the budget is spent in the order of urgency; weighted: the sum is cut",
    )
    max_bank: Annotated[float, Field(ge=0, lt=90)] = Field(60.0, description="steepest bank [deg]; 0: none")
    bank_time: Positive = Field(0.2, description="time to roll into a bank [s]")

    @model_validator(mode="after")
    def _speeds_rise(self) -> Self:
        low, high = self.min_speed, self.max_speed
        if isinstance(low, float | int) and isinstance(high, float | int) and low > high:
            raise ValueError(f"min_speed {low:g} must not exceed max_speed {high:g}")
        return self


class Species(Params):
    """One kind of boid."""

    count: Count | None = Field(None, description="how many; may be left out where `start` is a list or file")
    start: Placement = Field(Ball(), description="where they start")
    heading: Heading = Field(RandomHeading(), description="which way they head at the start")
    speed: NonNegative = Field(1.0, description="speed at the start [m/s]")
    separation: Rule = Field(Rule(), description="away from each: sum of -d/|d|^2, weight in m2/s2")
    alignment: Rule = Field(Rule(), description="to the mean velocity, weight in 1/s")
    cohesion: Rule = Field(Rule(), description="to the mean place, weight in 1/s2")
    limits: Limits = Field(Limits(), description="speed, acceleration, turning")
    behaviours: tuple[Behaviour, ...] = Field((), max_length=32, description="what else they want, in order")

    def boid_count(self) -> int:
        """How many, the placement's own count where `count` is left out."""
        return self.count if self.count is not None else own_count(self.start) or 0

    @model_validator(mode="after")
    def _start_fits(self) -> Self:
        check_start(self.count, self.start, self.heading)
        return self


class Interaction(Params):
    """How strongly a boid of one species minds another species, or its own, in its three rules."""

    separation: NonNegative = Field(1.0, description="factor on the other's separation")
    alignment: NonNegative | None = Field(
        None, description="factor on the other's velocity; left out: 1 for its own species, else 0"
    )
    cohesion: NonNegative | None = Field(
        None, description="factor on the other's place; left out: 1 for its own species, else 0"
    )


class BoidsParams(Species, SystemParams):
    """A flock after Reynolds 1987 and 1999; the fields of a species describe the main one, `flock`."""

    kind: Literal["boids"] = "boids"
    dimension: Literal[2, 3] = Field(3, description="2: in the plane z = 0")
    time_step: Positive = Field(1 / 60, description="largest step [s]")
    neighbourhood: Neighbourhood = Field(Metric(), description="who counts as a neighbour")
    species: Mapping[Name, Species] = Field({}, max_length=15, description="further species by name")
    interactions: Mapping[Name, Mapping[Name, Interaction]] = Field(
        {}, description="who minds whom: {species: {other: factors}}; by default the others are kept off"
    )

    def all_species(self) -> dict[str, Species]:
        """The main species and the others, in the order of their ids."""
        return {MAIN: self, **self.species}

    def particle_count(self) -> int:
        """Boids of all species."""
        return sum(species.boid_count() for species in self.all_species().values())

    def memory_bytes(self) -> int:
        """Columns, cells and scratch."""
        return (BYTES_PER_BOID + BYTES_PER_CANDIDATE // 4) * self.particle_count() + (1 << 20)

    def seconds_per_step(self) -> float:
        """From the benchmark's figure."""
        return SECONDS_PER_STEP + SECONDS_PER_BOID_STEP * self.particle_count()

    def largest_step(self) -> float:
        """The time step."""
        return self.time_step

    def check_scene(self, bounds: Bounds, body_names: Collection[str], system_names: Collection[str]) -> None:
        """Names of targets exist, bounds are there and wide enough; ValueError says which is not."""
        self._check_width(bounds)
        for name, species in self.all_species().items():
            for k, behaviour in enumerate(species.behaviours):
                target = getattr(behaviour, "target", None)
                place = f"{'' if name == MAIN else f'species.{name}.'}behaviours.{k}"
                if isinstance(target, BodyTarget) and target.name not in body_names:
                    there = ", ".join(body_names) or "none"
                    raise ValueError(f"{place}.target: no body {target.name!r}; there are {there}")
                if (
                    isinstance(behaviour, Containment)
                    and behaviour.size is None
                    and bounds.kind != "contained"
                ):
                    raise ValueError(f"{place}: containment needs a size, or bounds of kind contained")

    def _check_width(self, bounds: Bounds) -> None:
        """A periodic box must not be so narrow that a boid meets another twice."""
        if bounds.kind != "periodic" or bounds.lower is None or bounds.upper is None:
            return
        reach = max(
            rule.largest_radius()
            for species in self.all_species().values()
            for rule in (species.separation, species.alignment, species.cohesion)
        )
        width = min(bounds.upper[axis] - bounds.lower[axis] for axis in range(self.dimension))
        if width < NARROWEST * reach:
            raise ValueError(
                f"a rule's radius is {reach:g} m: periodic bounds must be at least {NARROWEST:g} radii wide, "
                f"not {width:g} m"
            )

    @model_validator(mode="after")
    def _names_exist(self) -> Self:
        names = list(self.all_species())
        if MAIN in self.species:
            raise ValueError(f"species: {MAIN!r} is the name of the main species")
        for who, others in self.interactions.items():
            for name in (who, *others):
                if name not in names:
                    raise ValueError(f"interactions: no species {name!r}; there are {', '.join(names)}")
        for name, species in self.all_species().items():
            for k, behaviour in enumerate(species.behaviours):
                target = getattr(behaviour, "target", None)
                other = target.name if isinstance(target, SpeciesTarget) else None
                if isinstance(behaviour, LeaderFollowing):
                    other = behaviour.leaders
                if other is not None:
                    self._check_target(name, k, other)
        return self

    def _check_target(self, name: str, k: int, other: str) -> None:
        species = self.all_species()
        place = f"behaviours.{k} of {name}"
        if other not in species:
            raise ValueError(f"{place}: no species {other!r}; there are {', '.join(species)}")
        if self.particle_count() > MOST_WITH_TARGETS:
            raise ValueError(
                f"{place}: a species as target needs at most {MOST_WITH_TARGETS:,} boids in all, "
                f"not {self.particle_count():,}"
            )
        pairs = species[name].boid_count() * species[other].boid_count()
        if pairs > MAX_TARGET_PAIRS:
            raise ValueError(
                f"{place}: {pairs:.0e} pairs of {name} and {other} to search each step; "
                f"at most {MAX_TARGET_PAIRS:.0e}"
            )
