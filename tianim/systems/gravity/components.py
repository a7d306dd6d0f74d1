"""What a gravitating scene is made of, as data: spheres, disks, rings, bodies, orbits, files, galaxies.

    components: {disk: {kind: exponential_disk, count: 40000, mass: 4.0, scale_length: 3.0},
                 halo: {kind: hernquist, count: 60000, mass: 40.0, scale_length: 20.0}}

Components that stand together form a group, and each starts in equilibrium in the potential of
all of them. A galaxy is a group that is placed as a whole, by place or by an orbit round another.
Lengths, masses and velocities are in the units of the system, in brackets [length], [mass],
[velocity]. Y is up: a disk that is not inclined lies in the x-z plane and spins along +Y.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Annotated, Literal

from pydantic import Field, model_validator
from typing_extensions import Self

from tianim.errors import SceneError
from tianim.params import MAX_COUNT, Name, NonNegative, Params, ScenePath
from tianim.systems.gravity.snapshots import HUGE, read_snapshot

ORIGIN = (0.0, 0.0, 0.0)

Amount = Annotated[float, Field(ge=-HUGE, le=HUGE)]
Length = Annotated[float, Field(gt=0, le=HUGE)]
Height = Annotated[float, Field(ge=0, le=HUGE)]
Vector = tuple[Amount, Amount, Amount]
Many = Annotated[int, Field(ge=1, le=MAX_COUNT)]
Angle = Annotated[float, Field(ge=-3600, le=3600)]
Tilt = Annotated[float, Field(ge=-180, le=180)]
# An ellipse; nearer to 1 the period's phase is lost in rounding.
Bound = Annotated[float, Field(ge=0, le=0.999999)]
# Distance of two galaxies at the start, in pericentres, where nothing is said.
FAR = 10.0


def check_mass(mass: float | None, massless: bool) -> None:
    """ValueError where a mass is missing, not positive, or given to what has none."""
    if massless:
        if mass:
            raise ValueError(f"mass {mass:g}: massless is true; leave one of the two out")
    elif mass is None:
        raise ValueError("mass: must be given (test particles that pull on nothing: massless: true)")
    elif mass <= 0.0:
        raise ValueError(
            f"mass {mass:g}: must be greater than 0 (test particles that pull on nothing: massless: true)"
        )


def check_rises(name: str, limits: tuple[float, float]) -> None:
    """ValueError where the first of two limits exceeds the second."""
    low, high = limits
    if low > high:
        raise ValueError(f"{name}: the first must not exceed the second: {low:g} > {high:g}")


class Stars(Params):
    """Many stars of one mass."""

    count: Many = Field(description="how many stars")
    mass: Amount | None = Field(
        None, description="mass of all its stars together [mass]; left out where massless", examples=[1.0]
    )
    massless: bool = Field(False, description="test particles: they feel the others and pull on nothing")

    @model_validator(mode="after")
    def _has_mass(self) -> Self:
        check_mass(self.mass, self.massless)
        return self

    @property
    def total(self) -> float:
        """Mass of all its stars [mass], 0 where massless."""
        return self.mass or 0.0


class Plummer(Stars):
    """A Plummer sphere: a star cluster."""

    kind: Literal["plummer"] = "plummer"
    scale_length: Length = Field(1.0, description="b of rho ~ (1 + r^2/b^2)^(-5/2) [length]")
    truncation: Length | None = Field(
        None,
        description="beyond it the density falls exponentially, over a fifth of it [length]; "
        "12.2 scale lengths (99 % of the mass) where left out",
    )


class Hernquist(Stars):
    """A Hernquist sphere: a bulge, an elliptical galaxy or a dark halo."""

    kind: Literal["hernquist"] = "hernquist"
    scale_length: Length = Field(1.0, description="a of rho ~ 1 / (r (r + a)^3) [length]")
    truncation: Length | None = Field(
        None,
        description="beyond it the density falls exponentially, over a fifth of it [length]; "
        "20 scale lengths where left out",
    )


class NFW(Stars):
    """A dark halo after Navarro, Frenk and White, cut off."""

    kind: Literal["nfw"] = "nfw"
    scale_length: Length = Field(1.0, description="r_s of rho ~ 1 / (r (r + r_s)^2) [length]")
    truncation: Length | None = Field(
        None,
        description="beyond it (r_200, say) the density falls exponentially, over a fifth of it [length]; "
        "10 scale lengths where left out",
    )


class King(Stars):
    """A King (lowered isothermal) sphere: a globular cluster with an edge."""

    kind: Literal["king"] = "king"
    core_radius: Length = Field(1.0, description="King's r_0 = sqrt(9 sigma^2 / (4 pi G rho_0)) [length]")
    w0: Annotated[float, Field(ge=0.5, le=12)] = Field(
        6.0, description="depth of the middle in sigma^2; the larger, the more concentrated"
    )


class UniformSphere(Stars):
    """A ball of even density with random velocities; cold, it collapses."""

    kind: Literal["uniform_sphere"] = "uniform_sphere"
    radius: Length = Field(1.0, description="radius [length]")
    virial_ratio: NonNegative = Field(
        0.0, description="2 x kinetic / potential energy of itself: 0 collapses cold, 1 is in balance"
    )


class ExponentialDisk(Stars):
    """A stellar disk, exponential in radius, sech^2 in height, warm by Toomre's Q, spinning along +Y."""

    kind: Literal["exponential_disk"] = "exponential_disk"
    scale_length: Length = Field(1.0, description="R_d of Sigma ~ exp(-R / R_d) [length]")
    height: Height = Field(0.1, description="z_0 of rho ~ sech^2(z / z_0) [length]")
    toomre_q: NonNegative = Field(
        1.3, description="Q = sigma_R kappa / (3.36 G Sigma) at 2.5 R_d; 1.2 to 1.5 give spirals; massless: 0"
    )
    truncation: Length | None = Field(
        None, description="no star beyond this radius [length]; 8 scale lengths where left out"
    )


class Ring(Params):
    """Massless stars on one circular orbit, evenly spaced, turning along +Y."""

    kind: Literal["ring"] = "ring"
    count: Many = Field(description="how many stars")
    radius: Length = Field(1.0, description="radius [length]")


class Rings(Params):
    """Massless stars on circular orbits in rings, as in Toomre and Toomre 1972; longer rings have more."""

    kind: Literal["rings"] = "rings"
    count: Many = Field(description="how many stars in all", examples=[60])
    radii: tuple[Length, Length] = Field(description="innermost and outermost radius [length]")
    rings: Annotated[int, Field(ge=1, le=10_000)] = Field(5, description="how many rings, equally spaced")

    @model_validator(mode="after")
    def _fits(self) -> Self:
        check_rises("radii", self.radii)
        if self.count < self.rings:
            raise ValueError(f"count {self.count}: must be at least the number of rings, {self.rings}")
        return self


class Body(Params):
    """One body."""

    mass: Amount | None = Field(None, description="mass [mass]; left out where massless", examples=[1.0])
    massless: bool = Field(False, description="a test particle: it feels the others and pulls on nothing")
    position: Vector = Field(ORIGIN, description="place [length]")
    velocity: Vector = Field(ORIGIN, description="velocity [velocity]")

    @model_validator(mode="after")
    def _has_mass(self) -> Self:
        check_mass(self.mass, self.massless)
        return self


class Bodies(Params):
    """Bodies one by one."""

    kind: Literal["bodies"] = "bodies"
    bodies: tuple[Body, ...] = Field(min_length=1, max_length=100_000, description="the bodies, in order")


class Orbit(Params):
    """A body on a Kepler ellipse; the reference plane is x-z, angles count from +X, turning along +Y."""

    mass: Amount | None = Field(None, description="mass [mass]; left out where massless", examples=[1.0])
    massless: bool = Field(False, description="a test particle: it feels the others and pulls on nothing")
    semi_major_axis: Length = Field(description="semi-major axis [length]")
    eccentricity: Bound = Field(0.0, description="eccentricity, less than 1")
    inclination: Tilt = Field(0.0, description="angle between the orbit and the x-z plane [deg]")
    node: Angle = Field(0.0, description="longitude of the ascending node [deg]")
    argument: Angle = Field(0.0, description="argument of the pericentre, from the node [deg]")
    anomaly: Angle = Field(0.0, description="mean anomaly: 0 at the pericentre, 180 at the apocentre [deg]")

    @model_validator(mode="after")
    def _has_mass(self) -> Self:
        check_mass(self.mass, self.massless)
        return self


class Orbits(Params):
    """Bodies on Kepler orbits round the origin of their group; the body in the middle comes from `bodies`."""

    kind: Literal["orbits"] = "orbits"
    central_mass: Length = Field(description="mass that they go round, their own not counted [mass]")
    orbits: tuple[Orbit, ...] = Field(min_length=1, max_length=100_000, description="the orbits, in order")


class Belt(Params):
    """Many massless bodies on Kepler orbits, elements even between limits, the three phases random."""

    kind: Literal["belt"] = "belt"
    count: Many = Field(description="how many bodies")
    central_mass: Length = Field(description="mass that they go round [mass]")
    semi_major_axis: tuple[Length, Length] = Field(description="least and greatest semi-major axis [length]")
    eccentricity: tuple[Bound, Bound] = Field((0.0, 0.0), description="least and greatest eccentricity")
    inclination: tuple[Tilt, Tilt] = Field((0.0, 0.0), description="least and greatest inclination [deg]")

    @model_validator(mode="after")
    def _fits(self) -> Self:
        for name in ("semi_major_axis", "eccentricity", "inclination"):
            check_rises(name, getattr(self, name))
        return self


class SnapshotFile(Params):
    """Stars from a file: GADGET HDF5, NPZ or CSV with position, velocity and mass."""

    kind: Literal["file"] = "file"
    path: ScenePath = Field(description="HDF5 (GADGET), NPZ or CSV file")
    massless: bool = Field(False, description="test particles, whatever masses the file has")
    types: tuple[Annotated[int, Field(ge=0, le=5)], ...] | None = Field(
        None, description="GADGET types to take: 0 gas, 1 halo, 2 disk, 3 bulge, 4 stars; all where left out"
    )

    @model_validator(mode="after")
    def _is_readable(self) -> Self:
        try:
            self.star_count()
        except SceneError as error:
            raise ValueError(str(error)) from error
        return self

    def star_count(self) -> int:
        """Stars that the file holds; read once and kept for the start."""
        return len(read_snapshot(self.path, self.types, massless=self.massless).position)


Component = Annotated[
    Plummer
    | Hernquist
    | NFW
    | King
    | UniformSphere
    | ExponentialDisk
    | Ring
    | Rings
    | Bodies
    | Orbits
    | Belt
    | SnapshotFile,
    Field(discriminator="kind"),
]
Components = Annotated[Mapping[Name, Component], Field(min_length=1, max_length=1000)]


class Place(Params):
    """Where a galaxy is, how it moves and how it is turned."""

    position: Vector = Field(ORIGIN, description="place of its barycentre [length]")
    velocity: Vector = Field(ORIGIN, description="velocity of its barycentre [velocity]")
    rotation: Vector = Field(ORIGIN, description="turned about the own x, then y, then z axis [deg]")


class Encounter(Params):
    """The two-body orbit of a galaxy round another, that of point masses with the total mass of each.

    Inside an extended halo the pull is weaker than that of a point: galaxies whose halos overlap
    pass at a larger distance than the pericentre asked for, unless friction brings them closer.
    """

    around: Name = Field(description="name of the other galaxy", examples=["south"])
    pericentre: Length = Field(1.0, description="least distance of the two [length]")
    eccentricity: Annotated[float, Field(ge=0, le=100)] = Field(
        1.0, description="1: a parabola; less: bound; more: a fly-by"
    )
    separation: Length | None = Field(
        None,
        description="distance at the start, before the pericentre [length]; left out: ten pericentres, or "
        "the apocentre where that is nearer",
    )
    inclination: Tilt = Field(0.0, description="angle between the orbit and the x-z plane [deg]")
    node: Angle = Field(0.0, description="longitude of the orbit's ascending node [deg]")
    argument: Angle = Field(0.0, description="argument of the orbit's pericentre, from the node [deg]")

    @model_validator(mode="after")
    def _is_on_orbit(self) -> Self:
        if self.start < self.pericentre:
            raise ValueError(
                f"separation {self.separation:g}: must be at least the pericentre, {self.pericentre:g}"
            )
        # Rounding must not refuse the apocentre itself.
        if self.start > self.apocentre * (1.0 + 1e-12):
            raise ValueError(
                f"separation {self.separation:g}: an orbit of eccentricity {self.eccentricity:g} reaches "
                f"{self.apocentre:g} at most"
            )
        return self

    @property
    def apocentre(self) -> float:
        """Largest distance of the two [length]."""
        if self.eccentricity >= 1.0:
            return math.inf
        return self.pericentre * (1.0 + self.eccentricity) / (1.0 - self.eccentricity)

    @property
    def start(self) -> float:
        """Distance at the start [length]."""
        if self.separation is None:
            return min(FAR * self.pericentre, self.apocentre)
        return self.separation


class Galaxy(Params):
    """A group that is placed as a whole.

    `inclination` and `argument` are those of Toomre and Toomre 1972: the angle between the disk and the
    orbit (below 90: prograde, 180: retrograde), and from the line of nodes to the pericentre. For a
    galaxy without an orbit they refer to the x-z plane and to +X.
    """

    components: Components = Field(description="what it is made of, by name")
    place: Place | None = Field(None, description="where it is; the origin where left out")
    orbit: Encounter | None = Field(None, description="its orbit round another galaxy, instead of a place")
    inclination: Tilt = Field(0.0, description="angle between its spin and the orbit's normal [deg]")
    argument: Angle = Field(0.0, description="from the line of nodes to the pericentre, in the orbit [deg]")

    @model_validator(mode="after")
    def _has_one_place(self) -> Self:
        if self.place is not None and self.orbit is not None:
            raise ValueError("place and orbit: a galaxy has one of the two")
        return self


def check_galaxies(galaxies: Mapping[str, Galaxy]) -> None:
    """ValueError where an orbit names a galaxy that is not there, or orbits go in a circle."""
    for name, galaxy in galaxies.items():
        path = [name]
        while galaxy.orbit is not None:
            around = galaxy.orbit.around
            if around not in galaxies:
                there = ", ".join(other for other in galaxies if other != path[-1]) or "none"
                raise ValueError(f"galaxies.{path[-1]}.orbit.around: no galaxy {around!r}; there are {there}")
            if around in path:
                raise ValueError(
                    f"galaxies.{path[-1]}.orbit.around: {' goes round '.join([*path, around])}; "
                    "one must have a place"
                )
            path.append(around)
            galaxy = galaxies[around]
