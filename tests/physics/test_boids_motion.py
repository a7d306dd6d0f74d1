"""What `tianim validate` leaves open: banking in climbing turns, and what a blow-up is called."""

import numpy as np
import pytest

from tianim.errors import BlowupError
from tianim.spatial.bodies import Bodies
from tianim.system import Bounds, World
from tianim.systems.boids import Boids, BoidsParams
from tianim.systems.boids.motion import GRAVITY

COUNT = 200
DT = 0.02
BANK_TIME = 0.3
LEAN_TOLERANCE = 2e-5  # float32 rounding of a quotient of sums of some ten terms


def _loners() -> Boids:
    """Boids that mind nobody and have no limit in reach."""
    off = {"radius": 0, "weight": 0}
    limits = {"max_speed": 1e3, "max_acceleration": 1e3, "max_bank": 89, "bank_time": BANK_TIME}
    params = BoidsParams(
        count=COUNT, speed=10, separation=off, alignment=off, cohesion=off, limits=limits, time_step=DT
    )
    return Boids("boids", params, World(Bounds(), Bodies({}), 3))


def test_banks_by_the_law_while_it_climbs_and_dives():
    """tan(bank) = a . right / (g + a . up), low-passed, against float64, over all headings."""
    boids = _loners()
    a = np.random.default_rng(1).uniform(-4, 4, (COUNT, 3))
    boids.add_force(lambda time, position, velocity: a)
    v = boids.read("velocity").astype(np.float64) + DT * a
    forward = v / np.linalg.norm(v, axis=1, keepdims=True)
    right = np.stack([forward[:, 2], np.zeros(COUNT), -forward[:, 0]], axis=1)
    right /= np.linalg.norm(right, axis=1, keepdims=True)
    up = np.cross(forward, right)
    wanted = (a * right).sum(axis=1) / (GRAVITY + (a * up).sum(axis=1))
    boids.step(0.0, DT)
    np.testing.assert_allclose(boids.read("lean"), wanted * DT / (DT + BANK_TIME), atol=LEAN_TOLERANCE)


@pytest.mark.parametrize(
    ("value", "reason"), [(np.nan, "not finite"), (-np.inf, "not finite"), (2e7, "farther")]
)
@pytest.mark.parametrize("name", ["position", "velocity"])
def test_a_blow_up_names_particle_and_reason(name, value, reason):
    boids = _loners()
    boids.check()
    values = boids.read(name).copy()
    values[17, 1] = value
    boids.write(name, values)
    with pytest.raises(BlowupError, match=f"particle 17.*{reason}"):
        boids.check()
