"""Gravity with many bodies: a cluster and disks that stay themselves or break up, tails of an encounter.

A dynamical time of a Plummer sphere is sqrt(3 pi / (16 G rho)) with rho the mean density within the
half-mass radius (Binney and Tremaine, eq. 2.39): 3.31 at G = M = b = 1.
"""

from functools import lru_cache, partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tianim.validate.case import Case
from tianim.validate.gravity import cluster, run, simulated

Floats = NDArray[np.float64]

DYNAMICAL_TIME = 3.31
SHARES = (0.1, 0.5, 0.9)
PEER_PLUMMER = "measured with falcON, N = 20,000, eps = 0.03, dt = 1/32"

# A disk in a fixed halo, G = scale length = 1: it turns once at two scale lengths in TURN.
HALO: dict[str, Any] = {"kind": "logarithmic", "speed": 0.75, "core": 0.5}
DISK_MASS = 0.8
EDGES = np.linspace(0.5, 3.0, 6)


class Cluster(NamedTuple):
    """Of a Plummer sphere: relative change of each radius, extremes of the virial ratio, energy drift."""

    radii: Floats
    lowest: float
    highest: float
    energy: float


@lru_cache(maxsize=2)
def plummer(count: int, times: float, dt: float) -> Cluster:
    """A Plummer sphere over so many dynamical times; radii averaged over the last of them."""
    system = simulated(cluster(count), softening={"length": 0.03}, time_step={"kind": "fixed", "length": dt})
    first = system.diagnostics()
    steps, virial, late = round(times * DYNAMICAL_TIME / dt), [first["virial_ratio"]], []
    for step in range(steps):
        system.step(step * dt, dt)
        if (steps - step) % round(0.25 / dt) == 0:
            now = system.diagnostics()
            virial.append(now["virial_ratio"])
            if (steps - step) * dt < DYNAMICAL_TIME:
                late.append([now[f"radius_{100 * share:g}"] for share in SHARES])
    start = np.array([first[f"radius_{100 * share:g}"] for share in SHARES])
    return Cluster(
        np.mean(late, axis=0) / start - 1.0,
        min(virial),
        max(virial),
        abs(system.diagnostics()["energy_drift"]),
    )


def _radius(count: int, times: float, dt: float, k: int) -> float:
    return float(plummer(count, times, dt).radii[k])


def _cluster(count: int, times: float, dt: float, which: str) -> float:
    return float(getattr(plummer(count, times, dt), which))


def disk_scene(count: int, toomre_q: float) -> dict[str, Any]:
    """A disk in its halo, G = 1, scale length 1."""
    disk = {"kind": "exponential_disk", "count": count, "mass": DISK_MASS, "scale_length": 1.0,
            "height": 0.1, "toomre_q": toomre_q, "truncation": 6.0}  # fmt: skip
    return {
        "components": {"disk": disk}, "external": (HALO,), "softening": {"length": 0.05},
        "time_step": {"kind": "fixed", "length": 0.1},
    }  # fmt: skip


def turn_time() -> float:
    """Time of one rotation at two scale lengths: of the halo and of a thin exponential disk."""
    from scipy.special import i0, i1, k0, k1

    y = 1.0  # R / 2 R_d
    disk = 4.0 * np.pi * (DISK_MASS / (2.0 * np.pi)) * y * y * (i0(y) * k0(y) - i1(y) * k1(y))
    halo = HALO["speed"] ** 2 * 4.0 / (HALO["core"] ** 2 + 4.0)
    return float(2.0 * np.pi * 2.0 / np.sqrt(disk + halo))


class Disk(NamedTuple):
    """Largest relative change of a ring's surface density at the end, largest clump contrast on the way."""

    change: float
    contrast: float


@lru_cache(maxsize=4)
def disk(count: int, toomre_q: float, turns: float) -> Disk:
    """A disk after so many rotations at two scale lengths.

    The clump contrast is the largest surface density of a cell over its ring's mean, in cells of
    0.25 by about 0.25 scale lengths.
    """
    scene = disk_scene(count, toomre_q)
    system = simulated(**scene)
    dt = scene["time_step"]["length"]

    def rings() -> Floats:
        x = system.read("position")
        return np.histogram(np.hypot(x[:, 0], x[:, 2]), EDGES)[0].astype(float)

    before, seen = rings(), []
    for _ in range(round(4 * turns)):
        run(system, round(0.25 * turn_time() / dt), dt)
        seen.append(contrast(system.read("position")))
    return Disk(float(np.abs(rings() / before - 1.0).max()), max(seen))


def contrast(position: Floats) -> float:
    """Largest surface density of a cell over the mean of its ring, from 0.5 to 3 scale lengths."""
    radius = np.hypot(position[:, 0], position[:, 2])
    angle = np.arctan2(position[:, 2], position[:, 0])
    worst = 0.0
    for inner in np.arange(0.5, 3.0, 0.25):
        cells = max(8, round(2.0 * np.pi * (inner + 0.125) / 0.25))
        own = angle[(radius >= inner) & (radius < inner + 0.25)]
        found = np.histogram(own, cells, (-np.pi, np.pi))[0]
        worst = max(worst, float(found.max() / found.mean()))
    return worst


def _disk(count: int, toomre_q: float, turns: float, which: str) -> float:
    return float(getattr(disk(count, toomre_q, turns), which))


def passage(count: int, inclination: float) -> float:
    """Share of the stars of both disks beyond 5 scale lengths of both centres after a passage.

    Restricted, as Toomre and Toomre 1972: massless stars in two softened masses that pass on a
    parabola, `inclination` [deg] between each disk's spin and the orbit's.
    """
    scale = 0.23  # of the disks, where the pericentre is 1; they end at 3 scale lengths

    def galaxy(**place: Any) -> dict[str, Any]:
        middle = {"kind": "bodies", "bodies": ({"mass": 1.0},)}
        disk = {"kind": "exponential_disk", "count": count, "massless": True, "scale_length": scale,
                "height": 0.0, "toomre_q": 0.0, "truncation": 3.0 * scale}  # fmt: skip
        return {"components": {"middle": middle, "disk": disk}, "inclination": inclination, **place}

    orbit = {"around": "north", "pericentre": 1.0, "eccentricity": 1.0, "separation": 4.0}
    system = simulated(
        {}, galaxies={"north": galaxy(), "south": galaxy(orbit=orbit)},
        softening={"length": 0.1}, time_step={"kind": "fixed", "length": 0.02},
    )  # fmt: skip
    run(system, round(12.0 / 0.02), 0.02)
    position, mass = system.read("position"), system.read("mass")
    centres, stars = position[mass > 0.0], position[mass == 0.0]
    nearest = np.min([np.linalg.norm(stars - centre, axis=1) for centre in centres], axis=0)
    return float((nearest > 5.0 * scale).mean())


def _load(name: str, **overrides: str) -> Any:
    """The system of a packaged scene, and its scene."""
    from tianim.scene import build, load_scene
    from tianim.scene.loading import PACKAGED

    scene = load_scene(PACKAGED / f"{name}.yaml", overrides)
    return build(scene)


@lru_cache(maxsize=2)
def collision(inclination: float) -> tuple[float, float]:
    """Of the scene `galaxy_collision` at its end: share of the disks' stars far from both, energy drift."""
    keys = {f"systems.collision.galaxies.{one}.inclination": f"{inclination}" for one in ("north", "south")}
    simulation = _load("galaxy_collision", **keys)
    for _ in simulation.frames():
        pass
    system: Any = simulation["collision"]
    position = system.read("position")

    def of(component: str) -> Floats:
        first, count = system.parts[f"collision_{component}"]
        return np.asarray(position[first : first + count])

    centres = [np.median(of(f"{one}_bulge"), axis=0) for one in ("north", "south")]
    stars = np.concatenate([of("north_disk"), of("south_disk")])
    nearest = np.min([np.linalg.norm(stars - centre, axis=1) for centre in centres], axis=0)
    scale = system.params.galaxies["north"].components["disk"].scale_length
    return float((nearest > 5.0 * scale).mean()), abs(system.diagnostics()["energy_drift"])


def _collision(inclination: float, which: int) -> float:
    return collision(inclination)[which]


def galaxy_energy() -> float:
    """Energy drift of the scene `galaxy` at its end."""
    simulation = _load("galaxy")
    for _ in simulation.frames():
        pass
    return abs(simulation["galaxy"].diagnostics()["energy_drift"])


TOOMRE = "Toomre and Toomre 1972, ApJ 178, 623: prograde passages draw tails, retrograde ones hardly any"
STABLE = "Toomre 1964, ApJ 139, 1217: a disk of Q > 1 is stable"
SHORT, LONG = (8000, 4.0, 1 / 16), (20_000, 20.0, 1 / 32)  # stars, dynamical times, step
# Radii of the short run: 800 stars within the first of them, at two independent times, 3 deviations.
WITHIN = {SHORT: (0.06, 0.04, 0.06), LONG: (0.015, 0.015, 0.03)}
FEW, MANY = 16_000, 40_000  # stars of a disk


def _plummer_cases(setup: tuple[int, float, float], slow: bool) -> list[Case]:
    count, times, _ = setup
    name = f"Plummer, {count:,} stars, {times:g} dynamical times"
    found = [
        Case(
            "gravity", f"{name}: change of the {100 * share:g} % radius", partial(_radius, *setup, k), 0.0,
            PEER_PLUMMER, tolerance=WITHIN[setup][k], slow=slow,
        )
        for k, share in enumerate(SHARES)
    ]  # fmt: skip
    limits: tuple[tuple[str, float, Any], ...] = (
        ("lowest", 0.97 if setup == SHORT else 0.99, "above"),
        ("highest", 1.03 if setup == SHORT else 1.01, "below"),
        ("energy", 5e-4, "below"),
    )
    words = {"lowest": "least virial ratio", "highest": "largest virial ratio", "energy": "energy drift"}
    return found + [
        Case("gravity", f"{name}: {words[which]}", partial(_cluster, *setup, which), limit, PEER_PLUMMER,
             comparison=comparison, slow=slow)
        for which, limit, comparison in limits
    ]  # fmt: skip


def _disk_cases(count: int, slow: bool) -> list[Case]:
    return [
        Case(
            "gravity", f"disk, Q = 1.5, {count:,} stars, two rotations: change of the surface density",
            partial(_disk, count, 1.5, 2.0, "change"), 0.1, STABLE, comparison="below", slow=slow,
        ),
        Case(
            "gravity", f"disk, Q = 0.5, {count:,} stars, one rotation: largest clump contrast",
            partial(_disk, count, 0.5, 1.0, "contrast"), 3.0, STABLE, comparison="above", slow=slow,
        ),
    ]  # fmt: skip


CASES: tuple[Case, ...] = (
    *_plummer_cases(SHORT, slow=False),
    *_plummer_cases(LONG, slow=True),
    *_disk_cases(FEW, slow=False),
    *_disk_cases(MANY, slow=True),
    Case(
        "gravity", "restricted encounter, prograde at 60 degrees: share of stars far from both",
        partial(passage, 1000, 60.0), 0.05, TOOMRE, comparison="above",
    ),
    Case(
        "gravity", "restricted encounter, retrograde: share of stars far from both",
        partial(passage, 1000, 180.0), 0.01, TOOMRE, comparison="below",
    ),
    Case(
        "gravity", "galaxy_collision, prograde at 60 degrees: share of stars far from both",
        partial(_collision, 60.0, 0), 0.05, TOOMRE, comparison="above", slow=True,
    ),
    Case(
        "gravity", "galaxy_collision, retrograde: share of stars far from both",
        partial(_collision, 180.0, 0), 0.01, TOOMRE, comparison="below", slow=True,
    ),
    Case(
        "gravity", "galaxy_collision: energy drift", partial(_collision, 60.0, 1), 1e-3,
        "leapfrog and tree: under 1e-3", comparison="below", slow=True,
    ),
    Case(
        "gravity", "galaxy: energy drift", galaxy_energy, 1e-3, "leapfrog and tree: under 1e-3",
        comparison="below", slow=True,
    ),
)  # fmt: skip
