"""Pairs of a fluid: rows, gradients and densities against every pair in float64."""

import numpy as np
import pytest
from numpy.typing import NDArray

from tianim.math.smoothing import lattice_sum, spline_scale, spline_slopes, spline_values
from tianim.system import Bounds
from tianim.systems.fluid import pairs as pairs_module
from tianim.systems.fluid.pairs import Pairs
from tianim.systems.fluid.particles import Particles

D = 0.1
# float32 differences of places up to 2 m: 1e-7 of a distance of 0.1, times the kernel's slope.
GRADIENT_TOLERANCE = 3e-5
DENSITY_TOLERANCE = 2e-6
BOX = Bounds("periodic", (-1.0, 0.5, 2.0), (0.0, 1.7, 3.0))

Floats = NDArray[np.float64]


def particles_at(position: Floats, dimension: int = 3) -> Particles:
    made = Particles(len(position), dimension, D, 2.0, np.array([1000.0], np.float32))
    made.columns.append(len(position), {"position": position})
    return made


def cloud(count: int, dimension: int, lower: Floats, upper: Floats, seed: int = 3) -> Floats:
    x = np.random.default_rng(seed).uniform(lower, upper, (count, 3)).astype(np.float32).astype(np.float64)
    x[:, dimension:] = 0.0
    return x


def check_all(pairs: Pairs, length: Floats) -> None:
    """Every row against float64."""
    own = pairs.particles
    n, h = own.count, own.h
    x = own["position"].to_numpy()[:, :n].T.astype(np.float64)
    way = x[:, None] - x[None]
    way -= length * np.round(way / np.where(length > 0.0, length, np.inf))
    r = np.linalg.norm(way, axis=2)
    begin, end = pairs.begin.to_numpy()[:n], pairs.end.to_numpy()[:n]
    neighbour, gradient = pairs.neighbour.to_numpy(), pairs.gradient.to_numpy()
    scale = D**own.dimension / lattice_sum(2.0, own.dimension) * spline_scale(h, own.dimension)
    for i in range(n):
        row = neighbour[begin[i] : end[i]]
        near = np.flatnonzero((r[i] < h) & (np.arange(n) != i))
        np.testing.assert_array_equal(np.sort(row), near)
        slope = scale * spline_slopes(r[i, row] / h, own.dimension) / (h * r[i, row])
        expected = slope[:, None] * way[i, row]
        np.testing.assert_allclose(
            gradient[:, begin[i] : end[i]].T, expected, atol=GRADIENT_TOLERANCE * scale / h, rtol=0
        )
    density = scale * spline_values(np.minimum(r / h, 1.0), own.dimension).sum(axis=1)
    np.testing.assert_allclose(own.density.to_numpy()[:n], density, rtol=DENSITY_TOLERANCE * 10)


@pytest.mark.parametrize("dimension", [2, 3])
@pytest.mark.parametrize("bounds", [Bounds(), BOX], ids=["open", "periodic"])
def test_rows_gradients_and_densities(dimension: int, bounds: Bounds) -> None:
    lower, upper = np.array(BOX.lower), np.array(BOX.upper)
    pairs = Pairs(particles_at(cloud(900, dimension, lower, upper), dimension), bounds)
    pairs.build()
    length = (upper - lower) * (bounds.kind == "periodic")
    length[dimension:] = 0.0
    check_all(pairs, length)


def test_the_lattice_at_rest_has_density_one() -> None:
    axis = np.arange(7) * D
    x = np.stack(np.meshgrid(axis, axis, axis), axis=-1).reshape(-1, 3)
    particles = particles_at(x)
    Pairs(particles, Bounds()).build()
    middle = np.argmin(np.linalg.norm(particles["position"].to_numpy()[:, : len(x)].T - 3 * D, axis=1))
    assert particles.density.to_numpy()[middle] == pytest.approx(1.0, abs=DENSITY_TOLERANCE)


def test_rows_grow_where_a_crowd_needs_more_room(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(pairs_module, "LEAST_ROOM", 8)
    monkeypatch.setattr(pairs_module, "LINE", 8)
    crowd = cloud(700, 3, np.zeros(3), np.full(3, 2.5 * D))
    pairs = Pairs(particles_at(crowd), Bounds())
    pairs.build()
    check_all(pairs, np.zeros(3))


def test_two_particles_in_one_place_push_nowhere() -> None:
    particles = particles_at(np.zeros((2, 3)))
    pairs = Pairs(particles, Bounds())
    pairs.build()
    assert pairs.end.to_numpy()[0] - pairs.begin.to_numpy()[0] == 1
    assert np.isfinite(particles.density.to_numpy()[:2]).all()
    np.testing.assert_array_equal(pairs.gradient.to_numpy()[:, pairs.begin.to_numpy()[0]], 0.0)


def test_particles_that_come_are_listed() -> None:
    particles = Particles(10, 3, D, 2.0, np.array([1000.0], np.float32))
    particles.columns.append(1, {"position": np.zeros((1, 3))})
    pairs = Pairs(particles, Bounds())
    pairs.build()
    particles.columns.append(1, {"position": np.array([[0.5 * D, 0.0, 0.0]])})
    pairs.build()
    check_all(pairs, np.zeros(3))
