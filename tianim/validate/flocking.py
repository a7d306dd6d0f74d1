"""The three rules of the flock: against brute force, invariants, cohesion when a flock expands, convergence.

Accelerations are taken from one step of the very system, as (v' - v) / dt with limits far away.
"""

from functools import lru_cache, partial
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse.csgraph import connected_components

from tianim.system import Bounds
from tianim.validate.build import OFF, OPEN, acceleration, advance, built, periodic, rule
from tianim.validate.case import Case
from tianim.validate.oracle import Flock

Floats = NDArray[np.float64]

REYNOLDS = "Reynolds 1987, SIGGRAPH, DOI 10.1145/37402.37406"
EXACT = "exact: float64 sums over all pairs"
SYMMETRY = "exact: symmetry of the law"
TOPO = "Ballerini et al. 2008, PNAS 105, 1232: cohesion of the 7 nearest does not depend on density"

# Sums of some 50 terms in float32 (rounding 6e-8 each), relative to the size of the terms.
ROUNDING = 1e-6
NO_LIMITS = {"max_speed": 1e9, "max_acceleration": 1e12}


PLAIN: dict[str, Any] = {
    "count": 300,
    "start": {"kind": "ball", "radius": 3.0},
    "separation": rule(1.0, 0.5),
    "alignment": rule(1.5),
    "cohesion": rule(2.0, 2.0),
    "limits": NO_LIMITS,
}
SIGHTED = {
    "separation": rule(1.0, 0.5, 120.0),
    "alignment": rule(1.5, 1.0, 200.0),
    "cohesion": rule(2.0, 2.0, 300.0),
}
TWO_SPECIES = {
    "species": {
        "others": {
            "count": 80, "speed": 2.0, "start": {"kind": "ball", "radius": 3.0}, "limits": NO_LIMITS,
            "separation": rule(0.7), "alignment": rule(2.0, 0.3, 250.0), "cohesion": rule(1.2),
        }
    },
    "interactions": {
        "flock": {"others": {"separation": 2.0, "alignment": 0.5, "cohesion": 0.25}},
        "others": {"flock": {"separation": 0.0, "cohesion": 3.0}, "others": {"alignment": 0.0}},
    },
}  # fmt: skip
SCARCE = {"limits": {"max_speed": 1e9, "max_acceleration": 5.0}}
FLOCKS: dict[str, tuple[dict[str, Any], Bounds]] = {
    "three dimensions": ({}, OPEN),
    "two dimensions": ({"dimension": 2, "count": 150}, OPEN),
    "three fields of view": (SIGHTED, OPEN),
    "7 nearest": ({"neighbourhood": {"kind": "topological", "k": 7}}, OPEN),
    "nearest one, in view": ({"neighbourhood": {"kind": "topological", "k": 1}, **SIGHTED}, OPEN),
    "20 nearest in two dimensions": (
        {"neighbourhood": {"kind": "topological", "k": 20}, "dimension": 2, "count": 200},
        OPEN,
    ),
    "prioritised budget": (SCARCE, OPEN),
    "budget of the sum": ({"limits": {**SCARCE["limits"], "allocation": "weighted"}}, OPEN),
    "periodic box": ({"start": {"kind": "box", "size": (8.0, 8.0, 8.0)}}, periodic(8.0, -4.0)),
    "two species": (TWO_SPECIES, OPEN),
    "two species, 7 nearest, budget": (
        {**TWO_SPECIES, **SCARCE, "neighbourhood": {"kind": "topological", "k": 7}},
        OPEN,
    ),
}


def flock_of(name: str, **more: Any) -> Any:
    """One of FLOCKS at its start."""
    fields, bounds = FLOCKS[name]
    return built("boids", bounds, **{**PLAIN, **fields, **more})


def oracle_of(system: Any) -> Flock:
    """The brute force of the same flock."""
    return Flock(system.params, system.read("position"), system.read("velocity"), system.world.bounds)


def rules_error(name: str) -> float:
    """Largest difference to brute force, relative to the size of the terms."""
    system = flock_of(name)
    oracle = oracle_of(system)
    difference = np.linalg.norm(acceleration(system) - oracle.acceleration(), axis=1)
    return float((difference / oracle.scale()).max())


def changed_by(system: Any, turn: Floats, order: NDArray[np.int64]) -> float:
    """How the accelerations change, beside by the turn itself, when the flock is turned and renumbered."""
    before, scale = acceleration(system), oracle_of(system).scale()
    for name in ("position", "velocity"):
        system.write(name, (system.read(name) @ turn)[order].astype(np.float32))
    difference = np.linalg.norm(acceleration(system) - (before @ turn)[order], axis=1)
    return float((difference / scale[order]).max())


def mirror_error() -> float:
    """Mirrored in x: every component must come out mirrored."""
    return changed_by(flock_of("three fields of view"), np.diag([-1.0, 1.0, 1.0]), np.arange(300))


def storage_error() -> float:
    """Ids dealt out anew, so that cells hold their boids in another order."""
    return changed_by(flock_of("7 nearest"), np.eye(3), np.random.default_rng(2).permutation(300))


def momentum_error() -> float:
    """Momentum that alignment makes as an unnormalised pair sum, relative to what flows between boids.

    With a_i = mean(v_j) - v_i over n_i neighbours, n_i a_i = sum(v_j - v_i): the total is zero where
    whoever minds is minded. The n_i come from the flock itself (see `minds`).
    """
    system = flock_of("three dimensions", separation=OFF, cohesion=OFF, alignment=rule(1.5))
    pair_sum = minds(system).sum(axis=1)[:, None] * acceleration(system)
    return float(np.linalg.norm(pair_sum.sum(axis=0)) / np.linalg.norm(pair_sum, axis=1).sum())


def minds(system: Any) -> NDArray[np.bool_]:
    """[i, j]: boid i aligns to boid j, read off its accelerations.

    Three boids at a time move, each along another axis, and all others are at rest: who then
    accelerates along an axis has that boid as a neighbour. Needs an alignment that sees all round.
    """
    count, velocity = system.count, system.read("velocity")
    graph = np.zeros((count, count), bool)
    for first in range(0, count, 3):
        group = range(first, min(first + 3, count))
        probe = np.zeros((count, 3), np.float32)
        for axis, j in enumerate(group):
            probe[j, axis] = 1.0
        system.write("velocity", probe)
        pulled = acceleration(system)
        for axis, j in enumerate(group):
            graph[:, j] = pulled[:, axis] > 0.0
    system.write("velocity", velocity)
    return graph


@lru_cache(maxsize=4)
def expansion(kind: str) -> tuple[int, int, int]:
    """A flock is drawn out to twice its size: clusters before and after, pairs of neighbours changed."""
    neighbourhood = {"kind": "topological", "k": 7} if kind == "topological" else {"kind": "metric"}
    # The metric radius gives 7 neighbours on average before; the topological one reaches everybody.
    radius = 40.0 if kind == "topological" else 10.0 * (7 / 300) ** (1 / 3) * 1.25
    system = flock_of(
        "three dimensions", start={"kind": "ball", "radius": 10.0}, neighbourhood=neighbourhood,
        separation=OFF, cohesion=OFF, alignment=rule(radius),
    )  # fmt: skip
    before = minds(system)
    system.write("position", 2.0 * system.read("position"))
    after = minds(system)
    clusters = [int(connected_components(graph, directed=False)[0]) for graph in (before, after)]
    return clusters[0], clusters[1], int(np.count_nonzero(before != after))


def _expansion(kind: str, which: int) -> float:
    return float(expansion(kind)[which])


def pair_of(velocity: list[list[float]], **fields: Any) -> Any:
    """Two boids half a metre from the origin on either side, on a line askew to the axes."""
    way = np.array([1.0, 1.7, -0.6]) / np.linalg.norm([1.0, 1.7, -0.6])
    start = {"kind": "points", "positions": (tuple(-0.5 * way), tuple(0.5 * way))}
    rules = {"separation": rule(2.0), "alignment": rule(2.0), "cohesion": rule(2.0)} | fields
    system = built("boids", start=start, limits=NO_LIMITS, **rules)
    system.write("velocity", np.asarray(velocity, np.float32))
    return system


def pair_leaves_its_line() -> float:
    """Two boids at rest part: how far from their line they get, relative to the way they make."""
    system = pair_of([[0.0] * 3] * 2, cohesion=OFF)
    line = system.read("position")[1].astype(np.float64)
    line /= np.linalg.norm(line)
    advance(system, 100, 0.01)
    moved = system.read("position").astype(np.float64) - [-0.5 * line, 0.5 * line]
    along = moved @ line
    if not (along[0] < -0.1 and along[1] > 0.1):
        return float("nan")
    return float(np.abs(moved - along[:, None] * line).max() / np.abs(along).max())


def pair_drift() -> float:
    """Way of the centre of two boids that move symmetrically, relative to their own way, in 3 s."""
    velocity = [[0.4, -0.1, 0.3], [-0.4, 0.1, -0.3]]
    system = pair_of(velocity)
    way = 0.0
    for step in range(300):
        before = system.read("position").astype(np.float64)
        system.step(0.01 * step, 0.01)
        way += float(np.linalg.norm(system.read("position") - before, axis=1).mean())
    return float(np.linalg.norm(system.read("position").astype(np.float64).mean(axis=0)) / way)


def convergence_order() -> float:
    """Observed order of the step, from three runs of the flock as a smooth ODE, each step half the last.

    Everybody sees everybody and nothing is limited, so that the right-hand side is smooth.
    """
    ends = []
    for halvings in range(3):
        system = flock_of(
            "three dimensions", count=20, start={"kind": "ball", "radius": 2.0},
            separation=rule(50.0, 0.3), alignment=rule(50.0, 0.5), cohesion=rule(50.0),
        )  # fmt: skip
        advance(system, 100 << halvings, 0.01 / 2**halvings)
        ends.append(system.read("position").astype(np.float64))
    return float(np.log2(np.linalg.norm(ends[0] - ends[1]) / np.linalg.norm(ends[1] - ends[2])))


def order_of(dimension: int) -> float:
    """Polarisation after 30 s of a flock that starts with random headings in a periodic box."""
    side = 8.0 if dimension == 2 else 6.0
    system = built(
        "boids", periodic(side), count=400, dimension=dimension,
        start={"kind": "box", "centre": (side / 2,) * 3, "size": (side,) * 3}, speed=1.0,
        separation=rule(0.5, 0.1), alignment=rule(1.5, 2.0), cohesion=rule(1.5, 0.5),
        limits={"min_speed": 0.5, "max_speed": 1.5},
    )  # fmt: skip
    if system.diagnostics()["polarisation"] > 0.3:
        return float("nan")
    advance(system, 600, 0.05)
    return float(system.diagnostics()["polarisation"])


def out_of_plane() -> float:
    """Largest z or v_z [m, m/s] of a flock in two dimensions after 5 s with wander and walls."""
    system = built(
        "boids", Bounds("contained", (-4.0,) * 3, (4.0,) * 3), count=200, dimension=2,
        start={"kind": "ball", "radius": 3.0}, behaviours=({"kind": "wander"}, {"kind": "containment"}),
    )  # fmt: skip
    advance(system, 300, 1 / 60)
    return float(max(np.abs(system.read(name)[:, 2]).max() for name in ("position", "velocity")))


equal = partial(Case, "boids")
below = partial(Case, "boids", comparison="below")
above = partial(Case, "boids", comparison="above")
CASES: tuple[Case, ...] = (
    *(
        below(f"three rules against brute force, {name}", partial(rules_error, name), ROUNDING, EXACT)
        for name in FLOCKS
    ),
    below("alignment as a pair sum conserves momentum", momentum_error, ROUNDING, SYMMETRY),
    below("mirrored flock, mirrored accelerations", mirror_error, ROUNDING, SYMMETRY),
    below("another storage order, the same accelerations", storage_error, ROUNDING, SYMMETRY),
    below("two at rest part along their line", pair_leaves_its_line, 1e-5, SYMMETRY),
    below("a symmetric pair does not drift", pair_drift, 1e-5, SYMMETRY),
    equal(
        "7 nearest: clusters when drawn out to twice the size",
        partial(_expansion, "topological", 1),
        1.0,
        TOPO,
    ),
    equal("7 nearest: neighbours changed by drawing out", partial(_expansion, "topological", 2), 0.0, TOPO),
    equal("metric radius: clusters of the same flock", partial(_expansion, "metric", 0), 1.0, TOPO),
    above("metric radius: clusters when drawn out", partial(_expansion, "metric", 1), 30.0, TOPO),
    equal("order of the step", convergence_order, 1.0, "exact: order 1, semi-implicit Euler", tolerance=0.1),
    *(
        above(
            f"polarisation from random headings in {dimension}D", partial(order_of, dimension), 0.9, REYNOLDS
        )
        for dimension in (2, 3)
    ),
    below("two dimensions: way out of the plane [m]", out_of_plane, 0.0, SYMMETRY),
)
