"""Small shapes that stand for a point with a heading: birds, fish, bees, darts, arrows.

A shape is one unit long: its nose is at +z, its back is +y, its left is +x, its middle the point.
`motion` times a sine is added to the vertices (wing beat, tail beat). `tint` brightens or darkens
the colour at each vertex (a pale belly, dark stripes).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

Float = NDArray[np.float32]
Int = NDArray[np.int32]


@dataclass(frozen=True)
class Shape:
    """Vertices (v, 3), motion (v, 3), tint (v,), triangles (t, 3).

    beat in 1/s; width of the plain stick that hides as much, seen from anywhere; normals (v, 3), or
    None where all is flat.
    """

    vertices: Float
    motion: Float
    tint: Float
    triangles: Int
    beat: float
    width: float
    normals: Float | None = None


def _shape(
    rows: Sequence[tuple[float, ...]], triangles: Sequence[tuple[int, int, int]], beat: float, width: float
) -> Shape:
    """A shape from rows (x, y, z, motion x, motion y, motion z, tint)."""
    table = np.array(rows, np.float32)
    return Shape(
        vertices=np.ascontiguousarray(table[:, :3]),
        motion=np.ascontiguousarray(table[:, 3:6]),
        tint=np.ascontiguousarray(table[:, 6]),
        triangles=np.array(triangles, np.int32),
        beat=beat,
        width=width,
    )


def _bird() -> Shape:
    """A slender body, swept wings that beat, a small fan of a tail."""
    rows = [
        (0.0, 0.0, 0.50, 0.0, 0.0, 0.0, 1.0),  # 0 beak
        (0.07, 0.03, 0.16, 0.0, 0.0, 0.0, 1.0),  # 1 left shoulder
        (-0.07, 0.03, 0.16, 0.0, 0.0, 0.0, 1.0),  # 2 right shoulder
        (0.0, -0.07, 0.10, 0.0, 0.0, 0.0, 0.75),  # 3 breast
        (0.06, 0.02, -0.14, 0.0, 0.0, 0.0, 1.0),  # 4 left hip
        (-0.06, 0.02, -0.14, 0.0, 0.0, 0.0, 1.0),  # 5 right hip
        (0.10, 0.01, -0.50, 0.0, 0.0, 0.0, 1.1),  # 6 tail, left
        (-0.10, 0.01, -0.50, 0.0, 0.0, 0.0, 1.1),  # 7 tail, right
        (0.34, 0.10, 0.14, 0.0, 0.13, 0.0, 1.15),  # 8 left wrist
        (-0.34, 0.10, 0.14, 0.0, 0.13, 0.0, 1.15),  # 9 right wrist
        (0.68, 0.06, -0.16, 0.0, 0.34, 0.0, 1.3),  # 10 left wing tip
        (-0.68, 0.06, -0.16, 0.0, 0.34, 0.0, 1.3),  # 11 right wing tip
    ]
    triangles = [
        (0, 1, 2),
        (0, 3, 1),
        (0, 2, 3),
        (1, 4, 5),
        (1, 5, 2),
        (4, 6, 7),
        (4, 7, 5),
        (3, 4, 1),
        (3, 2, 5),
    ]
    triangles += [(1, 8, 4), (8, 10, 4), (2, 5, 9), (9, 5, 11)]
    return _shape(rows, triangles, beat=2.6, width=0.15)


def _far_bird() -> Shape:
    """A bird of a few pixels: a body seen from any side, and two wings."""
    rows = [
        (0.0, 0.0, 0.50, 0.0, 0.0, 0.0, 1.0),
        (0.12, 0.0, -0.45, 0.0, 0.0, 0.0, 1.0),
        (-0.12, 0.0, -0.45, 0.0, 0.0, 0.0, 1.0),
        (0.0, -0.13, 0.05, 0.0, 0.0, 0.0, 0.8),
        (0.05, 0.03, 0.2, 0.0, 0.0, 0.0, 1.1),
        (-0.05, 0.03, 0.2, 0.0, 0.0, 0.0, 1.1),
        (0.66, 0.1, -0.1, 0.0, 0.34, 0.0, 1.3),
        (-0.66, 0.1, -0.1, 0.0, 0.34, 0.0, 1.3),
        (0.0, 0.03, -0.2, 0.0, 0.0, 0.0, 1.0),
    ]
    return _shape(rows, [(0, 1, 2), (0, 3, 8), (4, 6, 8), (5, 8, 7)], beat=2.6, width=0.15)


def _fish() -> Shape:
    """A body taller than wide, dark above and pale below, with a tail that beats from side to side."""
    rows = [
        (0.0, 0.0, 0.50, 0.015, 0.0, 0.0, 1.0),  # 0 mouth
        (0.0, 0.15, 0.14, 0.0, 0.0, 0.0, 0.42),  # 1 back
        (0.0, -0.15, 0.14, 0.0, 0.0, 0.0, 1.5),  # 2 belly
        (0.075, 0.01, 0.18, 0.0, 0.0, 0.0, 1.1),  # 3 left flank
        (-0.075, 0.01, 0.18, 0.0, 0.0, 0.0, 1.1),  # 4 right flank
        (0.0, 0.035, -0.30, 0.05, 0.0, 0.0, 0.6),  # 5 root of the tail, above
        (0.0, -0.035, -0.30, 0.05, 0.0, 0.0, 1.0),  # 6 root of the tail, below
        (0.0, 0.17, -0.50, 0.13, 0.0, 0.0, 0.7),  # 7 tail tip, above
        (0.0, -0.17, -0.50, 0.13, 0.0, 0.0, 0.9),  # 8 tail tip, below
        (0.0, 0.25, -0.04, 0.0, 0.0, 0.0, 0.45),  # 9 fin on the back
    ]
    triangles = [(0, 1, 3), (0, 3, 2), (1, 5, 3), (3, 5, 6), (3, 6, 2)]
    triangles += [(0, 4, 1), (0, 2, 4), (1, 4, 5), (4, 6, 5), (4, 2, 6), (5, 7, 6), (6, 7, 8), (1, 9, 5)]
    return _shape(rows, triangles, beat=2.2, width=0.13)


def _near_fish() -> Shape:
    """A fish to be seen close by: a round body, fins, and a tail fin like a crescent."""
    ring = 12
    # Along the body from the mouth: place, half height, half width, middle height.
    loft = [
        (0.5, 0.004, 0.004, -0.01), (0.465, 0.03, 0.026, -0.006), (0.4, 0.062, 0.05, 0.0),
        (0.28, 0.095, 0.07, 0.005), (0.14, 0.112, 0.078, 0.006), (-0.02, 0.1, 0.066, 0.004),
        (-0.17, 0.066, 0.044, 0.004),
        (-0.29, 0.034, 0.022, 0.005), (-0.385, 0.02, 0.012, 0.006),
    ]  # fmt: skip
    rows, normals, triangles = [], [], []
    for z, high, wide, middle in loft:
        for k in range(ring):
            angle = 2 * np.pi * k / ring
            c, s = np.cos(angle), np.sin(angle)
            tint = 0.95 - 0.5 * max(s, 0.0) + 0.5 * max(-s - 0.2, 0.0)  # dark back, pale belly
            rows.append((wide * c, middle + high * s, z, 0.35 * max(0.2 - z, 0.0) ** 2, 0.0, 0.0, tint))
            normal = np.array([c / max(wide, 1e-3), s / max(high, 1e-3), 4.0 * (z - 0.1)])
            normals.append(tuple(normal / np.linalg.norm(normal)))
    for j in range(len(loft) - 1):
        for k in range(ring):
            a, b = j * ring + k, j * ring + (k + 1) % ring
            triangles += [(a, b, a + ring), (b, b + ring, a + ring)]
    fins = (
        [(0.0, 0.015, -0.37), (0.0, 0.19, -0.53), (0.0, 0.03, -0.45)],
        [(0.0, 0.0, -0.37), (0.0, 0.03, -0.45), (0.0, -0.14, -0.5)],
        [(0.0, 0.1, 0.1), (0.0, 0.095, -0.06), (0.0, 0.235, -0.08)],
        [(0.0, 0.05, -0.2), (0.0, 0.035, -0.26), (0.0, 0.09, -0.28)],
        [(0.06, -0.05, 0.2), (0.055, -0.055, 0.08), (0.21, -0.12, 0.02)],
        [(-0.06, -0.05, 0.2), (-0.055, -0.055, 0.08), (-0.21, -0.12, 0.02)],
    )
    for fin in fins:
        triangles.append((len(rows), len(rows) + 1, len(rows) + 2))
        rows += [(x, y, z, 0.35 * max(0.2 - z, 0.0) ** 2, 0.0, 0.0, 0.6) for x, y, z in fin]
        normals += [(0.0, 0.0, 0.0)] * 3
    body = _shape(rows, triangles, beat=0.9, width=0.13)
    return replace(body, normals=np.array(normals, np.float32))


def _bee() -> Shape:
    """A stout striped body between two pale wings that whirr."""
    ring, rows = 6, [(0.0, 0.0, 0.50, 0.0, 0.0, 0.0, 0.12)]
    for z, radius, tint in ((0.3, 0.15, 0.15), (0.12, 0.22, 1.0), (-0.05, 0.23, 0.1), (-0.24, 0.2, 1.0)):
        for k in range(ring):
            angle = 2 * np.pi * k / ring
            rows.append((radius * np.cos(angle), radius * np.sin(angle), z, 0.0, 0.0, 0.0, tint))
    rows.append((0.0, -0.02, -0.5, 0.0, 0.0, 0.0, 0.1))
    end = len(rows) - 1
    triangles = [(0, 1 + k, 1 + (k + 1) % ring) for k in range(ring)]
    for band in range(3):
        for k in range(ring):
            a, b = 1 + band * ring + k, 1 + band * ring + (k + 1) % ring
            triangles += [(a, a + ring, b), (b, a + ring, b + ring)]
    last = 1 + 3 * ring
    triangles += [(last + k, end, last + (k + 1) % ring) for k in range(ring)]
    for side in (1.0, -1.0):
        first = len(rows)
        rows += [
            (0.06 * side, 0.2, 0.16, 0.0, 0.0, 0.0, 2.2),
            (0.62 * side, 0.34, 0.06, 0.0, 0.3, 0.0, 2.6),
            (0.5 * side, 0.3, -0.24, 0.0, 0.26, 0.0, 2.6),
        ]
        triangles.append((first, first + 1, first + 2))
    return _shape(rows, triangles, beat=9.0, width=0.22)


def _dart() -> Shape:
    """A slim pyramid with a keel: a thing that goes somewhere."""
    rows = [
        (0.0, 0.0, 0.50, 0.0, 0.0, 0.0, 1.1),
        (0.22, -0.04, -0.5, 0.0, 0.0, 0.0, 1.0),
        (-0.22, -0.04, -0.5, 0.0, 0.0, 0.0, 1.0),
        (0.0, 0.16, -0.42, 0.0, 0.0, 0.0, 1.0),
        (0.0, 0.0, -0.3, 0.0, 0.0, 0.0, 0.7),
    ]
    triangles = [(0, 1, 3), (0, 3, 2), (0, 2, 4), (0, 4, 1), (1, 4, 3), (2, 3, 4)]
    return _shape(rows, triangles, beat=0.0, width=0.11)


def _arrow() -> Shape:
    """A flat arrowhead with a notch, for plan views."""
    rows = [
        (0.0, 0.0, 0.50, 0.0, 0.0, 0.0, 1.0),
        (0.36, 0.0, -0.5, 0.0, 0.0, 0.0, 1.0),
        (-0.36, 0.0, -0.5, 0.0, 0.0, 0.0, 1.0),
        (0.0, 0.0, -0.28, 0.0, 0.0, 0.0, 1.0),
    ]
    return _shape(rows, [(0, 1, 3), (0, 3, 2)], beat=0.0, width=0.4)


FAR_SHAPES = {"birds": _far_bird()}  # for what is only a few pixels long
NEAR_SHAPES = {"fish": _near_fish()}  # for what is large in the picture
SHAPES = {"birds": _bird(), "fish": _fish(), "bees": _bee(), "darts": _dart(), "arrows": _arrow()}


def heading_quaternion(forward: Float, up: tuple[float, float, float] = (0.0, 1.0, 0.0)) -> Float:
    """Unit quaternions (x, y, z, w), shape (n, 4), that turn +z to `forward` and +y towards `up`.

    A zero or vertical `forward` keeps some fixed, finite turn.
    """
    n = len(forward)
    length = np.linalg.norm(forward, axis=1, keepdims=True)
    ahead = np.array((0.0, 0.0, 1.0), np.float32)
    z = np.where(length > 1e-12, forward / np.maximum(length, 1e-12), ahead).astype(np.float32)
    x = np.cross(np.broadcast_to(np.array(up, np.float32), (n, 3)), z)
    size = np.linalg.norm(x, axis=1, keepdims=True)
    other_up = np.array((up[2], up[0], up[1]), np.float32)
    x = np.where(size > 1e-5, x, np.cross(np.broadcast_to(other_up, (n, 3)), z))
    x = (x / np.maximum(np.linalg.norm(x, axis=1, keepdims=True), 1e-12)).astype(np.float32)
    return _from_axes(x, np.cross(z, x).astype(np.float32), z)


def _from_axes(x: Float, y: Float, z: Float) -> Float:
    """Quaternions of right-handed frames, by the largest component (Shepperd 1978)."""
    trace = x[:, 0] + y[:, 1] + z[:, 2]
    squares = np.stack(
        [1 + 2 * x[:, 0] - trace, 1 + 2 * y[:, 1] - trace, 1 + 2 * z[:, 2] - trace, 1 + trace], 1
    )
    products = np.empty((len(x), 4, 4), np.float32)
    products[:, range(4), range(4)] = squares
    products[:, 0, 1] = products[:, 1, 0] = x[:, 1] + y[:, 0]
    products[:, 0, 2] = products[:, 2, 0] = x[:, 2] + z[:, 0]
    products[:, 1, 2] = products[:, 2, 1] = y[:, 2] + z[:, 1]
    products[:, 0, 3] = products[:, 3, 0] = y[:, 2] - z[:, 1]
    products[:, 1, 3] = products[:, 3, 1] = z[:, 0] - x[:, 2]
    products[:, 2, 3] = products[:, 3, 2] = x[:, 1] - y[:, 0]
    best = np.take_along_axis(products, squares.argmax(1)[:, None, None], axis=1)[:, 0]
    norm = np.maximum(np.linalg.norm(best, axis=1, keepdims=True), 1e-12)
    return np.ascontiguousarray(best / norm, dtype=np.float32)


def forward_of(orientation: Float) -> Float:
    """The direction of the nose, shape (n, 3), of unit quaternions."""
    x, y, z, w = orientation.T
    return np.stack([2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)], axis=1)
