"""Ropes that hang and swing, held against the catenary, the law of elasticity and Bessel's J0.

The catenary is exact for what cannot be stretched; the rope here stretches by some thousandths.
"""

from functools import partial
from typing import Any

import numpy as np
from scipy.special import j0

from tianim.validate.case import Case
from tianim.validate.springs_scenes import (
    DOWN,
    GRAVITY,
    SCHEMES,
    STRANDS,
    calm,
    crossings,
    explicit,
    implicit,
    pinned,
    places,
    projective,
    run,
    settled,
    springs,
)

LIGHT = 0.1  # mass per length [kg/m]
FIRST_ZERO = 2.404826  # of J0


def catenary(which: str, solver: str, cells: int = 64) -> float:
    """A rope 1.5 long between ends 1 apart: its sag, or its horizontal tension over its weight."""
    low = (0.5, -np.sqrt(0.75**2 - 0.5**2), 0.0)
    rope = {
        "kind": "rope", "points": [(0.0, 0.0, 0.0), low, (1.0, 0.0, 0.0)], "segments": cells,
        "density": LIGHT, "stretch": 1e3,
    }  # fmt: skip
    system = springs(rope, pins=pinned("ends"), gravity=DOWN, air=calm(4.0), **implicit(solver))
    x = places(settled(system))
    if which == "sag":
        return float(-x[:, 1].min())
    _, tension = system.report.strains(x)
    d = np.diff(x, axis=0)
    along = tension * d[:, 0] / np.linalg.norm(d, axis=1)
    return float(along.mean() / (LIGHT * GRAVITY))


def hanging_rope(tip: float, cells: int = 32, **fields: Any) -> float:
    """Elongation of a hanging rope over rho g L^2 / 2 EA + M g L / EA; `tip` is M [kg]."""
    stretch = 100.0
    rope = {
        "kind": "rope", "points": [(0.0, 0.0, 0.0), (0.0, -1.0, 0.0)], "segments": cells,
        "density": LIGHT, "stretch": stretch,
    }  # fmt: skip
    weight = {"tip": {"piece": "p", "points": "last", "force": (0.0, -tip * GRAVITY, 0.0)}}
    system = springs(
        rope, pins=pinned("first"), pushes=weight, gravity=DOWN, air=calm(50.0),
        **(fields or projective("bdf2")),
    )  # fmt: skip
    x = places(settled(system))
    return float((-x[-1, 1] - 1.0) / ((0.5 * LIGHT + tip) * GRAVITY / stretch))


def swinging_rope(scheme: str, cells: int = 32) -> float:
    """Period of a hanging rope's first mode over 2 pi / (1.2024 sqrt(g / L)), 2.4048 / 2 of Bessel's J0."""
    rope = {
        "kind": "rope", "points": [(0.0, 0.0, 0.0), (0.0, -1.0, 0.0)], "segments": cells,
        "density": LIGHT, "stretch": 1e3,
    }  # fmt: skip
    system = springs(rope, pins=pinned("first"), gravity=DOWN, **implicit(scheme))
    x = places(system)
    mode = j0(FIRST_ZERO * np.sqrt(1.0 + x[:, 1]))
    x[:, 0] = 0.02 * mode
    system.write("position", x)
    weight = system.read("mass") * mode
    seen: list[tuple[float, float]] = []
    run(system, 4.0, lambda time, system: seen.append((time, weight @ places(system)[:, 0])), frames=480)
    when = crossings(*np.array(seen).T)
    measured = 2.0 * (when[-1] - when[0]) / (len(when) - 1)
    return float(measured * FIRST_ZERO / 2.0 * np.sqrt(GRAVITY) / (2.0 * np.pi))


CASES: tuple[Case, ...] = (
    *(
        Case(
            "springs", f"catenary, span 1, length 1.5, {solver}: {words}", partial(catenary, which, solver),
            expected, "exact: y = a cosh(x / a)", tolerance=0.005 * expected, unit="m",
        )
        for solver in ("strands", "implicit_euler")
        for words, which, expected in (
            ("sag", "sag", 0.502633), ("horizontal tension over rho g", "tension", 0.308236),
        )
    ),
    *(
        Case("springs", f"hanging rope{words}, {name}: elongation over the law's",
             partial(hanging_rope, tip, **fields), 1.0, "exact: (rho L / 2 + M) g L / EA", tolerance=0.01)
        for words, tip in (("", 0.0), (" with a weight", 0.2))
        for name, fields in (
            ("strands", STRANDS), ("bdf2", projective("bdf2")), ("explicit", explicit("symplectic_euler")),
        )
    ),
    *(
        Case("springs", f"swinging rope, {scheme}: first period over the law's",
             partial(swinging_rope, scheme), 1.0, "exact: omega = j_0,1 / 2 sqrt(g / L), J_0(j_0,1) = 0",
             tolerance=0.02)
        for scheme in ("strands", *SCHEMES)
    ),
)  # fmt: skip
