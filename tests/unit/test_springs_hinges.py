"""Angular springs: their slopes, what they keep, and that they turn two triangles back."""

from typing import Any

import numpy as np
import pytest
from pydantic import ValidationError

from tianim.spatial.bodies import Bodies
from tianim.system import Bounds, World
from tianim.systems.springs import SpringsParams, SpringSystem
from tianim.systems.springs.hinges import hinge_angles, hinge_gradients

# Central differences with steps of 1e-6 are good to 1e-9 of slopes of some 1 rad/m.
SLOPE_ERROR = 1e-8
EXACT = 1e-12
DOUBLE = 1e-13  # float64 sums of forces of about 1 N
POINTS = ((0.0, 0.0, 0.0), (0.0, 0.0, 1.0), (0.8, 0.1, 0.4), (-0.7, 0.2, 0.6))
EDGES = ((0, 1), (0, 2), (1, 2), (0, 3), (1, 3))


def folded(solver: str = "explicit", gravity: float = 0.0, **hinge: Any) -> SpringSystem:
    """Two triangles with a common edge."""
    piece = {
        "kind": "network", "points": POINTS, "mass": (1.0, 2.0, 0.5, 0.7),
        "springs": tuple({"between": edge, "stiffness": 500.0, "damping": 2.0} for edge in EDGES),
        "hinges": ({"points": (0, 1, 2, 3), "stiffness": 3.0, **hinge},),
    }  # fmt: skip
    given = {"kind": "springs", "solver": solver, "gravity": (0.0, gravity, 0.0), "pieces": {"book": piece}}
    params = SpringsParams.model_validate(given)
    return SpringSystem("one", params, World(Bounds(), Bodies({}), 1))


def test_the_slopes_of_an_angle_are_its_differences() -> None:
    rng = np.random.default_rng(3)
    for _ in range(20):
        x, points = rng.normal(size=(4, 3)), np.array([[0, 1, 2, 3]], np.int32)
        slopes, h = hinge_gradients(x, points)[0], 1e-6
        for i in range(4):
            for c in range(3):
                ahead, behind = x.copy(), x.copy()
                ahead[i, c] += h
                behind[i, c] -= h
                change = hinge_angles(ahead, points)[0] - hinge_angles(behind, points)[0]
                change -= 2.0 * np.pi * np.round(change / (2.0 * np.pi))
                limit = SLOPE_ERROR * (1.0 + np.abs(slopes).max() ** 3)  # the third derivative of the angle
                assert change / (2.0 * h) == pytest.approx(slopes[i, c], abs=limit)


def test_flat_is_nothing_and_a_right_angle_is_one() -> None:
    flat = np.array([[0, 0, 0], [0, 0, 1], [1, 0, 0], [-1, 0, 0]], np.float64)
    points = np.array([[0, 1, 2, 3]], np.int32)
    assert hinge_angles(flat, points)[0] == 0.0
    up = flat.copy()
    up[2] = (0.0, 1.0, 0.0)
    assert abs(hinge_angles(up, points)[0]) == pytest.approx(np.pi / 2.0, abs=EXACT)


def test_forces_are_minus_the_slope_of_the_energy() -> None:
    """The kernel's accelerations beside NumPy's slopes, springs at rest."""
    one = folded(angle=0.0)
    x, v = one.read("position"), one.read("velocity")
    dt = 1e-4
    one.step(0.0, dt)
    got = (one.read("velocity") - v) / dt * one.read("mass")[:, None]
    points = np.array([[0, 1, 2, 3]], np.int32)
    torque = -3.0 * hinge_angles(x, points)[0]
    # Rest lengths are float32: springs of 500 N/m are off by some 1e-5 N.
    np.testing.assert_allclose(got, torque * hinge_gradients(x, points)[0], atol=1e-4)


def test_a_hinge_neither_moves_nor_turns_the_whole() -> None:
    one = folded(angle=60.0, damping=0.1)
    for step in range(400):
        one.step(step * 1e-3, 1e-3)
    x, v, m = one.read("position"), one.read("velocity"), one.read("mass")
    assert np.abs(v).max() > 0.05
    np.testing.assert_allclose(m @ v, 0.0, atol=DOUBLE)
    np.testing.assert_allclose((m[:, None] * np.cross(x, v)).sum(axis=0), 0.0, atol=1e-9)


@pytest.mark.parametrize("angle", [0.0, 50.0, -120.0])
def test_it_comes_to_rest_at_its_angle(angle: float) -> None:
    one = folded(angle=angle, damping=0.5)
    dt = one.max_step()
    for step in range(round(20.0 / dt)):
        one.step(step * dt, dt)
    found = hinge_angles(one.read("position"), np.array([[0, 1, 2, 3]], np.int32))[0]
    assert np.degrees(found) == pytest.approx(angle, abs=0.1)
    assert one.diagnostics()["elastic_energy"] == pytest.approx(0.0, abs=1e-5)


def test_left_out_the_angle_is_that_of_the_start() -> None:
    one = folded()
    assert one.diagnostics()["elastic_energy"] == pytest.approx(0.0, abs=1e-9)
    one.step(0.0, 1e-3)
    np.testing.assert_allclose(one.read("velocity"), 0.0, atol=1e-6)


def test_hinges_need_explicit_steps() -> None:
    with pytest.raises(ValidationError, match="hinges need explicit steps, not projective"):
        folded("projective")
    assert folded("auto").solver.name == "explicit"


@pytest.mark.parametrize(
    ("points", "message"),
    [((0, 1, 2, 9), "no point 9; there are 0 to 3"), ((0, 1, 1, 2), "three of them lie in a line")],
)
def test_bad_hinges_are_refused(points: tuple[int, ...], message: str) -> None:
    with pytest.raises(ValidationError, match=message):
        folded(points=points)
