"""Mouths of emitters: where the particles of a layer stand, and how the mouth lies in space over time.

In a mouth's own axes +Z is the direction of the flow and +Y the mouth's height; a layer is the square
lattice of the spacing in the plane z = 0 of these axes. In two dimensions it is a line along +Y.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tianim.math.rotations import from_euler, look_rotation, multiply, rotate, rotate_back
from tianim.spatial.body_params import BodyParams
from tianim.spatial.mesh_files import read_mesh
from tianim.systems.fluid.block_params import ROUNDING, layers
from tianim.systems.fluid.source_params import BoxEmitter, DiscEmitter, EmitterParams, MeshEmitter

Floats = NDArray[np.float64]

# Tests of points against triangles that are made at a time.
CHUNK = 4_000_000
Z = np.array([0.0, 0.0, 1.0])


class Pose(NamedTuple):
    """Middle of a mouth [m] and the rotation from its axes to the world's, a quaternion."""

    position: Floats
    rotation: Floats


def axes_of(emitter: EmitterParams, dimension: int) -> Floats:
    """The rotation that lays +Z along the emitter's direction, and +Y along its height."""
    direction = np.array(emitter.direction)
    up = np.array(getattr(emitter, "up", (0.0, 1.0, 0.0)))
    if dimension == 2:
        direction[2] = 0.0
        up = np.cross(Z, direction)
    return look_rotation(direction, up)


def pose_at(emitter: EmitterParams, body: BodyParams | None, axes: Floats, time: float) -> Pose:
    """How the mouth lies at `time` [s], on the body it rides on."""
    now = emitter.at(time)
    position, rotation = np.array(now.position), from_euler(now.rotation)
    if body is not None:
        carrier = body.at(time)
        turn = from_euler(carrier.rotation)
        position = np.array(carrier.position) + rotate(turn, position)
        rotation = multiply(turn, rotation)
    return Pose(position, multiply(rotation, axes))


def layer_of(emitter: EmitterParams, spacing: float, dimension: int, axes: Floats) -> Floats:
    """Places of a layer's particles in the mouth's axes, (m, 3) [m]; at least one."""
    if isinstance(emitter, DiscEmitter):
        flat = _disc(emitter.radius / spacing, dimension) * spacing
    elif isinstance(emitter, BoxEmitter):
        width = layers(emitter.width, spacing) if dimension == 3 else 1
        flat = _rectangle(max(width, 1), max(layers(emitter.height, spacing), 1)) * spacing
    else:
        flat = _outline(emitter, spacing, dimension, axes)
    return np.column_stack([flat, np.zeros(len(flat))])


def _rectangle(width: int, height: int) -> Floats:
    """Places of a lattice of spacing 1 about the middle, (m, 2)."""
    x, y = np.meshgrid(np.arange(width) - 0.5 * (width - 1), np.arange(height) - 0.5 * (height - 1))
    return np.column_stack([x.ravel(), y.ravel()])


def _disc(radius: float, dimension: int) -> Floats:
    """Of the lattices with a place in the middle and with none, that whose area is nearer to the disc's."""
    if dimension == 2:
        return _rectangle(1, max(round(2.0 * radius), 1))
    best, off = np.zeros((1, 2)), np.inf
    for across in (2 * int(radius) + 1, 2 * int(radius + 0.5)):
        places = _rectangle(across, across)
        places = places[np.linalg.norm(places, axis=1) <= radius + ROUNDING]
        if len(places) and abs(len(places) - np.pi * radius**2) < off:
            best, off = places, abs(len(places) - np.pi * radius**2)
    return best


def _outline(emitter: MeshEmitter, spacing: float, dimension: int, axes: Floats) -> Floats:
    """Places of the lattice that some triangle covers, seen along the direction."""
    mesh = read_mesh(emitter.file)
    corners = rotate_back(axes, mesh.vertices * emitter.scale)[:, :2]
    lower, upper = corners.min(axis=0), corners.max(axis=0)
    if dimension == 2:
        lower[0] = upper[0] = 0.0
    width, height = (max(layers(side, spacing), 1) for side in upper - lower)
    places = 0.5 * (lower + upper) + spacing * _rectangle(width, height)
    a, b, c = (corners[mesh.triangles[:, k]] for k in range(3))
    covered = np.zeros(len(places), np.bool_)
    step = max(CHUNK // len(mesh.triangles), 1)
    for first in range(0, len(places), step):
        p = places[first : first + step, None]
        sides = np.stack([_side(a, b, p), _side(b, c, p), _side(c, a, p)])
        one_side = (sides >= 0.0).all(axis=0) | (sides <= 0.0).all(axis=0)
        covered[first : first + step] = np.any(one_side, axis=1)
    return places[covered] if covered.any() else 0.5 * (lower + upper)[None]


def _side(a: Floats, b: Floats, p: Floats) -> Floats:
    """On which side of the lines from a to b the points are."""
    u, v = b - a, p - a
    return np.asarray(u[:, 0] * v[..., 1] - u[:, 1] * v[..., 0])


def placed(pose: Pose, points: Floats) -> Floats:
    """Points of the mouth's axes in the world [m]."""
    return np.asarray(pose.position + rotate(pose.rotation, points))
