"""What pictures and exports show of a primitive body: triangles, or the edges of a container."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tianim.frame import Int
from tianim.math.rotations import look_rotation, rotate
from tianim.spatial.body_params import Box, Capsule, Plane, Sphere

Floats = NDArray[np.float64]

# Straight pieces of a full circle: 24 look round at the size of a picture.
SEGMENTS = 24


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


def primitive_shape(body: Plane | Box | Sphere | Capsule) -> Surface | Edges:
    """The shape of a primitive in its own axes."""
    if isinstance(body, Plane):
        return _square(body)
    if isinstance(body, Box):
        return _box_edges(body) if body.inside else _box(body)
    if isinstance(body, Sphere):
        return _circles(body.radius) if body.inside else _capsule(body.radius, 0.0)
    return _capsule(body.radius, body.length)


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


def _circles(radius: float) -> Edges:
    """Three great circles."""
    angle = 2.0 * np.pi * np.arange(SEGMENTS) / SEGMENTS
    ring = radius * np.stack([np.cos(angle), np.sin(angle), np.zeros(SEGMENTS)], axis=1)
    here = np.arange(SEGMENTS)
    loop = np.stack([here, (here + 1) % SEGMENTS], axis=1)
    return Edges(
        np.concatenate([np.roll(ring, turn, axis=1) for turn in range(3)]),
        np.concatenate([loop + turn * SEGMENTS for turn in range(3)]).astype(np.int32),
    )


def _capsule(radius: float, length: float) -> Surface:
    """Rings of points from the south to the north pole, the equator twice, half a length apart."""
    quarter = SEGMENTS // 4
    latitude = 0.5 * np.pi * np.arange(quarter) / quarter
    latitude = np.concatenate([-latitude[:0:-1], [0.0, 0.0], latitude[1:]])
    lift = 0.5 * length * np.repeat([-1.0, 1.0], quarter)
    longitude = 2.0 * np.pi * np.arange(SEGMENTS) / SEGMENTS
    flat = radius * np.cos(latitude)[:, None]
    rings = np.stack(
        [
            flat * np.sin(longitude),
            np.broadcast_to((radius * np.sin(latitude) + lift)[:, None], (len(lift), SEGMENTS)),
            flat * np.cos(longitude),
        ],
        axis=-1,
    )
    if length == 0.0:
        rings = np.delete(rings, quarter, axis=0)
    count = len(rings)
    top = radius + 0.5 * length
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
