"""What pictures and exports show of a primitive body: triangles, or the edges of a container."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tianim.frame import Int
from tianim.math.rotations import look_rotation, rotate
from tianim.spatial.body_params import Box, Capsule, Cylinder, Plane, Sphere

Floats = NDArray[np.float64]

# Straight pieces of a full circle: 24 look round at the size of a picture.
SEGMENTS = 24
# Triangles that meet at a larger angle than this [deg] make an edge to be drawn.
CREASE = 20.0


@dataclass(frozen=True)
class Surface:
    """Triangles in the body's own axes: `position` (n, 3) [m], `velocity` (n, 3) [m/s] if it bends."""

    position: Floats
    triangles: Int
    velocity: Floats | None = None


@dataclass(frozen=True)
class Edges:
    """Line segments in the body's own axes: `position` (n, 3) [m]."""

    position: Floats
    segments: Int


def primitive_shape(body: Plane | Box | Sphere | Capsule | Cylinder) -> Surface | Edges:
    """The shape of a primitive in its own axes."""
    if isinstance(body, Plane):
        return _square(body)
    if isinstance(body, Box):
        return _box_edges(body) if body.inside else _box(body)
    if isinstance(body, Sphere):
        return _circles(body.radius) if body.inside else _capsule(body.radius, 0.0)
    if isinstance(body, Cylinder):
        return _hoops(body) if body.inside else _cylinder(body)
    return _capsule(body.radius, body.length)


def wire(surface: Surface) -> Edges:
    """What is shown of a container that is a mesh: where it is bent, or all edges where it is smooth."""
    corners = surface.position[surface.triangles]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-300)
    sides = np.sort(surface.triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    triangle = np.repeat(np.arange(len(corners)), 3)
    order = np.lexsort(sides.T[::-1])
    sides, triangle = sides[order], triangle[order]
    same = (sides[1:] == sides[:-1]).all(axis=1)
    level = (normal[triangle[1:]] * normal[triangle[:-1]]).sum(axis=1) > np.cos(np.radians(CREASE))
    first = np.concatenate([[True], ~same])
    smooth = np.append(same & level, False)[first]
    segments = sides[first]
    return Edges(surface.position, (segments if smooth.all() else segments[~smooth]).astype(np.int32))


def _square(plane: Plane) -> Surface:
    half = 0.5 * plane.drawn_size
    corners = half * np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]], dtype=np.float64)
    facing = rotate(look_rotation(plane.normal), corners)
    return Surface(facing, np.array([[0, 1, 2], [0, 2, 3]], dtype=np.int32))


def _corners(box: Box) -> Floats:
    """Corner number 4 i + 2 j + k is at the upper end in x, y, z where i, j, k are 1."""
    signs = np.stack(np.meshgrid([-1, 1], [-1, 1], [-1, 1], indexing="ij"), axis=-1).reshape(8, 3)
    return np.asarray(0.5 * signs * box.size)


def _box(box: Box) -> Surface:
    sides = [[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]]
    triangles = [triple for a, b, c, d in sides for triple in ((a, b, c), (a, c, d))]
    return Surface(_corners(box), np.array(triangles, dtype=np.int32))


def _box_edges(box: Box) -> Edges:
    pairs = [(i, i | bit) for i in range(8) for bit in (1, 2, 4) if not i & bit]
    return Edges(_corners(box), np.array(pairs, dtype=np.int32))


def _ring(radius: float) -> Floats:
    """A circle about y, from the front (+z) by the left (+x)."""
    angle = 2.0 * np.pi * np.arange(SEGMENTS) / SEGMENTS
    return radius * np.stack([np.sin(angle), np.zeros(SEGMENTS), np.cos(angle)], axis=1)


def _loops(count: int) -> Int:
    """Segments of `count` closed rings."""
    here = np.arange(SEGMENTS)
    loop = np.stack([here, (here + 1) % SEGMENTS], axis=1)
    return np.concatenate([loop + ring * SEGMENTS for ring in range(count)]).astype(np.int32)


def _circles(radius: float) -> Edges:
    """Three great circles."""
    ring = _ring(radius)
    return Edges(np.concatenate([np.roll(ring, turn, axis=1) for turn in range(3)]), _loops(3))


def _hoops(body: Cylinder) -> Edges:
    """The rims of a cylinder and four lines between them."""
    lift = np.array([0.0, 0.5 * body.length, 0.0])
    ring = _ring(body.radius)
    quarters = np.arange(0, SEGMENTS, SEGMENTS // 4)
    uprights = np.stack([quarters, quarters + SEGMENTS], axis=1)
    return Edges(
        np.concatenate([ring - lift, ring + lift]),
        np.concatenate([_loops(2), uprights]).astype(np.int32),
    )


def _cylinder(body: Cylinder) -> Surface:
    half = 0.5 * body.length
    return _turned(np.full(2, body.radius), np.array([-half, half]), half)


def _capsule(radius: float, length: float) -> Surface:
    """The equator twice, half a length apart, but for a sphere."""
    quarter = SEGMENTS // 4
    latitude = 0.5 * np.pi * np.arange(quarter) / quarter
    latitude = np.concatenate([-latitude[:0:-1], [0.0, 0.0], latitude[1:]])
    lift = 0.5 * length * np.repeat([-1.0, 1.0], quarter)
    if length == 0.0:
        latitude, lift = np.delete(latitude, quarter), np.delete(lift, quarter)
    return _turned(radius * np.cos(latitude), radius * np.sin(latitude) + lift, radius + 0.5 * length)


def _turned(radii: Floats, heights: Floats, top: float) -> Surface:
    """A profile turned about y: rings from the south to the north, and the poles at -top and top."""
    count = len(radii)
    rings = _ring(1.0) * radii[:, None, None]
    rings[:, :, 1] = heights[:, None]
    position = np.concatenate([rings.reshape(-1, 3), [[0.0, -top, 0.0], [0.0, top, 0.0]]])
    here = np.arange(SEGMENTS)
    after = (here + 1) % SEGMENTS
    triangles = []
    for ring in range(count - 1):
        a, b = ring * SEGMENTS + here, ring * SEGMENTS + after
        triangles += [
            np.stack([a, b, b + SEGMENTS], axis=1),
            np.stack([a, b + SEGMENTS, a + SEGMENTS], axis=1),
        ]
    south, north = np.full(SEGMENTS, count * SEGMENTS), np.full(SEGMENTS, count * SEGMENTS + 1)
    last = (count - 1) * SEGMENTS
    triangles += [
        np.stack([south, after, here], axis=1),
        np.stack([last + here, last + after, north], axis=1),
    ]
    return Surface(position, np.concatenate(triangles).astype(np.int32))
