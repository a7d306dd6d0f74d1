"""What makes a murmuration, as numbers that any run can be judged by.

    flock = measure(frames, "boids", "boids_falcons", linking_length=2.2, reach=16.0)

One cluster: boids nearer than the linking length (the radius of their rules) hang together. The
heading is the mean of the unit velocities, its length the polarisation.

A density wave is a compression that runs through the flock ahead of its cause. A strike is when a
predator first comes within STRIKE of a boid. Boids are sorted into shells by their distance from
the predator at that moment, and followed: C(shell, t) is the shell's median density over that of
a second before, divided by the same ratio of the whole flock, which takes a slow swelling or
shrinking out. Only shells beyond the predator's reach count, whose boids do not mind it
themselves: there a wave shows as C well above 1, the later the farther out. The density of a boid
is that of its 7 nearest, 7 / (4/3 pi d^3).

Sources: Ballerini et al. 2008, PNAS 105, 1232; Procaccini et al. 2011, Animal Behaviour 82, 759
(waves that propagate away from a hunting falcon).
"""

from collections.abc import Iterable
from dataclasses import dataclass
from functools import lru_cache, partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from tianim.frame import Frame
from tianim.validate.case import Case, Comparison

Floats = NDArray[np.float64]

NEAREST = 7
STRIKE = 3.0  # m
SHELL = 4.0  # width of a shell [m]
FEWEST = 100  # boids in a shell that counts
BEFORE, AFTER = 1.0, 3.0  # s from the strike
EVERY = 0.1  # s between two samples
LAST = 5.0  # s over which the flock is judged
COMPRESSED = 1.05  # a shell whose peak is lower is not reached by the wave


@dataclass(frozen=True)
class Murmuration:
    """Numbers of a run; those of cluster, polarisation and turn are of its last five seconds.

    cluster              least part of the boids that is in the largest cluster
    polarisation         least and largest
    turn                 largest angle of the mean heading from where it was [deg]
    compression          largest C of a shell beyond the predators' reach, 0 where none strikes
    wave_speed           speed at which the peak runs outward [m/s], 0 where it reaches one shell only
    """

    cluster: float
    polarisation: tuple[float, float]
    turn: float
    compression: float
    wave_speed: float


def largest_cluster(position: Floats, linking_length: float) -> float:
    """Part of the points (n, 3) that hangs together by links up to that length [m]."""
    count = len(position)
    if count == 0:
        return 0.0
    pairs = cKDTree(position).query_pairs(linking_length, output_type="ndarray")
    graph = coo_matrix((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(count, count))
    labels = connected_components(graph, directed=False)[1]
    return float(np.bincount(labels).max() / count)


def mean_direction(velocity: Floats) -> Floats:
    """Mean of the unit velocities; its length is the polarisation."""
    speed = np.linalg.norm(velocity, axis=1, keepdims=True)
    return np.asarray((velocity / np.where(speed > 0.0, speed, 1.0)).mean(axis=0))


def turned_by(direction: Floats) -> float:
    """Largest angle [deg] between the first of the directions (m, 3) and a later one."""
    unit = direction / np.linalg.norm(direction, axis=1, keepdims=True)
    return float(np.degrees(np.arccos(np.clip(unit @ unit[0], -1.0, 1.0)).max()))


def density(position: Floats) -> Floats:
    """Number density [1/m3] round each point, from its 7 nearest."""
    distance = cKDTree(position).query(position, k=NEAREST + 1)[0][:, NEAREST]
    return np.asarray(NEAREST / (4.0 / 3.0 * np.pi * np.maximum(distance, 1e-9) ** 3))


def density_wave(time: Floats, position: Floats, predator: Floats, reach: float) -> tuple[float, float]:
    """Compression and speed [m/s] of the wave that one predator's first strike sends out.

    time (m,) [s], position (m, n, 3) [m] of the boids, predator (m, 3) [m]; (0, 0) without a strike.
    """
    gap = [cKDTree(x).query(p)[0] for x, p in zip(position, predator, strict=True)]
    struck = np.flatnonzero((np.asarray(gap) < STRIKE) & (time >= time[0] + BEFORE))
    if len(struck) == 0:
        return 0.0, 0.0
    now = struck[0]
    shell = ((np.linalg.norm(position[now] - predator[now], axis=1) - reach) // SHELL).astype(int)
    shells = [s for s in range(shell.max() + 1) if np.count_nonzero(shell == s) >= FEWEST]
    before = density(position[np.argmin(np.abs(time - (time[now] - BEFORE)))])
    later = np.flatnonzero((time >= time[now]) & (time <= time[now] + AFTER))
    rise = np.empty((len(later), len(shells)))
    for row, k in enumerate(later):
        ratio = density(position[k]) / before
        rise[row] = np.array([np.median(ratio[shell == s]) for s in shells]) / np.median(ratio)
    if rise.size == 0:
        return 0.0, 0.0
    distance = reach + SHELL * (np.array(shells) + 0.5)
    return float(rise.max()), _front_speed(time[later], distance, rise)


def _front_speed(time: Floats, distance: Floats, rise: Floats) -> float:
    """Speed [m/s] at which the peak of `rise` (times, shells) runs outward, 0 where it reaches one shell.

    From the shell that is compressed most outward and inward, as far as shells are compressed, have
    their peak within the time looked at, and have it the later the farther out they are.
    """
    peak = rise.argmax(axis=0)
    reached = (rise.max(axis=0) > COMPRESSED) & (peak > 0) & (peak < len(time) - 1)
    first = end = int(rise.max(axis=0).argmax())
    while end + 1 < len(distance) and reached[end + 1] and peak[end + 1] > peak[end]:
        end += 1
    while first > 0 and reached[first - 1] and peak[first - 1] < peak[first]:
        first -= 1
    if first == end:
        return 0.0
    run = slice(first, end + 1)
    return float(np.polyfit(time[peak[run]], distance[run], 1)[0])


def measure(
    frames: Iterable[Frame], flock: str, predators: str | None, linking_length: float, reach: float
) -> Murmuration:
    """Judge the part `flock` of a run, hunted by the part `predators`, which is minded within `reach` [m]."""
    times: list[float] = []
    places, hunters, headings = [], [], []
    for frame in frames:
        if times and frame.time < times[-1] + EVERY - 1e-6:
            continue
        boids = frame.part(flock)
        times.append(frame.time)
        places.append(boids.position)
        headings.append(mean_direction(np.asarray(boids.data["velocity"], np.float64)))
        hunters.append(frame.part(predators).position if predators else np.zeros((0, 3)))
    time, heading = np.array(times), np.array(headings)
    last = time >= time[-1] - LAST - 1e-6
    polarisation = np.linalg.norm(heading[last], axis=1)
    half_seconds = [k for k in np.flatnonzero(last) if k % 5 == 0]
    position, hunter = np.array(places, np.float64), np.array(hunters, np.float64)
    waves = [density_wave(time, position, hunter[:, k], reach) for k in range(hunter.shape[1])]
    compression, speed = max(waves, default=(0.0, 0.0))
    return Murmuration(
        cluster=min(largest_cluster(position[k], linking_length) for k in half_seconds),
        polarisation=(float(polarisation.min()), float(polarisation.max())),
        turn=turned_by(heading[last]),
        compression=compression,
        wave_speed=speed,
    )


SCENE = Path(__file__).resolve().parents[2] / "configs" / "murmuration.yaml"
SOURCE = "stated goals of the scene; Procaccini et al. 2011, Animal Behaviour 82, 759 for the waves"
# In the scene: radius of the rules, radius at which falcons are minded [m].
LINKING_LENGTH, REACH = 2.2, 16.0


@lru_cache(maxsize=1)
def of_scene() -> Murmuration:
    """The shipped scene, run to its end."""
    from tianim.scene import build, load_scene

    frames = build(load_scene(SCENE)).frames()
    return measure(frames, "boids", "boids_falcons", LINKING_LENGTH, REACH)


def _number(name: str, index: int | None = None) -> float:
    value = getattr(of_scene(), name)
    return float(value if index is None else value[index])


def _case(name: str, field: str, comparison: Comparison, limit: float, index: int | None = None) -> Case:
    run = partial(_number, field, index)
    return Case("boids", f"murmuration: {name}", run, limit, SOURCE, comparison=comparison, slow=True)


# The scene comes with the project, not with the installed package.
CASES: tuple[Case, ...] = (
    (
        _case("part in one cluster, last 5 s", "cluster", "above", 0.95),
        _case("least polarisation, last 5 s", "polarisation", "above", 0.6, 0),
        _case("largest polarisation, last 5 s", "polarisation", "below", 0.98, 1),
        _case("turn of the heading, last 5 s [deg]", "turn", "above", 45.0),
        _case("compression when a falcon strikes, beyond its reach", "compression", "above", 1.15),
        _case("speed at which the compression runs outward [m/s]", "wave_speed", "above", 1.0),
    )
    if SCENE.is_file()
    else ()
)
