"""The measures of a murmuration, on flocks made up so that the answer is known."""

import numpy as np
import pytest
from numpy.typing import NDArray

from tianim.frame import Frame, Points
from tianim.validate.murmuration import (
    density,
    density_wave,
    largest_cluster,
    mean_direction,
    measure,
    turned_by,
)

Floats = NDArray[np.float64]

COUNT = 4000
TIME = np.arange(0.0, 6.0, 0.1)
WAVE_SPEED = 12.0  # m/s


def slab() -> Floats:
    """A flock of 60 x 16 x 16 m, about one boid in 4 m3."""
    return np.random.default_rng(1).uniform((0.0, -8.0, -8.0), (60.0, 8.0, 8.0), (COUNT, 3))


def test_two_clumps_are_two_clusters() -> None:
    clump = np.random.default_rng(2).uniform(0.0, 3.0, (1000, 3))
    both = np.concatenate([clump, clump[:250] + 10.0])
    assert largest_cluster(both, 1.0) == pytest.approx(0.8)
    assert largest_cluster(both, 30.0) == 1.0
    assert largest_cluster(np.zeros((0, 3)), 1.0) == 0.0


def test_polarisation_is_that_of_directions_not_of_speeds() -> None:
    velocity = np.array([[5.0, 0.0, 0.0], [0.1, 0.0, 0.0], [0.0, 0.0, 3.0], [0.0, 0.0, 0.0]])
    np.testing.assert_allclose(mean_direction(velocity), [0.5, 0.0, 0.25])


def test_the_turn_is_the_largest_angle_from_the_start() -> None:
    angle = np.radians([0.0, 30.0, 80.0, 60.0])
    ways = np.stack([np.cos(angle), 0.0 * angle, np.sin(angle)], axis=1) * [[0.5], [0.9], [0.2], [1.0]]
    assert turned_by(ways) == pytest.approx(80.0)


def test_density_of_a_lattice() -> None:
    """In a cubic lattice the 7th neighbour is the first of those at sqrt(2) spacings."""
    steps = np.arange(12.0)
    lattice = np.stack(np.meshgrid(steps, steps, steps), axis=-1).reshape(-1, 3) * 0.5
    inner = np.all((lattice > 0.6) & (lattice < 4.9), axis=1)
    wanted = 7.0 / (4.0 / 3.0 * np.pi * (0.5 * 2.0**0.5) ** 3)
    np.testing.assert_allclose(density(lattice)[inner], wanted)


def predator() -> Floats:
    """Comes up to the slab's end at x = 0 and touches it at 2 s."""
    x = np.minimum(-1.0, -1.0 - 20.0 * (2.0 - TIME))
    return np.stack([x, 0.0 * x, 0.0 * x], axis=1)


def with_wave(height: float) -> Floats:
    """The slab, in which a compression of that height runs along x from 2 s on, at WAVE_SPEED."""
    start = slab()
    frames = []
    for t in TIME:
        front = WAVE_SPEED * (t - 2.0)
        # x + u(x), with u' = -height over a width of 6 m behind the front.
        x = start[:, 0]
        shift = -height * (np.clip(x, front - 6.0, front) - (front - 6.0)) if t > 2.0 else 0.0 * x
        frames.append(start + np.stack([shift, 0.0 * x, 0.0 * x], axis=1))
    return np.array(frames)


def test_a_wave_is_seen_with_its_speed() -> None:
    compression, speed = density_wave(TIME, with_wave(0.5), predator(), reach=10.0)
    assert compression > 1.3
    # Shells are 4 m wide and samples 1.2 m of front apart.
    assert speed == pytest.approx(WAVE_SPEED, rel=0.2)


def test_no_wave_is_seen_where_there_is_none() -> None:
    """A flock that flies on and shrinks as a whole, with a predator at its end."""
    shrinking = slab() * (1.0 - 0.05 * TIME)[:, None, None] + TIME[:, None, None] * (-3.0, 1.0, 0.0)
    compression, _ = density_wave(TIME, shrinking, predator() + TIME[:, None] * (-3.0, 1.0, 0.0), reach=10.0)
    assert compression < 1.05


def test_without_a_strike_there_is_no_wave() -> None:
    assert density_wave(TIME, with_wave(0.5), predator() - 50.0, reach=10.0) == (0.0, 0.0)


def test_frames_are_judged() -> None:
    """A slab that turns by 10 degrees a second for 6 s, a tenth of it flying the other way."""
    frames = []
    places, hunter = with_wave(0.5), predator()
    for k, t in enumerate(TIME):
        way = np.array([np.cos(np.radians(10.0 * t)), 0.0, np.sin(np.radians(10.0 * t))])
        velocity = np.tile(way, (COUNT, 1))
        velocity[: COUNT // 10] *= -1.0
        boids = Points("flock", places[k].astype(np.float32), {"velocity": velocity.astype(np.float32)})
        frames.append(Frame(k, float(t), (boids, Points("hawk", hunter[k : k + 1].astype(np.float32)))))
    found = measure(frames, "flock", "hawk", linking_length=4.0, reach=10.0)
    assert found.cluster > 0.99
    assert found.polarisation == pytest.approx((0.8, 0.8), abs=1e-6)
    assert found.turn == pytest.approx(50.0, abs=1.1)
    assert found.compression > 1.3
    assert found.wave_speed == pytest.approx(WAVE_SPEED, rel=0.2)
