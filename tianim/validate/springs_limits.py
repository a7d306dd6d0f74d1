"""Strain limits and tears of sheets: Provot's hanging cloth, and a strip that grows too heavy for itself.

Provot (1995) hangs a cloth by two corners, where its springs are stretched most, and keeps them within a
tenth of their length. The strip hangs by its upper edge: it must part there, and nowhere else.
"""

from functools import lru_cache, partial
from typing import Any, NamedTuple

import numpy as np
import scipy

from tianim.validate.case import Case, Comparison
from tianim.validate.springs_scenes import DOWN, calm, explicit, places, projective, run, springs

PROVOT = "Provot 1995: no spring longer than 1.1 times its rest length"
STRENGTH = "exact: Y times the limit, per width"
SOLVERS = {"explicit": explicit("symplectic_euler"), "projective": projective()}
# Longest step of the strip that tears [s]: in 5 ms what a torn spring bore goes on to the rows below it, and
# tears them in the same step, however well that is solved.
TEARING: dict[str, dict[str, Any]] = {"explicit": {}, "projective": {"time_step": {"largest": 0.0025}}}

# Provot's cloth: cells along a side, what its springs bear.
CELLS, LIMIT = 16, 0.1
# Rest lengths are float32.
ROUNDING = 1e-6
# The strip: length and width [m], cells along both, stretch [N/m], density [kg/m2]; the strain that it bears.
LONG, WIDE, ALONG, ACROSS, STRETCH, DENSITY = 1.0, 0.2, 20, 4, 500.0, 0.2
TEARS = 0.05

WITHOUT: tuple[tuple[str, int, float, Comparison, str], ...] = (
    ("largest strain", 0, 0.5, "above", ""),
    ("the longest spring is from a corner by", 1, 0.0, "below", "cells"),
)
# Of the weight: what is measured, which number, its value, how near.
WEIGHTS: tuple[tuple[float, str, str, float, float, Comparison], ...] = (
    (0.8, "springs that tear", "springs", 0.0, 0.0, "equal"),
    (1.3, "pieces", "pieces", 2.0, 0.0, "equal"),
    (1.3, "rows of cells that tear, but one", "spread", 0.0, 0.0, "equal"),
    # The edge itself holds half a row of cells, and frames are a hundredth of the time apart.
    (1.3, "weight when it tears over the law's", "load", 1.0 / (1.0 - 0.5 / ALONG), 0.02, "equal"),
    (1.3, "force on its edge over the law's", "force", 1.01, 0.0, "below"),
)


@lru_cache(maxsize=4)
def hung(solver: str, limit: float | None) -> tuple[float, float]:
    """A soft sheet, held at two corners: its largest strain, and how far from them that is [cells].

    The strain of all frames; the place at the end.
    """
    sheet = {
        "kind": "sheet", "segments": (CELLS, CELLS), "v": (0.0, -1.0, 0.0), "stretch": 30.0, "shear": 3.0,
        "strain_limit": limit,
    }  # fmt: skip
    corners = {name: {"piece": "p", "points": name} for name in ("left_bottom", "right_bottom")}
    system = springs(sheet, pins=corners, gravity=DOWN, air=calm(1.0), **SOLVERS[solver])
    worst = 0.0

    def look(time: float, system: Any) -> None:
        nonlocal worst
        worst = max(worst, float(system.report.strains(places(system))[0].max()))  # not what is pressed

    run(system, 1.0, look, frames=60)
    ends = system.whole.springs.ends[int(np.argmax(system.report.strains(places(system))[0]))]
    column, row = ends // (CELLS + 1), ends % (CELLS + 1)
    away = np.minimum(column, CELLS - column) + row
    return worst, float(away.min())


def hung_part(solver: str, limit: float | None, which: int) -> float:
    """The strain, or the place."""
    return hung(solver, limit)[which]


class Torn(NamedTuple):
    """What became of a sheet that hung by its upper edge.

    springs  that tore
    pieces   connected by what is left
    spread   of the torn springs down the sheet [cells]
    load     weight at which the first tore over Y times the limit times the width, 0 where none did
    force    the largest that its upper edge bore, over the same
    """

    springs: float
    pieces: float
    spread: float
    load: float
    force: float


@lru_cache(maxsize=4)
def hung_heavier(solver: str, part: float, seconds: float = 2.0) -> Torn:
    """A strip hung by its upper edge whose weight grows to `part` of what it bears, in so many seconds."""
    sheet = {
        "kind": "sheet", "size": (LONG, WIDE), "segments": (ALONG, ACROSS), "u": (0.0, -1.0, 0.0),
        "stretch": STRETCH, "shear": 25.0, "tear_strain": TEARS, "density": DENSITY, "damping": 1e-4,
    }  # fmt: skip
    bears = STRETCH * TEARS * WIDE
    g = part * bears / (DENSITY * LONG * WIDE)
    pull = {"keys": [[0.0, (0.0, 0.0, 0.0)], [seconds, (0.0, -g, 0.0)]], "interpolation": "linear"}
    pins = {"edge": {"piece": "p", "points": "left"}}
    system = springs(
        sheet, pins=pins, gravity=pull, air=calm(10.0), **SOLVERS[solver], **TEARING[solver]
    )  # fmt: skip
    ends = system.whole.springs.ends
    held = ((ends <= ACROSS).sum(axis=1) == 1).nonzero()[0]  # from the edge down
    force = load = 0.0

    def look(time: float, system: Any) -> None:
        nonlocal force, load
        x = places(system)
        d = x[ends[held, 1]] - x[ends[held, 0]]
        tension = system.report.strains(x)[1][held]
        down = np.abs(d[:, 1]) / np.linalg.norm(d, axis=1)
        force = max(force, float(tension @ down) / bears)
        if load == 0.0 and system.diagnostics()["torn"]:
            load = part * time / seconds

    run(system, 1.1 * seconds, look, frames=220)
    gone = system.limits.springs().stiffness == 0.0
    count = len(system.whole.mass)
    left = scipy.sparse.coo_matrix((np.ones((~gone).sum()), ends[~gone].T), shape=(count, count))
    pieces = scipy.sparse.csgraph.connected_components(left, directed=False)[0]
    rows = (ends[gone] // (ACROSS + 1)).mean(axis=1)
    spread = float(np.ptp(rows)) if gone.any() else 0.0
    return Torn(float(gone.sum()), float(pieces), spread, load, force)


def hung_heavier_part(solver: str, part: float, which: str) -> float:
    """One of the numbers."""
    return float(getattr(hung_heavier(solver, part), which))


CASES: tuple[Case, ...] = (
    *(
        Case("springs", f"Provot's cloth, held at two corners, {solver}: largest strain",
             partial(hung_part, solver, LIMIT, 0), LIMIT + ROUNDING, PROVOT, comparison="below")
        for solver in SOLVERS
    ),
    *(
        Case("springs", f"Provot's cloth without a limit, {solver}: {words}",
             partial(hung_part, solver, None, which), expected, PROVOT, comparison=comparison, unit=unit)
        for solver in SOLVERS
        for words, which, expected, comparison, unit in WITHOUT
    ),
    *(
        Case("springs", f"sheet under {part:g} of the weight that it bears, {solver}: {words}",
             partial(hung_heavier_part, solver, part, which), expected, STRENGTH, tolerance=tolerance,
             comparison=comparison)
        for solver in SOLVERS
        for part, words, which, expected, tolerance, comparison in WEIGHTS
    ),
)  # fmt: skip
