"""Gravity's forces: the momentum that they keep, and the errors of the tree wherever stars are."""

from functools import lru_cache, partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tianim.lang import ti
from tianim.spatial.columns import staggered
from tianim.systems.gravity.solver import Law, make_solver
from tianim.validate.case import Case
from tianim.validate.gravity import cluster, run, simulated

Floats = NDArray[np.float64]


def momentum_drift(count: int, steps: int, solver: dict[str, Any]) -> float:
    """|change of momentum| over the sum of m |v|, after so many steps of a cluster."""
    system = simulated(
        cluster(count), softening={"length": 0.05}, time_step={"kind": "fixed", "length": 1 / 32},
        solver={"check_every": 0, **solver},
    )  # fmt: skip
    start = system.stars.totals()
    now = run(system, steps, 1 / 32).stars.totals()
    return float(np.linalg.norm(now.momentum - start.momentum) / start.speed)


# Where stars are, for the errors of the tree.
COUNT = 20_000


def _places(setup: str) -> Floats:
    rng = np.random.default_rng(11)
    direction = rng.standard_normal((COUNT, 3))
    direction /= np.linalg.norm(direction, axis=1)[:, None]
    sphere = ((rng.uniform(0.0, 0.99, COUNT) ** (-2 / 3) - 1.0) ** -0.5)[:, None] * direction
    if setup == "Plummer":
        return sphere
    if setup == "two far clusters":
        return sphere + np.where(np.arange(COUNT) % 2 == 0, -500.0, 500.0)[:, None] * np.array(
            [1.0, 0.0, 0.0]
        )
    if setup == "200 places of 100 stars":
        return np.repeat(sphere[:200], COUNT // 200, axis=0)
    if setup == "all in one line":
        return rng.uniform(-1.0, 1.0, COUNT)[:, None] * np.array([[1.0, 0.0, 0.0]])
    # A disk in a halo.
    radius, angle = rng.gamma(2.0, 1.0, COUNT), rng.uniform(0.0, 2.0 * np.pi, COUNT)
    height = 0.1 * np.arctanh(rng.uniform(-0.999, 0.999, COUNT))
    disk = np.stack([radius * np.cos(angle), height, radius * np.sin(angle)], axis=1)
    return np.where(np.arange(COUNT)[:, None] % 5 < 2, disk, 5.0 * sphere)


@lru_cache(maxsize=8)
def tree_error(setup: str) -> tuple[float, float]:
    """Median and 99 % of the relative error of the tree's forces at an accuracy of 1e-3."""
    position = _places(setup)
    capacity = staggered(COUNT)
    x, a = ti.ndarray(ti.f64, (3, capacity)), ti.ndarray(ti.f64, (3, capacity))
    mass, phi = ti.ndarray(ti.f64, capacity), ti.ndarray(ti.f64, capacity)
    padded = np.zeros((3, capacity))
    padded[:, :COUNT] = position.T
    x.from_numpy(padded)
    mass.from_numpy(np.where(np.arange(capacity) < COUNT, 1.0 / COUNT, 0.0))
    solver = make_solver(COUNT, Law(1.0, 0.01), 1e-3, "tree", "auto", COUNT)
    solver.evaluate(x, mass, a, phi)
    median, tail = solver.sample_error(x, mass, a, 3)
    return float(median), float(tail)


def _tree(setup: str, which: int) -> float:
    return tree_error(setup)[which]


# How many times the asked error each may have: in a line and between heaps pulls cancel, errors do not.
SETUPS = {
    "Plummer": 1.0,
    "galaxy": 1.0,
    "two far clusters": 1.0,
    "200 places of 100 stars": 10.0,
    "all in one line": 10.0,
}
CASES: tuple[Case, ...] = (
    Case(
        "gravity", "momentum, direct sum in float64, 100 steps",
        partial(momentum_drift, 500, 100, {"precision": "double"}),
        1e-13, "exact: forces in pairs", comparison="below",
    ),
    Case(
        "gravity", "momentum, direct sum in float32, 100 steps",
        partial(momentum_drift, 3000, 100, {"kind": "direct", "precision": "single"}), 1e-6,
        "measured with falcON and direct sums: round-off of float32", comparison="below",
    ),
    Case(
        "gravity", "momentum, tree, 50 steps", partial(momentum_drift, 5000, 50, {"kind": "tree"}), 1e-13,
        "exact: the net force is taken from a tree's forces", comparison="below",
    ),
    *(
        Case("gravity", f"tree at 1e-3, {setup}: {what} error", partial(_tree, setup, which), limit * more,
             "against float64 direct sums of 1,000 stars", comparison="below")
        for setup, more in SETUPS.items()
        for which, what, limit in ((0, "median", 1e-3), (1, "99 %", 1e-2))
    ),
)  # fmt: skip
