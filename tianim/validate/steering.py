"""Steering: whether each behaviour does what it is for; `steering_laws` holds them against their formulas."""

from collections.abc import Mapping
from functools import lru_cache, partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tianim.system import Bounds
from tianim.validate.build import ALONE, OPEN, advance, built, runner, size, unit
from tianim.validate.case import Case

Floats = NDArray[np.float64]

STEERING = "Reynolds 1999, GDC, Steering Behaviors For Autonomous Characters"
ROOST = "Hildenbrandt et al. 2010, Behavioral Ecology 21, 1349"
ISOTROPY = "exact: isotropy"


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
    pursuit = {
        "kind": "pursuit",
        "target": {"kind": "species", "name": "prey"},
        "horizon": 10.0,
        "weight": 5.0,
    }
    system = runner(speed=2.0, species={"prey": prey}, behaviours=(pursuit,))
    for step in range(2000):
        system.step(0.01 * step, 0.01)
        hunter, hunted_one = system.read("position")
        if np.linalg.norm(hunter - hunted_one) < 0.1:
            return float(0.01 * (step + 1) / (12.0 / (2.0**2 - 1.0**2) ** 0.5))
    return float("nan")


@lru_cache(maxsize=2)
def chase(evades: bool) -> float:
    """Nearest [m] that a hunter at the same top speed comes to one that crosses its way, in 10 s."""
    evasion = {
        "kind": "evasion",
        "target": {"kind": "species", "name": "hunter"},
        "radius": 8.0,
        "weight": 4.0,
    }
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
    """Of 4,000 that wander from rest: bias of the mean wish, anisotropy, turn of the wish a step [rad]."""
    count, rate, dt = 4000, 0.5, 1 / 60
    system = built(
        "boids", **ALONE, count=count, speed=0.0, start={"kind": "ball", "radius": 10.0},
        limits={"max_speed": 1e6}, behaviours=({"kind": "wander", "rate": rate},),
    )  # fmt: skip
    wishes: list[Floats] = []
    before, turn = np.zeros((count, 3)), 0.0
    for step in range(300):
        system.step(step * dt, dt)
        after = system.read("velocity").astype(np.float64)
        wish = unit(after - before)
        if wishes:
            cosine = np.clip((wish * wishes[-1]).sum(axis=1), -1.0, 1.0)
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
    regions: dict[str, dict[str, Any]] = {"bounds": {}, "ball": {"size": 10.0}, "box": {"size": (20.0,) * 3}}
    system = built(
        "boids", bounds, **ALONE, count=200, speed=2.0, start={"kind": "ball", "radius": 6.0},
        limits={"min_speed": 1.0, "max_speed": 3.0, "max_acceleration": 10.0},
        behaviours=(
            {"kind": "containment", "margin": 3.0, "look_ahead": 0.5, "weight": 2.0, **regions[kind]},
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
    "box": {
        "kind": "box",
        "size": (3.0, 3.0, 3.0),
        "position": (10.0, 0.0, 0.0),
        "rotation": (0.0, 30.0, 20.0),
    },
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
    system = runner(
        behaviours=(way, {"kind": "cruise", "speed": 1.5}),
        start={"kind": "points", "positions": ((5.0, 3.0, 4.0),)},
    )
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
    """Of 200 that wander 40 s over a roost: level distance of 99 % over the radius, mean height [m]."""
    system = built(
        "boids", **ALONE, count=200, speed=8.0,
        start={"kind": "ball", "centre": (0.0, 20.0, 0.0), "radius": 10.0},
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


equal = partial(Case, "boids")
below = partial(Case, "boids", comparison="below")
above = partial(Case, "boids", comparison="above")
CASES: tuple[Case, ...] = (
    below("seek comes to its target [m]", seek_misses_by, 0.05, STEERING),
    above("flee gets beyond its radius", flee_gets_to, 1.0, STEERING),
    Case(
        "boids", "pursuit of a straight mover: time over the shortest", pursuit_time, (1.0, 1.05),
        "exact: D / sqrt(s^2 - u^2)", comparison="between",
    ),
    above("evasion keeps a hunter away [m]", partial(chase, True), 3.0, STEERING),
    below("without evasion the hunter comes near [m]", partial(chase, False), 0.5, STEERING),
    below("arrival: distance from the exact way [m]", arrival_error, 1e-2, "exact: a damped oscillator"),
    # Four standard errors of a mean of 8,000 unit vectors: 4 / sqrt(8000).
    below("wander has no preferred direction: mean", partial(_wandering, 0), 0.045, ISOTROPY),
    below("wander has no preferred axis: ratio of spreads", partial(_wandering, 1), 1.1, ISOTROPY),
    below("wander is smooth: turn of the wish in 1/60 s [rad]", partial(_wandering, 2), 0.15, STEERING),
    # Where there are walls too, they would hold them at 0.
    *(
        above(f"containment, {kind}: least room to the wall [m]", partial(least_room, kind), 0.1, STEERING)
        for kind in ("bounds", "ball", "box")
    ),
    *(
        above(f"obstacle avoidance, {kind}: {what}", partial(_past, kind, which), limit, STEERING)
        for kind in OBSTACLES
        for which, (what, limit) in enumerate({"least room [m]": 0.0, "share that gets past": 0.95}.items())
    ),
    below("path: distance from it over its radius", off_the_path, 1.2, STEERING),
    equal("flow: rate of taking its velocity [1/s]", flow_rate, 2.0, "exact: v' = w (u - v)", tolerance=0.02),
    equal(
        "leader: distance of trailing [m]", trail, 2.0 + 5.0 * 1.0 / 2.0,
        "exact: distance + slowing_radius u / v_max", tolerance=0.01,
    ),
    # The pull is full at twice the radius.
    below("roost: level distance of 99 % over the radius", partial(_roosting, 0), 2.0, ROOST),
    equal("roost: mean height over the place [m]", partial(_roosting, 1), 0.0, ROOST, tolerance=2.0),
)  # fmt: skip
