"""Couzin's model: its three phases, and one decision after the other against the law in float64."""

import numpy as np
import pytest
from checks import as_tests, assert_passes
from numpy.typing import NDArray

from tianim.system import Bounds
from tianim.systems.boids.couzin import CouzinParams
from tianim.validate import CASES, Case
from tianim.validate.build import OPEN, built

Floats = NDArray[np.float64]

# Directions of float32 sums of some fifty unit vectors.
DIRECTION = 5e-6


@pytest.mark.parametrize("case", as_tests(CASES["couzin"]))
def test_case(case: Case) -> None:
    assert_passes(case)


def unit(d: Floats) -> Floats:
    size = np.linalg.norm(d, axis=-1, keepdims=True)
    return np.asarray(d / np.where(size > 0.0, size, 1.0))


def wishes(x: Floats, v: Floats, radii: tuple[float, float, float], view: float) -> Floats:
    """What each wants by the paper's three zones."""
    d = x[None] - x[:, None]
    distance = np.linalg.norm(d, axis=2)
    others = ~np.eye(len(x), dtype=bool)
    heading = unit(v)
    seen = others & (np.einsum("ijk,ik->ij", d, heading) >= np.cos(np.radians(view) / 2) * distance)
    close = others & (distance < radii[0])
    middle = seen & (distance >= radii[0]) & (distance < radii[1])
    far = seen & (distance >= radii[1]) & (distance < radii[2])
    result = np.empty_like(x)
    for i in range(len(x)):
        towards, along = unit(d[i, far[i]]).sum(axis=0), heading[middle[i]].sum(axis=0)
        if close[i].any():
            result[i] = -unit(d[i, close[i]]).sum(axis=0)
        elif middle[i].any() and far[i].any():
            result[i] = 0.5 * (along + towards)
        elif middle[i].any() or far[i].any():
            result[i] = along + towards
        else:
            result[i] = heading[i]
    return unit(result)


@pytest.mark.parametrize("width", [0.0, 2.0, 6.0])
def test_decisions_are_the_law(width: float) -> None:
    """Without noise and with fast turning the new direction is the wish itself."""
    system = built(
        "couzin", count=150, orientation_width=width, attraction_width=4.0, noise=0.0, turn_rate=360.0,
        time_step=1.0, start={"kind": "ball", "radius": 6.0}, field_of_view=200.0,
    )  # fmt: skip
    x, v = (system.read(name).astype(np.float64) for name in ("position", "velocity"))
    wanted = wishes(x, v, (1.0, 1.0 + width, 5.0 + width), 200.0)
    system.step(0.0, 1.0)
    np.testing.assert_allclose(system.read("velocity"), 3.0 * wanted, atol=3.0 * DIRECTION)
    np.testing.assert_allclose(system.read("position"), x + 3.0 * wanted, atol=2e-5)


def test_nobody_turns_faster_than_allowed() -> None:
    system = built("couzin", count=100, noise=0.3)
    for step in range(50):
        before = system.read("velocity").astype(np.float64)
        system.step(0.1 * step, 0.1)
        after = system.read("velocity").astype(np.float64)
        cross = np.linalg.norm(np.cross(before, after), axis=1)
        turn = np.degrees(np.arctan2(cross, np.einsum("ij,ij->i", before, after)))
        assert turn.max() < 40.0 * 0.1 + 1e-3
        np.testing.assert_allclose(np.linalg.norm(after, axis=1), 3.0, rtol=1e-6)


def test_the_noise_turns_the_wish_by_sigma() -> None:
    """One alone keeps its direction but for the noise: a normal angle about a random axis."""
    sigma = 0.2
    spread = built(
        "couzin", count=2000, noise=sigma, turn_rate=360.0, repulsion_radius=1e-3, orientation_width=0.0,
        attraction_width=0.0, start={"kind": "lattice", "spacing": 1.0}, heading={"kind": "along"},
    )  # fmt: skip
    spread.step(0.0, 1.0)
    v = spread.read("velocity").astype(np.float64) / 3.0
    angle = np.arccos(np.clip(v[:, 0], -1.0, 1.0))
    # Four standard errors of a variance from 2,000 values: 4 sqrt(2 / 2000).
    assert abs(np.mean(angle**2) / sigma**2 - 1.0) < 4 * (2 / 2000) ** 0.5
    assert np.linalg.norm(v[:, 1:].mean(axis=0)) < 4 * sigma / 2000**0.5


def test_bounds_that_are_not_open_are_refused() -> None:
    CouzinParams().check_scene(OPEN, (), ())
    with pytest.raises(ValueError, match="open"):
        CouzinParams().check_scene(Bounds("periodic", (0.0,) * 3, (90.0,) * 3), (), ())
