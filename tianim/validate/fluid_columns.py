"""Water at rest: the pressure and the level of a column, and how much water is squeezed.

A column of depth H has P = rho g (H - y). It must stay as high as it was: particles that pile up at walls,
or a solver that stops too early, show as a level that sinks.
"""

from functools import lru_cache, partial
from typing import Any, NamedTuple

import numpy as np

from tianim.validate.case import Case
from tianim.validate.fluid_tanks import (
    DENSITY,
    GRAVITY,
    METHODS,
    box,
    height,
    places,
    run,
    speeds,
    tank,
    water,
)

EXACT = "exact: P = rho g (H - y)"
DEPTH = 1.0
# Until then the start has come to rest; how long the fast and the slow cases watch [s].
SETTLED, BRIEFLY, WATCHED = 3.0, 1.0, 5.0
# Mean density error allowed by method [%]: VALIDATION's gates.
DENSITY_ERROR = {"dfsph": 0.1, "pbf": 1.0, "wcsph": 1.0}


class Rest(NamedTuple):
    """Of a column that has settled; shares of what the depth gives."""

    slope: float  # of the pressure over -rho g
    rms: float  # of the pressure's error, over rho g H [%]
    speed: float  # largest, over sqrt(g H)
    density: float  # mean error [%]
    level: float  # how far it moved, in spacings


@lru_cache(maxsize=8)
def rest(method: str, layers: int, until: float) -> Rest:
    """A column with so many layers, watched from SETTLED until `until` [s]."""
    d = DEPTH / layers
    wide = 0.5
    system = water(
        d, {"column": box((0.0, 0.0), (wide, DEPTH))}, tank((0.0, 0.0), (wide, 1.5 * DEPTH)), method
    )
    layer, pressure, fastest, squeezed = [], [], [], []

    def look(time: float, system: object) -> None:
        if time > SETTLED:
            layer.append(places(system)[:, 1] / d)
            pressure.append(system.read("pressure"))  # type: ignore[attr-defined]
            fastest.append(np.linalg.norm(speeds(system), axis=1).max())
            squeezed.append(np.maximum(system.read("density") - 1.0, 0.0).mean())  # type: ignore[attr-defined]

    run(system, until, look)
    # Means over time and over layers a spacing thick; the uppermost and lowest touch air and ground.
    y, p = np.concatenate(layer), np.concatenate(pressure)
    row = np.minimum(y.astype(int), layers)
    count = np.maximum(np.bincount(row, minlength=layers + 1), 1)
    y, p = (np.bincount(row, values, minlength=layers + 1) / count for values in (d * y, p))
    y, p = y[1 : layers - 1], p[1 : layers - 1]
    weight = DENSITY * GRAVITY
    return Rest(
        float(-np.polyfit(y, p, 1)[0] / weight),
        float(100.0 * np.sqrt(np.mean((p - weight * (DEPTH - y)) ** 2)) / (weight * DEPTH)),
        float(max(fastest) / np.sqrt(GRAVITY * DEPTH)),
        float(100.0 * np.mean(squeezed)),
        float(abs(DEPTH - height(places(system), d)) / d),
    )


def _rest(method: str, layers: int, until: float, which: str) -> float:
    return float(getattr(rest(method, layers, until), which))


@lru_cache(maxsize=8)
def squeeze(iterations: int, layers: int) -> float:
    """PBF with so many iterations a step: mean density error of a settled column [%]."""
    d = DEPTH / layers
    system = water(
        d, {"column": box((0.0, 0.0), (0.3, DEPTH))}, tank((0.0, 0.0), (0.3, 1.5 * DEPTH)), "pbf",
        pbf={"least_iterations": iterations, "most_iterations": iterations},
        time_step={"largest": 1.0 / 240.0},
    )  # fmt: skip
    run(system, 1.0)
    return float(100.0 * np.maximum(system.read("density") - 1.0, 0.0).mean())


def squeeze_ratio(few: int, many: int) -> float:
    """The error after `many` iterations over that after `few`."""
    return squeeze(many, 20) / squeeze(few, 20)


def _worst_p99(system: Any, since: float, until: float) -> float:
    """Largest 99 % density error after the steps from `since` to `until` [s], in percent."""
    worst = [0.0]

    def look(time: float, system: Any) -> None:
        if time > since:
            worst.append(float(np.percentile(np.maximum(system.read("density") - 1.0, 0.0), 99)))

    run(system, until, look)
    return 100.0 * max(worst)


@lru_cache(maxsize=4)
def splash(method: str) -> float:
    """Two columns fall together: largest 99 % density error from 0.1 s to 1 s [%]."""
    d = 0.025
    blocks = {"left": box((0.0, 0.0), (0.4, 0.8)), "right": box((1.2, 0.0), (1.6, 0.8))}
    return _worst_p99(water(d, blocks, tank((0.0, 0.0), (1.6, 1.6)), method), 0.1, 1.0)


@lru_cache(maxsize=1)
def deep_start() -> float:
    """A slab of 82 layers that begins to fall apart, DFSPH: largest 99 % density error after 0.03 s [%].

    Steps that are too long for the pressure at its foot buckle the lattice there, to 15 %.
    """
    deep, across = 1.5, 8
    d = deep / 82
    system = water(
        d, {"column": box((0.0, 0.0, 0.0), (1.0, deep, across * d))},
        tank((0.0, 0.0, 0.0), (3.0, 2.0 * deep, across * d)), "dfsph", dimension=3,
    )  # fmt: skip
    return _worst_p99(system, 0.03, 0.12)


def _at_rest(method: str, layers: int, until: float, slow: bool) -> tuple[Case, ...]:
    """The gates of a hydrostatic column."""
    limits = (
        ("slope", "slope of the pressure over rho g", 1.0, 0.02, "equal", ""),
        ("rms", "RMS error of the pressure over rho g H", 3.0, 0.0, "below", "%"),
        ("speed", "largest speed over sqrt(g H)", 0.02, 0.0, "below", ""),
        ("density", "mean density error", DENSITY_ERROR[method], 0.0, "below", "%"),
        ("level", "change of height in spacings", 1.0, 0.0, "below", ""),
    )
    return tuple(
        Case(
            "fluid", f"column of {layers} layers, {method}, {until:g} s: {name}",
            partial(_rest, method, layers, until, which), expected, EXACT, tolerance=tolerance,
            comparison=comparison, unit=unit, slow=slow,  # type: ignore[arg-type]
        )
        for which, name, expected, tolerance, comparison, unit in limits
    )  # fmt: skip


CASES: tuple[Case, ...] = (
    *(case for method in METHODS for case in _at_rest(method, 20, SETTLED + BRIEFLY, False)),
    *(case for method in METHODS for case in _at_rest(method, 20, SETTLED + WATCHED, True)),
    *(case for layers in (40, 80) for case in _at_rest("pbf", layers, SETTLED + BRIEFLY, True)),
    *(case for case in _at_rest("dfsph", 40, SETTLED + BRIEFLY, True)),
    *(
        Case(
            "fluid", f"PBF, {many} iterations over {few}: mean density error",
            partial(squeeze_ratio, few, many), 1.0, "theory: each iteration brings it nearer",
            comparison="below",
        )
        for few, many in ((2, 4), (4, 8), (8, 16))
    ),
    Case(
        "fluid", "82 layers begin to fall apart, dfsph: largest 99 % density error", deep_start, 2.0,
        "the solver's tolerance: a mean of 0.05 %", comparison="below", unit="%",
    ),
    Case(
        "fluid", "two columns collide, PBF: largest 99 % density error", partial(splash, "pbf"), 5.0,
        "the issue's gate; SPlisHSPlasH's PBF shows 10 to 12 %", comparison="below", unit="%",
    ),
)  # fmt: skip
