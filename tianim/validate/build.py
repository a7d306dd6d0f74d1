"""Systems for the cases, built as a scene would build them but without a scene."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydantic import TypeAdapter

from tianim.spatial.bodies import Bodies, BodyParams
from tianim.system import Bounds, World
from tianim.systems import SYSTEMS

Floats = NDArray[np.float64]

OPEN = Bounds()


def periodic(length: float, lower: float = 0.0) -> Bounds:
    """A periodic cube [m]."""
    return Bounds("periodic", (lower,) * 3, (lower + length,) * 3)


def built(
    kind: str,
    bounds: Bounds = OPEN,
    seed: int = 1,
    bodies: Mapping[str, Mapping[str, Any]] | None = None,
    **fields: Any,
) -> Any:
    """A system of that kind at its start; `fields` and `bodies` as a scene file has them."""
    shapes = TypeAdapter(dict[str, BodyParams]).validate_python(dict(bodies or {}))
    kind_of = SYSTEMS[kind]
    params = kind_of.params.model_validate({"kind": kind, **fields})
    world = World(bounds, Bodies(shapes), seed)
    world.bodies.move(0.0, 1.0)
    return kind_of.system("flock", params, world)


def advance(system: Any, steps: int, dt: float, start: float = 0.0) -> None:
    """So many steps of dt [s], from the time `start` [s] on; bodies move along."""
    world = getattr(system, "world", None)
    for step in range(steps):
        time = start + step * dt
        if world is not None:
            world.bodies.move(time, dt)
        system.step(time, dt)


def rule(radius: float, weight: float = 1.0, field_of_view: float = 360.0) -> dict[str, float]:
    """A rule of the flock as a scene file has it."""
    return {"radius": radius, "weight": weight, "field_of_view": field_of_view}


OFF = rule(0.0, 0.0)
ALONE: dict[str, Any] = {"separation": OFF, "alignment": OFF, "cohesion": OFF}


def runner(**fields: Any) -> Any:
    """One boid at the origin that heads along x at 1 m/s, 2 m/s at most."""
    start = {"kind": "points", "positions": ((0.0, 0.0, 0.0),)}
    heading = {"kind": "along", "direction": (1.0, 0.0, 0.0)}
    return built(
        "boids", **{**ALONE, "start": start, "heading": heading, "limits": {"max_speed": 2.0}, **fields}
    )


def acceleration(system: Any, dt: float = 1.0) -> Floats:
    """What a step of dt [s] adds to the velocities, over dt, (n, 3) [m/s2] in id order; then as it was."""
    position, velocity = system.read("position"), system.read("velocity")
    system.step(0.0, dt)
    after = system.read("velocity")
    system.write("position", position)
    system.write("velocity", velocity)
    return np.asarray((after.astype(np.float64) - velocity) / dt)


def size(d: Floats) -> Floats:
    """Lengths (n, 1) of vectors (n, 3)."""
    return np.asarray(np.linalg.norm(d, axis=1, keepdims=True))


def unit(d: Floats) -> Floats:
    """Directions of vectors (n, 3), zero for zero."""
    length = size(d)
    return np.asarray(d / np.where(length > 0.0, length, 1.0))
