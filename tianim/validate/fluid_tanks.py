"""Water for the cases: how it is set up, run and measured, for all files of fluid cases."""

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from tianim.system import Bounds
from tianim.validate.build import OPEN, built

Floats = NDArray[np.float64]
Corner = tuple[float, ...]

METHODS = ("dfsph", "pbf", "wcsph")
GRAVITY = 9.81
DENSITY = 1000.0
NONE = (0.0, 0.0, 0.0)
# Particles nearer than this many spacings hang together: past the diagonal of a square of four.
LINK = 1.6
# A particle with fewer neighbours than this is spray.
FEWEST = 3


def corners(lower: Corner, upper: Corner) -> tuple[tuple[float, float, float], tuple[float, float, float]]:
    """Two points of space, or of the plane z = 0, as three numbers; there z counts for nothing."""
    low, high = (*lower, -0.5)[:3], (*upper, 0.5)[:3]
    return (low[0], low[1], low[2]), (high[0], high[1], high[2])


def tank(lower: Corner, upper: Corner) -> Bounds:
    """A box with walls [m]."""
    return Bounds("contained", *corners(lower, upper))


def box(lower: Corner, upper: Corner, **more: Any) -> dict[str, Any]:
    """A block of water between two corners [m]."""
    low, high = corners(lower, upper)
    return {"kind": "box", "lower": low, "upper": high, **more}


def water(
    spacing: float,
    blocks: Mapping[str, Mapping[str, Any]],
    bounds: Bounds = OPEN,
    method: str = "dfsph",
    bodies: Mapping[str, Mapping[str, Any]] | None = None,
    **fields: Any,
) -> Any:
    """A fluid at its start, flat unless `dimension` says otherwise."""
    fields.setdefault("dimension", 2)
    return built(
        "fluid", bounds, bodies=bodies, method=method, spacing=spacing, blocks=dict(blocks), **fields
    )


def run(
    system: Any,
    until: float,
    look: Callable[[float, Any], None] | None = None,
    start: float = 0.0,
) -> Any:
    """The system at `until` [s], in steps as long as it may take; `look(time, system)` after each."""
    time = start
    while until - time > 1e-9:
        steps = np.ceil((until - time) / system.max_step() * (1.0 - 1e-9))
        dt = (until - time) / max(steps, 1.0)
        system.world.bodies.move(time, dt)
        system.step(time, dt)
        time += dt
        if look is not None:
            look(time, system)
    return system


def places(system: Any) -> Floats:
    """Positions (n, 3) [m] in float64."""
    return np.asarray(system.read("position"), np.float64)


def speeds(system: Any) -> Floats:
    """Velocities (n, 3) [m/s] in float64."""
    return np.asarray(system.read("velocity"), np.float64)


def bulk(x: Floats, spacing: float) -> Floats:
    """The particles (m, 3) that hang together with most others, without spray."""
    pairs = cKDTree(x).query_pairs(LINK * spacing, output_type="ndarray")
    count = len(x)
    links = coo_array((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(count, count))
    _, group = connected_components(links, directed=False)
    neighbours = np.bincount(pairs.ravel(), minlength=count)
    return x[(group == np.bincount(group).argmax()) & (neighbours >= FEWEST)]


def height(x: Floats, spacing: float) -> float:
    """Level of water at rest [m]: half a spacing above the mean of the highest row's particles."""
    columns = np.floor((x[:, 0] - x[:, 0].min()) / (2.0 * spacing)).astype(int)
    tops = np.full(columns.max() + 1, -np.inf)
    np.maximum.at(tops, columns, x[:, 1])
    return float(tops[np.isfinite(tops)].mean() + 0.5 * spacing)
