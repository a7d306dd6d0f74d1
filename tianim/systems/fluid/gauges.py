"""Gauges: numbers that are read off the fluid once a frame, on the host.

The fluid's relative density at any point is delta(x) = sum_j V W(x - x_j): 1 within, one half at a flat
surface. The surface over a point is where delta, going up from the ground, falls under half of what it
is within (so that a line on a wall, where half of the kernel is missing, gives the same height).
"""

from collections.abc import Callable, Mapping
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from tianim.math.smoothing import spline_scale, spline_values
from tianim.system import Bounds
from tianim.systems.fluid.gauge_params import (
    ForceGauge,
    FrontGauge,
    Gauge,
    HeightGauge,
    PressureGauge,
    SpeedGauge,
    VolumeGauge,
)
from tianim.systems.fluid.params import FluidParams

Floats = NDArray[np.float64]
Numbers = dict[str, float]

# Steps of the search for a surface, to a spacing.
FINENESS = 16
# Going up from the ground, the fluid ends where delta falls under this: a quarter of it lies in a corner.
BULK = 0.15
# Less than this part of the kernel within the fluid: no fluid is near.
NEAR = 0.05
# A part of the front has so many neighbours within the support radius.
FRONT_NEIGHBOURS = 3
# Front-most particles that are looked at together.
BATCH = 256
# Singular values below this part of the largest give no slope of the pressure.
FLAT = 0.05


class Reading(NamedTuple):
    """The fluid of now, in any order.

    position, velocity (n, 3), pressure (n,) [Pa], phase (n,); force (3,) [N] on each body by name
    """

    position: NDArray[np.floating]
    velocity: NDArray[np.floating]
    pressure: NDArray[np.floating]
    phase: NDArray[np.integer]
    force: Mapping[str, NDArray[np.floating]]


class Gauges:
    """All gauges of a fluid."""

    def __init__(self, params: FluidParams, bounds: Bounds) -> None:
        self.params, self.bounds = params, bounds
        self.dimension, self.spacing, self.h = params.dimension, params.spacing, params.support_radius
        self.weight = params.cell_volume * spline_scale(self.h, self.dimension)
        self.length = np.zeros(3)
        if bounds.kind == "periodic" and bounds.lower is not None and bounds.upper is not None:
            self.length[: self.dimension] = np.subtract(bounds.upper, bounds.lower)[: self.dimension]

    def __len__(self) -> int:
        return len(self.params.gauges)

    def read(self, fluid: Reading) -> Numbers:
        """`gauge_<name>` and so on, in the order of the scene."""
        numbers: Numbers = {}
        for name, gauge in self.params.gauges.items():
            for ending, value in self._one(gauge, fluid).items():
                numbers[f"gauge_{name}{ending}"] = float(value)
        return numbers

    def _one(self, gauge: Gauge | ForceGauge, fluid: Reading) -> Numbers:
        if isinstance(gauge, ForceGauge):
            return _by_axis(fluid.force[gauge.body])
        if gauge.phase is not None:
            mine = fluid.phase == self.params.phase_number(gauge.phase)
            fluid = Reading(
                fluid.position[mine],
                fluid.velocity[mine],
                fluid.pressure[mine],
                fluid.phase[mine],
                fluid.force,
            )
        measures: dict[type, Callable[..., Numbers]] = {
            HeightGauge: self._height, FrontGauge: self._front, PressureGauge: self._pressure,
            VolumeGauge: self._volume, SpeedGauge: self._speed,
        }  # fmt: skip
        return measures[type(gauge)](gauge, fluid)

    def _away(self, fluid: Reading, point: Floats) -> Floats:
        """Ways from a point to all particles [m], (n, 3), to the nearest image; in 2D without z."""
        way = fluid.position - point
        way[:, self.dimension :] = 0.0
        images = self.length * np.round(way / np.where(self.length > 0.0, self.length, 1.0))
        return np.asarray(way - images)

    def _height(self, gauge: HeightGauge, fluid: Reading) -> Numbers:
        floor = gauge.floor
        if floor is None and self.bounds.lower is not None:
            floor = self.bounds.lower[1]
        # Of the way's parts only those across count here: which image is nearest up and down does not.
        across = self._away(fluid, np.array([gauge.line[0], 0.0, gauge.line[1]]))
        near = np.hypot(across[:, 0], across[:, 2]) < self.h
        y, r2 = fluid.position[near, 1].astype(np.float64), across[near, 0] ** 2 + across[near, 2] ** 2
        if floor is None:
            floor = float(fluid.position[:, 1].min()) - 0.5 * self.spacing if len(fluid.position) else 0.0
        if floor is not None:
            y, r2 = y[y > floor], r2[y > floor]
        if len(y) == 0:
            return {"": floor}
        for stack in self._stacks(y):
            heights, density = self._profile(y[stack], r2[stack])
            if density.max() >= BULK:
                break
        bottom = int(np.argmax(density >= BULK))
        bulk = density[bottom : bottom + int(np.argmin(density[bottom:] >= BULK))]
        if len(bulk) == 0:
            return {"": floor}
        level = 0.5 * float(np.median(bulk[bulk > 0.5 * bulk.max()]))
        first = bottom + int(np.argmax(bulk >= level))
        under = np.flatnonzero(density[first:] < level)
        k = first + int(under[0])
        # Between the last sample above the level and the first under it.
        share = (density[k - 1] - level) / (density[k - 1] - density[k])
        return {"": max(heights[k - 1] + share * (heights[k] - heights[k - 1]), floor)}

    def _stacks(self, y: Floats) -> list[NDArray[np.int64]]:
        """The particles in stacks from below, between which no kernel reaches: a drop may fall far."""
        order = np.argsort(y, kind="stable")
        gaps = np.flatnonzero(np.diff(y[order]) > 2.0 * self.h)
        return [np.sort(stack) for stack in np.split(order, gaps + 1)]

    def _profile(self, y: Floats, r2: Floats) -> tuple[Floats, Floats]:
        """Delta along the line: heights and densities, from below all fluid to above it."""
        step = self.spacing / FINENESS
        heights = np.arange(y.min() - self.h, y.max() + self.h + step, step)
        density = np.zeros(len(heights))
        reach = int(np.ceil(self.h / step))
        nearest = np.round((y - heights[0]) / step).astype(np.int64)
        for k in range(-reach, reach + 1):
            place = nearest + k
            there = (place >= 0) & (place < len(heights))
            q = np.sqrt(r2[there] + (heights[place[there]] - y[there]) ** 2) / self.h
            np.add.at(density, place[there], self.weight * spline_values(np.minimum(q, 1.0), self.dimension))
        return heights, density

    def _front(self, gauge: FrontGauge, fluid: Reading) -> Numbers:
        direction = np.array(gauge.direction) / np.linalg.norm(gauge.direction)
        x = fluid.position.astype(np.float64)
        if len(x) == 0:
            return {"": 0.0}
        along = (x - np.array(gauge.origin)) @ direction
        bulk = _bulk(x, self.spacing)
        if gauge.depth is not None:
            bulk &= x[:, 1] < x[bulk, 1].min() + gauge.depth
        places = np.flatnonzero(bulk)
        places = places[np.argsort(-along[places], kind="stable")]
        tree = cKDTree(x)
        for first in range(0, len(places), BATCH):
            some = places[first : first + BATCH]
            neighbours = tree.query_ball_point(x[some], self.h, return_length=True) - 1
            full = np.flatnonzero(neighbours >= FRONT_NEIGHBOURS)
            if len(full):
                return {"": float(along[some[full[0]]])}
        return {"": float(along[places[0]])}

    def _pressure(self, gauge: PressureGauge, fluid: Reading) -> Numbers:
        """The plane through the pressures around, weighted by W: at a wall it reaches on to the wall."""
        way = self._away(fluid, np.array(gauge.position))[:, : self.dimension]
        r = np.linalg.norm(way, axis=1)
        near = r < self.h
        weight = self.weight * spline_values(r[near] / self.h, self.dimension)
        if weight.sum() < NEAR:
            return {"": 0.0}
        mean = (weight @ way[near]) / weight.sum()
        level = float(weight @ fluid.pressure[near] / weight.sum())
        root = np.sqrt(weight)
        slopes = np.linalg.lstsq(
            root[:, None] * (way[near] - mean), root * (fluid.pressure[near] - level), rcond=FLAT
        )[0]
        return {"": float(level - slopes @ mean)}

    def _volume(self, gauge: VolumeGauge, fluid: Reading) -> Numbers:
        return {"": np.count_nonzero(self._in_box(gauge, fluid)) * self.params.cell_volume}

    def _speed(self, gauge: SpeedGauge, fluid: Reading) -> Numbers:
        velocity = fluid.velocity[self._in_box(gauge, fluid)].astype(np.float64)
        if len(velocity) == 0:
            return {"": 0.0, **_by_axis(np.zeros(3))}
        return {"": float(np.linalg.norm(velocity, axis=1).mean()), **_by_axis(velocity.mean(axis=0))}

    def _in_box(self, gauge: VolumeGauge | SpeedGauge, fluid: Reading) -> NDArray[np.bool_]:
        x = fluid.position[:, : self.dimension]
        lower, upper = np.array(gauge.lower)[: self.dimension], np.array(gauge.upper)[: self.dimension]
        return np.asarray(((x >= lower) & (x < upper)).all(axis=1))


def _by_axis(vector: NDArray[np.floating]) -> Numbers:
    return {f"_{axis}": float(value) for axis, value in zip("xyz", vector, strict=True)}


def _bulk(x: Floats, spacing: float) -> NDArray[np.bool_]:
    """Which particles belong to the largest body of fluid: their cells of a spacing touch one another."""
    cells = np.floor(x / spacing).astype(np.int64)
    cells -= cells.min(axis=0) - 1
    shape = cells.max(axis=0) + 2
    code = (cells[:, 0] * shape[1] + cells[:, 1]) * shape[2] + cells[:, 2]
    taken, cell, particles = np.unique(code, return_inverse=True, return_counts=True)
    ends = []
    for step in np.ndindex(3, 3, 3):
        a, b, c = (k - 1 for k in step)
        offset = (a * shape[1] + b) * shape[2] + c
        if offset <= 0:
            continue  # each pair of cells once
        place = np.minimum(np.searchsorted(taken, taken + offset), len(taken) - 1)
        there = taken[place] == taken + offset
        ends.append(np.stack([np.flatnonzero(there), place[there]]))
    one, other = np.concatenate(ends, axis=1)
    graph = coo_array((np.ones(len(one)), (one, other)), shape=(len(taken),) * 2)
    group = connected_components(graph, directed=False)[1]
    sizes = np.bincount(group, weights=particles)
    return np.asarray(group[cell] == np.argmax(sizes))
