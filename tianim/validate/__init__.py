"""Validation: systems held against published, exact and brute-force numbers.

    for result in run("boids", slow=False, out=Path("out/validation")):
        print(result["check"], result["measured"], result["passed"])

The cases serve `tianim validate` and the tests alike. A family (`boids`) includes the models that
belong to it; each can be asked for by itself too.
"""

import difflib
import math
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from tianim import runtime
from tianim.errors import BlowupError, SceneError
from tianim.validate import (
    couzin,
    flocking,
    fluid,
    fluid_bodies,
    fluid_columns,
    fluid_dam_break,
    fluid_drops,
    fluid_flows,
    gravity,
    gravity_forces,
    gravity_galaxies,
    limits,
    murmuration,
    springs_air,
    springs_blocks,
    springs_contact,
    springs_drape,
    springs_integrators,
    springs_laws,
    springs_limits,
    springs_ropes,
    springs_self,
    springs_sheets,
    springs_solids,
    springs_strips,
    steering,
    steering_laws,
    vicsek,
)
from tianim.validate.case import Case, Figure

__all__ = ["CASES", "Case", "Figure", "run"]

_FLOCKS = (*flocking.CASES, *steering_laws.CASES, *steering.CASES, *limits.CASES, *murmuration.CASES)
CASES: dict[str, tuple[Case, ...]] = {
    "boids": (*_FLOCKS, *vicsek.CASES, *couzin.CASES),
    "couzin": couzin.CASES,
    "fluid": (
        *fluid.CASES,
        *fluid_columns.CASES,
        *fluid_dam_break.CASES,
        *fluid_flows.CASES,
        *fluid_drops.CASES,
        *fluid_bodies.CASES,
    ),
    "gravity": (*gravity.CASES, *gravity_forces.CASES, *gravity_galaxies.CASES),
    "springs": (
        *springs_integrators.CASES,
        *springs_laws.CASES,
        *springs_air.CASES,
        *springs_sheets.CASES,
        *springs_strips.CASES,
        *springs_ropes.CASES,
        *springs_blocks.CASES,
        *springs_limits.CASES,
        *springs_drape.CASES,
        *springs_contact.CASES,
        *springs_solids.CASES,
        *springs_self.CASES,
    ),
    "vicsek": vicsek.CASES,
}

Result = dict[str, Any]
Begins = Callable[[int, int, str], object]


def run(
    system: str | None = None, slow: bool = False, out: Path | None = None, begins: Begins | None = None
) -> Iterator[Result]:
    """Results of the cases of `system` (all where None), one by one; `slow` runs the long ones too.

    A result has the keys system, check, expected, measured, error, tolerance, passed, source and
    seconds, plain JSON types all; measured is None where a run blew up. Plots are written into
    `out` as soon as all points of a figure are there. `begins` is called before each case with its number
    from 1 on, how many there are, and its title. SceneError for a system without cases.
    """
    if system is not None and system not in CASES:
        nearest = difflib.get_close_matches(system, CASES, n=1)
        hint = f"did you mean {nearest[0]!r}?" if nearest else f"there are {', '.join(CASES)}"
        raise SceneError(f"no checks for system {system!r}: {hint}")
    asked = CASES.values() if system is None else (CASES[system],)
    cases = tuple(dict.fromkeys(case for group in asked for case in group if slow or not case.slow))
    return _results(cases, out, begins)


def _results(cases: tuple[Case, ...], out: Path | None, begins: Begins | None) -> Iterator[Result]:
    runtime.current()
    measured: dict[Case, float] = {}
    for k, case in enumerate(cases):
        if begins is not None:
            begins(k + 1, len(cases), case.title())
        started = time.perf_counter()
        try:
            measured[case] = float(case.run())
        except BlowupError:
            measured[case] = math.nan
        yield result(case, measured[case], time.perf_counter() - started)
        figure = case.figure
        if (
            out is not None
            and figure is not None
            and figure not in (other.figure for other in cases[k + 1 :])
        ):
            from tianim.validate.plots import plot

            points = {
                c: value for c, value in measured.items() if c.figure == figure and math.isfinite(value)
            }
            plot(figure, points, out)


def result(case: Case, measured: float, seconds: float) -> Result:
    """A case and what came out, as plain JSON types."""
    finite = math.isfinite(measured)
    return {
        "system": case.system,
        "check": case.title(),
        "expected": list(case.expected) if isinstance(case.expected, tuple) else case.expected,
        "measured": measured if finite else None,
        "error": case.error(measured) if finite else None,
        "tolerance": case.tolerance,
        "passed": case.passed(measured),
        "source": case.source,
        "seconds": round(seconds, 3),
    }
