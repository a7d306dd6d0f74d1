"""Vicsek's model: the published order parameter, and the law step by step in float64."""

import numpy as np
import pytest
from checks import as_tests, assert_passes
from numpy.typing import NDArray

from tianim.math.random import ULP, words_numpy
from tianim.spatial.bodies import Bodies
from tianim.system import Bounds, World
from tianim.systems.boids.vicsek import Vicsek, VicsekParams
from tianim.validate import CASES, Case
from tianim.validate.build import built

# Angles of float32 sums of unit vectors, some ten of them [rad].
ANGLE = 2e-6


@pytest.mark.parametrize("case", as_tests(CASES["vicsek"]))
def test_case(case: Case) -> None:
    assert_passes(case)


def by_the_law(
    x: NDArray[np.float64], angle: NDArray[np.float64], eta: float, length: float, step: int, seed: int
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """New places and directions by the paper's equations; the noise is that of the counters."""
    d = x[None] - x[:, None]
    d -= length * np.round(d / length)
    near = (d**2).sum(axis=2) < 1.0
    new = np.angle(near @ np.exp(1j * angle))
    draw = (words_numpy(seed, np.arange(len(x)), step, 0)[:, 0] >> 8) * ULP
    moved = x + 0.03 * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    return moved % length, new + eta * (draw - 0.5)


@pytest.mark.parametrize("lower", [0.0, -2.5])
def test_a_step_is_the_law(lower: float) -> None:
    """Places with the old velocity, the mean direction with oneself, noise in [-eta/2, eta/2]."""
    length, eta, seed = 5.0, 1.5, 7
    bounds = Bounds("periodic", (lower, lower, 0.0), (lower + length, lower + length, 1.0))
    system = built("vicsek", bounds, seed, count=200, radius=1.0, speed=0.03, noise=eta, time_step=1.0)
    for step in range(5):
        x = system.read("position")[:, :2].astype(np.float64) - lower
        velocity = system.read("velocity").astype(np.float64)
        wanted_x, wanted_angle = by_the_law(
            x, np.arctan2(velocity[:, 1], velocity[:, 0]), eta, length, step, seed
        )
        system.step(float(step), 1.0)
        off = system.read("position")[:, :2] - lower - wanted_x
        assert np.abs(off - length * np.round(off / length)).max() < 1e-6
        velocity = system.read("velocity").astype(np.float64)
        turn = np.arctan2(velocity[:, 1], velocity[:, 0]) - wanted_angle
        assert np.abs((turn + np.pi) % (2 * np.pi) - np.pi).max() < ANGLE
        np.testing.assert_allclose(np.linalg.norm(velocity, axis=1), 0.03, rtol=1e-6)


def test_without_noise_order_is_complete() -> None:
    bounds = Bounds("periodic", (0.0,) * 3, (3.1,) * 3)
    system = built("vicsek", bounds, count=60, radius=1.0, speed=0.03, noise=0.0, time_step=1.0)
    for step in range(300):
        system.step(float(step), 1.0)
    assert system.diagnostics()["polarisation"] > 0.9999


@pytest.mark.parametrize(
    ("bounds", "words"),
    [
        (Bounds(), "periodic"),
        (Bounds("contained", (0.0,) * 3, (9.0,) * 3), "periodic"),
        (Bounds("periodic", (0.0,) * 3, (9.0, 3.0, 9.0)), "3.01"),
    ],
)
def test_bounds_that_do_not_fit_are_refused(bounds: Bounds, words: str) -> None:
    with pytest.raises(ValueError, match=words):
        VicsekParams(count=10).check_scene(bounds, (), ())


def test_starts_from_a_file(tmp_path):
    """Places and headings of a file are taken over, the speed is the model's."""
    rng = np.random.default_rng(5)
    position = np.zeros((20, 3), np.float32)
    position[:, :2] = rng.uniform(0, 5, (20, 2))
    angle = rng.uniform(-np.pi, np.pi, 20)
    heading = np.stack([np.cos(angle), np.sin(angle), np.zeros(20)], axis=1).astype(np.float32)
    np.savez(tmp_path / "start.npz", position=position, velocity=7.0 * heading)
    params = VicsekParams(count=20, speed=0.03, start={"kind": "file", "path": str(tmp_path / "start.npz")})
    system = Vicsek("vicsek", params, World(Bounds("periodic", (0, 0, -1), (5, 5, 1)), Bodies({}), 1))
    np.testing.assert_array_equal(system.read("position"), position)
    np.testing.assert_allclose(system.read("velocity"), 0.03 * heading, atol=1e-8)
