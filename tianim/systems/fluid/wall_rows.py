"""Rows of the wall table on the host: what kernels need to know of a body as a wall of a fluid."""

import math

import numpy as np
from numpy.typing import NDArray

from tianim.spatial.bodies import (
    CELL,
    CYLINDER,
    KIND,
    MESH,
    PLANE,
    POSITION,
    RATE,
    ROTATION,
    ROUNDED,
    ROUNDING,
    SHAPE,
    SIGN,
    SIZE,
    SPIN,
    VELOCITY,
    BodyParams,
    Box,
    Capsule,
    Cylinder,
    Plane,
    Sphere,
)
from tianim.spatial.sections import cut
from tianim.system import Bounds
from tianim.systems.fluid import wall_shares as forms
from tianim.systems.fluid.wall_shares import FORM

Row = NDArray[np.float32]


def pack_bounds(row: Row, bounds: Bounds) -> None:
    """Contained bounds as the row of a box container."""
    lower, upper = np.array(bounds.lower), np.array(bounds.upper)
    row[KIND], row[SIGN] = ROUNDED, -1.0
    row[POSITION : POSITION + 3], row[ROTATION + 3] = 0.5 * (lower + upper), 1.0
    row[SHAPE : SHAPE + 3] = 0.5 * (upper - lower)


def set_form(row: Row, dimension: int) -> None:
    """Which shares serve the body of a row; in two dimensions its section."""
    if dimension == 2:
        cut(row)
    form = forms.BY_DISTANCE
    if row[KIND] == CYLINDER:
        form = forms.CYLINDER
    elif row[KIND] == ROUNDED:
        form = forms.CAPSULE if row[ROUNDING] > 0.0 else forms.BOX
    row[FORM] = form


def largest_speed(row: NDArray[np.float32]) -> float:
    """No point of the body's surface is faster [m/s]; infinite where that is not known."""
    speed, spin = float(np.linalg.norm(row[VELOCITY:SPIN])), float(np.linalg.norm(row[SPIN : SPIN + 3]))
    if row[RATE] != 0.0:
        return math.inf
    if spin == 0.0:
        return speed
    if row[KIND] == PLANE:
        return math.inf
    corner = np.abs(row[SHAPE : SHAPE + 3].astype(np.float64))
    if row[KIND] == MESH:
        corner = np.maximum(corner, np.abs(row[SHAPE : SHAPE + 3] + row[CELL] * row[SIZE : SIZE + 3]))
    if row[KIND] == CYLINDER:
        corner[2] = 0.0
    return speed + spin * (float(np.linalg.norm(corner)) + float(row[ROUNDING]))


def half_thickness(body: BodyParams) -> float:
    """How deep the middle of a solid lies at least [m]; 0 where nobody knows, infinite for containers."""
    if isinstance(body, Plane) or getattr(body, "inside", False):
        return math.inf
    if isinstance(body, Box):
        return 0.5 * min(body.size)
    if isinstance(body, Cylinder):
        return min(body.radius, 0.5 * body.length)
    return body.radius if isinstance(body, Sphere | Capsule) else 0.0
