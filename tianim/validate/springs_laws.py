"""Few masses and springs, held against closed forms: oscillations, damping, momenta, pendulums.

Any spring is linear along its own line: the laws hold exactly there.
"""

from functools import lru_cache, partial
from typing import Any

import numpy as np
from scipy.special import ellipk

from tianim.validate.case import Case
from tianim.validate.springs_scenes import (
    DOWN,
    GRAVITY,
    crossings,
    explicit,
    fields_of,
    network,
    pinned,
    places,
    run,
    speeds,
    spin,
    springs,
)

DAMPED_SOURCE = "exact: m x'' + c x' + k x = 0"
LEVER_SOURCE = "exact: dampers along the line of two masses do no moment"
# Forces are float32 sums over springs: a relative error of some 1e-7 a step.
FORCE_ROUNDING = 1e-6
# The damped spring [kg], [N/m].
MASS, STIFFNESS, REST, PULLED = 1.0, 100.0, 1.0, 0.1
CRITICAL = 2.0 * float(np.sqrt(STIFFNESS * MASS))
DAMPINGS = {"under": 0.1 * CRITICAL, "critical": CRITICAL, "over": 2.0 * CRITICAL}
# A pendulum whose rod is a spring [N/m] that its weight stretches by 1e-5 of its length.
ROD = 1e6


def damped_place(damping: float, t: float) -> float:
    """Where a damped spring is that was let go at PULLED from its rest."""
    rate, k = 0.5 * damping / MASS, STIFFNESS / MASS
    split = np.sqrt(complex(k - rate**2))
    if abs(split) == 0.0:
        return float(PULLED * np.exp(-rate * t) * (1.0 + rate * t))
    swing = np.cos(split * t) + rate / split * np.sin(split * t)
    return float((PULLED * np.exp(-rate * t) * swing).real)


def damped_spring(damping: float, step: float, **fields: Any) -> Any:
    """A mass on a damped spring along x, PULLED out, let go."""
    piece = network(
        [(0.0, 0.0, 0.0), (REST + PULLED, 0.0, 0.0)], [(0, 1, STIFFNESS, REST, damping)], mass=MASS
    )
    return springs(piece, pins=pinned([0]), time_step={"largest": step}, **fields)


def damped_error(solver: str, damping: float, steps: int, until: float = 0.5) -> float:
    """Error of a damped spring's place after half a second, over where it was let go."""
    system = run(damped_spring(damping, until / steps, **fields_of(solver)), until)
    return float(abs(places(system)[1, 0] - REST - damped_place(damping, until)) / PULLED)


def damped_order(solver: str, steps: int = 100) -> float:
    """Slope of a damped spring's error over the step, from halving it."""
    errors = [damped_error(solver, DAMPINGS["under"], count) for count in (steps, 2 * steps)]
    return float(np.log2(errors[0] / errors[1]))


def log_decrement() -> float:
    """ln(x_n / x_n+1) of a damped spring over pi c / (m omega_d); peaks from three samples each."""
    c = 0.02 * CRITICAL
    system = damped_spring(c, 2e-3, **explicit("rk4"))
    seen = [PULLED]
    run(system, 2.0, lambda time, system: seen.append(float(places(system)[1, 0] - REST)), frames=1000)
    x = np.array(seen)
    k = np.flatnonzero((x[1:-1] > x[:-2]) & (x[1:-1] >= x[2:])) + 1
    left, mid, right = x[k - 1], x[k], x[k + 1]
    peaks = mid - (right - left) ** 2 / 8.0 / (right - 2.0 * mid + left)
    omega = np.sqrt(STIFFNESS / MASS - (0.5 * c / MASS) ** 2)
    return float(np.log(peaks[0] / peaks[-1]) / (len(peaks) - 1) / (np.pi * c / (MASS * omega)))


def reduced_mass(rest: float | None) -> float:
    """Frequency of two masses 1 and 3 on a spring over sqrt(k / mu); None: of rest length 0."""
    masses, k = (1.0, 3.0), 100.0
    piece = network([(0.0, 0.0, 0.0), (1.1, 0.0, 0.0)], [(0, 1, k, rest or 0.0, 0.0)], mass=masses)
    system = springs(piece, **explicit("velocity_verlet"), time_step={"largest": 1e-3})
    seen: list[tuple[float, float]] = []

    def look(time: float, system: Any) -> None:
        x = places(system)[:, 0]
        seen.append((time, x[1] - x[0] - (rest or 0.0)))

    run(system, 5.0, look, frames=2500)
    time, stretch = np.array(seen).T
    when = crossings(time, stretch)
    measured = np.pi * (len(when) - 1) / (when[-1] - when[0])
    return float(measured / np.sqrt(k * (1.0 / masses[0] + 1.0 / masses[1])))


SQUARE = [(x, y, 0.0) for x, y in ((-0.5, -0.5), (0.5, -0.5), (0.5, 0.5), (-0.5, 0.5))]
BRACED = [(0, 1), (1, 2), (2, 3), (3, 0), (0, 2), (1, 3)]


@lru_cache(maxsize=8)
def spinning_square(solver: str, which: str) -> tuple[float, float]:
    """After 10 s a spinning and drifting square has so much of its spin and of its velocity.

    which: `damped` along its springs, or `drag` of 0.1 1/s onto each point.
    """
    c = 5.0 if which == "damped" else 0.0
    piece = network(
        SQUARE, [(a, b, 100.0, None, c) for a, b in BRACED], spin=(0.0, 0.0, 1.0), velocity=(0.0, 0.0, 1.0)
    )
    drag = {"density": 0.0, "drag": 0.2 if which == "drag" else 0.0}
    system = springs(piece, air=drag, time_step={"largest": 5e-3}, **fields_of(solver))
    before = spin(system)[2], speeds(system)[:, 2].mean()
    run(system, 10.0)
    return float(spin(system)[2] / before[0]), float(speeds(system)[:, 2].mean() / before[1])


def _square(solver: str, which: str, part: int) -> float:
    return spinning_square(solver, which)[part]


def pendulum(angle: float, step: float = 1.4e-3, **fields: Any) -> float:
    """Period of a pendulum let go at `angle` [deg], over 2 pi sqrt(L / g)."""
    start = np.radians(angle)
    # As long as its weight makes it on average over a small swing.
    rest = 1.0 - GRAVITY / ROD
    place = (np.sin(start), -np.cos(start), 0.0)
    system = springs(
        network([(0.0, 0.0, 0.0), place], [(0, 1, ROD, rest, 0.0)]), pins=pinned([0]), gravity=DOWN,
        time_step={"largest": step}, **(fields or explicit("velocity_verlet")),
    )  # fmt: skip
    seen: list[tuple[float, float]] = []
    small = 2.0 * np.pi / np.sqrt(GRAVITY)
    # From the first fall through the lowest place to the next one takes half a period.
    run(
        system, 0.9 * pendulum_period(angle) * small,
        lambda time, system: seen.append((time, places(system)[1, 0])), frames=600,
    )  # fmt: skip
    time, x = np.array(seen).T
    when = crossings(time, x)
    return float(2.0 * (when[1] - when[0]) / small)


def pendulum_period(angle: float) -> float:
    """Over that of small swings: 2 K(sin^2(angle / 2)) / pi."""
    return float(2.0 / np.pi * ellipk(np.sin(0.5 * np.radians(angle)) ** 2))


TRIANGLE = [(0.0, 0.0, 0.0), (1.0, 0.0, 0.0), (0.5, 0.8, 0.0)]
FORCE, PUSHED = (2.0, 3.0, -1.0), 0.1


@lru_cache(maxsize=8)
def pushed_triangle(solver: str) -> tuple[float, float]:
    """A corner of a triangle is pushed for a moment: errors of the centre's velocity, and of the lengths.

    The first over J / sum m, the second over the lengths after the springs' dampers have calmed it.
    """
    masses = (1.0, 2.0, 3.0)
    piece = network(TRIANGLE, [(a, b, 400.0, None, 10.0) for a, b in ((0, 1), (1, 2), (2, 0))], mass=masses)
    force = {"keys": [[0.0, FORCE], [PUSHED, (0.0, 0.0, 0.0)]], "interpolation": "step"}
    system = springs(
        piece, pushes={"shot": {"piece": "p", "points": [2], "force": force}},
        time_step={"largest": 2e-3}, **fields_of(solver),
    )  # fmt: skip
    run(system, PUSHED)
    run(system, 4.0, start=PUSHED)
    mass = np.array(masses)
    exact = np.array(FORCE) * PUSHED / mass.sum()
    velocity = mass @ speeds(system) / mass.sum()
    x, x0 = places(system), np.array(TRIANGLE)
    lengths, rest = (np.array([np.linalg.norm(p[a] - p[a - 1]) for a in range(3)]) for p in (x, x0))
    return (
        float(np.abs(velocity - exact).max() / np.linalg.norm(exact)),
        float(np.abs(lengths / rest - 1.0).max()),
    )


def _pushed(solver: str, which: int) -> float:
    return pushed_triangle(solver)[which]


CASES: tuple[Case, ...] = (
    *(
        Case(
            "springs", f"{name}damped spring, rk4: error after 0.5 s",
            partial(damped_error, "rk4", damping, 200), FORCE_ROUNDING, DAMPED_SOURCE, comparison="below",
        )
        for name, damping in (
            ("under", DAMPINGS["under"]), ("critically ", DAMPINGS["critical"]), ("over", DAMPINGS["over"])
        )
    ),
    *(
        Case("springs", f"damped spring: order of {solver}", partial(damped_order, solver), expected,
             DAMPED_SOURCE, tolerance=0.15)
        for solver, expected in (
            ("symplectic_euler", 1), ("velocity_verlet", 2), ("implicit_euler", 1), ("bdf2", 2)
        )
    ),
    Case(
        "springs", "log decrement over pi c / (m omega_d)", log_decrement, 1.0, DAMPED_SOURCE, tolerance=1e-3
    ),
    *(
        Case("springs", f"two masses on a spring {name}: frequency over sqrt(k / mu)",
             partial(reduced_mass, rest), 1.0, "exact: mu = m1 m2 / (m1 + m2)", tolerance=1e-4)
        for name, rest in (("of no length", None), ("of length 1", 1.0))
    ),
    *(
        Case("springs", f"internal damping, {solver}: {name} of a square after 10 s, over the start's",
             partial(_square, solver, "damped", part), 1.0, LEVER_SOURCE, tolerance=1e-6)
        for solver, parts in (
            ("symplectic_euler", (("spin", 0), ("velocity", 1))), ("velocity_verlet", (("spin", 0),)),
        )
        for name, part in parts
    ),
    *(
        # Steps of 5 ms lose a thousandth of the exponent.
        Case("springs", f"drag of 0.2 1/s: {name} of a square after 10 s, over the start's",
             partial(_square, "symplectic_euler", "drag", part), float(np.exp(-2.0)), "exact: e^-2",
             tolerance=5e-4)
        for name, part in (("spin", 0), ("velocity", 1))
    ),
    *(
        Case("springs", f"pendulum from {angle} deg: period over that of small swings",
             partial(pendulum, float(angle)), expected, "exact: 2 K(sin^2(angle / 2)) / pi", tolerance=1e-4)
        for angle, expected in ((10, 1.001907), (90, 1.180341))
    ),
    *(
        Case("springs", f"momentary force on a triangle, {solver}: {name}", partial(_pushed, solver, which),
             limit, "exact: J / sum m; dampers calm what is left", comparison="below")
        for solver in ("symplectic_euler", "implicit_euler", "bdf2")
        for name, which, limit in (
            ("error of the centre's velocity", 0, 1e-6), ("error of its sides after 4 s", 1, 1e-3),
        )
    ),
)  # fmt: skip
