"""Galaxies in their places: groups of stars turned and moved as wholes, two of them on an orbit.

The disk of a galaxy on an orbit is tilted as in Toomre and Toomre, ApJ 178 (1972), DOI 10.1086/151823:
by the inclination i about the line of nodes, where the companion rises through the disk; from it
the companion runs through the argument w to its pericentre. i = 0 is a prograde passage.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from tianim.errors import SceneError
from tianim.systems.gravity import kepler
from tianim.systems.gravity.components import Encounter, Galaxy, Place

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Drawn:
    """Stars of one component in the frame of its group."""

    position: Floats
    velocity: Floats
    mass: Floats


def barycentre(parts: Mapping[str, Drawn]) -> tuple[float, Floats, Floats]:
    """Total mass, and the place and velocity of its centre; zeros where nothing has mass."""
    total = float(sum(part.mass.sum() for part in parts.values()))
    if total <= 0.0:
        return 0.0, np.zeros(3), np.zeros(3)
    position = sum(part.mass @ part.position for part in parts.values()) / total
    velocity = sum(part.mass @ part.velocity for part in parts.values()) / total
    return total, np.asarray(position), np.asarray(velocity)


def recentred(parts: Mapping[str, Drawn]) -> dict[str, Drawn]:
    """The parts with their barycentre at rest at the origin."""
    _, position, velocity = barycentre(parts)
    return {
        name: Drawn(part.position - position, part.velocity - velocity, part.mass)
        for name, part in parts.items()
    }


def place_groups(
    galaxies: Mapping[str, Galaxy], groups: Mapping[str, dict[str, Drawn]], G: float
) -> dict[str, dict[str, Drawn]]:
    """Each group turned and moved as a whole to where its galaxy belongs."""
    mass = {name: barycentre(parts)[0] for name, parts in groups.items()}
    placed = {}
    for name, parts in groups.items():
        turn = orientation(name, galaxies)
        position, velocity = _whereabouts(name, galaxies, mass, G)
        placed[name] = {
            key: Drawn(turn.apply(one.position) + position, turn.apply(one.velocity) + velocity, one.mass)
            for key, one in recentred(parts).items()
        }
    return placed


def _whereabouts(
    name: str, galaxies: Mapping[str, Galaxy], mass: Mapping[str, float], G: float
) -> tuple[Floats, Floats]:
    """Place and velocity of a galaxy's barycentre; `check_galaxies` has seen that this ends."""
    galaxy = galaxies[name]
    orbit = galaxy.orbit
    if orbit is None:
        place = galaxy.place or Place()
        return np.array(place.position), np.array(place.velocity)
    mu = G * (mass[name] + mass[orbit.around])
    if not mu > 0.0:
        raise SceneError(f"galaxies.{name}.orbit: neither it nor {orbit.around!r} has a mass")
    angles = (np.radians(angle) for angle in (orbit.inclination, orbit.node, orbit.argument))
    apart, relative = kepler.encounter_state(orbit.pericentre, orbit.eccentricity, orbit.start, mu, *angles)
    position, velocity = _whereabouts(orbit.around, galaxies, mass, G)
    return position + apart, velocity + relative


def orientation(name: str, galaxies: Mapping[str, Galaxy]) -> Rotation:
    """How a galaxy is turned: with the orbit, tilted by its own angles in it, then as its place says."""
    galaxy = galaxies[name]
    orbit, side = _orbit_of(name, galaxies)
    towards, normal = kepler.orbit_axes(*np.radians([orbit.inclination, orbit.node, orbit.argument]))
    with_orbit = Rotation.from_matrix(np.stack([towards, normal, np.cross(towards, normal)], axis=1))
    # The line of nodes lies the argument before the companion's pericentre.
    node = Rotation.from_rotvec(-np.radians(galaxy.argument) * normal).apply(side * towards)
    turn = Rotation.from_rotvec(-np.radians(galaxy.inclination) * node) * with_orbit
    if galaxy.place is not None:
        turn = Rotation.from_euler("XYZ", galaxy.place.rotation, degrees=True) * turn
    return turn


def _orbit_of(name: str, galaxies: Mapping[str, Galaxy]) -> tuple[Encounter, float]:
    """The orbit that a galaxy takes part in, and on which side of it the companion's pericentre is."""
    own = galaxies[name].orbit
    if own is not None:
        return own, -1.0
    for other in galaxies.values():
        if other.orbit is not None and other.orbit.around == name:
            return other.orbit, 1.0
    return Encounter(around=name), 1.0
