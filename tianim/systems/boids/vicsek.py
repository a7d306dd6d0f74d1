"""Vicsek's model: self-propelled particles that take the mean direction of their neighbours.

    theta_i' = arg( sum over |x_j - x_i| < r of exp(i theta_j) ) + noise,  noise uniform in [-eta/2, eta/2]
    x_i'     = x_i + v_i dt

The sum includes the particle itself; places advance with the old velocity. One `step` is one
application of the law, whatever its dt: choose time_step = 1/fps. Source: T. Vicsek et al., Phys.
Rev. Lett. 75 (1995) 1226, DOI 10.1103/PhysRevLett.75.1226. Limits: two dimensions, periodic
bounds at least 3 radii wide.
"""

from collections.abc import Collection
from typing import Annotated, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator
from typing_extensions import Self

from tianim.lang import f32_1d, f32_2d, i32_1d, i32_2d, ti
from tianim.math.random import uniform
from tianim.params import Animated, Count, Positive
from tianim.spatial.columns import staggered
from tianim.spatial.grid import NeighborGrid
from tianim.spatial.placement import Placement, RandomHeading, check_start, place
from tianim.spatial.tubes import (
    MOTIONS,
    NX,
    STRIDE,
    TASKS,
    TURN,
    first_row,
    gather_tube,
    pieces,
    rounded,
    slice_of,
    take_turn,
)
from tianim.system import Bounds, SystemParams, World
from tianim.systems.boids.params import BYTES_PER_BOID, SECONDS_PER_BOID_STEP, SECONDS_PER_STEP
from tianim.systems.boids.swarm import Swarm


class VicsekParams(SystemParams):
    """Self-propelled particles after Vicsek 1995, in periodic bounds."""

    kind: Literal["vicsek"] = "vicsek"
    count: Count = Field(description="how many")
    start: Placement | None = Field(
        None, description="where they start, and how they head if a file says; left out: all over the bounds"
    )
    radius: Positive = Field(1.0, description="minds particles within this [m]")
    speed: Positive = Field(0.9, description="speed of all [m/s]")
    noise: Animated[Annotated[float, Field(ge=0, le=7)]] = Field(
        1.0, description="width eta of the noise [rad]"
    )
    time_step: Positive = Field(1 / 30, description="one application of the law [s]")

    @model_validator(mode="after")
    def _start_fits(self) -> Self:
        if self.start is not None:
            check_start(self.count, self.start, RandomHeading())
        return self

    def particle_count(self) -> int:
        """All of them."""
        return self.count

    def memory_bytes(self) -> int:
        """Columns, cells and scratch."""
        return BYTES_PER_BOID * self.count + (1 << 20)

    def seconds_per_step(self) -> float:
        """As boids in two dimensions."""
        return SECONDS_PER_STEP + SECONDS_PER_BOID_STEP / 2 * self.count

    def largest_step(self) -> float:
        """The time step."""
        return self.time_step

    def check_scene(self, bounds: Bounds, body_names: Collection[str], system_names: Collection[str]) -> None:
        """Periodic bounds, wide enough."""
        if bounds.kind != "periodic" or bounds.lower is None or bounds.upper is None:
            raise ValueError("vicsek needs bounds of kind periodic")
        for axis in range(2):
            if bounds.upper[axis] - bounds.lower[axis] < 3.01 * self.radius:
                raise ValueError(f"radius {self.radius:g}: periodic bounds must be wider than 3.01 radii")


@ti.kernel
def align(
    eta: ti.f32,
    speed: ti.f32,
    reach: ti.f32,
    step: ti.i32,
    seed: ti.u32,
    shape: i32_1d,
    geometry: f32_1d,
    start: i32_1d,
    identity: i32_2d,
    x: f32_2d,
    v: f32_2d,
    scratch: f32_2d,
    offset: i32_2d,
    turned: f32_2d,
):
    """New velocities from the mean directions, into `turned` (2, capacity); reach is r squared."""
    nx = shape[NX]
    shape[TURN] = 0
    for block in range(shape[TASKS] * shape[STRIDE]):
        if block % shape[STRIDE] == 0:
            task = block // shape[STRIDE]
            piece = take_turn(shape)
            while piece < pieces(shape):
                for row in range(first_row(piece, shape, start), first_row(piece + 1, shape, start)):
                    if start[row * nx + nx] == start[row * nx]:
                        continue
                    gather_tube(
                        2, MOTIONS, task, row, shape, geometry, start, x, v, identity, scratch, offset
                    )
                    for column in range(nx):
                        cell, s = row * nx + column, slice_of(column, nx)
                        begin, end = offset[task, s - 1], offset[task, s + 2]
                        for i in range(start[cell], start[cell + 1]):
                            me = offset[task, s] + i - start[cell]
                            xi, yi = scratch[0, me], scratch[1, me]
                            cosine, sine = 0.0, 0.0
                            for j in range(begin, begin + rounded(end - begin)):
                                dx, dy = scratch[0, j] - xi, scratch[1, j] - yi
                                near = ti.select((j < end) & (dx * dx + dy * dy < reach), 1.0, 0.0)
                                cosine += near * scratch[3, j]
                                sine += near * scratch[4, j]
                            angle = ti.atan2(sine, cosine)
                            angle += eta * (uniform(seed, identity[0, i], step, 0) - 0.5)
                            turned[0, i] = speed * ti.cos(angle)
                            turned[1, i] = speed * ti.sin(angle)
                piece = take_turn(shape)


@ti.kernel
def advance(n: ti.i32, dt: ti.f32, bounds: f32_2d, turned: f32_2d, x: f32_2d, v: f32_2d):
    """Places with the old velocity, wrapped; then the new velocity."""
    for i in range(n):
        for c in ti.static(range(2)):
            lower, upper = bounds[0, c], bounds[1, c]
            p = x[c, i] + dt * v[c, i]
            p -= (upper - lower) * ti.floor((p - lower) / (upper - lower))
            if p < lower or p >= upper:
                p = lower
            x[c, i] = p
            v[c, i] = turned[c, i]


class Vicsek(Swarm):
    """The system `kind: vicsek`; `polarisation` is the paper's order parameter v_a."""

    def __init__(self, name: str, params: VicsekParams, world: World) -> None:
        super().__init__(name, params.count, 2, world, {})
        self.params, self.seed = params, world.seed
        self.grid = NeighborGrid(self.count, 2, world.bounds, params.radius)
        self._turned = ti.ndarray(ti.f32, (2, staggered(self.count)))
        self._bounds = ti.ndarray(ti.f32, (2, 3))
        corners = np.array([world.bounds.lower, world.bounds.upper], np.float32)
        self._bounds.from_numpy(corners)
        self._place(np.random.default_rng(world.seed), corners)

    def _place(self, rng: np.random.Generator, corners: NDArray[np.float32]) -> None:
        """All over the bounds in every direction, or as `start` says."""
        position, velocity = np.zeros((2, self.count, 3), np.float32)
        position[:, :2] = corners[0, :2] + rng.random((self.count, 2)) * (corners[1] - corners[0])[:2]
        angle = rng.uniform(-np.pi, np.pi, self.count)
        if self.params.start is not None:
            placed = place(self.params.start, self.count, rng, 2)
            position = placed.position
            if placed.velocity is not None:
                angle = np.arctan2(placed.velocity[:, 1], placed.velocity[:, 0])
        velocity[:, :2] = self.params.speed * np.stack([np.cos(angle), np.sin(angle)], axis=1)
        self.columns.write("position", self.inside(position))
        self.columns.write("velocity", velocity)

    def max_step(self) -> float:
        """The time step [s]."""
        return self.params.time_step

    def step(self, time: float, dt: float) -> None:
        """One application of the law."""
        self._measured = False
        if self.count == 0:
            return
        now, grid, columns = self.params.at(time), self.grid, self.columns
        grid.sort(columns)
        align(
            now.noise, now.speed, now.radius**2, round(time / dt), self.seed & 0xFFFFFFFF,
            grid.shape, grid.geometry, grid.start, columns["id"], columns["position"], columns["velocity"],
            grid.scratch, grid.offset, self._turned,
        )  # fmt: skip
        advance(self.count, dt, self._bounds, self._turned, columns["position"], columns["velocity"])
