"""Parameters of gravity: units, stars, softening, forces, motion, what is measured."""

from collections.abc import Collection, Mapping
from itertools import pairwise
from typing import Annotated, Literal

import numpy as np
from pydantic import Field, model_validator
from typing_extensions import Self

from tianim.params import Fraction, Name, Params
from tianim.system import Bounds, SystemParams
from tianim.systems.gravity.components import Bodies, Component, Galaxy, Orbits, SnapshotFile, check_galaxies
from tianim.systems.gravity.external import External, Magnitude
from tianim.systems.gravity.solver import DIRECT_SINGLE, tree_cost

Units = Literal["nbody", "galactic", "solar", "si"]
# G in the units of each preset.
CONSTANTS: dict[str, float] = {
    "nbody": 1.0,
    "galactic": 43007.1,  # kpc, km/s, 1e10 solar masses; time: kpc/(km/s) = 0.9778e9 years
    "solar": 4.0 * np.pi**2,  # astronomical units, years, solar masses
    "si": 6.6743e-11,  # CODATA 2022
}
# Units of velocity and mass in each preset, for frames; "" has no name.
VELOCITY_UNITS = {"nbody": "", "galactic": "km/s", "solar": "au/yr", "si": "m/s"}
MASS_UNITS = {"nbody": "", "galactic": "1e10 Msun", "solar": "Msun", "si": "kg"}

# Steps that one frame may be halved into: 2^16.
MOST_LEVELS = 16
# What a step may be where nothing is said [s]; a frame is nearly always shorter.
LONGEST_STEP = 1.0
# eta where it is left out: of softened stars (GADGET's usual 0.22), and of orbits without softening,
# which are then divided into some 300 steps.
ETA_SOFT, ETA_HARD = 0.2, 0.02

# State of a star (places, velocities, accelerations, mass, potential) and what the tree takes.
BYTES_PER_STAR = 180
BYTES_SAVED, BYTES_RUNG, BYTES_STAGES = 80, 8, 96
# Of launching the kernels of a step.
SECONDS_PER_STEP = 4e-4
# Bytes of a star in a snapshot file: place, velocity, mass and id in single precision.
BYTES_IN_FILE = 32


class Softening(Params):
    """How the force is bounded at short distances: each star a small cloud."""

    length: Annotated[float, Field(ge=0, le=1e50)] = Field(
        0.0, description="Plummer-equivalent softening length [own length]; 0: none, for a few bodies"
    )
    kind: Literal["plummer", "spline"] = Field(
        "plummer", description="plummer: 1/sqrt(r^2 + length^2); spline: exactly Newton beyond 2.8 lengths"
    )


class SolverParams(Params):
    """How forces are found."""

    kind: Literal["auto", "direct", "tree"] = Field(
        "auto", description="direct: every pair; tree: far stars in groups; auto: what costs less"
    )
    accuracy: Annotated[float, Field(ge=1e-6, le=0.1)] = Field(
        1e-3, description="median relative error of a force that the tree may have"
    )
    precision: Literal["auto", "single", "double"] = Field(
        "auto", description="of each pair's force; sums are always double; auto: double for few bodies"
    )
    check_every: Annotated[int, Field(ge=0, le=1_000_000)] = Field(
        50, description="frames between two checks of the tree's error on 1,000 stars; 0: never"
    )


class FixedStep(Params):
    """The same step always."""

    kind: Literal["fixed"] = "fixed"
    length: Magnitude = Field(description="largest step [own time]", examples=[0.01])


class _Chosen(Params):
    eta: Annotated[float, Field(gt=0, le=10)] | None = Field(
        None,
        description="tau = eta sqrt(softening / |a|); left out: 0.2, and 0.02 without softening, "
        "where |potential| / |a| stands for it",
    )
    largest: Magnitude | None = Field(
        None, description="largest step [own time]; left out: that of a second of the scene"
    )
    levels: Annotated[int, Field(ge=0, le=MOST_LEVELS)] = Field(
        10, description="how often the time between two frames may be halved"
    )


class AdaptiveStep(_Chosen):
    """One step for all, the smallest that a star asks for at either end."""

    kind: Literal["adaptive"] = "adaptive"


class BlockStep(_Chosen):
    """Each star its own power-of-two step, and its forces at the ends of its steps alone; leapfrog only."""

    kind: Literal["block"] = "block"


TimeStep = Annotated[FixedStep | AdaptiveStep | BlockStep, Field(discriminator="kind")]


class Rings(Params):
    """Rings of a disk to be measured in each frame, about its own centre and axis."""

    component: Name = Field(description="name of the component", examples=["disk"])
    edges: tuple[Magnitude, ...] = Field(
        min_length=2, max_length=101, description="radii between the rings, rising [own length]",
        examples=[[0.5, 1.0, 2.0]],
    )  # fmt: skip
    quantities: tuple[Literal["rotation_curve", "surface_density", "toomre_q"], ...] = Field(
        ("rotation_curve", "surface_density", "toomre_q"), description="what is measured in each ring"
    )

    @model_validator(mode="after")
    def _edges_rise(self) -> Self:
        for inner, outer in pairwise(self.edges):
            if outer <= inner:
                raise ValueError(f"edges must rise: {outer:g} comes after {inner:g}")
        return self


class Diagnostics(Params):
    """What is measured in each frame besides energies, momenta and the virial ratio."""

    lagrangian: tuple[Fraction, ...] = Field(
        (0.1, 0.5, 0.9), max_length=20, description="shares of the mass whose radii are reported"
    )
    rings: tuple[Rings, ...] = Field((), max_length=20, description="profiles of disks")
    potential: bool = Field(False, description="frames hold the potential of each star too")


def _stars_of(component: Component) -> int:
    """Stars of a component; of a file a guess by its size."""
    if isinstance(component, Bodies):
        return len(component.bodies)
    if isinstance(component, Orbits):
        return len(component.orbits)
    if isinstance(component, SnapshotFile):
        return component.path.stat().st_size // BYTES_IN_FILE
    return component.count


class GravityParams(SystemParams):
    """Stars under their own gravity."""

    kind: Literal["gravity"] = "gravity"
    units: Units = Field(
        "nbody",
        description="nbody: G = 1; galactic: kpc, km/s, 1e10 solar masses; solar: au, years, solar masses; "
        "si: m, s, kg",
    )
    gravitational_constant: Magnitude | None = Field(
        None, description="G in own units; left out: that of the units"
    )
    time_scale: Magnitude = Field(1.0, description="own time that passes in a second of the scene")
    components: Mapping[Name, Component] = Field(
        {}, max_length=1000, description="stars by name; those that stand here together are in equilibrium"
    )
    galaxies: Mapping[Name, Galaxy] = Field(
        {}, max_length=100, description="groups of components that are placed and turned as wholes"
    )
    recentre: bool = Field(
        True, description="the centre of mass starts at rest at the origin; not with external potentials"
    )
    external: tuple[External, ...] = Field((), max_length=100, description="potentials that do not move")
    softening: Softening = Field(Softening(), description="softening of the forces between stars")
    solver: SolverParams = Field(SolverParams(), description="how forces are found")
    integrator: Literal[
        "leapfrog", "forest_ruth", "rk4", "symplectic_euler", "forward_euler", "constant_acceleration",
        "trapezoid",
    ] = Field(
        "leapfrog",
        description="leapfrog (kick, drift, kick) and forest_ruth keep energy; the lectures' forward_euler, "
        "constant_acceleration and trapezoid do not",
    )  # fmt: skip
    time_step: TimeStep = Field(AdaptiveStep(), description="how long a step is")
    diagnostics: Diagnostics = Field(Diagnostics(), description="what is measured in each frame")

    @property
    def g(self) -> float:
        """G in own units."""
        given = self.gravitational_constant
        return CONSTANTS[self.units] if given is None else given

    @property
    def eta(self) -> float:
        """The factor of tau, where steps are chosen."""
        given = getattr(self.time_step, "eta", None)
        return float(given or (ETA_SOFT if self.softening.length > 0.0 else ETA_HARD))

    def all_components(self) -> tuple[Component, ...]:
        """Of the scene and of its galaxies, in the order of their ids."""
        inside = (part for galaxy in self.galaxies.values() for part in galaxy.components.values())
        return (*self.components.values(), *inside)

    def particle_count(self) -> int:
        """Stars of all components."""
        return sum(_stars_of(component) for component in self.all_components())

    def memory_bytes(self) -> int:
        """State and solver."""
        extra = {"adaptive": BYTES_SAVED, "block": BYTES_RUNG}.get(self.time_step.kind, 0)
        extra += BYTES_STAGES if self.integrator == "rk4" else 0
        return (BYTES_PER_STAR + extra) * self.particle_count() + (1 << 20)

    def seconds_per_step(self) -> float:
        """Of one force evaluation; steps that are halved cost more."""
        count = self.particle_count()
        massive = sum(
            _stars_of(part) for part in self.all_components() if not getattr(part, "massless", False)
        )
        pairs = 1e-9 * DIRECT_SINGLE * count * massive
        tree = 1e-9 * tree_cost(count, self.solver.accuracy)
        cost = {"direct": pairs, "tree": tree, "auto": min(pairs, tree)}[self.solver.kind]
        return SECONDS_PER_STEP + cost

    def largest_step(self) -> float:
        """Largest step at the start [s]; where steps are chosen, it is halved as stars need it."""
        step = self.time_step
        length = step.length if isinstance(step, FixedStep) else step.largest
        return LONGEST_STEP if length is None else length / self.time_scale

    def check_scene(self, bounds: Bounds, body_names: Collection[str], system_names: Collection[str]) -> None:
        """Space is open: stars neither wrap nor bounce."""
        if bounds.kind != "open":
            raise ValueError(f"gravity needs bounds of kind open, not {bounds.kind}")

    @model_validator(mode="after")
    def _block_is_leapfrog(self) -> Self:
        if isinstance(self.time_step, BlockStep) and self.integrator != "leapfrog":
            raise ValueError(f"time_step: block steps are leapfrog's, not {self.integrator}'s")
        return self

    @model_validator(mode="after")
    def _galaxies_fit(self) -> Self:
        check_galaxies(self.galaxies)
        return self
