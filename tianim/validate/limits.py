"""What boids can do: limits, the order in which the budget is spent, banking."""

from functools import lru_cache, partial
from typing import Any

import numpy as np

from tianim.validate.build import acceleration, advance, built, rule, runner, size, unit
from tianim.validate.case import Case, Comparison

LIMITS = {"min_speed": 0.8, "max_speed": 1.6, "max_acceleration": 6.0, "max_turn_rate": 150.0}
# Angles are read from float32 velocities: 1e-7 rad of a turn of 0.04 rad a step.
BOUNDS: dict[str, tuple[Comparison, float]] = {
    "top speed": ("below", 1.0 + 1e-6),
    "least speed": ("above", 1.0 - 1e-6),
    "turn rate": ("below", 1.0 + 1e-4),
    "acceleration": ("below", 1.0 + 1e-5),
}


@lru_cache(maxsize=4)
def excess(dimension: int) -> dict[str, float]:
    """Of a crowd that wants more than it may: largest and least speed, turn and acceleration over the limits.

    The acceleration is measured in a second run, where speed and turning are free.
    """
    crowd: dict[str, Any] = {
        "count": 300, "dimension": dimension, "start": {"kind": "ball", "radius": 2.0}, "speed": 1.0,
        "separation": rule(1.0, 3.0), "alignment": rule(1.0), "cohesion": rule(1.5, 5.0),
        "behaviours": ({"kind": "wander", "weight": 20.0},),
    }  # fmt: skip
    # The budget limits what is spent in order, the integrator what is summed: one in each dimension.
    allocation = "prioritised" if dimension == 2 else "weighted"
    seen = {"top speed": 0.0, "least speed": np.inf, "turn rate": 0.0, "acceleration": 0.0}
    system, free = (
        built("boids", **crowd, limits=LIMITS),
        built("boids", **crowd, limits={"max_speed": 1e6, "max_acceleration": 6.0, "allocation": allocation}),
    )
    dt = 1 / 60
    for step in range(120):
        before, loose = (one.read("velocity").astype(np.float64) for one in (system, free))
        for one in (system, free):
            one.step(step * dt, dt)
        after, looser = (one.read("velocity").astype(np.float64) for one in (system, free))
        speed = size(after)
        cross = np.linalg.norm(np.cross(before, after), axis=1)
        turn = np.degrees(np.arctan2(cross, np.einsum("ij,ij->i", before, after))).max() / dt
        change = float(size(looser - loose).max()) / dt
        seen["top speed"] = max(seen["top speed"], float(speed.max()) / LIMITS["max_speed"])
        seen["least speed"] = min(seen["least speed"], float(speed.min()) / LIMITS["min_speed"])
        seen["turn rate"] = max(seen["turn rate"], float(turn) / LIMITS["max_turn_rate"])
        seen["acceleration"] = max(seen["acceleration"], change / LIMITS["max_acceleration"])
    return seen


def _excess(dimension: int, which: str) -> float:
    return excess(dimension)[which]


def bank_error() -> float:
    """Tangent of the bank in a steady level turn, over v omega / g."""
    omega = 0.8
    system = runner(limits={"max_speed": 1e3, "max_bank": 80.0, "bank_time": 0.2}, speed=10.0)
    system.add_force(lambda time, position, velocity: np.cross((0.0, omega, 0.0), velocity))
    advance(system, 180, 1 / 60)
    return float(system.read("lean")[0] * 9.81 / (np.linalg.norm(system.read("velocity")) * omega))


def urgent_first() -> float:
    """Where the budget is scarce, fleeing gets all of it: part of the acceleration that goes elsewhere."""
    system = built(
        "boids", count=100, start={"kind": "ball", "radius": 2.0}, separation=rule(3.0, 50.0), speed=0.5,
        limits={"max_speed": 100.0, "max_acceleration": 2.0},
        behaviours=({"kind": "flee", "target": {"kind": "point"}, "radius": 10.0, "weight": 5.0},),
    )  # fmt: skip
    x, v = (system.read(name).astype(np.float64) for name in ("position", "velocity"))
    wanted = 2.0 * unit(100.0 * unit(x) - v)
    return float((size(acceleration(system, 0.1) - wanted) / 2.0).max())


CASES: tuple[Case, ...] = (
    *(
        Case(
            "boids", f"limit of {which}, {dimension}D", partial(_excess, dimension, which), limit,
            "exact: the limit", comparison=comparison,
        )
        for dimension in (2, 3)
        for which, (comparison, limit) in BOUNDS.items()
    ),
    Case(
        "boids", "urgent behaviours are served first", urgent_first, 1e-5,
        "Reynolds 1987: prioritised allocation", comparison="below",
    ),
    Case(
        "boids", "bank in a steady turn over v omega / g", bank_error, 1.0,
        "exact: tan(bank) = v omega / g", tolerance=0.01,
    ),
)  # fmt: skip
