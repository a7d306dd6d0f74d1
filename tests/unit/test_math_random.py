"""Counter-based random numbers: equal to the NumPy twin, evenly spread, without pattern."""

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.stats import chi2, kstest

from tianim.lang import f32_2d, ti
from tianim.math.random import normal3, smooth_direction, uniform, unit_vector, words, words_numpy

u32_2d: Any = ti.types.ndarray(dtype=ti.u32, ndim=2)

COUNT = 200_000
# Seeds are fixed: these limits hold or fail for good. A true generator fails one in 1e4.
CHANCE = 1e-4
# Five standard deviations of the mean of COUNT numbers with unit variance.
MEAN = 5.0 / np.sqrt(COUNT)

UNIFORM, NORMAL, UNIT = 0, 1, 2


@ti.kernel
def fill_words(out: u32_2d, seed: ti.i32, step: ti.i32, stream: ti.i32):
    for i in range(out.shape[0]):
        bits = words(seed, i - 5, step, stream)
        for c in ti.static(range(4)):
            out[i, c] = bits[c]


@ti.kernel
def fill(out: f32_2d, what: ti.i32, seed: ti.i32, step: ti.i32, stream: ti.i32, dimension: ti.i32):
    for i in range(out.shape[0]):
        v = ti.Vector([0.0, 0.0, 0.0])
        if what == UNIFORM:
            v.x = uniform(seed, i, step, stream)
        elif what == NORMAL:
            v = normal3(seed, i, step, stream)
        else:
            v = unit_vector(seed, i, step, stream, dimension)
        for c in ti.static(range(3)):
            out[i, c] = v[c]


@ti.kernel
def fill_smooth(out: f32_2d, seed: ti.i32, step: ti.f32, rate: ti.f32, ids: ti.i32, dimension: ti.i32):
    """Row i: id i % ids at the time step * (i // ids)."""
    for i in range(out.shape[0]):
        v = smooth_direction(seed, i % ids, step * (i // ids), rate, 0, dimension)
        for c in ti.static(range(3)):
            out[i, c] = v[c]


def draw(what: int, seed: int = 1, step: int = 2, stream: int = 3, dimension: int = 3) -> NDArray[np.float64]:
    out = np.zeros((COUNT, 3), dtype=np.float32)
    fill(out, what, seed, step, stream, dimension)
    return out.astype(np.float64)


@pytest.mark.parametrize("counter", [(0, 0, 0), (1, 2, 3), (-1, 2**31 - 1, -(2**31)), (123456789, 7, 65536)])
def test_words_are_those_of_the_twin(counter: tuple[int, int, int]) -> None:
    seed, step, stream = counter
    out = np.zeros((1000, 4), dtype=np.uint32)
    fill_words(out, seed, step, stream)
    np.testing.assert_array_equal(out, words_numpy(seed, np.arange(1000) - 5, step, stream))


def test_the_published_values_of_the_hash() -> None:
    """The pcg4d of the paper's listing, worked out in Python's unbounded integers."""
    mask = 2**32 - 1
    v = [(n * 1664525 + 1013904223) & mask for n in (1, 2, 3, 4)]
    for last in (False, True):
        v[0] = (v[0] + v[1] * v[3]) & mask
        v[1] = (v[1] + v[2] * v[0]) & mask
        v[2] = (v[2] + v[0] * v[1]) & mask
        v[3] = (v[3] + v[1] * v[2]) & mask
        if not last:
            v = [n ^ (n >> 16) for n in v]
    assert words_numpy(1, 2, 3, 4).tolist() == v


def test_no_two_counters_give_the_same_words() -> None:
    side = np.arange(24)
    bits = words_numpy(*np.meshgrid(side[:8], side, side, side[:8])).reshape(-1, 4)
    assert len(np.unique(bits, axis=0)) == len(bits)


def test_every_bit_is_even() -> None:
    bits = words_numpy(1, np.arange(COUNT), 2, 3)
    ones = np.array([(bits >> np.uint32(bit)) & np.uint32(1) for bit in range(32)]).mean(axis=1)
    # 128 bits: five standard deviations of a share of COUNT throws.
    np.testing.assert_allclose(ones, 0.5, atol=0.5 * MEAN)


def test_uniform_numbers() -> None:
    u = draw(UNIFORM)[:, 0]
    assert u.min() >= 0.0
    assert u.max() < 1.0
    assert kstest(u, "uniform").pvalue > CHANCE
    np.testing.assert_array_equal(
        u, (words_numpy(1, np.arange(COUNT), 2, 3)[:, 0] >> np.uint32(8)) * 2.0**-24
    )


def test_normal_numbers() -> None:
    v = draw(NORMAL)
    assert np.isfinite(v).all()
    for axis in range(3):
        assert kstest(v[:, axis], "norm").pvalue > CHANCE
    np.testing.assert_allclose(np.cov(v.T), np.eye(3), atol=2 * MEAN)
    # Fourth moments see what covariances cannot: x^2 and y^2 share a radius in Box and Muller.
    np.testing.assert_allclose(np.corrcoef((v * v).T), np.eye(3), atol=2 * MEAN)


def test_unit_vectors() -> None:
    v = draw(UNIT)
    np.testing.assert_allclose(np.linalg.norm(v, axis=1), 1.0, atol=1e-6)
    for axis in range(3):
        assert kstest(v[:, axis], "uniform", args=(-1.0, 2.0)).pvalue > CHANCE
    flat = draw(UNIT, dimension=2)
    assert not flat[:, 2].any()
    assert kstest(np.arctan2(flat[:, 1], flat[:, 0]), "uniform", args=(-np.pi, 2 * np.pi)).pvalue > CHANCE


@pytest.mark.parametrize("argument", range(4))
@pytest.mark.parametrize("distance", [1, 2, 256])
def test_neighbouring_counters_are_independent(argument: int, distance: int) -> None:
    """Pairs of numbers whose counters differ in one place fill a square evenly."""
    n = 400
    counters = np.meshgrid(
        *(np.arange(n) if axis in (argument, (argument + 1) % 4) else [5] for axis in range(4))
    )
    shifted = [c + distance * (axis == argument) for axis, c in enumerate(counters)]
    first, second = (words_numpy(*c).reshape(-1, 4) >> np.uint32(28) for c in (counters, shifted))
    for a in range(4):
        for b in range(4):
            table = np.bincount((first[:, a] * 16 + second[:, b]).astype(np.int64), minlength=256)
            expected = len(first) / 256
            statistic = ((table - expected) ** 2 / expected).sum()
            assert chi2.sf(statistic, 255) > CHANCE / 10  # 192 tables over the whole test


def test_ids_that_follow_each_other_show_no_wave() -> None:
    u = draw(UNIFORM)[:, 0] - 0.5
    power = np.abs(np.fft.rfft(u))[1:-1] ** 2 / (COUNT / 12)
    # The powers of noise are exponential with mean 1: the largest of 1e5 exceeds 20 once in 5,000.
    assert power.max() < 20.0


def smooth(ids: int, steps: int, step: float, rate: float, dimension: int = 3) -> NDArray[np.float64]:
    out = np.zeros((ids * steps, 3), dtype=np.float32)
    fill_smooth(out, 3, step, rate, ids, dimension)
    return out.reshape(steps, ids, 3).astype(np.float64)


def test_smooth_directions_are_unit_vectors_and_turn_without_jumps() -> None:
    d = smooth(500, 401, 0.005, 2.0)
    np.testing.assert_allclose(np.linalg.norm(d, axis=-1), 1.0, atol=1e-6)
    turn = np.linalg.norm(np.diff(d, axis=0), axis=-1)
    # From one independent direction to the next in 0.5 s is 100 steps: a mean turn of 90 degrees
    # makes 0.016 a step; the quickest go through near zero vectors and turn about in a few steps.
    assert 0.01 < turn.mean() < 0.03
    assert np.quantile(turn, 0.999) < 0.3


def test_smooth_directions_forget_after_two_beats() -> None:
    d = smooth(20_000, 9, 0.25, 2.0)  # a beat is two steps
    together = (d * d[0]).sum(axis=-1).mean(axis=1)
    assert together[1] > 0.5
    # A mean of 20,000 cosines with variance 1/3: five standard deviations are 0.02.
    np.testing.assert_allclose(together[4:], 0.0, atol=0.02)
    np.testing.assert_allclose(d.mean(axis=(0, 1)), 0.0, atol=0.02)


def test_smooth_directions_in_two_dimensions() -> None:
    d = smooth(1000, 5, 0.1, 1.0, dimension=2)
    assert not d[..., 2].any()
    np.testing.assert_allclose(np.linalg.norm(d, axis=-1), 1.0, atol=1e-6)
