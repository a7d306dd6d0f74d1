"""Placement at the start of a run: points that fill a shape, and directions, from a seeded generator."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tianim.errors import SceneError
from tianim.frame import Float
from tianim.math.rotations import look_rotation, rotate
from tianim.spatial.placement_params import (
    Along,
    Ball,
    BoxRegion,
    Disc,
    FileHeading,
    Heading,
    Lattice,
    Placement,
    PointFile,
    PointList,
    RandomHeading,
    Shell,
    Swirl,
    Torus,
)
from tianim.spatial.point_files import read_points

__all__ = [
    "Along",
    "Ball",
    "BoxRegion",
    "Disc",
    "FileHeading",
    "Heading",
    "Lattice",
    "Placed",
    "Placement",
    "PointFile",
    "PointList",
    "RandomHeading",
    "Shell",
    "Swirl",
    "Torus",
    "check_start",
    "directions",
    "own_count",
    "place",
    "random_directions",
]

Floats = NDArray[np.float64]
Fillable = Ball | Shell | BoxRegion | Disc | Torus | Lattice


@dataclass(frozen=True)
class Placed:
    """What `place` gives: position (count, 3) [m], velocity (count, 3) [m/s] or None."""

    position: Float
    velocity: Float | None

    @property
    def count(self) -> int:
        """Number of particles."""
        return len(self.position)


def own_count(placement: Placement) -> int | None:
    """How many points a placement brings along; None where it takes as many as asked for."""
    if isinstance(placement, PointList):
        return len(placement.positions)
    if isinstance(placement, PointFile):
        return len(read_points(placement.path).position)
    return None


def check_start(count: int | None, start: Placement, heading: Heading) -> None:
    """ValueError where `count`, the places and the directions cannot go together."""
    there = own_count(start)
    if there is None and count is None:
        raise ValueError(f"count: must be given, a start of kind {start.kind} takes any number")
    if there is not None and count not in (None, there):
        raise ValueError(f"count {count}: must be {there}, the number of points that the start brings")
    if isinstance(heading, FileHeading):
        try:
            _from_file(heading, there if there is not None else count or 0)
        except SceneError as error:
            raise ValueError(f"heading: {error}") from None


def place(placement: Placement, count: int | None, rng: np.random.Generator, dimension: int = 3) -> Placed:
    """Start points for `count` particles, in 2 or 3 dimensions.

    `count` None takes as many as a list or file brings; SceneError where the two disagree. In two
    dimensions points and velocities are laid into the plane z = 0.
    """
    there = own_count(placement)
    if count is None:
        count = there
    if count is None:
        raise SceneError(f"count: must be given, a {placement.kind} takes any number of particles")
    if there is not None and there != count:
        raise SceneError(f"count {count}: the {placement.kind} placement has {there} points; leave count out")
    velocity = None
    if isinstance(placement, PointFile):
        data = read_points(placement.path)
        position, velocity = data.position, data.velocity
    elif isinstance(placement, PointList):
        position = np.array(placement.positions, dtype=np.float64).reshape(-1, 3)
    else:
        position = _fill(placement, count, rng, dimension)
    if dimension == 2:
        position = position * (1.0, 1.0, 0.0)
        velocity = None if velocity is None else velocity * (1.0, 1.0, 0.0)
    return Placed(
        np.ascontiguousarray(position, dtype=np.float32),
        None if velocity is None else np.ascontiguousarray(velocity, dtype=np.float32),
    )


def directions(heading: Heading, position: ArrayLike, rng: np.random.Generator, dimension: int = 3) -> Float:
    """Unit vectors (n, 3): the way that particles at `position` (n, 3) [m] head."""
    x = np.asarray(position, dtype=np.float64)
    anywhere = random_directions(len(x), rng, dimension)
    if isinstance(heading, Along):
        wanted = _cone(heading, len(x), rng, dimension)
    elif isinstance(heading, Swirl):
        wanted = _swirl(heading, x, dimension)
    elif isinstance(heading, FileHeading):
        wanted = _from_file(heading, len(x))
    else:
        wanted = anywhere
    if dimension == 2:
        wanted = wanted * (1.0, 1.0, 0.0)
    length = np.linalg.norm(wanted, axis=1, keepdims=True)
    given = length > 0.0
    return np.where(given, wanted / np.where(given, length, 1.0), anywhere).astype(np.float32)


def random_directions(count: int, rng: np.random.Generator, dimension: int = 3) -> Floats:
    """Unit vectors (count, 3) without a preferred direction; z = 0 in two dimensions."""
    if dimension == 2:
        angle = 2.0 * np.pi * rng.random(count)
        return np.stack([np.cos(angle), np.sin(angle), np.zeros(count)], axis=1)
    z = 2.0 * rng.random(count) - 1.0
    angle = 2.0 * np.pi * rng.random(count)
    flat = np.sqrt(1.0 - z * z)
    return np.stack([flat * np.cos(angle), flat * np.sin(angle), z], axis=1)


def _fill(placement: Fillable, count: int, rng: np.random.Generator, dimension: int) -> Floats:
    """Points (count, 3) [m] in or on a shape."""
    if isinstance(placement, Ball):
        local = _radial(0.0, placement.radius, count, rng, dimension)
    elif isinstance(placement, Shell):
        local = _radial(placement.radius - placement.thickness, placement.radius, count, rng, dimension)
    elif isinstance(placement, BoxRegion):
        local = (rng.random((count, 3)) - 0.5) * placement.size
    elif isinstance(placement, Disc):
        local = _radial(placement.hole, placement.radius, count, rng, 2)
        local = local if dimension == 2 else rotate(look_rotation(placement.normal), local)
    elif isinstance(placement, Torus):
        local = _torus(placement, count, rng, dimension)
    else:
        local = _lattice(placement, count, rng, dimension)
    return local + placement.centre


def _radial(inner: float, outer: float, count: int, rng: np.random.Generator, dimension: int) -> Floats:
    """Evenly between two radii: r^dimension is uniform."""
    ratio = (inner / outer) ** dimension
    radius = outer * (ratio + (1.0 - ratio) * rng.random(count)) ** (1.0 / dimension)
    return radius[:, None] * random_directions(count, rng, dimension)


def _torus(torus: Torus, count: int, rng: np.random.Generator, dimension: int) -> Floats:
    ring, tube = torus.ring_radius, torus.tube_radius
    if dimension == 2:
        return _radial(ring - tube, ring + tube, count, rng, 2)
    r = tube * np.sqrt(rng.random(count))
    turn = 2.0 * np.pi * rng.random(count)
    # Outside there is more room: the density of the angle is 1 + r / ring cos(turn). An angle
    # that fails the test by half of that is mirrored, which gives this density exactly.
    flip = 2.0 * rng.random(count) > 1.0 + r / ring * np.cos(turn)
    turn = np.where(flip, np.pi - turn, turn)
    around = 2.0 * np.pi * rng.random(count)
    flat = ring + r * np.cos(turn)
    local = np.stack([flat * np.cos(around), flat * np.sin(around), r * np.sin(turn)], axis=1)
    return rotate(look_rotation(torus.axis), local)


def _lattice(lattice: Lattice, count: int, rng: np.random.Generator, dimension: int) -> Floats:
    side = 1
    while side**dimension < count:
        side += 1
    index = np.arange(count)
    row, column = index // side, index % side
    if dimension == 2:
        cell = np.stack([column, row, np.zeros(count)], axis=1)
    else:
        cell = np.stack([column, row // side, row % side], axis=1).astype(np.float64)
    if count:
        cell -= 0.5 * cell.max(axis=0)
    jitter = lattice.jitter * (rng.random((count, 3)) - 0.5)
    return np.asarray(lattice.spacing * (cell + jitter))


def _from_file(heading: FileHeading, count: int) -> Floats:
    velocity = read_points(heading.path).velocity
    there = 0 if velocity is None else len(velocity)
    if velocity is None or there != count:
        raise SceneError(f"{heading.path}: has {there} velocities, needed are {count}")
    return velocity


def _cone(along: Along, count: int, rng: np.random.Generator, dimension: int) -> Floats:
    """Evenly in a cone (a sector) about a direction."""
    spread = np.radians(along.spread)
    axis = np.asarray(along.direction)
    if dimension == 2:
        middle = np.arctan2(axis[1], axis[0])
        angle = middle + spread * (2.0 * rng.random(count) - 1.0)
        return np.stack([np.cos(angle), np.sin(angle), np.zeros(count)], axis=1)
    z = 1.0 - (1.0 - np.cos(spread)) * rng.random(count)
    angle = 2.0 * np.pi * rng.random(count)
    flat = np.sqrt(np.maximum(1.0 - z * z, 0.0))
    local = np.stack([flat * np.cos(angle), flat * np.sin(angle), z], axis=1)
    return rotate(look_rotation(axis), local)


def _swirl(swirl: Swirl, x: Floats, dimension: int) -> Floats:
    """Tangents about the axis, turned inward; zero on the axis."""
    axis = np.array([0.0, 0.0, 1.0] if dimension == 2 else swirl.axis)
    axis /= np.linalg.norm(axis)
    out = x - swirl.centre
    out = out - (out @ axis)[:, None] * axis
    radius = np.linalg.norm(out, axis=1, keepdims=True)
    out = np.divide(out, radius, out=np.zeros_like(out), where=radius > 0.0)
    angle = np.radians(swirl.inward)
    return np.asarray(np.cos(angle) * np.cross(axis, out) - np.sin(angle) * out)
