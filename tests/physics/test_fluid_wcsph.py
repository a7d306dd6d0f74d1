"""Weakly compressible SPH: one step against float64, what steps must keep, a column, and walls that hold."""

from typing import Any

import numpy as np
import pytest
from fluid_methods import DENSITIES, Flow, cube

from tianim.system import Bounds
from tianim.systems.fluid.wcsph import ALPHA, DAMPING, MACH, Wcsph

D, DT = 0.1, 0.0005
GRAVITY = (0.0, -9.81, 0.0)
C = 20.0
GAMMA = 7.0
# Sums of thirty float32 terms against float64, over the largest value; the pressure has the 7th power.
SINGLE = 5e-5
# Sum of all momenta over the sum of their sizes, after fifty steps of float32.
MOMENTUM = 3e-6
# A fall of a second: places of some metres in float32, rounded in each of 400 steps.
FREE_FALL = 3e-5
THROWN = {"kind": "box", "lower": (0.1, 0.0, 0.0), "upper": (1.0, 0.9, 0.9), "velocity": (6.0, 0.0, 0.0)}
SOUND: dict[str, Any] = {"wcsph": {"sound_speed": C, "gamma": GAMMA}}


def stirred(bounds: Bounds = Bounds(), side: int = 6, viscosity: float = 0.0) -> Flow:
    """A compressed, disordered block of two phases with random velocities."""
    x = cube(side, 0.95 * D, 0.1)
    rng = np.random.default_rng(2)
    v = rng.normal(0.0, 0.5, x.shape)
    return Flow(
        Wcsph, x, v, rng.integers(0, 2, len(x)), D, bounds=bounds, gravity=(0.0, 0.0, 0.0),
        viscosity=viscosity, **SOUND,
    )  # fmt: skip


@pytest.mark.parametrize("walled", [False, True])
def test_one_step_against_float64(walled: bool) -> None:
    bounds = Bounds("contained", (-0.01, -0.01, -0.01), (0.7, 0.7, 0.7)) if walled else Bounds()
    flow = stirred(bounds)
    flow.method.find()
    flow.method.accelerate(0.0, DT)
    x, v, rho = flow.stored("position"), flow.stored("velocity"), flow.rho()
    delta, g = flow.densities(x), np.zeros((flow.n, 3))
    if walled:
        g = flow.array(flow.walls.gradient).T
        delta += flow.array(flow.walls.share)
    pairs, h = flow.gradients(x), flow.particles.h
    p = rho * C**2 / GAMMA * (np.maximum(delta, 1.0) ** GAMMA - 1.0)
    rate = np.einsum("ijc,ijc->i", pairs, v[:, None] - v[None]) + np.einsum(
        "ic,ic->i", g + np.zeros_like(v), v
    )
    p = np.where(p > 0.0, np.maximum(p + DAMPING * C * h * rho * rate, 0.0), 0.0)
    force = np.einsum("ij,ijc->ic", p[:, None] + p[None], pairs) + p[:, None] * g
    d, r = flow.differences(x)
    np.fill_diagonal(r, 1.0)
    meeting = np.einsum("ijc,ijc->ij", d, v[:, None] - v[None]) / (r**2 + 0.01 * h**2)
    meeting *= 2.0 * rho[None] / (rho[:, None] + rho[None])
    expected = v + DT * (ALPHA * C * h * np.einsum("ij,ijc->ic", meeting, pairs) - force / rho[:, None])

    flow.method.solve(DT)
    pressure = flow.array(flow.particles.pressure)
    assert np.abs(pressure - p).max() < SINGLE * p.max()
    assert np.abs(flow.stored("velocity") - expected).max() < SINGLE * np.abs(expected - v).max()


def test_momentum_is_kept() -> None:
    flow = stirred()
    start, size = flow.momentum()
    flow.run(50, DT)
    end, _ = flow.momentum()
    assert np.linalg.norm(end - start) < MOMENTUM * size


@pytest.mark.parametrize("dimension", [2, 3])
def test_a_full_box_keeps_its_momentum(dimension: int) -> None:
    """There gradients are corrected, each pair's by both of its particles."""
    side = 12 if dimension == 2 else 8
    x = cube(side, D, 0.15, dimension)
    v = np.random.default_rng(6).normal(0.0, 0.5, x.shape)
    v[:, dimension:] = 0.0
    bounds = Bounds("periodic", (0.0, 0.0, 0.0), (side * D,) * 3)
    flow = Flow(Wcsph, x, v, None, D, dimension, bounds, gravity=(0.0, 0.0, 0.0), **SOUND)
    assert flow.method._correction is not None
    start, size = flow.momentum()
    flow.run(20, DT)
    end, _ = flow.momentum()
    assert np.linalg.norm(end - start) < MOMENTUM * size


@pytest.mark.parametrize("dimension", [2, 3])
def test_free_fall(dimension: int) -> None:
    x = cube(5, D, dimension=dimension)
    flow = Flow(Wcsph, x, spacing=D, dimension=dimension, gravity=GRAVITY, **SOUND)
    steps, dt = 400, 0.0025
    flow.run(steps, dt)
    fall = 0.5 * 9.81 * (steps * dt) ** 2
    place = flow.stored("position").mean(axis=0)
    assert abs(place[1] - (x[:, 1].mean() - fall)) < FREE_FALL * fall
    assert np.all(flow.stored("position")[:, dimension:] == 0.0)


def column(dimension: int, layers: int = 16) -> Flow:
    width = 8
    axes = [np.arange(width), np.arange(layers), np.arange(width if dimension == 3 else 1)]
    x = (np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, 3) + 0.5) * D
    if dimension == 2:
        x[:, 2] = 0.0
    bounds = Bounds("contained", (0.0, 0.0, 0.0), (width * D, 4.0, width * D))
    return Flow(Wcsph, x, spacing=D, dimension=dimension, bounds=bounds, gravity=GRAVITY)


@pytest.mark.parametrize("dimension", [2, 3])
def test_a_column_stays(dimension: int) -> None:
    """It rings: sound goes up and down in 4 H / c, over four of which pressures are averaged."""
    flow = column(dimension)
    deep = 16 * D
    assert flow.run(500) == 0
    slopes, errors, end = [], [], flow.time + 16.0 * deep / flow.method.sound_speed
    while flow.time < end:
        assert flow.run(1) == 0
        y, p = flow.stored("position")[:, 1], flow.array(flow.particles.pressure)
        inside = (y > 0.15 * deep) & (y < 0.85 * deep)
        slopes.append(np.polyfit(y[inside], p[inside], 1)[0])
        errors.append(np.maximum(flow.array(flow.particles.density) - 1.0, 0.0).mean())
    assert np.mean(slopes) == pytest.approx(-9810.0, rel=0.05)
    # g H / c^2 at the bottom is one percent.
    assert np.mean(errors) == pytest.approx(0.005, rel=0.3)
    speed = np.linalg.norm(flow.stored("velocity"), axis=1)
    assert np.sqrt((speed**2).mean()) < 0.05 * np.sqrt(9.81 * deep)
    assert flow.stored("position")[:, 1].max() == pytest.approx(deep - 0.5 * D, abs=0.5 * D)


def test_thrown_against_a_wall_nothing_gets_out() -> None:
    """Where 6 of 6 runs of another program lost their particles."""
    low, high = (0.0, 0.0, 0.0), (2.0, 2.0, 1.0)
    x = cube(9, D) + np.array([0.1, 0.05, 0.05])
    v = np.zeros_like(x)
    v[:, 0] = 6.0
    bounds = Bounds("contained", low, high)
    flow = Flow(
        Wcsph, x, v, spacing=D, bounds=bounds, gravity=GRAVITY,
        blocks={"thrown": THROWN},
    )  # fmt: skip
    assert flow.method.sound_speed == pytest.approx(MACH * 6.0)
    energy = 0.5 * 36.0 + 9.81 * x[:, 1].mean()
    for _ in range(8):
        assert flow.run(60) == 0
        place, speed = flow.stored("position"), flow.stored("velocity")
        assert np.all((place > np.array(low)) & (place < np.array(high)))
        now = 0.5 * (speed**2).sum(axis=1).mean() + 9.81 * place[:, 1].mean()
        # Compressed sound is energy too, a few percent of the motion's.
        assert now < 1.02 * energy
        energy = min(energy, now)


def test_sound_speed() -> None:
    flow = column(3)
    fall = 15.5 * D
    assert flow.method.sound_speed == pytest.approx(MACH * np.sqrt(9.81 * fall), rel=1e-5)
    h = 2.0 * D
    limit = flow.forces.largest_step()
    assert limit == pytest.approx(0.4 * h / flow.method.sound_speed, rel=1e-3)
    assert Flow(Wcsph, cube(3, D), spacing=D, **SOUND).method.sound_speed == C


def test_viscosity_of_the_fluid_counts_as_monaghans() -> None:
    own = 2.0 * 5.0 * 0.002
    thin, thick = (
        Flow(
            Wcsph, cube(3, D), spacing=D, viscosity=nu,
            phases={"light": {"density": DENSITIES[1], "viscosity": nu}}, **SOUND,
        ).method.alpha_c_h
        for nu in (0.0, 0.002)
    )  # fmt: skip
    assert thin == pytest.approx(ALPHA * C * 2.0 * D)
    assert thick == pytest.approx(thin - own)


def test_a_full_periodic_box_may_pull_a_drop_not() -> None:
    """Below the density at rest: tension where there is no surface, none where there is one."""
    bounds = Bounds("periodic", (0.0, 0.0, 0.0), (0.9, 0.9, 0.9))
    x = cube(9, D, 0.1)
    full = Flow(Wcsph, x, spacing=D, bounds=bounds, gravity=(0.0, 0.0, 0.0), **SOUND)
    full.run(1, 1e-6)
    assert full.array(full.particles.pressure).min() < 0.0
    drop = Flow(Wcsph, x[:400], spacing=D, bounds=bounds, gravity=(0.0, 0.0, 0.0), **SOUND)
    drop.run(1, 1e-6)
    assert drop.array(drop.particles.pressure).min() == 0.0
