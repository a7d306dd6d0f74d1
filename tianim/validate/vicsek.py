"""Vicsek's order parameter against an independent run of the model as of 1995.

The golden numbers are means of four runs of 20,000 steps each by another program (N = 100, L = 5,
r = 1, v = 0.03), standard error at most 0.003; a case allows four of them and 0.005, and four
standard errors of our own mean, from the spread of six runs at each noise.
"""

from functools import lru_cache, partial

import numpy as np

from tianim.system import Bounds
from tianim.validate.build import built
from tianim.validate.case import Case, Figure

SOURCE = (
    "Vicsek et al. 1995, Phys. Rev. Lett. 75, 1226, Fig. 2a; numbers of an independent re-run, 20,000 steps"
)
# Order parameter at noise eta, density 4, N = 100.
TABLE = {
    0.5: 0.988, 1.0: 0.954, 1.5: 0.898, 2.0: 0.821, 2.5: 0.729, 3.0: 0.619,
    3.5: 0.498, 4.0: 0.361, 4.5: 0.223, 5.0: 0.130, 5.5: 0.099, 6.0: 0.090,
}  # fmt: skip
GOLDEN = 4 * 0.003 + 0.005
# Standard deviation of the mean of one run of SHORT steps at each noise, measured with six seeds.
SPREAD = {
    0.5: 0.0002, 1.0: 0.0007, 1.5: 0.0017, 2.0: 0.0036, 2.5: 0.0036, 3.0: 0.006,
    3.5: 0.006, 4.0: 0.007, 4.5: 0.016, 5.0: 0.005, 5.5: 0.002, 6.0: 0.001,
}  # fmt: skip
SHORT, LONG = 5000, 20_000  # steps
TRANSIENT = 500  # steps until the start is forgotten; crossing the box takes 170
EVERY = 5  # steps between two samples
SHORT_NOISES = (1.0, 3.0)

NOISE_FIGURE, SHORT_FIGURE = (
    Figure(name, "noise eta [rad]", "order parameter v_a (N = 100, density 4)")
    for name in ("vicsek_order_and_noise", "vicsek_order_and_noise_short")
)


@lru_cache(maxsize=64)
def order_parameter(eta: float, count: int, length: float, steps: int, skip: int, seed: int) -> float:
    """Mean of v_a after `skip` steps of a run in a square of that length [m]; v = 0.03, r = 1."""
    bounds = Bounds("periodic", (0.0, 0.0, 0.0), (length, length, 1.0))
    system = built("vicsek", bounds, seed, count=count, radius=1.0, speed=0.03, noise=eta, time_step=1.0)
    samples = []
    for step in range(steps):
        system.step(float(step), 1.0)
        if step >= skip and step % EVERY == 0:
            samples.append(system.diagnostics()["polarisation"])
    return float(np.mean(samples))


def _noise_case(eta: float, expected: float, steps: int, slow: bool) -> Case:
    return Case(
        system="vicsek",
        name=f"order parameter at noise {eta:g}, {steps // 1000},000 steps",
        run=partial(order_parameter, eta, 100, 5.0, steps, TRANSIENT, 1),
        expected=expected,
        tolerance=GOLDEN + 4 * SPREAD[eta] * (SHORT / steps) ** 0.5,
        source=SOURCE,
        slow=slow,
        figure=NOISE_FIGURE if slow else SHORT_FIGURE,
        x=eta,
    )


def _random_value() -> float:
    """v_a at full noise times sqrt(N): sqrt(pi)/2 for directions that are random."""
    return order_parameter(2.0 * np.pi, 100, 5.0, 2500, 0, 1) * 100**0.5


DENSITIES = (0.1, 0.5, 2.0, 4.0)


def _by_density(density: float) -> float:
    """v_a after 4,000 steps at L = 20, noise 2: the bands still merge, a lower bound where dense."""
    return order_parameter(2.0, round(400 * density), 20.0, 4000, 2000, 1)


def _least_growth() -> float:
    """Smallest rise of v_a from one density to the next."""
    return float(np.diff([_by_density(density) for density in DENSITIES]).min())


CASES: tuple[Case, ...] = (
    *(_noise_case(eta, TABLE[eta], SHORT, slow=False) for eta in SHORT_NOISES),
    Case(
        system="vicsek",
        name="full noise: order parameter times sqrt(N)",
        run=_random_value,
        expected=np.pi**0.5 / 2,
        # Directions are new every step; 500 samples of a Rayleigh variable, deviation 0.46: se 0.021.
        tolerance=0.083,
        source="a sum of N random unit vectors: sqrt(pi/4) = 0.886 of sqrt(N)",
    ),
    *(_noise_case(eta, value, LONG, slow=True) for eta, value in TABLE.items()),
    Case(
        system="vicsek",
        name="least growth of the order parameter with density, 0.1 to 4",
        run=_least_growth,
        expected=0.0,
        comparison="above",
        source="Vicsek et al. 1995, Fig. 2b: v_a grows with the density",
        slow=True,
    ),
)
