"""Systems for the cases, built as a scene would build them but without a scene."""

from collections.abc import Mapping
from typing import Any

from pydantic import TypeAdapter

from tianim.spatial.bodies import Bodies, BodyParams
from tianim.system import Bounds, World
from tianim.systems import SYSTEMS

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
    return kind_of.system("flock", params, world)  # type: ignore[call-arg]  # a protocol has no __init__


def advance(system: Any, steps: int, dt: float, start: float = 0.0) -> None:
    """So many steps of dt [s], from the time `start` [s] on; bodies move along."""
    world = getattr(system, "world", None)
    for step in range(steps):
        time = start + step * dt
        if world is not None:
            world.bodies.move(time, dt)
        system.step(time, dt)
