"""What the air does to sheets: how fast they fall, how the wind pushes them."""

from functools import partial

import numpy as np

from tianim.validate.case import Case
from tianim.validate.springs_scenes import (
    DOWN,
    GRAVITY,
    SCHEMES,
    explicit,
    projective,
    run,
    speeds,
    springs,
)


def falling_sheet(solver: str) -> float:
    """Speed of a falling sheet over sqrt(2 m g / (rho A C))."""
    rho, across, density = 1.2, 1.1, 0.2
    # Stiff enough to fall flat.
    sheet = {"kind": "sheet", "size": (0.5, 0.5), "segments": (8, 8), "density": density, "bend": 0.1}
    fields = projective(solver) if solver in SCHEMES else explicit(solver)
    system = springs(sheet, gravity=DOWN, air={"density": rho, "normal": across}, **fields)
    run(system, 1.5)
    exact = np.sqrt(2.0 * density * GRAVITY / (rho * across))
    return float(-speeds(system)[:, 1].mean() / exact)


def wind_on_a_tilted_sheet() -> float:
    """Largest error of the air's force on a tilted sheet in the wind, over that force."""
    rho, across, along, wind = 1.2, 1.1, 0.3, np.array([3.0, 1.0, -2.0])
    angle, size = np.radians(30.0), 0.5
    v = (0.0, np.sin(angle), np.cos(angle))
    system = springs(
        {"kind": "sheet", "size": (size, size), "segments": (5, 7), "v": v, "velocity": (0.5, 0.0, 0.0)},
        air={"density": rho, "normal": across, "tangential": along, "wind": tuple(wind)},
        **explicit("symplectic_euler"),
    )  # fmt: skip
    before, mass, h = speeds(system), system.read("mass"), 1e-4
    system.step(0.0, h)
    force = mass @ (speeds(system) - before) / h
    u = wind - (0.5, 0.0, 0.0)
    n = np.cross((1.0, 0.0, 0.0), v)
    un = u @ n
    law = 0.5 * rho * size**2 * (across * abs(un) * un * n + along * np.linalg.norm(u) * (u - un * n))
    return float(np.abs(force - law).max() / np.linalg.norm(law))


CASES: tuple[Case, ...] = (
    *(
        Case("springs", f"falling sheet, {solver}: speed over sqrt(2 m g / (rho A C))",
             partial(falling_sheet, solver), 1.0, "exact: drag and weight are even", tolerance=0.02)
        for solver in ("symplectic_euler", "bdf2")
    ),
    Case(
        "springs", "wind on a tilted sheet: error of its force", wind_on_a_tilted_sheet, 1e-5,
        "exact: rho / 2 A (C_n |u_n| u_n + C_t |u| u_t)", comparison="below",
    ),
)  # fmt: skip
