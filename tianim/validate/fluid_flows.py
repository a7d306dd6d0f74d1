"""Flows with a closed form: Taylor and Green's vortices, a standing wave, channels with walls that drag.

Channels are periodic along x, 40 spacings across; two boxes are their walls. Their profiles are series
that hold at every time, so that they need not run until they are steady.
"""

from functools import lru_cache, partial
from typing import Any, NamedTuple

import numpy as np
from scipy.optimize import curve_fit

from tianim.system import Bounds
from tianim.validate.case import Case
from tianim.validate.fluid_tanks import GRAVITY, METHODS, Floats, box, places, run, speeds, tank, water

VORTEX_SOURCE = "exact: Taylor and Green 1937, u ~ exp(-2 k^2 nu t)"
WAVE_SOURCE = "exact, small waves: omega^2 = g k tanh(k h)"
CHANNEL_SOURCE = "exact: the series of the channel that starts at rest"

REYNOLDS = 100.0
# The step [s] of the vortices: pressures of first order in time take 6 % of the decay at 5 ms, 2 % at this.
VORTEX_STEP = 0.002
# A wave twice as long as the tank, which is as deep as long [m].
LENGTH, DEPTH = 1.0, 1.0
AMPLITUDE = 0.03
# The channel [m], its spacings across and along, [m2/s], [m/s].
GAP, ACROSS, ALONG = 1.0, 40, 10
THICK, SPEED = 0.1, 0.1


@lru_cache(maxsize=4)
def vortex(method: str, across: int, until: float = 0.6) -> tuple[float, float]:
    """Taylor and Green's vortices in a unit square: rate of decay of the speed [1/s], momentum drift."""
    d, nu = 1.0 / across, 1.0 / REYNOLDS
    system = water(
        d, {"all": box((0.0, 0.0), (1.0, 1.0))}, Bounds("periodic", (0.0,) * 3, (1.0,) * 3), method,
        viscosity=nu, artificial_viscosity=0.0, gravity=(0.0, 0.0, 0.0), time_step={"largest": VORTEX_STEP},
    )  # fmt: skip
    x = 2.0 * np.pi * places(system)
    v = np.zeros_like(x)
    v[:, 0] = -np.cos(x[:, 0]) * np.sin(x[:, 1])
    v[:, 1] = np.sin(x[:, 0]) * np.cos(x[:, 1])
    system.write("velocity", v.astype(np.float32))
    seen = [(0.0, np.mean(v**2))]
    run(system, until, lambda time, system: seen.append((time, np.mean(speeds(system) ** 2))), 0.0)
    time, energy = np.array(seen).T
    # The lattice of the start breaks up in the first tenth of a second.
    late = time > 0.1
    drift = np.linalg.norm(speeds(system).mean(axis=0))
    return float(-0.5 * np.polyfit(time[late], np.log(energy[late]), 1)[0]), float(drift)


def decay_error(method: str, across: int) -> float:
    """Of the rate of decay, over the exact 8 pi^2 / Re [%]."""
    return 100.0 * abs(vortex(method, across)[0] * REYNOLDS / (8.0 * np.pi**2) - 1.0)


class Wave(NamedTuple):
    """A damped cosine fitted to the mean of the velocity along the tank."""

    period: float  # over that of the law
    rate: float  # of its decay [1/s]


@lru_cache(maxsize=4)
def wave(method: str, across: int, viscosity: float = 1e-6, until: float = 3.0) -> Wave:
    """Half a standing wave in a tank with slip walls, so many spacings along, started by its velocities."""
    d, k = LENGTH / across, np.pi / LENGTH
    omega = float(np.sqrt(GRAVITY * k * np.tanh(k * DEPTH)))
    system = water(
        d, {"all": box((0.0, 0.0), (LENGTH, DEPTH), settled=True)},
        tank((0.0, 0.0), (LENGTH, 1.5 * DEPTH)), method, viscosity=viscosity, artificial_viscosity=0.0,
    )  # fmt: skip
    x = k * places(system)
    v = np.zeros_like(x)
    top = AMPLITUDE * omega / np.sinh(k * DEPTH)
    v[:, 0], v[:, 1] = -top * np.sin(x[:, 0]) * np.cosh(x[:, 1]), top * np.cos(x[:, 0]) * np.sinh(x[:, 1])
    system.write("velocity", v.astype(np.float32))
    seen = [(0.0, v[:, 0].mean())]
    run(system, until, lambda time, system: seen.append((time, speeds(system)[:, 0].mean())), 0.0)
    time, mean = np.array(seen).T

    def damped(t: Floats, size: float, rate: float, w: float, phase: float, base: float) -> Floats:
        return np.asarray(size * np.exp(-rate * t) * np.cos(w * t + phase) + base)

    found, _ = curve_fit(damped, time, mean, p0=(mean[0], 0.1, omega, 0.0, 0.0))
    return Wave(float(omega / abs(found[2])), float(found[1]))


def _wave(method: str, across: int, viscosity: float, which: str) -> float:
    return float(getattr(wave(method, across, viscosity), which))


def poiseuille(y: Floats, t: float) -> Floats:
    """Velocity at y in (0, GAP), t after the pull of 8 nu SPEED / GAP^2 sets in, in SPEED."""
    u = 4.0 * y / GAP * (1.0 - y / GAP)
    for n in range(1, 60, 2):
        k = n * np.pi / GAP
        u = u - 32.0 / (n * np.pi) ** 3 * np.sin(k * y) * np.exp(-(k**2) * THICK * t)
    return u


def couette(y: Floats, t: float) -> Floats:
    """Velocity at y, t after the upper wall began to move at SPEED, in SPEED."""
    u = y / GAP
    for n in range(1, 60):
        k = n * np.pi / GAP
        u = u + 2.0 / (n * np.pi) * (-1.0) ** n * np.sin(k * y) * np.exp(-(k**2) * THICK * t)
    return u


@lru_cache(maxsize=4)
def channel(name: str, method: str, across: int = ACROSS) -> float:
    """RMS error of the profile at three times, over the largest velocity [%]."""
    d = GAP / across
    along, wall = ALONG * d, 0.25 * GAP
    times = np.array([0.15, 0.4, 1.0]) * GAP**2 / THICK
    end = times[-1]
    moving: Any = (0.0, GAP + 0.5 * wall, 0.0)
    if name == "couette":
        moving = {"keys": [[0.0, moving], [end, (SPEED * end, GAP + 0.5 * wall, 0.0)]]}
    size = (along + 4.0 * SPEED * end, wall, 1.0)
    system = water(
        d, {"all": box((0.0, 0.0), (along, GAP))},
        Bounds("periodic", (0.0, -wall, 0.0), (along, GAP + wall, 1.0)), method,
        bodies={
            "floor": {"kind": "box", "size": size, "position": (0.0, -0.5 * wall, 0.0)},
            "lid": {"kind": "box", "size": size, "position": moving},
        },
        viscosity=THICK, artificial_viscosity=0.0, walls={"friction": 1.0},
        gravity=(8.0 * THICK * SPEED / GAP**2 if name == "poiseuille" else 0.0, 0.0, 0.0),
    )  # fmt: skip
    law = poiseuille if name == "poiseuille" else couette
    worst, start = 0.0, 0.0
    for t in times:
        run(system, float(t), start=start)
        start = float(t)
        error = speeds(system)[:, 0] / SPEED - law(places(system)[:, 1], start)
        worst = max(worst, float(np.sqrt(np.mean(error**2))))
    return 100.0 * worst


THICK_WATER = 0.02
CASES: tuple[Case, ...] = (
    Case(
        "fluid", "Taylor-Green, Re 100, 40 across, dfsph: error of the decay",
        partial(decay_error, "dfsph", 40), 5.0, VORTEX_SOURCE, comparison="below", unit="%",
    ),
    *(
        Case(
            "fluid", f"Taylor-Green, Re 100, {across} across, {method}: error of the decay",
            partial(decay_error, method, across), 5.0, VORTEX_SOURCE, comparison="below", unit="%", slow=True,
        )
        for method, across in (("pbf", 40), ("wcsph", 40), ("dfsph", 80))
    ),
    *(
        Case(
            "fluid", f"standing wave, 30 along, {method}: period over the law's",
            partial(_wave, method, 30, 1e-6, "period"), 1.0, WAVE_SOURCE, tolerance=0.03,
            slow=method == "wcsph",
        )
        for method in METHODS
    ),
    Case(
        "fluid", "standing wave, 60 along, dfsph: period over the law's",
        partial(_wave, "dfsph", 60, 1e-6, "period"), 1.0, WAVE_SOURCE, tolerance=0.03, slow=True,
    ),
    Case(
        "fluid", "standing wave of nu = 0.02 m2/s, 30 along, dfsph: rate of decay",
        partial(_wave, "dfsph", 30, THICK_WATER, "rate"), 2.0 * THICK_WATER * (np.pi / LENGTH) ** 2,
        "theory: Lamb 1932, 2 nu k^2", tolerance=0.08 * 2.0 * THICK_WATER * np.pi**2, unit="1/s",
        slow=True,
    ),
    *(
        Case(
            "fluid", f"{name}, {ACROSS} across, {method}: error of the profile",
            partial(channel, name, method), 2.0, CHANNEL_SOURCE, comparison="below", unit="%",
            slow=method != "dfsph" or name == "couette",
        )
        for method in METHODS
        for name in ("poiseuille", "couette")
    ),
)  # fmt: skip
