"""Springs: the cases of `tianim validate springs`, and how they measure."""

from typing import Any

import numpy as np
import pytest
from checks import as_tests, assert_passes_or_is_known
from scipy.integrate import quad, solve_bvp
from scipy.optimize import brentq

from tianim.validate import CASES, Case
from tianim.validate.springs_laws import DAMPINGS, MASS, PULLED, STIFFNESS, damped_place, pendulum_period
from tianim.validate.springs_scenes import crossings, explicit, network, pinned, places, run, springs
from tianim.validate.springs_strips import ELASTICA

# What `tianim validate springs`, with --slow too, shows as failed: its error as `Case.error` has it, and why.
# None may be WORSE times as far off.
SHORT = {
    "cantilever, mesh, w L^3 / B = 1, implicit_euler: drop, over L": (
        0.0078, "a narrow strip bends the other way too, at 8/9 of the stiffness"
    ),
    "cantilever, mesh, w L^3 / B = 1, implicit_euler: of its chord": (0.46, "as its drop"),
    "swinging rope, implicit_euler: first period over the law's": (
        0.025, "implicit Euler calms it; bdf2 does not, and solver strands is for ropes"
    ),
}  # fmt: skip


@pytest.mark.parametrize("case", as_tests(CASES["springs"]))
def test_case(case: Case) -> None:
    assert_passes_or_is_known(case, SHORT)


def test_what_falls_short_is_a_case() -> None:
    assert set(SHORT) <= {case.name for case in CASES["springs"]}


def test_the_names_of_cases_differ() -> None:
    names = [case.name for case in CASES["springs"]]
    assert len(set(names)) == len(names)


@pytest.mark.parametrize("load", ELASTICA)
def test_the_published_elastica_is_the_solution_of_its_equation(load: int) -> None:
    """The equation is theta'' = -load (1 - s) cos theta, theta(0) = 0, theta'(1) = 0, down."""

    def slope(s: Any, y: Any) -> Any:
        return np.stack([y[1], -load * (1.0 - s) * np.cos(y[0])])

    s = np.linspace(0.0, 1.0, 101)
    found = solve_bvp(slope, lambda a, b: np.array([a[0], b[1]]), s, np.zeros((2, 101)), tol=1e-9)
    along = quad(lambda t: np.cos(found.sol(t)[0]), 0.0, 1.0)[0]
    down = quad(lambda t: np.sin(found.sol(t)[0]), 0.0, 1.0)[0]
    measured = along, down, np.degrees(np.arctan2(down, along))
    # As many digits as are printed.
    np.testing.assert_allclose(measured, ELASTICA[load], rtol=1e-4)


def test_the_published_catenary_has_its_span_and_length() -> None:
    a = brentq(lambda a: 2.0 * a * np.sinh(0.5 / a) - 1.5, 0.1, 1.0)
    assert a == pytest.approx(0.308236, abs=1e-6)
    assert a * np.cosh(0.5 / a) - a == pytest.approx(0.502633, abs=1e-6)


@pytest.mark.parametrize("damping", DAMPINGS.values(), ids=DAMPINGS)
def test_the_damped_spring_obeys_its_equation(damping: float) -> None:
    h, t = 1e-4, 0.21
    before, now, after = (damped_place(damping, t + k * h) for k in (-1, 0, 1))
    force = MASS * (after - 2.0 * now + before) / h**2 + damping * (after - before) / (2.0 * h)
    # Differences of float64 numbers over h^2: 1e-17 by 1e-8.
    assert force + STIFFNESS * now == pytest.approx(0.0, abs=1e-5 * STIFFNESS * PULLED)
    assert damped_place(damping, 0.0) == pytest.approx(PULLED)


@pytest.mark.parametrize(("angle", "period"), [(10.0, 1.001907), (90.0, 1.180341)])
def test_the_published_periods_are_the_integral(angle: float, period: float) -> None:
    assert pendulum_period(angle) == pytest.approx(period, abs=1e-6)


def test_crossings_are_found_between_samples() -> None:
    t = np.linspace(0.0, 3.0, 61)
    np.testing.assert_allclose(crossings(t, np.sin(3.0 * t)), np.arange(1, 3) * np.pi / 3.0, atol=1e-5)


def test_a_push_moves_what_is_pinned_not_at_all() -> None:
    force = {"shove": {"piece": "p", "points": "all", "force": (1.0, 0.0, 0.0)}}
    system = springs(
        network([(0.0, 0.0, 0.0), (1.0, 0.0, 0.0)]), pins=pinned([0]), pushes=force,
        **explicit("symplectic_euler"),
    )  # fmt: skip
    run(system, 1.0)
    x = places(system)
    np.testing.assert_array_equal(x[0], 0.0)
    assert x[1, 0] == pytest.approx(1.5, rel=0.01)
