"""Steering: each behaviour against its law in float64, what it is for, and the limits that all obey."""

from collections.abc import Callable, Mapping
from functools import lru_cache, partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tianim.system import Bounds
from tianim.validate.build import OPEN, advance, built
from tianim.validate.case import Case, Comparison
from tianim.validate.flocking import OFF, ROUNDING, acceleration, rule

Floats = NDArray[np.float64]

STEERING = "Reynolds 1999, GDC, Steering Behaviors For Autonomous Characters"
LAW = "exact: the law as stated, in float64"

TOP = 3.0  # top speed in the laws [m/s]
WEIGHT = 0.5
TARGET = (1.0, 2.0, -1.5)
ALONE: dict[str, Any] = {"separation": OFF, "alignment": OFF, "cohesion": OFF}


def unit(d: Floats) -> Floats:
    """Directions of vectors (n, 3), zero for zero."""
    size = np.linalg.norm(d, axis=1, keepdims=True)
    return np.asarray(d / np.where(size > 0.0, size, 1.0))


def size(d: Floats) -> Floats:
    """Lengths (n, 1) of vectors (n, 3)."""
    return np.linalg.norm(d, axis=1, keepdims=True)


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
            limits={"max_speed": TOP, "max_acceleration": most}, behaviours=({**behaviour, "weight": WEIGHT},),
        )  # fmt: skip
    x, v = (system.read(key)[:100].astype(np.float64) for key in ("position", "velocity"))
    wanted = WEIGHT * law(x, v)
    if name.startswith("containment"):
        wanted *= np.minimum(1.0, 1.0 / np.maximum(size(wanted), 1e-30))
    if np.count_nonzero(size(wanted) > 0.0) < 20:
        return float("nan")
    return float((size(acceleration(system)[:100] - wanted) / (1.0 + size(wanted))).max())


def runner(**fields: Any) -> Any:
    """One boid at the origin that heads along x at 1 m/s, 2 m/s at most."""
    start = {"kind": "points", "positions": ((0.0, 0.0, 0.0),)}
    heading = {"kind": "along", "direction": (1.0, 0.0, 0.0)}
    return built("boids", **{**ALONE, "start": start, "heading": heading, "limits": {"max_speed": 2.0}, **fields})


def seek_misses_by() -> float:
    """Nearest that a seeker comes to a target behind it [m]."""
    system = runner(behaviours=({"kind": "seek", "target": {"kind": "point", "position": (-4.0, 3.0, 1.0)}},))
    nearest = np.inf
    for step in range(240):
        system.step(step / 60, 1 / 60)
        nearest = min(nearest, float(np.linalg.norm(system.read("position")[0] - (-4.0, 3.0, 1.0))))
    return nearest


def flee_gets_to() -> float:
    """Distance after 10 s of a boid that fled from a point in its way, over the radius that it minds."""
    danger = {"kind": "point", "position": (1.0, 0.2, 0.0)}
    system = runner(behaviours=({"kind": "flee", "target": danger, "radius": 5.0, "weight": 2.0},))
    advance(system, 300, 1 / 30)
    return float(np.linalg.norm(system.read("position")[0] - danger["position"]) / 5.0)


def pursuit_time() -> float:
    """Time to catch one that moves straight on, over the shortest possible at these speeds."""
    prey = {
        "start": {"kind": "points", "positions": ((12.0, 0.0, 0.0),)}, "speed": 1.0, **ALONE,
        "heading": {"kind": "along", "direction": (0.0, 0.0, 1.0)}, "limits": {"max_speed": 1.0},
    }  # fmt: skip
    system = runner(
        speed=2.0, species={"prey": prey}, limits={"max_speed": 2.0},
        behaviours=({"kind": "pursuit", "target": {"kind": "species", "name": "prey"}, "horizon": 10.0, "weight": 5.0},),
    )  # fmt: skip
    for step in range(2000):
        system.step(0.01 * step, 0.01)
        hunter, hunted_one = system.read("position")
        if np.linalg.norm(hunter - hunted_one) < 0.1:
            return float(0.01 * (step + 1) / (12.0 / (2.0**2 - 1.0**2) ** 0.5))
    return float("nan")


@lru_cache(maxsize=2)
def chase(evades: bool) -> float:
    """Nearest [m] that a hunter at the same top speed comes to one that crosses its way, in 10 s."""
    evasion = {"kind": "evasion", "target": {"kind": "species", "name": "hunter"}, "radius": 8.0, "weight": 4.0}
    hunter = {
        "start": {"kind": "points", "positions": ((5.0, 0.0, -6.0),)}, "speed": 2.0, **ALONE,
        "heading": {"kind": "along", "direction": (0.0, 0.0, 1.0)}, "limits": {"max_speed": 2.0},
        "behaviours": ({"kind": "pursuit", "target": {"kind": "species", "name": "flock"}, "weight": 2.0},),
    }  # fmt: skip
    system = runner(speed=2.0, species={"hunter": hunter}, behaviours=(evasion,) if evades else ())
    nearest = np.inf
    for step in range(600):
        system.step(step / 60, 1 / 60)
        one, other = system.read("position").astype(np.float64)
        nearest = min(nearest, float(np.linalg.norm(one - other)))
    return nearest


def arrival_error() -> float:
    """Largest distance [m] from x'' = w (-v_max x / R - x'), the exact way in, over 10 s."""
    w, top, radius, dt = 2.0, 2.0, 5.0, 1e-2
    goal = {"kind": "point", "position": (2.0, 0.0, 0.0)}
    system = runner(behaviours=({"kind": "arrival", "target": goal, "slowing_radius": radius, "weight": w},))
    root = np.sqrt(w * w / 4.0 - w * top / radius)
    fast, slow = -w / 2.0 - root, -w / 2.0 + root
    # x(0) = -2 from the goal, x'(0) = 1.
    a = (1.0 + 2.0 * slow) / (fast - slow)
    worst = 0.0
    for step in range(1000):
        system.step(dt * step, dt)
        if step % 50 == 49:
            t = dt * (step + 1)
            exact = a * np.exp(fast * t) + (-2.0 - a) * np.exp(slow * t)
            worst = max(worst, abs(float(system.read("position")[0, 0]) - 2.0 - exact))
    return worst


@lru_cache(maxsize=1)
def wandering() -> tuple[float, float, float]:
    """Of 4,000 that wander from rest: bias of the mean wish, anisotropy, largest turn of the wish a step [rad]."""
    count, rate, dt = 4000, 0.5, 1 / 60
    system = built(
        "boids", **ALONE, count=count, speed=0.0, start={"kind": "ball", "radius": 10.0},
        limits={"max_speed": 1e6}, behaviours=({"kind": "wander", "rate": rate},),
    )  # fmt: skip
    wishes, before, turn = [], np.zeros((count, 3)), 0.0
    for step in range(300):
        system.step(step * dt, dt)
        after = system.read("velocity").astype(np.float64)
        wish = unit(after - before)
        if wishes:
            cosine = np.clip(np.einsum("ij,ij->i", wish, wishes[-1]), -1.0, 1.0)
            # The turn of nearly all: a wish that passes through zero may turn at once.
            turn = max(turn, float(np.quantile(np.arccos(cosine), 0.99)))
        wishes.append(wish)
        before = after
    at_once = np.concatenate(wishes[::150])
    spread = np.linalg.eigvalsh(np.cov(at_once.T))
    return float(np.linalg.norm(at_once.mean(axis=0))), float(spread[-1] / spread[0]), turn


def _wandering(which: int) -> float:
    return wandering()[which]


def least_room(kind: str) -> float:
    """Least room [m] that 200 wandering boids leave to the walls within 20 s, negative: outside."""
    bounds = Bounds("contained", (-10.0,) * 3, (10.0,) * 3) if kind == "bounds" else OPEN
    region: dict[str, Any] = {"bounds": {}, "ball": {"size": 10.0}, "box": {"size": (20.0, 20.0, 20.0)}}[kind]
    system = built(
        "boids", bounds, **ALONE, count=200, speed=2.0, start={"kind": "ball", "radius": 6.0},
        limits={"min_speed": 1.0, "max_speed": 3.0, "max_acceleration": 10.0},
        behaviours=(
            {"kind": "containment", "margin": 3.0, "look_ahead": 0.5, "weight": 2.0, **region},
            {"kind": "wander", "weight": 2.0},
        ),
    )  # fmt: skip
    least = np.inf
    for _ in range(40):
        advance(system, 15, 1 / 30)
        x = system.read("position").astype(np.float64)
        least = min(least, 10.0 - float((size(x) if kind == "ball" else np.abs(x)).max()))
    return least


OBSTACLES: dict[str, Mapping[str, Any]] = {
    "sphere": {"kind": "sphere", "radius": 2.0, "position": (10.0, 0.0, 0.0)},
    "box": {"kind": "box", "size": (3.0, 3.0, 3.0), "position": (10.0, 0.0, 0.0), "rotation": (0.0, 30.0, 20.0)},
    "capsule": {"kind": "capsule", "radius": 1.0, "length": 4.0, "position": (10.0, 0.0, 0.0)},
}


def room(kind: str, x: Floats) -> Floats:
    """Distance [m] of points to one of OBSTACLES, negative inside."""
    from scipy.spatial.transform import Rotation

    shape = OBSTACLES[kind]
    local = x - shape["position"]
    if kind == "sphere":
        return np.asarray(np.linalg.norm(local, axis=1) - shape["radius"])
    if kind == "capsule":
        local[:, 1] -= np.clip(local[:, 1], -shape["length"] / 2, shape["length"] / 2)
        return np.asarray(np.linalg.norm(local, axis=1) - shape["radius"])
    turn = Rotation.from_euler("xyz", shape["rotation"], degrees=True)
    over = np.abs(turn.inv().apply(local)) - np.divide(shape["size"], 2.0)
    return np.asarray(np.linalg.norm(np.maximum(over, 0.0), axis=1) + np.minimum(over.max(axis=1), 0.0))


@lru_cache(maxsize=8)
def past_obstacle(kind: str) -> tuple[float, float]:
    """A stream of 300 flies at a body: least room [m], and the share that gets past within 15 s."""
    system = built(
        "boids", bodies={"rock": OBSTACLES[kind]}, **ALONE, count=300, speed=2.0,
        start={"kind": "box", "size": (4.0, 6.0, 6.0)}, heading={"kind": "along"},
        limits={"min_speed": 1.0, "max_speed": 3.0, "max_acceleration": 8.0},
        behaviours=(
            {"kind": "obstacle_avoidance", "margin": 1.0, "look_ahead": 1.0},
            {"kind": "flow", "field": {"kind": "uniform", "velocity": (2.0, 0.0, 0.0)}},
        ),
    )  # fmt: skip
    least = np.inf
    for _ in range(450):
        advance(system, 2, 1 / 60)
        least = min(least, float(room(kind, system.read("position").astype(np.float64)).min()))
    return least, float(np.mean(system.read("position")[:, 0] > 13.0))


def _past(kind: str, which: int) -> float:
    return past_obstacle(kind)[which]


def off_the_path() -> float:
    """Farthest [m] from a square path of 10 m sides that a follower gets after 10 s, over its radius."""
    corners = ((0.0, 0.0, 0.0), (10.0, 0.0, 0.0), (10.0, 0.0, 10.0), (0.0, 0.0, 10.0))
    way = {"kind": "path", "points": corners, "loop": True, "radius": 1.0, "ahead": 1.5, "weight": 4.0}
    system = runner(behaviours=(way, {"kind": "cruise", "speed": 1.5}), start={"kind": "points", "positions": ((5.0, 3.0, 4.0),)})
    worst, laps, angle = 0.0, 0.0, 0.0
    for step in range(1500):
        system.step(step / 30, 1 / 30)
        x, y, z = (float(value) for value in system.read("position")[0])
        turn = float(np.arctan2(z - 5.0, x - 5.0))
        laps += (turn - angle + np.pi) % (2.0 * np.pi) - np.pi if step else 0.0
        angle = turn
        if step > 300:
            outside = np.array([x - np.clip(x, 0.0, 10.0), z - np.clip(z, 0.0, 10.0)])
            inside = max(0.0, min(x, 10.0 - x, z, 10.0 - z))
            worst = max(worst, float(np.hypot(np.linalg.norm(outside) + inside, y)))
    # It goes round, the way that the corners are listed, and does not stand.
    return worst if laps > 2.0 * np.pi else float("nan")


def flow_rate() -> float:
    """Rate [1/s] at which a boid takes the velocity of a uniform flow, weight 2, from 1 s on."""
    u = np.array([0.0, 0.5, -1.0])
    flow = {"kind": "flow", "field": {"kind": "uniform", "velocity": tuple(u)}, "weight": 2.0}
    system = runner(behaviours=(flow,))
    gap = []
    for second in range(2):
        gap.append(np.linalg.norm(system.read("velocity")[0] - u))
        advance(system, 200, 5e-3, start=float(second))
    return float(np.log(gap[0] / gap[1]))


def trail() -> float:
    """Distance [m] at which one follows a leader that goes straight on at 1 m/s."""
    leader = {
        "start": {"kind": "points", "positions": ((5.0, 0.0, 2.0),)}, "speed": 1.0, **ALONE,
        "heading": {"kind": "along", "direction": (1.0, 0.0, 0.0)},
    }  # fmt: skip
    follow = {"kind": "leader", "leaders": "head", "distance": 2.0, "slowing_radius": 5.0, "weight": 2.0}
    system = runner(species={"head": leader}, behaviours=(follow,))
    advance(system, 900, 1 / 30)
    behind = system.read("position")[1].astype(np.float64) - system.read("position")[0]
    return float(behind[0]) if np.hypot(behind[1], behind[2]) < 0.01 else float("nan")


@lru_cache(maxsize=1)
def roosting() -> tuple[float, float]:
    """Of 200 that wander 40 s over a roost: level distance of all but 1 %, over the radius; mean height [m]."""
    system = built(
        "boids", **ALONE, count=200, speed=8.0, start={"kind": "ball", "centre": (0.0, 20.0, 0.0), "radius": 10.0},
        limits={"min_speed": 6.0, "max_speed": 10.0, "max_acceleration": 20.0},
        behaviours=(
            {"kind": "roost", "centre": (0.0, 20.0, 0.0), "radius": 30.0, "weight": 6.0, "vertical": 0.1},
            {"kind": "wander", "weight": 2.0},
            {"kind": "cruise", "speed": 8.0},
        ),
    )  # fmt: skip
    places = []
    for _ in range(8):
        advance(system, 150, 1 / 30)
        places.append(system.read("position").astype(np.float64))
    x = np.concatenate(places)
    return float(np.quantile(np.hypot(x[:, 0], x[:, 2]), 0.99) / 30.0), float(x[:, 1].mean() - 20.0)


def _roosting(which: int) -> float:
    return roosting()[which]


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


LIMITS = {"min_speed": 0.8, "max_speed": 1.6, "max_acceleration": 6.0, "max_turn_rate": 150.0}


@lru_cache(maxsize=4)
def excess(dimension: int) -> dict[str, float]:
    """Of a crowded flock that wants more than it may: largest speed, least speed, turn, each over its limit.

    The acceleration is measured in a second run, where speed and turning are free.
    """
    crowd: dict[str, Any] = {
        "count": 300, "dimension": dimension, "start": {"kind": "ball", "radius": 2.0}, "speed": 1.0,
        "separation": rule(1.0, 3.0), "alignment": rule(1.0), "cohesion": rule(1.5, 5.0),
        "behaviours": ({"kind": "wander", "weight": 20.0},),
    }  # fmt: skip
    seen = {"top speed": 0.0, "least speed": np.inf, "turn rate": 0.0, "acceleration": 0.0}
    system, free = built("boids", **crowd, limits=LIMITS), built(
        "boids", **crowd, limits={"max_speed": 1e6, "max_acceleration": LIMITS["max_acceleration"]}
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


def _case(name: str, run: Callable[[], float], comparison: Comparison, limit: float, source: str = STEERING) -> Case:
    return Case("boids", name, run, limit, source, comparison=comparison)


CASES: tuple[Case, ...] = (
    *(_case(f"law of {name}", partial(law_error, name), "below", ROUNDING, LAW) for name in (*LAWS, *SPECIES_LAWS)),
    _case("seek comes to its target [m]", seek_misses_by, "below", 0.05),
    _case("flee gets beyond its radius", flee_gets_to, "above", 1.0),
    Case("boids", "pursuit of a straight mover: time over the shortest", pursuit_time, (1.0, 1.05),
         "exact: D / sqrt(s^2 - u^2)", comparison="between"),
    _case("evasion keeps a hunter away [m]", partial(chase, True), "above", 3.0),
    _case("without evasion the hunter comes near [m]", partial(chase, False), "below", 0.5),
    _case("arrival: distance from the exact way [m]", arrival_error, "below", 1e-2, "exact: x'' = w (-v_max x/R - x')"),
    # Four standard errors of a mean of 8,000 unit vectors: 4 / sqrt(8000).
    _case("wander has no preferred direction: mean", partial(_wandering, 0), "below", 0.045, "exact: isotropy"),
    _case("wander has no preferred axis: ratio of spreads", partial(_wandering, 1), "below", 1.1, "exact: isotropy"),
    _case("wander is smooth: turn of the wish in 1/60 s [rad]", partial(_wandering, 2), "below", 0.15),
    *(
        _case(f"containment, {kind}: least room to the wall [m]", partial(least_room, kind), "above", 0.0)
        for kind in ("bounds", "ball", "box")
    ),
    *(
        _case(f"obstacle avoidance, {kind}: least room [m]", partial(_past, kind, 0), "above", 0.0)
        for kind in OBSTACLES
    ),
    *(
        _case(f"obstacle avoidance, {kind}: share that gets past", partial(_past, kind, 1), "above", 0.95)
        for kind in OBSTACLES
    ),
    _case("path: distance from it over its radius", off_the_path, "below", 1.2),
    Case("boids", "flow: rate of taking its velocity [1/s]", flow_rate, 2.0, "exact: v' = w (u - v)", tolerance=0.02),
    Case("boids", "leader: distance of trailing [m]", trail, 2.0 + 5.0 * 1.0 / 2.0,
         "exact: distance + slowing_radius u / v_max", tolerance=0.01),
    # The pull is full at twice the radius.
    _case("roost: level distance of 99 % over the radius", partial(_roosting, 0), "below", 2.0),
    Case("boids", "roost: mean height over the place [m]", partial(_roosting, 1), 0.0, STEERING, tolerance=2.0),
    _case("urgent behaviours are served first", urgent_first, "below", 1e-5, "Reynolds 1987: prioritised allocation"),
    *(
        _case(f"limit of {which}, {dimension}D", partial(_excess, dimension, which), comparison, limit, "exact: the limit")
        for dimension in (2, 3)
        # Angles are read from float32 velocities: 1e-7 rad of a turn of 0.04 rad a step.
        for which, comparison, limit in (
            ("top speed", "below", 1.0 + 1e-6), ("least speed", "above", 1.0 - 1e-6),
            ("turn rate", "below", 1.0 + 1e-4), ("acceleration", "below", 1.0 + 1e-5),
        )
    ),
    Case("boids", "bank in a steady turn over v omega / g", bank_error, 1.0, "exact: tan(bank) = v omega / g", tolerance=0.01),
)  # fmt: skip
