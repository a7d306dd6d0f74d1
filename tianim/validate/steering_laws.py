"""Each steering behaviour against its law in float64, for boids at random places and velocities."""

from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tianim.validate.build import ALONE, acceleration, built, size, unit
from tianim.validate.case import Case
from tianim.validate.flocking import ROUNDING

Floats = NDArray[np.float64]

LAW = "exact: the law as stated, in float64"

TOP = 3.0  # top speed in the laws [m/s]
WEIGHT = 0.5
TARGET = (1.0, 2.0, -1.5)


def _seek(x: Floats, v: Floats, at: Any = TARGET) -> Floats:
    return TOP * unit(at - x) - v


def _flee(x: Floats, v: Floats, at: Any = TARGET, seen_at: Any = TARGET) -> Floats:
    return np.where(size(seen_at - x) < 4.0, -TOP * unit(at - x) - v, 0.0)


def _arrival(x: Floats, v: Floats, at: Any = TARGET) -> Floats:
    return TOP * np.minimum(size(at - x) / 3.0, 1.0) * unit(at - x) - v


def _ahead(x: Floats, other: Floats, other_v: Floats, horizon: float) -> Floats:
    """Where the other will be in the time that the way takes at top speed."""
    return np.asarray(other + np.minimum(horizon, size(other - x) / TOP) * other_v)


def _vortex(x: Floats, v: Floats) -> Floats:
    arm = x - (0.5, 0.0, -0.5)
    arm[:, 1] = 0.0
    r = size(arm) / 2.0
    return 1.5 * r * np.exp(0.5 * (1.0 - r**2)) * np.cross((0.0, 1.0, 0.0), unit(arm)) - v


def _cellular(x: Floats, v: Floats) -> Floats:
    p, q = (np.pi / 2.5 * x[:, :2]).T
    return 0.8 * np.stack([np.sin(p) * np.cos(q), -np.cos(p) * np.sin(q), 0.0 * p], axis=1) - v


def _roost(x: Floats, v: Floats) -> Floats:
    level = (TARGET - x) * (1.0, 0.0, 1.0)
    outside = np.clip(size(level) / 1.5 - 1.0, 0.0, 1.0)
    return outside * unit(level) + 0.3 * (TARGET - x) * (0.0, 1.0, 0.0)


def _box(x: Floats, v: Floats) -> Floats:
    p, half = x + 0.4 * v - TARGET, np.array([2.0, 1.5, 2.5])
    return -np.sign(p) * np.maximum(np.abs(p) - half + 1.0, 0.0)


def _ball(x: Floats, v: Floats) -> Floats:
    p = x + 0.4 * v - TARGET
    return -unit(p) * np.maximum(size(p) - 2.5 + 1.0, 0.0)


def _path(x: Floats, v: Floats) -> Floats:
    """A straight path along x from -20 to 20; the point 0.5 s ahead is what must stay near it."""
    p = x + 0.5 * v
    aim = np.stack([np.clip(p[:, 0], -20.0, 20.0) + 4.0, 0.0 * p[:, 0], 0.0 * p[:, 0]], axis=1)
    far = np.hypot(p[:, 1], p[:, 2])[:, None] > 1.0
    return np.where(far, TOP * unit(aim - x) - v, 0.0)


_POINT = {"kind": "point", "position": TARGET}
_REGION = {"kind": "containment", "margin": 1.0, "look_ahead": 0.4, "centre": TARGET}
_VORTEX = {"kind": "vortex", "centre": (0.5, 0.0, -0.5), "radius": 2.0, "speed": 1.5}
_PATH_POINTS = ((-20.0, 0.0, 0.0), (20.0, 0.0, 0.0))
LAWS: dict[str, tuple[Mapping[str, Any], Callable[[Floats, Floats], Floats]]] = {
    "seek": ({"kind": "seek", "target": _POINT}, _seek),
    "flee": ({"kind": "flee", "target": _POINT, "radius": 4.0}, _flee),
    "arrival": ({"kind": "arrival", "target": _POINT, "slowing_radius": 3.0}, _arrival),
    "cruise": ({"kind": "cruise", "speed": 1.2}, lambda x, v: (1.2 - size(v)) * unit(v)),
    "uniform flow": ({"kind": "flow", "field": {"kind": "uniform", "velocity": (0.5, 1.0, -1.0)}},
                     lambda x, v: (0.5, 1.0, -1.0) - v),
    "vortex": ({"kind": "flow", "field": _VORTEX}, _vortex),
    "cellular flow": ({"kind": "flow", "field": {"kind": "cellular", "size": 2.5, "speed": 0.8}}, _cellular),
    "roost": ({"kind": "roost", "centre": TARGET, "radius": 1.5, "vertical": 0.3}, _roost),
    "containment in a box": ({**_REGION, "size": (4.0, 3.0, 5.0)}, _box),
    "containment in a ball": ({**_REGION, "size": 2.5}, _ball),
    "path": ({"kind": "path", "points": _PATH_POINTS, "radius": 1.0, "ahead": 4.0}, _path),
}  # fmt: skip


def hunted(behaviour: Mapping[str, Any]) -> Any:
    """100 boids with that behaviour and one of another species, `other`, that moves."""
    return built(
        "boids", **ALONE, count=100, start={"kind": "ball", "radius": 4.0}, speed=1.5,
        limits={"max_speed": TOP, "max_acceleration": 1e6}, behaviours=({**behaviour, "weight": WEIGHT},),
        species={
            "other": {
                "count": 1, "start": {"kind": "points", "positions": (TARGET,)}, "speed": 1.0, **ALONE,
                "heading": {"kind": "along", "direction": (0.6, 0.0, 0.8)},
            }
        },
    )  # fmt: skip


_OTHER = np.array([TARGET]), np.array([[0.6, 0.0, 0.8]])
SPECIES_LAWS: dict[str, tuple[Mapping[str, Any], Callable[[Floats, Floats], Floats]]] = {
    "pursuit": (
        {"kind": "pursuit", "target": {"kind": "species", "name": "other"}, "horizon": 0.7},
        lambda x, v: _seek(x, v, _ahead(x, *_OTHER, 0.7)),
    ),
    "evasion": (
        {"kind": "evasion", "target": {"kind": "species", "name": "other"}, "horizon": 0.7, "radius": 4.0},
        lambda x, v: _flee(x, v, _ahead(x, *_OTHER, 0.7)),
    ),
    "leader following": (
        {"kind": "leader", "leaders": "other", "distance": 1.5, "slowing_radius": 3.0},
        lambda x, v: _arrival(x, v, _OTHER[0] - 1.5 * _OTHER[1]),
    ),
}


def law_error(name: str) -> float:
    """Largest difference to the law among boids at random places and velocities, relative to 1 + |a|."""
    if name in SPECIES_LAWS:
        behaviour, law = SPECIES_LAWS[name]
        system = hunted(behaviour)
    else:
        behaviour, law = LAWS[name]
        # Containment is stated in units of the acceleration limit: one m/s2 there, no limit elsewhere.
        most = 1.0 if name.startswith("containment") else 1e6
        system = built(
            "boids", **ALONE, count=100, start={"kind": "ball", "radius": 4.0}, speed=1.5,
            limits={"max_speed": TOP, "max_acceleration": most},
            behaviours=({**behaviour, "weight": WEIGHT},),
        )  # fmt: skip
    x, v = (system.read(key)[:100].astype(np.float64) for key in ("position", "velocity"))
    wanted = WEIGHT * law(x, v)
    if name.startswith("containment"):
        wanted *= np.minimum(1.0, 1.0 / np.maximum(size(wanted), 1e-30))
    if np.count_nonzero(size(wanted) > 0.0) < 20:
        return float("nan")
    return float((size(acceleration(system)[:100] - wanted) / (1.0 + size(wanted))).max())


CASES: tuple[Case, ...] = tuple(
    Case("boids", f"law of {name}", partial(law_error, name), ROUNDING, LAW, comparison="below")
    for name in (*LAWS, *SPECIES_LAWS)
)
