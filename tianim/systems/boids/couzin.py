"""Couzin's model: zones of repulsion, orientation and attraction round each individual.

With d = x_j - x_i, u its unit vector, zones |d| < r_r, < r_o = r_r + dr_o, < r_a = r_o + dr_a, the
outer two without the blind volume behind:

    wish = -sum u             where anyone is in the zone of repulsion, else
    wish = sum v_j / |v_j|    over the zone of orientation, and sum u over the zone of attraction:
           their mean where both have somebody, the own direction where nobody is anywhere

The wish is turned by a Gaussian angle of deviation sigma, the direction turns towards it by at
most `turn_rate` dt, and x' = x + s dt v. Depending on dr_o a group swarms, mills in a torus, or flies
parallel. Source: I. Couzin et al., J. theor. Biol. 218 (2002) 1, DOI 10.1006/jtbi.2002.3065.
Limits: open space, three dimensions.
"""

import math
from collections.abc import Collection
from typing import Literal

import numpy as np
from pydantic import Field, model_validator
from typing_extensions import Self

from tianim.lang import f32_1d, f32_2d, i32_1d, i32_2d, ti
from tianim.math.random import normal3, unit_vector
from tianim.params import Animated, Count, Degrees, NonNegative, Positive
from tianim.spatial.columns import staggered
from tianim.spatial.grid import NeighborGrid
from tianim.spatial.placement import Ball, Heading, Placement, RandomHeading, check_start, directions, place
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
from tianim.systems.boids.flocking import TINY
from tianim.systems.boids.motion import turned
from tianim.systems.boids.params import BYTES_PER_BOID, SECONDS_PER_BOID_STEP, SECONDS_PER_STEP
from tianim.systems.boids.steering import column
from tianim.systems.boids.swarm import Swarm
from tianim.systems.boids.tables import view_bound


class CouzinParams(SystemParams):
    """A group after Couzin 2002; the defaults are the paper's middle values."""

    kind: Literal["couzin"] = "couzin"
    count: Count = Field(100, description="how many")
    start: Placement = Field(Ball(radius=5.0), description="where they start")
    heading: Heading = Field(RandomHeading(), description="which way they head at the start")
    speed: Positive = Field(3.0, description="speed s of all [m/s]")
    repulsion_radius: Positive = Field(1.0, description="radius r_r of the zone of repulsion [m]")
    orientation_width: Animated[NonNegative] = Field(
        2.0, description="width dr_o of the zone of orientation [m]"
    )
    attraction_width: NonNegative = Field(14.0, description="width dr_a of the zone of attraction [m]")
    field_of_view: Degrees = Field(270.0, description="full angle seen [deg]")
    turn_rate: Positive = Field(40.0, description="fastest turn [deg/s]")
    noise: NonNegative = Field(0.05, description="deviation sigma of the wish a step [rad]")
    time_step: Positive = Field(0.1, description="step tau [s]")

    @model_validator(mode="after")
    def _start_fits(self) -> Self:
        check_start(self.count, self.start, self.heading)
        return self

    def check_scene(self, bounds: Bounds, body_names: Collection[str], system_names: Collection[str]) -> None:
        """Open space: the group would go through walls."""
        if bounds.kind != "open":
            raise ValueError("couzin needs bounds of kind open")

    def particle_count(self) -> int:
        """All of them."""
        return self.count

    def memory_bytes(self) -> int:
        """Columns, cells and scratch."""
        return BYTES_PER_BOID * self.count + (1 << 20)

    def seconds_per_step(self) -> float:
        """As boids."""
        return SECONDS_PER_STEP + SECONDS_PER_BOID_STEP * self.count

    def largest_step(self) -> float:
        """The time step."""
        return self.time_step


@ti.kernel
def decide(
    repulsion: ti.f32,
    orientation: ti.f32,
    attraction: ti.f32,
    view: ti.f32,
    shape: i32_1d,
    geometry: f32_1d,
    start: i32_1d,
    identity: i32_2d,
    x: f32_2d,
    v: f32_2d,
    scratch: f32_2d,
    offset: i32_2d,
    wish: f32_2d,
):
    """The direction each wants, into `wish` (3, capacity); the radii are squared."""
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
                        3, MOTIONS, task, row, shape, geometry, start, x, v, identity, scratch, offset
                    )
                    for c in range(nx):
                        cell, s = row * nx + c, slice_of(c, nx)
                        begin, end = offset[task, s - 1], offset[task, s + 2]
                        for i in range(start[cell], start[cell + 1]):
                            me = offset[task, s] + i - start[cell]
                            heading = column(v, i)
                            heading *= ti.rsqrt(heading.dot(heading) + TINY)
                            hx, hy, hz = heading.x, heading.y, heading.z
                            xi, yi, zi = scratch[0, me], scratch[1, me], scratch[2, me]
                            rx, ry, rz, close = 0.0, 0.0, 0.0, 0.0
                            ox, oy, oz, aligned = 0.0, 0.0, 0.0, 0.0
                            ax, ay, az, far = 0.0, 0.0, 0.0, 0.0
                            for j in range(begin, begin + rounded(end - begin)):
                                dx, dy, dz = scratch[0, j] - xi, scratch[1, j] - yi, scratch[2, j] - zi
                                r2 = dx * dx + dy * dy + dz * dz
                                ahead = dx * hx + dy * hy + dz * hz
                                other = ti.select((j < end) & (j != me), 1.0, 0.0)
                                seen = ti.select(ahead * ti.abs(ahead) >= view * r2, other, 0.0)
                                near = ti.select(r2 < repulsion, other, 0.0)
                                middle = ti.select((r2 >= repulsion) & (r2 < orientation), seen, 0.0)
                                outer = ti.select(
                                    (r2 >= orientation) & (r2 >= repulsion) & (r2 < attraction), seen, 0.0
                                )
                                inverse = ti.rsqrt(r2 + TINY)
                                rx -= near * inverse * dx
                                ry -= near * inverse * dy
                                rz -= near * inverse * dz
                                close += near
                                ox += middle * scratch[3, j]
                                oy += middle * scratch[4, j]
                                oz += middle * scratch[5, j]
                                aligned += middle
                                ax += outer * inverse * dx
                                ay += outer * inverse * dy
                                az += outer * inverse * dz
                                far += outer
                            # All fly at one speed: the sum of velocities has the direction of the units'.
                            together = ti.Vector([ox, oy, oz]) * ti.rsqrt(column(v, i).norm_sqr() + TINY)
                            towards = ti.Vector([ax, ay, az])
                            want = together + towards
                            if close > 0.0:
                                want = ti.Vector([rx, ry, rz])
                            elif aligned > 0.0 and far > 0.0:
                                want = 0.5 * want
                            if want.norm() < 1e-6:
                                want = heading
                            want = want.normalized()
                            for c in ti.static(range(3)):
                                wish[c, i] = want[c]
                piece = take_turn(shape)


@ti.kernel
def turn_and_move(
    n: ti.i32,
    dt: ti.f32,
    speed: ti.f32,
    turn: ti.f32,
    sigma: ti.f32,
    step: ti.i32,
    seed: ti.u32,
    identity: i32_2d,
    wish: f32_2d,
    x: f32_2d,
    v: f32_2d,
):
    """Noise on the wish, the turn limited to `turn` [rad], the move."""
    for i in range(n):
        want = column(wish, i)
        axis = want.cross(unit_vector(seed, identity[0, i], step, 0, 3))
        size = axis.norm()
        if size > 1e-6:
            angle = sigma * normal3(seed, identity[0, i], step, 1).x
            want = ti.cos(angle) * want + ti.sin(angle) * (axis / size).cross(want)
        new = speed * turned(column(v, i), want, turn).normalized()
        for c in ti.static(range(3)):
            v[c, i] = new[c]
            x[c, i] += dt * new[c]


class Couzin(Swarm):
    """The system `kind: couzin`; diagnostics `polarisation` and `milling` are p_group and m_group."""

    def __init__(self, name: str, params: CouzinParams, world: World) -> None:
        super().__init__(name, params.count, 3, world, {})
        self.params, self.seed = params, world.seed
        self.grid = NeighborGrid(self.count, 3, world.bounds, self._reach(params.at(0.0))[2])
        self._wish = ti.ndarray(ti.f32, (3, staggered(self.count)))
        rng = np.random.default_rng(world.seed)
        placed = place(params.start, params.count, rng)
        self.columns.write("position", placed.position)
        self.columns.write("velocity", params.speed * directions(params.heading, placed.position, rng))

    @staticmethod
    def _reach(params: CouzinParams) -> tuple[float, float, float]:
        """Outer radii of the three zones [m]."""
        orientation = params.repulsion_radius + params.orientation_width
        return params.repulsion_radius, orientation, orientation + params.attraction_width

    def max_step(self) -> float:
        """The time step [s]."""
        return self.params.time_step

    def step(self, time: float, dt: float) -> None:
        """Sort, decide, turn and move."""
        self._measured = False
        if self.count == 0:
            return
        now, grid, columns = self.params.at(time), self.grid, self.columns
        repulsion, orientation, attraction = self._reach(now)
        grid.resize(attraction)
        grid.sort(columns)
        decide(
            repulsion**2, orientation**2, attraction**2, view_bound(now.field_of_view),
            grid.shape, grid.geometry, grid.start, columns["id"], columns["position"], columns["velocity"],
            grid.scratch, grid.offset, self._wish,
        )  # fmt: skip
        turn_and_move(
            self.count, dt, now.speed, math.radians(now.turn_rate) * dt, now.noise, round(time / dt),
            self.seed & 0xFFFFFFFF, columns["id"], self._wish, columns["position"], columns["velocity"],
        )  # fmt: skip

    def diagnostics(self) -> dict[str, float]:
        """Those of a swarm, and `milling` |mean of (unit arm from the centre) x (unit velocity)|."""
        return {**super().diagnostics(), "milling": self._milling()}

    def _milling(self) -> float:
        if self.count == 0:
            return 0.0
        x, v = (self.read(name).astype(np.float64) for name in ("position", "velocity"))
        arm = x - x.mean(axis=0)
        arm /= np.maximum(np.linalg.norm(arm, axis=1, keepdims=True), 1e-12)
        heading = v / np.maximum(np.linalg.norm(v, axis=1, keepdims=True), 1e-12)
        return float(np.linalg.norm(np.cross(arm, heading).mean(axis=0)))
