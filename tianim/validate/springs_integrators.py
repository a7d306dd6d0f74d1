"""How integrators and schemes step: energy on an oscillator, orders, free fall.

Springs of rest length 0 are linear: the factor of a step is exact there.
"""

from functools import lru_cache, partial

import numpy as np
from scipy.integrate import solve_ivp

from tianim.validate.case import Case
from tianim.validate.springs_scenes import (
    DOWN,
    GRAVITY,
    SCHEMES,
    Floats,
    explicit,
    fields_of,
    network,
    pinned,
    places,
    projective,
    run,
    speeds,
    springs,
)

ENERGY_SOURCE = "theory: the factor of a step on an oscillator, 100 periods"
# Forces are float32 sums over springs: a relative error of some 1e-7 a step.
FORCE_ROUNDING = 1e-6
# The oscillator [kg], [N/m]: omega = 1, and steps are in units of 1 / omega.
OMEGA = 1.0
PERIODS = 100
# What a mass swings around [N/m], [m], and where and how fast it begins.
STIFFNESS, REST = 100.0, 1.0
ORBIT = (1.2, 0.0, 0.0, 3.0)
ORDERS = {
    "symplectic_euler": 1, "velocity_verlet": 2, "rk4": 4, "forward_euler": 1, "trapezoid": 1,
    "constant_acceleration": 1, "implicit_euler": 1, "bdf2": 2,
}  # fmt: skip


@lru_cache(maxsize=16)
def energies(solver: str, step: float, periods: int = PERIODS) -> Floats:
    """Energy over that of the start after each step of `step` / omega of a linear spring, over 100 periods.

    The run ends where it has grown by 1e30.
    """
    system = springs(
        network([(0.0, 0.0, 0.0), (1.0, 0.0, 0.0)], [(0, 1, OMEGA**2, 0.0, 0.0)]),
        pins=pinned([0]), time_step={"largest": step}, **fields_of(solver),
    )  # fmt: skip
    found = [(1.0, 0.0)]
    for k in range(round(2.0 * np.pi * periods / step)):
        system.step(k * step, step)
        found.append((float(places(system)[1, 0]), float(speeds(system)[1, 0])))
        if not found[-1][0] ** 2 + found[-1][1] ** 2 < 1e30:
            break
    x, v = np.array(found).T
    return np.asarray(np.stack([x, v, x**2 + v**2]))


def end_energy(solver: str, step: float) -> float:
    """Energy after 100 periods over that of the start."""
    return float(energies(solver, step)[2, -1])


def step_factor_error(solver: str, step: float, factor: float) -> float:
    """Largest error of a step's energy factor where the rule fixes it for every step."""
    E = energies(solver, step)[2]
    E = E[: np.argmax(E < 1e-20)] if (E < 1e-20).any() else E
    return float(np.abs(E[1:] / E[:-1] / factor - 1.0).max())


def steps_to_blow_up(solver: str, step: float) -> float:
    """Steps until the energy has grown by 1e30."""
    return float(energies(solver, step).shape[1] - 1)


def gain_of_a_period(solver: str, step: float) -> float:
    """Logarithm of the energy's growth over 100 periods, by that of (1 + step^2 / 2) a step."""
    E = energies(solver, step)[2]
    return float(np.log(E[-1]) / ((len(E) - 1) * np.log(1.0 + 0.5 * step**2)))


def kept_by_symplectic_euler(step: float) -> float:
    """Largest drift of E - h omega^2 x v / 2, which its steps keep exactly, over E at the start."""
    x, v, E = energies("symplectic_euler", step)
    kept = 0.5 * E - 0.5 * step * x * v
    return float(np.abs(kept / kept[0] - 1.0).max())


def extreme_energy(solver: str, step: float, which: str) -> float:
    """Lowest or highest energy on the way, over that of the start."""
    E = energies(solver, step)[2]
    return float(E.min() if which == "lowest" else E.max())


def fall_error(solver: str, step: float = 0.01) -> float:
    """Error of a thrown mass after a second, over how far it fell."""
    thrown = np.array([1.0, 2.0, 0.0])
    piece = network([(0.0, 0.0, 0.0)], velocity=tuple(thrown))
    system = run(springs(piece, gravity=DOWN, time_step={"largest": step}, **fields_of(solver)), 1.0)
    exact = thrown + 0.5 * np.array(DOWN)
    return float(np.abs(places(system)[0] - exact).max() / (0.5 * GRAVITY))


@lru_cache(maxsize=1)
def orbit_place() -> Floats:
    """Where a mass is after 2 s that swings around a spring's other end, solved to 1e-12."""

    def slope(t: float, state: Floats) -> Floats:
        x = state[:2]
        r = np.linalg.norm(x)
        return np.concatenate([state[2:], -STIFFNESS * (1.0 - REST / r) * x])

    found = solve_ivp(slope, (0.0, 2.0), ORBIT, method="DOP853", rtol=1e-12, atol=1e-12)
    return np.asarray(found.y[:2, -1])


def orbit_error(solver: str, steps: int) -> float:
    """Error of the place of a mass that swings around a spring's other end for 2 s [m]."""
    piece = network(
        [(0.0, 0.0, 0.0), (ORBIT[0], ORBIT[1], 0.0)], [(0, 1, STIFFNESS, REST, 0.0)],
        velocities=((0.0, 0.0, 0.0), (ORBIT[2], ORBIT[3], 0.0)),
    )  # fmt: skip
    fields = projective(solver, iterations=40) if solver in SCHEMES else explicit(solver)
    system = springs(piece, pins=pinned([0]), time_step={"largest": 2.0 / steps}, **fields)
    run(system, 2.0)
    return float(np.linalg.norm(places(system)[1, :2] - orbit_place()))


def order(solver: str) -> float:
    """Slope of the error over the step, from halving it."""
    steps = 150 if solver == "rk4" else 800
    return float(np.log2(orbit_error(solver, steps) / orbit_error(solver, 2 * steps)))


CASES: tuple[Case, ...] = (
    *(
        Case(
            "springs", f"oscillator, {solver}, h omega = {step:g}: error of a step's energy factor",
            partial(step_factor_error, solver, step, 1.0 + step**2 if solver == "forward_euler"
                    else 1.0 / (1.0 + step**2)),
            # Lengths of the spring are float32.
            FORCE_ROUNDING, ENERGY_SOURCE, comparison="below",
        )
        for solver in ("forward_euler", "implicit_euler") for step in (0.2, 1.0, 2.5)
    ),
    Case(
        # 1.04^1762 is the first beyond 1e30.
        "springs", "oscillator, forward_euler, h omega = 0.2: steps until E is 1e30",
        partial(steps_to_blow_up, "forward_euler", 0.2), 1762.0, ENERGY_SOURCE, tolerance=2.0,
    ),
    *(
        Case(
            "springs", f"oscillator, symplectic_euler, h omega = {step:g}: drift of what it keeps",
            partial(kept_by_symplectic_euler, step), 1e-5, "exact: E - h omega^2 x v / 2",
            comparison="below",
        )
        for step in (0.2, 1.0)
    ),
    *(
        Case(
            "springs", f"oscillator, {solver}, h omega = 0.2: {which} energy of 100 periods",
            partial(extreme_energy, solver, 0.2, which), limits, ENERGY_SOURCE, comparison="between",
        )
        for solver, which, limits in (
            ("symplectic_euler", "lowest", (1.0 / 1.1 - 1e-4, 1.0)),
            ("symplectic_euler", "highest", (1.0, 1.0 / 0.9 + 1e-4)),
            ("velocity_verlet", "lowest", (0.99 - 1e-4, 1.0)),
            ("velocity_verlet", "highest", (1.0, 1.0 + 1e-4)),
        )
    ),
    *(
        Case(
            "springs", f"oscillator, rk4, h omega = {step:g}: energy after 100 periods",
            partial(end_energy, "rk4", step), expected, ENERGY_SOURCE, tolerance=tolerance,
        )
        for step, expected, tolerance in ((0.2, 0.997, 1e-3), (1.0, 4.6e-4, 1e-5))
    ),
    *(
        Case(
            "springs", f"oscillator, {solver}, h omega = 2.5: steps until E is 1e30",
            partial(steps_to_blow_up, solver, 2.5), steps, "theory: stable below h omega = 2",
            tolerance=1.0,
        )
        for solver, steps in (("symplectic_euler", 25.0), ("velocity_verlet", 26.0))
    ),
    *(
        Case(
            "springs", f"oscillator, {solver}, h omega = 0.2: growth over that of 1 + (h omega)^2 / 2 a step",
            partial(gain_of_a_period, solver, 0.2), 1.0, "theory: determinant of a step", tolerance=5e-3,
        )
        for solver in ("trapezoid", "constant_acceleration")
    ),
    *(
        Case(
            # Halving the step: the next power of it still shows in the slope.
            "springs", f"order of {solver}", partial(order, solver), expected, "theory: order of the method",
            tolerance=0.15,
        )
        for solver, expected in ORDERS.items()
    ),
    *(
        Case("springs", f"free fall, {solver}: error after a second", partial(fall_error, solver), limit,
             "exact: x = v t + g t^2 / 2; Euler's rules err by the step over the time", comparison="below")
        for solver, limit in (
            ("velocity_verlet", 1e-9), ("constant_acceleration", 1e-9), ("rk4", 1e-9),
            ("symplectic_euler", 0.0101), ("implicit_euler", 0.0101), ("bdf2", 2e-4),
        )
    ),
)  # fmt: skip
