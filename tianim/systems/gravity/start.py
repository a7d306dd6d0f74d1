"""The start of a gravitating system: its components drawn, its groups placed.

`make` draws every component in the frame of its group, with velocities that balance the pull of the
whole group, puts each galaxy's barycentre where it belongs and joins all in the order of the scene.
A component draws from a generator of its own, seeded by the seed and its full name, so that one
component never changes the random numbers of another.
"""

from __future__ import annotations

import zlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tianim.errors import SceneError
from tianim.spatial.placement import random_directions
from tianim.systems.gravity import components as kinds
from tianim.systems.gravity import kepler
from tianim.systems.gravity.components import Component, Galaxy, check_galaxies
from tianim.systems.gravity.disk import sample_disk, thick_disk, turned, turned_vectors
from tianim.systems.gravity.eddington import Isotropic, directed
from tianim.systems.gravity.external import (
    External,
    LogarithmicPotential,
    NFWPotential,
    PointPotential,
)
from tianim.systems.gravity.placing import Drawn, place_groups, recentred
from tianim.systems.gravity.profiles import (
    HERNQUIST_CUT,
    NFW_CUT,
    PLUMMER_CUT,
    Ball,
    Halo,
    Logarithmic,
    MiyamotoNagai,
    Point,
    Profile,
    Shells,
    SoftSphere,
    Sphere,
    Total,
    cut_sphere,
    hernquist_shape,
    king_sphere,
    nfw_shape,
    plummer_shape,
)
from tianim.systems.gravity.snapshots import Units, read_snapshot

Floats = NDArray[np.float64]
Spheres = kinds.Plummer | kinds.Hernquist | kinds.NFW | kinds.King
SPHERES = (kinds.Plummer, kinds.Hernquist, kinds.NFW, kinds.King)


@dataclass(frozen=True)
class Made:
    """The start: position (n, 3) [length], velocity (n, 3) [velocity], mass (n,) [mass], component (n,).

    `component` counts `names`, which are `disk` for a component of the scene and `north_disk` for
    one of the galaxy `north`. Stars of a component follow each other.
    """

    position: Floats
    velocity: Floats
    mass: Floats
    component: NDArray[np.int32]
    names: tuple[str, ...]


@dataclass(frozen=True)
class Surroundings:
    """What a component needs to know: the gravitational constant, softening, seed, units."""

    G: float
    softening: float
    seed: int
    units: Units | None = None

    def rng(self, name: str) -> np.random.Generator:
        """The generator of the component called `name`."""
        return np.random.default_rng((self.seed, zlib.crc32(name.encode())))


def make(
    components: Mapping[str, Component],
    galaxies: Mapping[str, Galaxy],
    external: Sequence[External],
    G: float,
    softening: float,
    seed: int,
    *,
    units: Units | None = None,
    recentre: bool = True,
) -> Made:
    """Draw and place everything; `components` and each of `galaxies` are a group.

    external  potentials that pull too; those round the origin count for the balance of `components`
    units     of the system, for files that state their own
    recentre  put the barycentre at rest at the origin; never with `external`, which stays in its place

    Raises SceneError, in one line: nothing pulls on a component, no equilibrium, a bad file.
    """
    surroundings = Surroundings(G, softening, seed, units)
    try:
        check_galaxies(galaxies)
    except ValueError as error:
        raise SceneError(str(error)) from error
    fixed = [profile_of(one, G) for one in external if not any(one.centre)]
    drawn = _draw_group("", components, fixed, surroundings)
    groups = {
        name: _draw_group(f"{name}_", one.components, (), surroundings) for name, one in galaxies.items()
    }
    for placed in place_groups(galaxies, groups, G).values():
        drawn |= placed
    if len(drawn) < len(components) + sum(map(len, groups.values())):
        raise SceneError("two components have one full name; rename one (a_b of a galaxy a is component b)")
    if not drawn:
        raise SceneError("no components and no galaxies: nothing to simulate")
    if recentre and not external:
        drawn = recentred(drawn)
    parts = list(drawn.values())
    return Made(
        np.concatenate([part.position for part in parts]),
        np.concatenate([part.velocity for part in parts]),
        np.concatenate([part.mass for part in parts]),
        np.repeat(np.arange(len(parts), dtype=np.int32), [len(part.mass) for part in parts]),
        tuple(drawn),
    )


def _draw_group(
    prefix: str, components: Mapping[str, Component], external: Sequence[Profile], around: Surroundings
) -> dict[str, Drawn]:
    """Stars of the components of one group, each in the pull of all."""
    given: dict[str, Drawn] = {}
    profiles: dict[str, Profile] = {}
    spheres: dict[str, Sphere] = {}
    for key, component in components.items():
        name = prefix + key
        if type(component) in GIVEN:
            given[name] = GIVEN[type(component)](name, component, around)
            distance = np.linalg.norm(given[name].position, axis=1)
            profiles[name] = Shells(distance, given[name].mass, around.softening)
        elif isinstance(component, SPHERES):
            spheres[name] = sphere_of(component)
            profiles[name] = SoftSphere(spheres[name], around.softening)
        elif isinstance(component, kinds.ExponentialDisk):
            profiles[name] = thick_disk(component, around.softening)
        elif isinstance(component, kinds.UniformSphere):
            profiles[name] = Ball(component.total, component.radius)
    drawn = {}
    for key, component in components.items():
        name = prefix + key
        if name in given:
            drawn[name] = given[name]
            continue
        if isinstance(component, SPHERES):
            total = Total([*external, *profiles.values()])
            drawn[name] = _sphere(name, component, spheres[name], total, around)
            continue
        others = Total([*external, *(one for other, one in profiles.items() if other != name)])
        drawn[name] = _draw(name, component, others, around)
    return drawn


def profile_of(external: External, G: float) -> Profile:
    """The pull of an external potential as a profile."""
    if isinstance(external, PointPotential):
        return Point(external.mass, external.softening)
    if isinstance(external, NFWPotential):
        c = external.concentration
        return Halo(external.mass / (np.log1p(c) - c / (1.0 + c)), external.scale_radius)
    if isinstance(external, LogarithmicPotential):
        return Logarithmic(external.speed, external.core, G)
    return MiyamotoNagai(external.mass, external.scale_length, external.height)


def sphere_of(component: Spheres) -> Sphere:
    """The table of a sphere's density."""
    if isinstance(component, kinds.King):
        return king_sphere(component.w0, component.core_radius, component.total)
    shape, cut = {
        kinds.Plummer: (plummer_shape, PLUMMER_CUT),
        kinds.Hernquist: (hernquist_shape, HERNQUIST_CUT),
        kinds.NFW: (nfw_shape, NFW_CUT),
    }[type(component)]
    scale = component.scale_length
    far = cut * scale if component.truncation is None else component.truncation
    return cut_sphere(shape, scale, far, component.total)


def _sphere(name: str, component: kinds.Stars, sphere: Sphere, total: Total, around: Surroundings) -> Drawn:
    """A sphere in equilibrium in the pull of all."""
    rng = around.rng(name)
    radius = sphere.radius_of(1.0 - rng.random(component.count))
    # Places first: how many numbers the speeds take depends on the others in the group.
    position = directed(radius, rng)
    velocity = directed(Isotropic(name, sphere, total, around.G).speeds(radius, rng), rng)
    mass = np.full(component.count, component.total / component.count)
    return Drawn(position, velocity, mass)


def _draw(name: str, component: Any, others: Total, around: Surroundings) -> Drawn:
    """A disk in its own pull and that of the others, a ball, or rings."""
    rng, G = around.rng(name), around.G
    if isinstance(component, kinds.ExponentialDisk):
        position, velocity = sample_disk(name, component, others, G, around.softening, rng)
    elif isinstance(component, kinds.UniformSphere):
        position, velocity = _ball(component, G, rng)
    else:
        position, velocity = _circles(name, component, others, G)
    total = getattr(component, "total", 0.0)
    return Drawn(position, velocity, np.full(component.count, total / component.count))


def _ball(ball: kinds.UniformSphere, G: float, rng: np.random.Generator) -> tuple[Floats, Floats]:
    """An even ball, its velocities scaled to the virial ratio exactly."""
    radius = ball.radius * rng.random(ball.count) ** (1.0 / 3.0)
    position = radius[:, None] * random_directions(ball.count, rng)
    velocity = rng.standard_normal((ball.count, 3))
    # 2 K = ratio |W| with W = -3/5 G M^2 / R of its own pull.
    wanted = ball.virial_ratio * 0.6 * G * ball.total / ball.radius
    return position, velocity * np.sqrt(wanted / np.mean(np.sum(velocity**2, axis=1)))


def _circles(name: str, rings: kinds.Ring | kinds.Rings, others: Total, G: float) -> tuple[Floats, Floats]:
    """Rings on circular orbits."""
    if isinstance(rings, kinds.Ring):
        radii, counts = np.array([rings.radius]), np.array([rings.count])
    else:
        radii = np.linspace(*rings.radii, rings.rings)
        # Each ring has stars by its length, one at least, and the sum is exact.
        share = np.cumsum(radii) / radii.sum() * (rings.count - rings.rings)
        counts = 1 + np.diff(np.round(share).astype(int), prepend=0)
    speed = np.sqrt(np.maximum(others.speed_squared(radii, G), 0.0))
    if not (speed > 0.0).all():
        raise SceneError(f"component {name!r}: nothing pulls on it; its group needs a mass")
    angle = 2.0 * np.pi * np.concatenate([np.arange(n) / n for n in counts])
    radius = np.repeat(radii, counts)
    return turned(radius, angle, 0.0), turned_vectors(angle, 0.0, np.repeat(speed, counts), 0.0)


def _bodies(name: str, component: kinds.Bodies, around: Surroundings) -> Drawn:
    bodies = component.bodies
    return Drawn(
        np.array([body.position for body in bodies], np.float64),
        np.array([body.velocity for body in bodies], np.float64),
        np.array([body.mass or 0.0 for body in bodies], np.float64),
    )


def _orbits(name: str, component: kinds.Orbits, around: Surroundings) -> Drawn:
    orbits = component.orbits
    mass = np.array([one.mass or 0.0 for one in orbits], np.float64)

    def column(field: str) -> Floats:
        return np.array([getattr(one, field) for one in orbits], np.float64)

    angles = (np.radians(column(field)) for field in ("inclination", "node", "argument", "anomaly"))
    elements = kepler.Elements(column("semi_major_axis"), column("eccentricity"), *angles)
    return Drawn(*kepler.state(elements, around.G * (component.central_mass + mass)), mass)


def _belt(name: str, component: kinds.Belt, around: Surroundings) -> Drawn:
    rng, n = around.rng(name), component.count

    def between(limits: tuple[float, float]) -> Floats:
        return limits[0] + (limits[1] - limits[0]) * rng.random(n)

    elements = kepler.Elements(
        between(component.semi_major_axis),
        between(component.eccentricity),
        np.radians(between(component.inclination)),
        *(2.0 * np.pi * rng.random(n) for _ in range(3)),
    )
    return Drawn(*kepler.state(elements, around.G * component.central_mass), np.zeros(n))


def _file(name: str, component: kinds.SnapshotFile, around: Surroundings) -> Drawn:
    read = read_snapshot(component.path, component.types, around.units, component.massless)
    mass = np.zeros(len(read.position)) if read.mass is None else read.mass
    return Drawn(read.position, read.velocity, mass)


# Components that are what they are, whatever is round them.
GIVEN: Mapping[type, Callable[[str, Any, Surroundings], Drawn]] = {
    kinds.Bodies: _bodies,
    kinds.Orbits: _orbits,
    kinds.Belt: _belt,
    kinds.SnapshotFile: _file,
}
