"""Rotations in kernels beside SciPy, and what the host's forms promise."""

import numpy as np
import pytest
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation, Slerp

from tianim.lang import f32_2d, ti
from tianim.math import quaternion, rotations

# float32 through some ten operations on numbers of order one.
ROUNDING = 3e-6
# float64 on the host.
EXACT = 1e-12

RNG = np.random.default_rng(9)
Q = Rotation.from_quat(RNG.normal(size=(200, 4))).as_quat()
R = Rotation.from_quat(RNG.normal(size=(200, 4))).as_quat()
V = RNG.normal(size=(200, 3))
W = RNG.normal(size=(200, 3))

MULTIPLY, ROTATE, BACK, LOOK, SLERP, AXES, AXIS_ANGLE = range(7)


@ti.kernel
def apply(what: ti.i32, a: f32_2d, b: f32_2d, t: ti.f32, out: f32_2d):
    for i in range(out.shape[0]):
        p = ti.Vector([a[i, 0], a[i, 1], a[i, 2], a[i, 3]])
        q = ti.Vector([b[i, 0], b[i, 1], b[i, 2], b[i, 3]])
        r = ti.Vector([0.0, 0.0, 0.0, 0.0])
        if what == MULTIPLY:
            r = quaternion.multiply(p, q)
        elif what == ROTATE:
            r.xyz = quaternion.rotate(p, q.xyz)
        elif what == BACK:
            r.xyz = quaternion.rotate_back(p, q.xyz)
        elif what == LOOK:
            r = quaternion.look_rotation(p.xyz, q.xyz)
        elif what == SLERP:
            r = quaternion.slerp(p, q, t)
        elif what == AXES:
            x = quaternion.rotate(p, ti.Vector([1.0, 0.0, 0.0]))
            y = quaternion.rotate(p, ti.Vector([0.0, 1.0, 0.0]))
            r = quaternion.from_axes(x, y, x.cross(y))
        else:
            r = quaternion.multiply(quaternion.conjugate(quaternion.from_axis_angle(q.xyz, 0.5 * t)), p)
        for c in ti.static(range(4)):
            out[i, c] = r[c]


def run(what: int, a: ArrayLike, b: ArrayLike, t: float = 0.0) -> NDArray[np.float64]:
    rows = [np.zeros((len(np.asarray(a)), 4), dtype=np.float32) for _ in range(3)]
    for row, values in zip(rows, (a, b), strict=False):
        row[:, : np.shape(values)[1]] = values
    apply(what, rows[0], rows[1], t, rows[2])
    return rows[2].astype(np.float64)


def assert_same_rotation(a: ArrayLike, b: ArrayLike, atol: float) -> None:
    """Q and -q are one rotation; as matrices they are equal."""
    np.testing.assert_allclose(
        Rotation.from_quat(a).as_matrix(), Rotation.from_quat(b).as_matrix(), atol=atol
    )


def test_multiply() -> None:
    expected = (Rotation.from_quat(Q) * Rotation.from_quat(R)).as_quat()
    assert_same_rotation(run(MULTIPLY, Q, R), expected, ROUNDING)
    assert_same_rotation(rotations.multiply(Q, R), expected, EXACT)


def test_rotate_and_back() -> None:
    world = Rotation.from_quat(Q).apply(V)
    np.testing.assert_allclose(run(ROTATE, Q, V)[:, :3], world, atol=ROUNDING)
    np.testing.assert_allclose(run(BACK, Q, world)[:, :3], V, atol=ROUNDING)
    np.testing.assert_allclose(rotations.rotate_back(Q, rotations.rotate(Q, V)), V, atol=EXACT)


def test_euler_angles_are_about_the_turned_axes() -> None:
    """First 90 degrees about x: the turned y points along z, so the second turn is about z."""
    np.testing.assert_allclose(
        rotations.rotate(rotations.from_euler((90.0, 0.0, 0.0)), [0, 1, 0]), [0, 0, 1], atol=EXACT
    )
    np.testing.assert_allclose(
        rotations.rotate(rotations.from_euler((90.0, 90.0, 0.0)), [1, 0, 0]), [0, 1, 0], atol=EXACT
    )
    x, y, z = (rotations.from_euler(angle) for angle in ((20.0, 0, 0), (0, 30.0, 0), (0, 0, 40.0)))
    assert_same_rotation(
        rotations.multiply(rotations.multiply(x, y), z), rotations.from_euler((20.0, 30.0, 40.0)), EXACT
    )


@pytest.mark.parametrize("host", [True, False])
def test_look_rotation_points_forward_and_keeps_up_up(host: bool) -> None:
    q = rotations.look_rotation(V, W) if host else run(LOOK, V, W)
    atol = EXACT if host else ROUNDING
    turn = Rotation.from_quat(q)
    forward = V / np.linalg.norm(V, axis=1, keepdims=True)
    np.testing.assert_allclose(turn.apply([0.0, 0.0, 1.0]), forward, atol=atol)
    np.testing.assert_allclose((turn.apply([1.0, 0.0, 0.0]) * W).sum(axis=1), 0.0, atol=5 * atol)
    assert ((turn.apply([0.0, 1.0, 0.0]) * W).sum(axis=1) > 0.0).all()


@pytest.mark.parametrize("host", [True, False])
def test_look_rotation_without_a_usable_up(host: bool) -> None:
    forward = np.array([[0.0, 2.0, 0.0], [0.0, -1.0, 0.0], [3.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
    up = np.array([[0.0, 1.0, 0.0], [0.0, 5.0, 0.0], [0.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    q = rotations.look_rotation(forward, up) if host else run(LOOK, forward, up)
    unit = forward / np.linalg.norm(forward, axis=1, keepdims=True)
    np.testing.assert_allclose(np.linalg.norm(q, axis=1), 1.0, atol=ROUNDING)
    np.testing.assert_allclose(Rotation.from_quat(q).apply([0.0, 0.0, 1.0]), unit, atol=ROUNDING)


def test_look_rotation_of_nothing_is_no_rotation() -> None:
    nowhere, up = np.zeros((1, 3)), [[0.0, 1.0, 0.0]]
    assert_same_rotation(run(LOOK, nowhere, up), [[0.0, 0.0, 0.0, 1.0]], ROUNDING)
    assert_same_rotation(rotations.look_rotation(nowhere), [[0.0, 0.0, 0.0, 1.0]], EXACT)
    assert rotations.look_rotation((1.0, 0.0, 0.0)).shape == (4,)


def test_from_axes_in_every_branch() -> None:
    halves = Rotation.from_rotvec(
        np.pi * np.concatenate([np.eye(3), [[0.6, 0.8, 0.0], [0.0, 0.6, -0.8]]])
    ).as_quat()
    both = np.concatenate([Q, halves])
    assert_same_rotation(run(AXES, both, both), both, ROUNDING)


def test_axis_and_angle() -> None:
    axis = V / np.linalg.norm(V, axis=1, keepdims=True)
    expected = (Rotation.from_rotvec(0.7 * axis).inv() * Rotation.from_quat(Q)).as_quat()
    assert_same_rotation(run(AXIS_ANGLE, Q, axis, 1.4), expected, ROUNDING)


@pytest.mark.parametrize("t", [0.0, 0.25, 0.5, 1.0])
def test_slerp_beside_scipy(t: float) -> None:
    expected = [
        Slerp([0.0, 1.0], Rotation.from_quat(np.array(pair)))(t).as_quat() for pair in zip(Q, R, strict=True)
    ]
    # Angles near a half turn are found by an arc cosine, which loses half the digits there.
    assert_same_rotation(run(SLERP, Q, R, t), expected, 1e-5)
    assert_same_rotation(rotations.slerp(Q, R, t), expected, EXACT)


def test_slerp_of_close_rotations() -> None:
    near = (Rotation.from_quat(Q) * Rotation.from_rotvec(1e-3 * V)).as_quat()
    expected = (Rotation.from_quat(Q) * Rotation.from_rotvec(0.5e-3 * V)).as_quat()
    assert_same_rotation(run(SLERP, Q, near, 0.5), expected, ROUNDING)
    assert_same_rotation(run(SLERP, Q, -near, 0.5), expected, ROUNDING)


def test_angular_velocity() -> None:
    spin = np.array([0.3, -1.0, 2.0])
    after = (Rotation.from_rotvec(0.1 * spin) * Rotation.from_quat(Q)).as_quat()
    np.testing.assert_allclose(rotations.angular_velocity(Q, after, 0.1), np.tile(spin, (200, 1)), atol=1e-11)
