"""Parameters of a particle fluid: liquid, blocks, emitters, sinks, walls, method, step, gauges.

Everything is in SI and follows from `spacing`, the distance d of particles at rest: a particle has
the volume V = d^3 (in two dimensions d^2, per metre of depth) and the mass density x V; its
neighbours are those nearer than the support radius, `support` spacings.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field, model_validator
from typing_extensions import Self

from tianim.math.smoothing import SUPPORT
from tianim.params import Animated, Fraction, Keyframes, Name, Params, Positive, Vector3
from tianim.spatial.grid import NARROWEST
from tianim.system import Bounds, SystemParams
from tianim.systems.fluid.block_params import ROUNDING, BlockParams, BoxBlock, Many, SphereBlock
from tianim.systems.fluid.gauge_params import ForceGauge, FrontGauge, GaugeParams
from tianim.systems.fluid.method_params import DfsphParams, PbfParams, WcsphParams
from tianim.systems.fluid.source_params import EmitterParams, SinkParams

# Heavier by more, a phase lets the pressure solve of the lighter one no longer converge.
LARGEST_DENSITY_RATIO = 10.0
# Places of neighbour lists are float32 (spatial/neighbor_lists.py).
MOST_PARTICLES = 1 << 24
MOST_NAMES = 1000

# State, its twin for sorting, and scratch; a stored pair (neighbour and gradient) and pairs a particle.
BYTES_PER_PARTICLE = 240
BYTES_PER_PAIR = 16
PAIRS_PER_PARTICLE = {2: 28, 3: 40}
# Of a step with some six iterations of the pressure solve on two ordinary cores.
SECONDS_PER_PARTICLE = {"dfsph": 1.1e-6, "pbf": 1.5e-6, "wcsph": 0.5e-6}
SECONDS_PER_STEP = 1e-3
# Part of the period of a ripple of two spacings, over 2 pi, that is stable; see surface_tension.py.
CAPILLARY = 0.4
# Way in a step, in spacings: PBF takes places from where they are, and bears more.
CFL = {"dfsph": 0.5, "pbf": 0.8, "wcsph": 0.4}
# What limits a step (timestep.py), and what to do about it.
CURES = {
    "flow": "the fluid is fast for its spacing: a larger spacing, a larger time_step.cfl or a slower start",
    "spray": "single particles are very fast: look whether blocks overlap or start in a wall",
    "pressed": "the fluid is deep for its spacing, or driven together: a larger spacing",
    "capillary": "the surface tension is large for the spacing: a larger spacing or less surface_tension",
    "acoustic": "the sound is fast for the spacing: a larger spacing, a smaller wcsph.sound_speed or dfsph",
    "depth": "the fluid is deep for its spacing: a larger spacing, or dfsph",
    "largest": "time_step.largest is that short",
}
# What counts as standing still when the first step is estimated [m/s].
LEAST_SPEED = 1e-3

Density = Annotated[float, Field(ge=0.01, le=1e5)]
Viscosity = Annotated[float, Field(ge=0, le=1e4)]


class Phase(Params):
    """A liquid beside the fluid's own."""

    density: Density = Field(1000.0, description="density at rest [kg/m3]")
    viscosity: Viscosity = Field(1.0e-6, description="kinematic viscosity [m2/s]; water 1e-6, honey 5e-3")


class BodyWall(Params):
    """How one body acts on the fluid."""

    friction: Fraction = Field(0.0, description="0: the fluid slips, 1: it sticks")


class Walls(Params):
    """How the bounds and the bodies act on the fluid."""

    friction: Fraction = Field(0.0, description="0: the fluid slips, 1: it sticks")
    bodies: Mapping[Name, BodyWall] = Field(
        {}, max_length=MOST_NAMES, description="bodies with a friction of their own, by name"
    )

    def friction_of(self, body: str) -> float:
        """Friction of a body."""
        return self.bodies[body].friction if body in self.bodies else self.friction


class TimeStep(Params):
    """How long a step may be; the limits of flow, viscosity, surface tension and sound come on top."""

    largest: Positive = Field(0.005, description="largest step [s]")
    smallest: Positive = Field(1e-6, description="smallest step [s]: one that would need less stops the run")
    cfl: Annotated[float, Field(gt=0, le=2)] | None = Field(
        None,
        description="way that the fastest particle goes in a step, part of the spacing; left out: 0.5, "
        "with the method pbf 0.8",
    )
    most_substeps: Annotated[int, Field(ge=1, le=1_000_000)] = Field(
        5000, description="steps that a frame may need; more stop the run and say why"
    )

    @model_validator(mode="after")
    def _smallest_is_below_largest(self) -> Self:
        if self.smallest > self.largest:
            raise ValueError(
                f"smallest {self.smallest:g} s: must not exceed the largest step, {self.largest:g} s"
            )
        return self


def capillary_limit(density: float, spacing: float, tension: float) -> float:
    """Largest step [s] for a surface tension [N/m] of a fluid [kg/m3] of this spacing [m]."""
    if tension == 0.0:
        return math.inf
    return CAPILLARY * math.sqrt(density * spacing**3 / (2.0 * math.pi * tension))


def refuse_substeps(substeps: int, allowed: TimeStep, name: str, step: float) -> None:
    """ValueError where a frame needs more substeps than are `allowed`, of `step` [s] for the limit `name`."""
    if substeps > allowed.most_substeps:
        raise ValueError(
            f"a frame would need {substeps:,} substeps, of {step:.3g} s ({name}), more than "
            f"time_step.most_substeps, {allowed.most_substeps:,}: {CURES[name]}; or a larger most_substeps"
        )


class FluidParams(SystemParams):
    """A liquid of particles."""

    kind: Literal["fluid"] = "fluid"
    method: Literal["dfsph", "pbf", "wcsph"] = Field(
        "dfsph", description="dfsph: accurate; pbf: forgiving; wcsph: simple, short steps"
    )
    dimension: Literal[2, 3] = Field(3, description="2: in the plane z = 0, a metre deep")
    spacing: Annotated[float, Field(ge=1e-6, le=1e6)] = Field(
        0.02, description="distance of particles at rest [m]"
    )
    support: Annotated[float, Field(ge=1.5, le=4)] | None = Field(
        None,
        description="support radius of the smoothing kernel, in spacings; left out: 2, and 2.75 in the plane",
    )
    density: Density = Field(1000.0, description="density at rest [kg/m3]")
    viscosity: Viscosity = Field(1.0e-6, description="kinematic viscosity [m2/s]; water 1e-6, honey 5e-3")
    artificial_viscosity: Annotated[float, Field(ge=0, le=1)] = Field(
        0.1,
        description="viscosity added to calm single particles, part of spacing x sqrt(gravity x spacing)",
    )
    surface_tension: Annotated[float, Field(ge=0, le=1e4)] = Field(
        0.0, description="surface tension [N/m]; water 0.0728"
    )
    vorticity: Annotated[float, Field(ge=0, le=10)] = Field(
        0.0, description="strength of vorticity confinement, which keeps whirls going; 0: none"
    )
    gravity: Animated[Vector3] = Field((0.0, -9.81, 0.0), description="acceleration of all fluid [m/s2]")
    phases: Mapping[Name, Phase] = Field(
        {}, max_length=15, description="liquids beside the fluid's own, by name"
    )
    blocks: Mapping[Name, BlockParams] = Field(
        {}, max_length=MOST_NAMES, description="the fluid at the start, by name",
        examples=[{"pool": {"kind": "box", "lower": [0.0, 0.0, 0.0], "upper": [0.1, 0.1, 0.1]}}],
    )  # fmt: skip
    emitters: Mapping[Name, EmitterParams] = Field(
        {}, max_length=MOST_NAMES, description="where fluid comes in, by name"
    )
    sinks: Mapping[Name, SinkParams] = Field(
        {}, max_length=MOST_NAMES, description="where fluid goes out, by name"
    )
    capacity: Many | None = Field(
        None,
        description="particles that there may be at a time; left out: blocks and all that emitters give",
    )
    walls: Walls = Field(Walls(), description="how bounds and bodies act on the fluid")
    time_step: TimeStep = Field(TimeStep(), description="how long a step may be")
    dfsph: DfsphParams = Field(DfsphParams(), description="of the method dfsph")
    pbf: PbfParams = Field(PbfParams(), description="of the method pbf")
    wcsph: WcsphParams = Field(WcsphParams(), description="of the method wcsph")
    gauges: Mapping[Name, GaugeParams] = Field(
        {}, max_length=MOST_NAMES, description="what is measured in each frame, by name"
    )

    @property
    def support_radius(self) -> float:
        """Reach of the smoothing kernel, h [m]."""
        return (self.support or SUPPORT[self.dimension]) * self.spacing

    @property
    def calming(self) -> float:
        """Kinematic viscosity that is added to that of every phase [m2/s]."""
        gravity = math.hypot(*self.at(0.0).gravity)
        return self.artificial_viscosity * self.spacing * math.sqrt(gravity * self.spacing)

    @property
    def cfl(self) -> float:
        """Way that the fastest particle goes in a step [spacings]."""
        given = self.time_step.cfl
        return CFL[self.method] if given is None else given

    @property
    def cell_volume(self) -> float:
        """Volume of a particle, V = d^3 [m3]; in two dimensions d^2 [m2]."""
        return float(self.spacing**self.dimension)

    def all_phases(self) -> tuple[Phase, ...]:
        """The fluid's own liquid and the others, in the order of their numbers."""
        return (Phase(density=self.density, viscosity=self.viscosity), *self.phases.values())

    def phase_number(self, name: str | None) -> int:
        """Number of a phase: 0 is the fluid's own, None."""
        return 0 if name is None else 1 + list(self.phases).index(name)

    def particle_count(self) -> int:
        """The most that there will be at one time."""
        return self.capacity or self.block_count() + self.emitted_count()

    def block_count(self) -> int:
        """Particles at the start, estimated."""
        return sum(block.particle_count(self.spacing, self.dimension) for block in self.blocks.values())

    def emitted_count(self) -> int:
        """Particles that all emitters give over the whole run; those without an end are not counted."""
        counts = (emitter.particle_count(self.spacing, self.dimension) for emitter in self.emitters.values())
        return sum(count or 0 for count in counts)

    def memory_bytes(self) -> int:
        """State, lists with gradients and scratch."""
        wider = self.support_radius / (SUPPORT[self.dimension] * self.spacing)
        pairs = PAIRS_PER_PARTICLE[self.dimension] * wider**self.dimension
        return int((BYTES_PER_PARTICLE + BYTES_PER_PAIR * pairs) * self.particle_count()) + (1 << 22)

    def seconds_per_step(self) -> float:
        """From the benchmark's figures."""
        return SECONDS_PER_STEP + SECONDS_PER_PARTICLE[self.method] * self.particle_count()

    def largest_step(self) -> float:
        """Largest step [s] at the start: as given, or by the speed of blocks, emitters and sound."""
        return min(self._step_limits().values())

    def _step_limits(self) -> dict[str, float]:
        """What is known of the limits at the start, by name [s]."""
        lightest = min(phase.density for phase in self.all_phases())
        return {
            "largest": self.time_step.largest,
            "flow": self.cfl * self.spacing / self._fastest(),
            "capillary": capillary_limit(lightest, self.spacing, self.surface_tension),
        }

    def check_substeps(self, frame: float) -> None:
        """ValueError where a frame of so many seconds needs more than `time_step.most_substeps`."""
        limits = self._step_limits()
        name = min(limits, key=lambda key: limits[key])
        refuse_substeps(math.ceil(frame / limits[name] * (1.0 - 1e-9)), self.time_step, name, limits[name])

    def check_scene(self, bounds: Bounds, body_names: Collection[str], system_names: Collection[str]) -> None:
        """Bounds have room, blocks lie within them, bodies exist; ValueError says which does not."""
        _check_width(self, bounds)
        _check_blocks(self, bounds)
        named = [(f"walls.bodies.{name}", name) for name in self.walls.bodies]
        named += [
            (f"emitters.{name}.on", one.on) for name, one in self.emitters.items() if one.on is not None
        ]
        named += [
            (f"gauges.{name}.body", one.body)
            for name, one in self.gauges.items()
            if isinstance(one, ForceGauge)
        ]
        for place, body in named:
            if body not in body_names:
                raise ValueError(f"{place}: no body {body!r}; there are {', '.join(body_names) or 'none'}")

    def _fastest(self) -> float:
        """Speed [m/s] that the first step must allow for."""
        blocks = [math.hypot(*block.velocity) for block in self.blocks.values()]
        emitters = [one.fastest(self.dimension) for one in self.emitters.values() if one.start == 0.0]
        sound = (self.wcsph.sound_speed or 0.0) if self.method == "wcsph" else 0.0
        return max([LEAST_SPEED, *blocks, *emitters]) + sound

    @model_validator(mode="after")
    def _has_fluid(self) -> Self:
        if not self.blocks and not self.emitters:
            raise ValueError("blocks, emitters: a fluid needs one of them, or there is none")
        for name, block in self.blocks.items():
            if isinstance(block, BoxBlock):
                _check_thickness(name, block, self.spacing, self.dimension)
        for name, emitter in self.emitters.items():
            endless = emitter.particle_count(self.spacing, self.dimension) is None
            if endless and self.capacity is None:
                raise ValueError(
                    f"emitters.{name}: give its end [s], or how many it gives at most (most), or how many "
                    "particles the fluid may have at one time (capacity)"
                )
        if self.particle_count() > MOST_PARTICLES:
            raise ValueError(
                f"spacing {self.spacing:g} m: gives {self.particle_count():,} particles; "
                f"at most {MOST_PARTICLES:,}"
            )
        return self

    @model_validator(mode="after")
    def _directions_are_in_the_plane(self) -> Self:
        if self.dimension == 3:
            return self
        vectors = {f"emitters.{name}.direction": one.direction for name, one in self.emitters.items()}
        for name, gauge in self.gauges.items():
            if isinstance(gauge, FrontGauge):
                vectors[f"gauges.{name}.direction"] = gauge.direction
        if not isinstance(self.gravity, Keyframes) and any(self.gravity):
            vectors["gravity"] = self.gravity
        for place, vector in vectors.items():
            if not any(vector[:2]):
                raise ValueError(f"{place}: has no part in the plane z = 0, in which dimension: 2 lies")
        return self

    @model_validator(mode="after")
    def _phases_exist(self) -> Self:
        groups: dict[str, Mapping[str, Any]] = {
            "blocks": self.blocks, "emitters": self.emitters, "sinks": self.sinks, "gauges": self.gauges
        }  # fmt: skip
        for group, members in groups.items():
            for name, one in members.items():
                phase = getattr(one, "phase", None)
                if phase is not None and phase not in self.phases:
                    there = ", ".join(self.phases) or "none"
                    raise ValueError(
                        f"{group}.{name}.phase: no phase {phase!r} in phases; there are {there} "
                        "(left out: the fluid's own)"
                    )
        return self

    @model_validator(mode="after")
    def _densities_are_near(self) -> Self:
        for name, phase in self.phases.items():
            for other, density in (("the fluid", self.density), *_densities(self.phases)):
                ratio = phase.density / density
                if not 1.0 / LARGEST_DENSITY_RATIO <= ratio <= LARGEST_DENSITY_RATIO:
                    raise ValueError(
                        f"phases.{name}.density {phase.density:g} kg/m3: differs from {other}'s, "
                        f"{density:g}, by a factor {max(ratio, 1.0 / ratio):.3g}; "
                        f"at most {LARGEST_DENSITY_RATIO:g}"
                    )
        return self


def _densities(phases: Mapping[str, Phase]) -> list[tuple[str, float]]:
    return [(name, phase.density) for name, phase in phases.items()]


def _check_thickness(name: str, block: BoxBlock, spacing: float, dimension: int) -> None:
    """ValueError where a box has no room for one layer."""
    for axis, count in enumerate(block.shape(spacing, dimension)):
        if count == 0:
            thick = block.upper[axis] - block.lower[axis]
            raise ValueError(
                f"blocks.{name}: {thick:g} m in {'xyz'[axis]}, less than the spacing, {spacing:g} m: "
                "it would hold nothing"
            )


def _check_width(params: FluidParams, bounds: Bounds) -> None:
    """ValueError where the bounds have no room for a particle, or a particle would meet another twice."""
    if bounds.lower is None or bounds.upper is None:
        return
    for axis in range(params.dimension):
        width = bounds.upper[axis] - bounds.lower[axis]
        if params.spacing > width:
            raise ValueError(
                f"spacing {params.spacing:g} m: larger than the bounds, which are {width:g} m "
                f"wide in {'xyz'[axis]}"
            )
        if bounds.kind == "periodic" and width < NARROWEST * params.support_radius:
            raise ValueError(
                f"periodic bounds are {width:g} m wide in {'xyz'[axis]}: must be at least {NARROWEST:g} "
                f"support radii of {params.support_radius:g} m"
            )


def _check_blocks(params: FluidParams, bounds: Bounds) -> None:
    """ValueError where a box or a ball reaches out of the bounds: that is told without filling it."""
    if bounds.lower is None or bounds.upper is None:
        return
    for name, block in params.blocks.items():
        if isinstance(block, BoxBlock):
            low, high = np.array(block.lower), np.array(block.upper)
        elif isinstance(block, SphereBlock):
            low, high = (np.array(block.centre) + sign * block.radius for sign in (-1.0, 1.0))
        else:
            continue
        for axis in range(params.dimension):
            below, above = bounds.lower[axis] - low[axis], high[axis] - bounds.upper[axis]
            if max(below, above) > ROUNDING * params.spacing and not block.carve:
                end = low[axis] if below > above else high[axis]
                raise ValueError(
                    f"blocks.{name}: reaches {max(below, above):.3g} m out of the bounds in "
                    f"{'xyz'[axis]}, to {end:g} m"
                )
