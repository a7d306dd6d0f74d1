"""Water and bodies: buoyancy, a tank that is shaken; and two liquids in one tank."""

from functools import lru_cache, partial
from typing import Any

import numpy as np
from scipy.optimize import brentq
from scipy.spatial.transform import Rotation

from tianim.validate.case import Case
from tianim.validate.fluid_tanks import DENSITY, GRAVITY, METHODS, Floats, box, places, run, tank, water

BUOYANCY = "exact: Archimedes, the weight of the water displaced"

# A tank and the body that is held in it [m].
WIDE, DEEP, SPACING = 1.0, 0.5, 1.0 / 60.0
BODY: dict[str, dict[str, Any]] = {
    "box": {"kind": "box", "size": (0.24, 0.2, 1.0)},
    "disc": {"kind": "sphere", "radius": 0.12},
}
SETTLED, WATCHED, FRAME = 1.5, 1.0, 1.0 / 60.0


def submerged(body: dict[str, Any], level: float) -> float:
    """Area of a body below `level` [m2], counted from its middle."""
    if body["kind"] == "box":
        wide, high, _ = body["size"]
        return float(wide * np.clip(level + 0.5 * high, 0.0, high))
    r = body["radius"]
    s = float(np.clip(level, -r, r))
    return float(r**2 * np.arccos(-s / r) + s * np.sqrt(r**2 - s**2))


@lru_cache(maxsize=8)
def lift(shape: str, ratio: float, method: str) -> float:
    """Upward force on a held body over the weight of the water that it displaces.

    A body of density ratio 1 would hang in the water, one of 0.5 float half submerged: there it is held.
    """
    body = BODY[shape]
    middle = 0.25 if ratio == 1.0 else DEEP
    system = water(
        SPACING, {"pool": box((0.0, 0.0), (WIDE, DEEP), carve=True, settled=True)},
        tank((0.0, 0.0), (WIDE, 2.0 * DEEP)), method,
        bodies={"held": {**body, "position": (0.5 * WIDE, middle, 0.0)}},
        gauges={"lift": {"kind": "force", "body": "held"}}, viscosity=1e-3,
    )  # fmt: skip
    # The level of so much water with the body in it.
    amount = len(places(system)) * SPACING**2
    level = brentq(lambda y: WIDE * y - amount - submerged(body, y - middle), 0.0, 2.0 * DEEP)
    run(system, SETTLED)
    system.diagnostics()
    forces, time = [], SETTLED
    while time < SETTLED + WATCHED:
        run(system, time + FRAME, start=time)
        time += FRAME
        forces.append(system.diagnostics()["gauge_lift_y"])
    return float(np.mean(forces) / (DENSITY * GRAVITY * submerged(body, level - middle)))


# The shaken tank: its size [m], and how it moves (s, m, degrees), over and over.
TANK = (1.0, 0.8, 0.4)
PERIOD, SWAY, TILT = 1.1, 0.25, 30.0


def _shaken(dimension: int) -> dict[str, Any]:
    """The tank as a body with keyframes."""
    quarter = 0.25 * PERIOD
    sway = [(0.0, 0.0), (SWAY, 0.1), (0.0, -0.1), (-SWAY, 0.1), (0.0, 0.0)]
    tilt = [0.0, TILT, -0.4 * TILT, -TILT, 0.0]
    roll = 12.0 if dimension == 3 else 0.0
    keys = [[k * quarter, (x, y, 0.0)] for k, (x, y) in enumerate(sway)]
    turns = [[k * quarter, (roll * (k % 2), 0.0, angle)] for k, angle in enumerate(tilt)]
    curve = {"interpolation": "cubic", "repeat": "loop"}
    return {
        "kind": "box", "size": TANK, "inside": True,
        "position": {"keys": keys, **curve}, "rotation": {"keys": turns, **curve},
    }  # fmt: skip


@lru_cache(maxsize=8)
def slosh(method: str, dimension: int, until: float) -> tuple[float, float]:
    """Farthest that a particle gets out of the tank, in spacings, and particles put back as a last resort."""
    d = 0.025 if dimension == 2 else 0.04
    w, h, b = (0.5 * side for side in TANK)
    depth = () if dimension == 2 else (-b,)
    system = water(
        d, {"pool": box((-w, -h, *depth), (w, 0.0, *(-z for z in depth)))}, method=method,
        bodies={"tank": _shaken(dimension)}, dimension=dimension,
    )  # fmt: skip
    body = system.world.bodies.params["tank"]
    half = np.array([w, h, b])[:dimension]
    worst = [0.0, 0.0]

    def look(time: float, system: Any) -> None:
        pose = body.at(time)
        turn = Rotation.from_euler("XYZ", pose.rotation, degrees=True)
        local = turn.inv().apply(places(system) - pose.position)[:, :dimension]
        worst[0] = max(worst[0], float((np.abs(local) - half).max()) / d)
        worst[1] = system.diagnostics()["clamped"]

    run(system, until, look)
    return worst[0], worst[1]


def _slosh(method: str, dimension: int, until: float, which: int) -> float:
    return slosh(method, dimension, until)[which]


OIL = {"oil": {"density": 500.0, "viscosity": 1e-4}}


def _two_liquids(oil: dict[str, Any], method: str, until: float) -> tuple[Floats, Floats]:
    """Heights of the water and of the oil after so long, in a tank of 0.4 x 0.4 m that they fill by half."""
    blocks = {"oil": {**oil, "phase": "oil"}, "water": box((0.0, 0.0), (0.4, 0.4), carve=True)}
    system = water(0.02, blocks, tank((0.0, 0.0), (0.4, 0.6)), method, phases=OIL, viscosity=1e-4)
    run(system, until)
    y, phase = places(system)[:, 1], system.read("phase")
    return y[phase == 0], y[phase == 1]


def interface(method: str) -> float:
    """Light on heavy: part of the particles that are on the wrong side after 2 s, past a spacing [%]."""
    heavy, light = _two_liquids(box((0.0, 0.2), (0.4, 0.4)), method, 2.0)
    middle, d = 0.2, 0.02
    return float(50.0 * (np.mean(heavy > middle + d) + np.mean(light < middle - d)))


def exchange(method: str) -> float:
    """Light beside heavy: how far the light is above the heavy after 4 s, over that of two layers."""
    heavy, light = _two_liquids(box((0.0, 0.0), (0.2, 0.4)), method, 4.0)
    return float((light.mean() - heavy.mean()) / 0.2)


# Of the buoyancies, those that run with every test: the others take minutes together.
QUICK = (("dfsph", "disc", 0.5), ("pbf", "box", 0.5))
CASES: tuple[Case, ...] = (
    *(
        Case(
            "fluid", f"buoyancy of a {shape}, density ratio {ratio:g}, {method}: force over the weight",
            partial(lift, shape, ratio, method), 1.0, BUOYANCY, tolerance=0.05,
            slow=(method, shape, ratio) not in QUICK,
        )
        for method in METHODS
        for shape in BODY
        for ratio in (0.5, 1.0)
    ),
    *(
        Case(
            "fluid", f"tank shaken for {until:g} s, {dimension}D, {method}: {name}",
            partial(_slosh, method, dimension, until, which), limit, "exact", comparison="below",
            slow=until > 2.0 or method == "wcsph",
        )
        for until, dimension in ((2.0, 2), (20.0, 2), (20.0, 3))
        for method in (METHODS if dimension == 2 else ("dfsph", "pbf"))
        # Places are float32: a particle on the wall may be a millionth of a spacing beyond it.
        for which, name, limit in ((0, "outside, in spacings", 1e-4), (1, "put back", 0.0))
    ),
    *(
        Case(
            "fluid", f"oil on water, {method}: part that is on the wrong side after 2 s",
            partial(interface, method), 2.0, "the heavy one stays below", comparison="below", unit="%",
            slow=method == "wcsph",
        )
        for method in METHODS
    ),
    Case(
        "fluid", "oil beside water: how far it has risen after 4 s", partial(exchange, "dfsph"), 0.8,
        "the heavy one sinks", comparison="above", slow=True,
    ),
)  # fmt: skip
