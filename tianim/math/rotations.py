"""Rotations on the host: quaternions (x, y, z, w) as NumPy arrays (..., 4), through SciPy.

The same conventions as `tianim.math.quaternion`: local to world, +Z forward, +Y up.
"""

from typing import Any

import numpy as np
import scipy  # loads its parts when they are first used: a scene without bodies starts 0.25 s sooner
from numpy.typing import ArrayLike, NDArray

Floats = NDArray[np.float64]

# Squared sine of the angle below which two directions count as parallel.
PARALLEL = 1e-12


def _rotation() -> Any:
    return scipy.spatial.transform.Rotation


def from_euler(angles: ArrayLike) -> Floats:
    """Angles [deg] (..., 3) about the own x, then y, then z axis (intrinsic XYZ)."""
    return np.asarray(
        _rotation().from_euler("XYZ", np.asarray(angles, dtype=np.float64), degrees=True).as_quat()
    )


def multiply(a: ArrayLike, b: ArrayLike) -> Floats:
    """The rotation `b` first, then `a`."""
    return np.asarray((_rotation().from_quat(a) * _rotation().from_quat(b)).as_quat())


def rotate(q: ArrayLike, v: ArrayLike) -> Floats:
    """Local vectors `v` (..., 3) in world axes."""
    return np.asarray(_rotation().from_quat(q).apply(v))


def rotate_back(q: ArrayLike, v: ArrayLike) -> Floats:
    """World vectors `v` (..., 3) in local axes."""
    return np.asarray(_rotation().from_quat(q).apply(v, inverse=True))


def angular_velocity(before: ArrayLike, after: ArrayLike, dt: float) -> Floats:
    """World angular velocity [rad/s] that turns `before` into `after` in `dt` [s] the shorter way."""
    turn = _rotation().from_quat(after) * _rotation().from_quat(before).inv()
    return np.asarray(turn.as_rotvec() / dt)


def slerp(a: ArrayLike, b: ArrayLike, t: float) -> Floats:
    """From `a` (t = 0) to `b` (t = 1), each (4,) or (n, 4), by the shorter way."""
    start = _rotation().from_quat(a)
    turn = start.inv() * _rotation().from_quat(b)
    return np.asarray((start * _rotation().from_rotvec(t * turn.as_rotvec())).as_quat())


def look_rotation(forward: ArrayLike, up: ArrayLike = (0.0, 1.0, 0.0)) -> Floats:
    """Local +Z onto `forward` (n, 3), local +Y as near to `up` as that allows.

    Neither needs unit length. `up` along `forward` gives some roll; `forward` zero gives +Z.
    """
    z = _unit(np.atleast_2d(np.asarray(forward, dtype=np.float64)), (0.0, 0.0, 1.0))
    y = _unit(np.broadcast_to(np.asarray(up, dtype=np.float64), z.shape), (0.0, 1.0, 0.0))
    x = np.cross(y, z)
    parallel = np.sum(x * x, axis=1) < PARALLEL
    other = np.where(np.abs(z[:, :1]) > 0.7, (0.0, 1.0, 0.0), (1.0, 0.0, 0.0))
    x[parallel] = np.cross(z[parallel], other[parallel])
    x /= np.linalg.norm(x, axis=1, keepdims=True)
    axes = np.stack([x, np.cross(z, x), z], axis=-1)
    quaternions = np.asarray(_rotation().from_matrix(axes).as_quat())
    return quaternions if np.ndim(forward) > 1 else quaternions[0]


def _unit(v: Floats, fallback: tuple[float, float, float]) -> Floats:
    length = np.linalg.norm(v, axis=1, keepdims=True)
    return np.where(length > 0.0, v / np.where(length > 0.0, length, 1.0), fallback)
