"""Sheets in the units of their fabric, held against statics and waves: sag, wave speed, shear, bending.

A sheet that hangs from its top edge is as long whatever its resolution and its solver.
"""

from functools import partial
from typing import Any

import numpy as np

from tianim.validate.build import acceleration
from tianim.validate.case import Case
from tianim.validate.springs_scenes import (
    DOWN,
    GRAVITY,
    SCHEMES,
    calm,
    crossings,
    explicit,
    pinned,
    places,
    projective,
    run,
    springs,
)

SAG_SOURCE = "exact: rho g L / (2 Y)"
# The hanging sheet: 1 m, [kg/m2], [N/m].
DENSITY, STRETCH = 0.2, 1000.0
SAG = 100.0 * DENSITY * GRAVITY / (2.0 * STRETCH)  # [%]
# Sags agree far better than the 10 % that peers are held to.
SAG_TOLERANCE = 0.01 * SAG
BEND = 1e-3


def hanging(across: int, **fields: Any) -> float:
    """Mean elongation of a sheet hung by its whole top edge [%]."""
    sheet = {"kind": "sheet", "segments": (across, across), "v": (0.0, 1.0, 0.0)}
    system = springs(sheet, pins=pinned("top"), gravity=DOWN, **fields)
    run(system, 0.15 if fields["solver"] == "explicit" else 1.0)
    return float(-100.0 * places(system)[:: across + 1, 1].mean())


def hanging_projective(across: int, scheme: str) -> float:
    """By the implicit solver, as it is by default."""
    return hanging(across, **projective(scheme))


def hanging_explicit(across: int) -> float:
    """By short steps, with the drag that calms its first mode soonest."""
    omega = 0.5 * np.pi * np.sqrt(STRETCH / DENSITY)
    return hanging(across, air=calm(2.0 * omega), **explicit("symplectic_euler"))


def hanging_xpbd(across: int) -> float:
    """By small steps that solve it line by line, calmed."""
    return hanging(across, air=calm(10.0), solver="xpbd")


def sag_spread(scheme: str) -> float:
    """Largest over least sag of 32, 64 and 128 cells, less 1."""
    sags = [hanging_projective(across, scheme) for across in (32, 64, 128)]
    return float(max(sags) / min(sags) - 1.0)


def wave_speed(across: int = 64, **fields: Any) -> float:
    """Speed of a long wave along a narrow sheet between two pinned ends, over sqrt(Y / rho)."""
    sheet = {
        "kind": "sheet", "size": (1.0, 4.0 / across), "segments": (across, 4), "damping": 0.0,
    }  # fmt: skip
    system = springs(sheet, pins=pinned("left", "right"), **(fields or explicit("velocity_verlet")))
    x = places(system)
    mode = np.sin(np.pi * x[:, 0])
    start = x.copy()
    x[:, 0] += 1e-3 * mode
    system.write("position", x)
    seen = [(0.0, float(mode @ mode) * 1e-3)]

    def look(time: float, system: Any) -> None:
        seen.append((time, float(mode @ (places(system) - start)[:, 0])))

    run(system, 0.06, look, frames=240)
    when = crossings(*np.array(seen).T)
    half = (when[-1] - when[0]) / (len(when) - 1)
    return float(1.0 / half / np.sqrt(STRETCH / DENSITY))


def stiffness_at(angle: float, diagonals: int, shear: float = 300.0) -> float:
    """Of a sheet of 8 x 8 cells, [N/m], that is drawn out at `angle` [deg] and nowhere else.

    The work of the forces that the kernels give, for a homogeneous strain.
    """
    strain = 1e-4
    sheet = {"kind": "sheet", "segments": (8, 8), "shear": shear, "diagonals": diagonals}
    system = springs(sheet, **explicit("symplectic_euler"))
    x = places(system)
    n = np.array([np.cos(np.radians(angle)), 0.0, np.sin(np.radians(angle))])
    moved = strain * (x @ n)[:, None] * n
    system.write("position", x + moved)
    force = system.read("mass")[:, None] * acceleration(system)
    return float(-(force * moved).sum() / strain**2)


def law_at(diagonals: int, sign: int, shear: float = 300.0) -> float:
    """The same by the law: springs along u and v, and diagonals of 4 G in all along each or one of them."""
    c = 0.5 * (STRETCH + np.hypot(STRETCH, 2.0 * shear))
    own = {2: 2.0, 1: 4.0 if sign > 0 else 0.0}[diagonals] * shear
    return float(0.5 * (c - shear) + own)


def rolled_energy(**sheet: Any) -> float:
    """Elastic energy of a sheet rolled on a cylinder of radius 1 m, its cells flat [J]."""
    system = springs({"kind": "sheet", "segments": (32, 32), **sheet}, **explicit("symplectic_euler"))
    x = places(system)
    h, radius = 1.0 / 32, 1.0
    angle = 2.0 * np.arcsin(0.5 * h / radius) * np.round(x[:, 0] / h)
    x[:, 0], x[:, 1] = radius * np.sin(angle), radius * (1.0 - np.cos(angle))
    system.write("position", x)
    return float(system.diagnostics()["elastic_energy"])


CASES: tuple[Case, ...] = (
    *(
        Case(
            "springs", f"hanging sheet of {across} x {across} cells, {scheme}: sag",
            partial(hanging_projective, across, scheme), SAG, SAG_SOURCE, tolerance=SAG_TOLERANCE, unit="%",
            slow=across > 64,
        )
        for scheme in SCHEMES for across in (32, 64, 128)
    ),
    *(
        Case(
            "springs", f"hanging sheet of {across} x {across} cells, explicit: sag",
            partial(hanging_explicit, across), SAG, SAG_SOURCE, tolerance=SAG_TOLERANCE, unit="%",
            slow=across > 32,
        )
        for across in (32, 64)
    ),
    *(
        Case(
            "springs", f"hanging sheet of {across} x {across} cells, xpbd: sag",
            partial(hanging_xpbd, across), SAG, SAG_SOURCE, tolerance=SAG_TOLERANCE, unit="%",
            slow=across > 32,
        )
        for across in (32, 64, 128)
    ),
    *(
        Case(
            "springs", f"hanging sheet of 32, 64 and 128 cells, {scheme}: sags differ by",
            partial(sag_spread, scheme), 0.05, "resolution does not matter", comparison="below", slow=True,
        )
        for scheme in SCHEMES
    ),
    Case(
        "springs", "long wave along a sheet, velocity_verlet: speed over sqrt(Y / rho)", wave_speed, 1.0,
        "exact: 70.7 m/s here", tolerance=0.03,
    ),
    Case(
        "springs", "long wave along a sheet, bdf2 at 0.5 ms: speed over sqrt(Y / rho)",
        partial(wave_speed, 64, **projective("bdf2"), time_step={"largest": 5e-4}), 1.0,
        "exact: 70.7 m/s here", tolerance=0.03,
    ),
    *(
        Case(
            "springs", f"sheet of {words}, drawn at {45 * sign:+d} deg: stiffness",
            partial(stiffness_at, 45.0 * sign, diagonals), law_at(diagonals, sign),
            "exact: its springs' stiffness", tolerance=1e-3 * law_at(diagonals, sign), unit="N/m",
        )
        for diagonals, words in ((1, "one diagonal"), (2, "two diagonals")) for sign in (1, -1)
    ),
    Case(
        # Lengths are of float64 but for rounding.
        "springs", "sheet rolled on a cylinder, no bending stiffness: energy", rolled_energy, 1e-12,
        "exact: nothing is stretched", comparison="below", unit="J",
    ),
    Case(
        "springs", "sheet rolled on a cylinder: energy", partial(rolled_energy, bend=BEND), 0.5 * BEND,
        "exact: B / 2 times the curvature squared; half a cell at each end is flat",
        tolerance=0.04 * 0.5 * BEND, unit="J",
    ),
    Case(
        "springs", "sheet rolled on a cylinder, springs over two cells: energy",
        partial(rolled_energy, skip=10.0), 1e-9, "they resist folds", comparison="above", unit="J",
    ),
)  # fmt: skip
