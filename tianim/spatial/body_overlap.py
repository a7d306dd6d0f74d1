"""How deep two fixed bodies reach into each other: what a scene check asks before a run.

Sphere, capsule and box are a box of half lengths h (a point, a segment, a box) grown by a
radius. Where the two cores are apart, a small bounded least-squares problem gives their
distance. Where they meet, the least shift that parts them is along a face normal or a cross
product of two edges (separating axes). A cylinder has no such core: with one, the direction that
parts two bodies best is searched for, from the likely ones on.
"""

from itertools import product
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import lsq_linear, minimize

from tianim.math.rotations import from_euler, rotate
from tianim.spatial.body_params import BodyParams, Box, Capsule, Cylinder, Plane, Sphere

Floats = NDArray[np.float64]

# Depths below this part of the bodies' size are rounding: bodies that touch do not overlap.
ROUNDING = 1e-9
# The same where a direction is searched for, and from how many.
SEARCHED = 1e-7
DIRECTIONS = 200
POLISHED = 3


class _Rounded(NamedTuple):
    """A box grown by a radius [m]: `edges` (3, 3) are half edges as rows, in world axes."""

    centre: Floats
    edges: Floats
    radius: float


class _Cylinder(NamedTuple):
    """A cylinder [m]: `half` (3,) from the centre to the centre of an end, in world axes."""

    centre: Floats
    half: Floats
    radius: float

    @property
    def axis(self) -> Floats:
        """Unit vector along it."""
        return np.asarray(self.half / np.linalg.norm(self.half))


class _HalfSpace(NamedTuple):
    """Where (x - point) . normal < 0."""

    point: Floats
    normal: Floats


def overlap(a: BodyParams, b: BodyParams) -> float | None:
    """Depth [m] to which two fixed solids reach into each other; 0.0 where they touch or are apart.

    None where that is not decided: keyframed bodies, meshes, containers, two planes.
    """
    first, second = _solid(a), _solid(b)
    if first is None or second is None:
        return None
    if isinstance(first, _HalfSpace):
        first, second = second, first
    if isinstance(first, _HalfSpace):
        return None
    rounding = ROUNDING
    if isinstance(second, _HalfSpace):
        reach = _reach(first, second.normal)
        depth = reach - float((first.centre - second.point) @ second.normal)
        size = reach + float(np.abs(first.centre).max())
    else:
        size = float(np.linalg.norm(first.centre - second.centre)) + first.radius + second.radius
        if isinstance(first, _Rounded) and isinstance(second, _Rounded):
            depth = first.radius + second.radius - _core_distance(first, second)
        else:
            depth, rounding = -_widest_gap(first, second), SEARCHED
    return float(depth) if depth > rounding * size else 0.0


def _solid(body: BodyParams) -> _Rounded | _Cylinder | _HalfSpace | None:
    if body.at(0.0) is not body or getattr(body, "inside", False):
        return None
    centre, rotation = np.array(body.position), from_euler(body.rotation)
    if isinstance(body, Plane):
        return _HalfSpace(centre, rotate(rotation, np.array(body.normal) / np.linalg.norm(body.normal)))
    if isinstance(body, Box):
        return _Rounded(centre, rotate(rotation, 0.5 * np.diag(body.size)), 0.0)
    if isinstance(body, Sphere):
        return _Rounded(centre, np.zeros((3, 3)), body.radius)
    if isinstance(body, Capsule):
        return _Rounded(centre, rotate(rotation, np.diag([0.0, 0.5 * body.length, 0.0])), body.radius)
    if isinstance(body, Cylinder):
        return _Cylinder(centre, rotate(rotation, np.array([0.0, 0.5 * body.length, 0.0])), body.radius)
    return None


def _reach(solid: _Rounded | _Cylinder, direction: Floats) -> float:
    """How far it reaches from its centre along the unit vector `direction` [m]."""
    if isinstance(solid, _Rounded):
        return float(np.abs(solid.edges @ direction).sum()) + solid.radius
    sine = np.linalg.norm(np.cross(solid.axis, direction))
    return float(abs(solid.half @ direction) + solid.radius * sine)


def _widest_gap(a: _Rounded | _Cylinder, b: _Rounded | _Cylinder) -> float:
    """The gap between the shadows of two solids, along the direction where it is widest [m].

    Negative where they meet, the least shift that parts them; otherwise any gap will do.
    """
    between = b.centre - a.centre

    def closed(direction: Floats) -> float:
        length = float(np.linalg.norm(direction))
        if length == 0.0:
            return np.inf
        unit = direction / length
        return _reach(a, unit) + _reach(b, unit) - abs(float(between @ unit))

    apart = closed(between)
    if apart < 0.0:
        return -apart
    starts = sorted(_likely_directions(a, b), key=closed)
    ends = (
        minimize(closed, start, method="Nelder-Mead", options={"xatol": 1e-9, "fatol": 1e-12}).fun
        for start in starts[:POLISHED]
    )
    return -min(closed(starts[0]), *ends)


def _likely_directions(a: _Rounded | _Cylinder, b: _Rounded | _Cylinder) -> list[Floats]:
    """Normals of faces and ends, the way from one to the other, across an axis, and all around."""
    between = b.centre - a.centre
    found = [between]
    for solid in (a, b):
        if isinstance(solid, _Cylinder):
            found += [solid.axis, between - (between @ solid.axis) * solid.axis]
        else:
            found += [*_faces(solid.edges), *solid.edges]
    found += [np.cross(u, v) for u, v in product(found, found)]
    k = np.arange(DIRECTIONS)
    height, turn = 1.0 - (2.0 * k + 1.0) / DIRECTIONS, k * np.pi * (3.0 - np.sqrt(5.0))
    across = np.sqrt(1.0 - height**2)
    found += list(np.stack([across * np.cos(turn), height, across * np.sin(turn)], axis=1))
    return [direction for direction in found if np.linalg.norm(direction) > 0.0]


def _core_distance(a: _Rounded, b: _Rounded) -> float:
    """Distance of the cores [m]; negative, the least shift that parts them, where they meet."""
    gap = b.centre - a.centre
    # The nearest points are centre + edges^T u with -1 <= u <= 1.
    columns = np.concatenate([a.edges, -b.edges])
    columns = columns[np.linalg.norm(columns, axis=1) > 0.0].T
    if columns.size == 0:
        return float(np.linalg.norm(gap))
    nearest = lsq_linear(columns, gap, bounds=(-1.0, 1.0), method="bvls")
    distance = float(np.linalg.norm(columns @ nearest.x - gap))
    if distance > ROUNDING * np.abs(columns).sum():
        return distance
    axes = [*_faces(a.edges), *_faces(b.edges), *(np.cross(u, v) for u, v in product(a.edges, b.edges))]
    depths = [_shift(axis, gap, columns) for axis in axes if np.linalg.norm(axis) > 0.0]
    return -min(depths, default=0.0)


def _faces(edges: Floats) -> list[Floats]:
    return [np.cross(edges[i], edges[j]) for i, j in ((1, 2), (2, 0), (0, 1))]


def _shift(axis: Floats, gap: Floats, columns: Floats) -> float:
    """How far to move along `axis` until the cores' shadows on it are apart."""
    unit = axis / np.linalg.norm(axis)
    return float(np.abs(unit @ columns).sum() - abs(unit @ gap))
