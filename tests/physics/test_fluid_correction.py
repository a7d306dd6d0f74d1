"""Corrected gradients: right for linear flows, however the particles lie; forces keep what they must."""

import numpy as np
import pytest
from fluid_bed import Bed, Floats, gathered, lattice, stirred

from tianim.system import Bounds
from tianim.systems.fluid.correction import Correction
from tianim.systems.fluid.pairs import Pairs

# Of sums of some thirty float32 terms, over the sum of their sizes.
SINGLE = 3e-6


class Corrected:
    """A cloud with its corrected gradients, row by row: i, j, L_i G_ij, L_j G_ij."""

    def __init__(self, bed: Bed) -> None:
        self.bed = bed
        correction = Correction(bed.particles, bed.pairs, bed.walls)
        correction.find()
        pairs, n = bed.pairs, bed.n
        begin, end = pairs.begin.to_numpy()[:n], pairs.end.to_numpy()[:n]
        rows = np.concatenate([np.arange(a, b) for a, b in zip(begin, end, strict=True)])
        self.i = np.repeat(np.arange(n), end - begin)
        self.j = pairs.neighbour.to_numpy()[rows]
        self.raw, self.own, self.back = (
            array.to_numpy()[:, rows].T.astype(np.float64)
            for array in (pairs.gradient, correction.gradient, correction.back)
        )
        self.x = bed.stored("position")

    def rate(self, gradient: Floats, v: Floats) -> Floats:
        """Of delta of each particle in a flow, (n,)."""
        return np.bincount(self.i, ((v[self.i] - v[self.j]) * gradient).sum(axis=1), self.bed.n)

    def inside(self) -> Floats:
        """Particles with all their neighbours."""
        middle = 0.5 * (self.x.max(axis=0) + self.x.min(axis=0))
        reach = self.bed.particles.h + 0.5
        half = 0.5 * (self.x.max(axis=0) - self.x.min(axis=0)) - reach
        free = np.abs(self.x - middle) < half
        return free[:, : self.bed.particles.dimension].all(axis=1)


@pytest.mark.parametrize("dimension", [2, 3])
def test_a_strain_that_keeps_the_density_has_no_rate(dimension: int) -> None:
    """A lattice pressed along y, pulled along x by three tenths: E^3 is left of E = 0.1 to 0.2, a tenth."""
    x = lattice(18 if dimension == 2 else 11, dimension, 0.1)
    x[:, 0] *= 1.3
    x[:, 1] /= 1.3
    cloud = Corrected(Bed(x, np.zeros_like(x), dimension))
    strain = cloud.x * np.array([1.0, -1.0, 0.0])
    before, after = (cloud.rate(g, strain)[cloud.inside()] for g in (cloud.raw, cloud.own))
    # The wider spline of the plane hardly sees that its neighbours lie otherwise.
    assert np.abs(before.mean()) > (0.05 if dimension == 2 else 0.2)
    assert np.sqrt(np.mean(after**2)) < 0.1 * np.sqrt(np.mean(before**2))


@pytest.mark.parametrize("dimension", [2, 3])
def test_a_turning_body_has_no_rate(dimension: int) -> None:
    """At the surface too: L M is symmetric. Hence forces have no moment."""
    cloud = Corrected(stirred(dimension))
    turn = np.cross([0.0, 0.0, 1.0] if dimension == 2 else [0.3, -0.2, 0.5], cloud.x)
    sizes = np.bincount(
        cloud.i, (np.abs(turn[cloud.i] - turn[cloud.j]) * np.abs(cloud.own)).sum(axis=1), cloud.bed.n
    )
    assert np.abs(cloud.rate(cloud.own, turn)).max() < SINGLE * sizes.max()


def test_forces_are_mutual() -> None:
    """Of any pressures: no total force and no total moment."""
    cloud = Corrected(stirred(3))
    p = np.random.default_rng(5).uniform(0.0, 1.0, cloud.bed.n)
    each = p[cloud.i, None] * cloud.own + p[cloud.j, None] * cloud.back
    force = gathered(cloud.i, each, cloud.bed.n)
    size = np.abs(force).sum()
    assert np.abs(force.sum(axis=0)).max() < SINGLE * size
    reach = np.abs(cloud.x).max()
    assert np.abs(np.cross(cloud.x, force).sum(axis=0)).max() < 3.0 * SINGLE * size * reach


def test_particles_that_touch_a_wall_keep_their_gradients() -> None:
    bed = stirred(2)
    share = np.zeros(bed.n)
    share[::2] = 0.1
    bed.walls.put("share", share)
    cloud = Corrected(bed)
    touching = share[cloud.i] > 0.0
    np.testing.assert_array_equal(cloud.own[touching], cloud.raw[touching])
    assert np.abs(cloud.own[~touching] - cloud.raw[~touching]).max() > 0.0


@pytest.mark.parametrize("dimension", [2, 3])
def test_the_moment_is_how_density_grows_with_compression(dimension: int) -> None:
    """By which the pressure that is shown differs from P: from the gradients, in float64."""
    bed = stirred(dimension)
    found = bed.particles.moment.to_numpy()[: bed.n].copy()
    cloud = Corrected(bed)
    apart = cloud.x[cloud.i] - cloud.x[cloud.j]
    expected = -np.bincount(cloud.i, (cloud.raw * apart).sum(axis=1), bed.n) / dimension
    np.testing.assert_allclose(found, expected, atol=10.0 * SINGLE)
    assert np.all(bed.particles.moment.to_numpy()[: bed.n] == 1.0)  # that of corrected gradients


def test_only_fluid_without_a_surface_is_corrected() -> None:
    """A periodic box that is full, and one that is not."""
    x = lattice(10, 2)
    box = Bounds("periodic", (0.0,) * 3, (10.0,) * 3)
    full, half = Bed(x, 0.0 * x, 2, bounds=box), Bed(x[:40], 0.0 * x[:40], 2, bounds=box)
    assert isinstance(full.pairs, Pairs)
    assert full.pairs.is_full
    assert not half.pairs.is_full
