"""Drops in free space: what they keep (momentum, spin, mass), how they fall, and surface tension."""

from functools import lru_cache, partial
from typing import Any

import numpy as np
from scipy.optimize import curve_fit
from scipy.spatial import ConvexHull

from tianim.validate.case import Case
from tianim.validate.fluid_tanks import (
    DENSITY,
    GRAVITY,
    METHODS,
    NONE,
    Floats,
    box,
    places,
    run,
    speeds,
    water,
)

LAPLACE = "exact: Laplace's jump, sigma/R in 2D, 2 sigma/R in 3D"
RAYLEIGH = "exact: Rayleigh 1879, n = 2: omega^2 = 6 sigma/(rho R^3) in 2D, 8 sigma/(rho R^3) in 3D"

# A drop of water [m], [N/m].
RADIUS, SIGMA = 0.01, 0.0728


def ball(radius: float, centre: tuple[float, float] = (0.0, 0.0), **more: Any) -> dict[str, Any]:
    """A block of water that is a disc, or a sphere."""
    return {"kind": "sphere", "centre": (*centre, 0.0), "radius": radius, **more}


@lru_cache(maxsize=8)
def collision(method: str) -> tuple[float, float, float]:
    """Two drops hit off their centres: drift of momentum and spin over their sums, particles lost."""
    d = 0.02
    blocks = {
        "one": ball(0.2, (-0.25, 0.05), velocity=(2.0, 0.0, 0.0)),
        "other": ball(0.2, (0.25, -0.05), velocity=(-2.0, 0.0, 0.0)),
    }
    system = water(d, blocks, method=method, gravity=NONE, viscosity=1e-3, surface_tension=0.1)
    before, count = _totals(system), len(places(system))
    run(system, 0.3)
    after = _totals(system)
    return (
        float(np.linalg.norm(after[0] - before[0]) / before[2]),
        float(abs(after[1] - before[1]) / before[3]),
        float(abs(len(places(system)) - count)),
    )


def _totals(system: Any) -> tuple[Floats, float, float, float]:
    """Mean velocity, mean angular momentum about z, and the sums that they are compared with."""
    x, v = places(system), speeds(system)
    spin = x[:, 0] * v[:, 1] - x[:, 1] * v[:, 0]
    return v.mean(axis=0), float(spin.mean()), float(np.abs(v).mean()), float(np.abs(spin).mean())


def _collision(method: str, which: int) -> float:
    return collision(method)[which]


@lru_cache(maxsize=4)
def fall(method: str) -> tuple[float, float]:
    """A drop thrown upwards: relative error of place and velocity of its centre after half a second."""
    system = water(0.02, {"drop": ball(0.2, velocity=(1.0, 3.0, 0.0))}, method=method)
    start, end = places(system).mean(axis=0), 0.5
    run(system, end)
    x, v = places(system).mean(axis=0) - start, speeds(system).mean(axis=0)
    place = np.array([1.0 * end, 3.0 * end - 0.5 * GRAVITY * end**2, 0.0])
    speed = np.array([1.0, 3.0 - GRAVITY * end, 0.0])
    return (
        float(np.linalg.norm(x - place) / np.linalg.norm(place)),
        float(np.linalg.norm(v - speed) / np.linalg.norm(speed)),
    )


def _fall(method: str, which: int) -> float:
    return fall(method)[which]


def spin_drift(method: str) -> float:
    """A spinning drop, without gravity: relative drift of its angular momentum after half a second."""
    system = water(0.02, {"drop": ball(0.2)}, method=method, gravity=NONE, viscosity=0.01)
    x = places(system)
    v = 4.0 * np.stack([-x[:, 1], x[:, 0], np.zeros(len(x))], axis=1)
    system.write("velocity", v.astype(np.float32))
    before = _totals(system)[1]
    run(system, 0.5)
    return abs(_totals(system)[1] / before - 1.0)


def drop(across: int, dimension: int = 2, shape: str = "ball", **fields: Any) -> Any:
    """A drop of water with surface tension, so many spacings in its radius."""
    side = RADIUS
    blocks = {"drop": ball(RADIUS)}
    if shape == "cube":
        blocks = {"drop": box((-side,) * dimension, (side,) * dimension)}
    fields.setdefault("viscosity", 1e-5)
    return water(
        RADIUS / across, blocks, dimension=dimension, gravity=NONE, surface_tension=SIGMA,
        **fields,
    )  # fmt: skip


@lru_cache(maxsize=4)
def laplace(across: int, dimension: int = 2) -> float:
    """Pressure within a drop at rest, over Laplace's."""
    system = drop(across, dimension, viscosity=1e-4)
    seen: list[float] = []

    def look(time: float, system: Any) -> None:
        if time > 0.1:
            inside = np.linalg.norm(places(system), axis=1) < 0.6 * RADIUS
            seen.append(float(system.read("pressure")[inside].mean()))

    run(system, 0.2, look)
    return float(np.mean(seen) / ((dimension - 1) * SIGMA / RADIUS))


@lru_cache(maxsize=4)
def rayleigh(across: int, dimension: int = 2) -> float:
    """Period of a drop that is pulled long by a twentieth and let go, over Rayleigh's."""
    system = drop(across, dimension)
    stretch = 1.05
    x = places(system)
    x[:, 0] *= stretch
    x[:, 1:dimension] *= stretch ** (-1.0 / (dimension - 1))
    system.write("position", x.astype(np.float32))
    factor = 6.0 if dimension == 2 else 8.0
    omega = float(np.sqrt(factor * SIGMA / (DENSITY * RADIUS**3)))
    seen: list[tuple[float, float]] = []

    def look(time: float, system: Any) -> None:
        place = places(system)
        place = place - place.mean(axis=0)
        size = (place**2).mean(axis=0)
        seen.append((time, float((size[0] - size[1]) / (size[0] + size[1]))))

    run(system, 2.2 * 2.0 * np.pi / omega, look)
    time, shape = np.array(seen).T

    def damped(t: Floats, size: float, rate: float, w: float, phase: float, base: float) -> Floats:
        return np.asarray(size * np.exp(-rate * t) * np.cos(w * t + phase) + base)

    found, _ = curve_fit(damped, time, shape, p0=(shape[0], 1.0, omega, 0.0, 0.0), maxfev=20000)
    return float(omega / abs(found[2]))


@lru_cache(maxsize=4)
def roundness(across: int, dimension: int = 2) -> tuple[float, float]:
    """Of a square or cube left to itself: sphericity of its hull at last, drift of its momentum."""
    system = drop(across, dimension, "cube", viscosity=1e-4)
    run(system, 0.3)
    x = places(system)[:, :dimension]
    hull = ConvexHull(x)
    if dimension == 2:
        round_ = 4.0 * np.pi * hull.volume / hull.area**2  # in 2D these are the area and the perimeter
    else:
        round_ = np.pi ** (1 / 3) * (6.0 * hull.volume) ** (2 / 3) / hull.area
    fastest = np.sqrt(SIGMA / (DENSITY * RADIUS))
    return float(round_), float(np.linalg.norm(speeds(system).mean(axis=0)) / fastest)


def _roundness(across: int, dimension: int, which: int) -> float:
    return roundness(across, dimension)[which]


def emitted_error(method: str) -> float:
    """A hose of a stated rate for half a second: error of the water that came out, in layers of its mouth."""
    d, rate, radius, until = 0.01, 0.1, 0.05, 0.5
    hose = {"kind": "disc", "radius": radius, "direction": (1.0, 0.0, 0.0), "rate": rate, "end": 2.0 * until}
    system = water(d, {}, method=method, gravity=NONE, emitters={"hose": hose})
    run(system, until)
    return abs(len(places(system)) * d**2 - rate * until) / (2.0 * radius * d)


@lru_cache(maxsize=4)
def drain(method: str) -> float:
    """A stream through a sink: particles left beyond it."""
    d = 0.02
    stream = box((-0.2, -0.1), (0.2, 0.1), velocity=(2.0, 0.0, 0.0))
    hole = {"kind": "box", "lower": (0.4, -1.0, -1.0), "upper": (1.0, 1.0, 1.0)}
    system = water(d, {"stream": stream}, method=method, gravity=NONE, sinks={"hole": hole})
    run(system, 0.5)
    return float(len(places(system)))


CASES: tuple[Case, ...] = (
    *(
        Case(
            "fluid", f"two drops collide, {method}: {name}", partial(_collision, method, which), limit,
            "exact: forces between particles are mutual", comparison="below",
        )
        for method in METHODS
        for which, name, limit in (
            (0, "drift of the momentum", 1e-5), (1, "drift of the angular momentum", 1e-3),
            (2, "particles lost", 0.0),
        )
    ),
    *(
        Case(
            "fluid", f"free fall, {method}: error of the {name}", partial(_fall, method, which), limit,
            "exact", comparison="below",
        )
        for method in METHODS
        for which, name, limit in ((0, "place", 1e-4), (1, "velocity", 1e-5))
    ),
    *(
        Case(
            "fluid", f"a drop spins, {method}: drift of the angular momentum", partial(spin_drift, method),
            1e-3, "exact: forces between particles are central", comparison="below",
        )
        for method in METHODS
    ),
    *(
        Case(
            "fluid", f"a hose, {method}: error of the water that came out, in layers",
            partial(emitted_error, method), 1.01, "exact: rate times time", comparison="below",
        )
        for method in METHODS
    ),
    Case("fluid", "particles that are left beyond a sink", partial(drain, "dfsph"), 0.0, "exact",
         comparison="below"),
    *(
        Case(
            "fluid", f"a drop at rest, {across} in its radius, {dimension}D: pressure over Laplace's",
            partial(laplace, across, dimension), 1.0, LAPLACE, tolerance=0.1, slow=dimension == 3,
        )
        for across, dimension in ((10, 2), (8, 3))
    ),
    *(
        Case(
            "fluid", f"a drop swings, {across} in its radius, {dimension}D: period over Rayleigh's",
            partial(rayleigh, across, dimension), 1.0, RAYLEIGH, tolerance=0.1, slow=True,
        )
        for across, dimension in ((15, 2), (8, 3))
    ),
    *(
        Case(
            "fluid", f"a {name} becomes round: {what}", partial(_roundness, across, dimension, which), limit,
            "the least surface", comparison=comparison, slow=dimension == 3,  # type: ignore[arg-type]
        )
        for name, across, dimension in (("square", 8, 2), ("cube", 6, 3))
        for which, what, limit, comparison in (
            (0, "sphericity", 0.95, "above"), (1, "drift of the momentum", 1e-5, "below"),
        )
    ),
)  # fmt: skip
