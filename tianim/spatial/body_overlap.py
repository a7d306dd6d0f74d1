"""How deep two fixed bodies reach into each other: what a scene check asks before a run.

Sphere, capsule and box are a box of half lengths h (a point, a segment, a box) grown by a
radius. Where the two cores are apart, a small bounded least-squares problem gives their
distance. Where they meet, the least shift that parts them is along a face normal or a cross
product of two edges (separating axes).
"""

from itertools import product
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import lsq_linear

from tianim.math.rotations import from_euler, rotate
from tianim.spatial.body_params import BodyParams, Box, Capsule, Plane, Sphere

Floats = NDArray[np.float64]

# Depths below this part of the bodies' size are rounding: bodies that touch do not overlap.
ROUNDING = 1e-9


class _Rounded(NamedTuple):
    """A box grown by a radius [m]: `edges` (3, 3) are half edges as rows, in world axes."""

    centre: Floats
    edges: Floats
    radius: float


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
    if isinstance(second, _HalfSpace):
        lowest = (first.centre - second.point) @ second.normal - np.abs(first.edges @ second.normal).sum()
        depth = first.radius - lowest
        size = first.radius + np.abs(first.centre).max() + np.abs(first.edges).max()
    else:
        depth = first.radius + second.radius - _core_distance(first, second)
        size = np.linalg.norm(first.centre - second.centre) + first.radius + second.radius
    return float(depth) if depth > ROUNDING * size else 0.0


def _solid(body: BodyParams) -> _Rounded | _HalfSpace | None:
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
    return None


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
