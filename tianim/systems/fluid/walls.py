"""Walls of a fluid: the bounds and the bodies, as a share of density and as contacts.

A wall fills part of a particle's surroundings: lambda, "share", adds to the relative density, its gradient
points into the solid and carries the pressure (see `wall_tables`):

    delta_i = sum_j V W_ij + lambda_i
    a_i = ... - P_i grad lambda_i / rho,              D delta_i / D t = ... + grad lambda_i . v_i - flux_i
    flux_i = sum_b grad lambda_ib . v_b(x_i)          force on body b: V P_i grad lambda_ib

Pressure alone does not keep a lone particle out, for it and the wall make less than density 1: `hold` ends
the velocity of what would come nearer than LEAST spacings (`wall_contact`).

A step: measure -> pressures -> push (where somebody asks for forces) -> hold -> x += dt v -> clamp.
"""

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tianim.lang import f32_1d, f32_2d, f64_2d, i32_1d, i32_2d, ti, workers
from tianim.spatial.bodies import FAR, WIDTH, Bodies, signed_distance, surface_velocity
from tianim.system import Bounds
from tianim.systems.fluid.params import Walls as WallParams
from tianim.systems.fluid.particles import Particles
from tianim.systems.fluid.wall_contact import add_impulse, clamp_places, hold_velocities, shift_places
from tianim.systems.fluid.wall_rows import half_thickness, largest_speed, pack_bounds, set_form
from tianim.systems.fluid.wall_shares import (
    COULOMB,
    FLAT,
    WALL_WIDTH,
    body_share,
    flat,
    is_open_ended,
)
from tianim.systems.fluid.wall_tables import reach, share_tables

# No particle is led nearer to a wall than so many spacings; the first layer of a resting fluid is at 0.5.
LEAST = 0.25
# Places may have been shifted by so many spacings between `measure` and `hold`.
MOVED = 0.2
# Paths are followed in pieces of at most so many spacings, and of at most this part of the way from LEAST
# before a solid to its middle: beyond that a particle would be put out on the other side.
PIECE = 0.5
BEFORE_MIDDLE = 0.9
# Impulses are summed over so many ranges of particles, and then over the ranges, whatever the threads.
RANGES = 128
# Coulomb's coefficient of a wall that sticks.
STICKS = 1e6
BOUNDS = "bounds"


@ti.kernel
def measure_walls(
    n: ti.i32,
    adding: ti.template(),
    count: ti.i32,
    support: ti.f32,
    h: ti.f32,
    table: f32_2d,
    samples: f32_1d,
    shares: f32_2d,
    x: f32_2d,
    share: f32_1d,
    gradient: f32_2d,
    flux: f32_1d,
    distance: f32_1d,
    normal: f32_2d,
    speed: f32_2d,
    nearest: i32_1d,
    across: ti.f32,
    density: f32_1d,
    moment: f32_1d,
):
    """What all walls are to each particle; where `adding`, shares go into `density`, and into `moment`.

    There a wall at s adds s |grad lambda|, in one of the `across` directions of space.
    """
    for i in range(n):
        p = ti.Vector([x[0, i], x[1, i], x[2, i]])
        g, added = ti.Vector([0.0, 0.0, 0.0]), ti.Vector([0.0, 0.0, 0.0, 0.0])
        free, through, added_through = 1.0, 0.0, 0.0
        near, closest = -1, ti.Vector([0.0, 0.0, 0.0, FAR])
        v_near = ti.Vector([0.0, 0.0, 0.0])
        for b in range(count):
            hit = flat(table, b, signed_distance(table, samples, b, p))
            v = ti.Vector([0.0, 0.0, 0.0])
            if hit.w < h:
                v = surface_velocity(table, samples, b, p)
                if table[b, FLAT] > 0.0:
                    v.z = 0.0
            if hit.w < support:
                own = body_share(table, shares, support, b, p, hit)
                if is_open_ended(table, b):
                    g = g * (1.0 - own.w) + own.xyz * free
                    through = through * (1.0 - own.w) + own.xyz.dot(v) * free
                    free *= 1.0 - own.w
                else:
                    added += own
                    added_through += own.xyz.dot(v)
            if hit.w < closest.w:
                near, closest, v_near = b, hit, v
        total = ti.min(1.0 - free + added.w, 1.0)
        share[i] = total
        flux[i] = through + added_through
        distance[i] = closest.w
        nearest[i] = near
        for c in ti.static(range(3)):
            gradient[c, i] = g[c] + added[c]
            normal[c, i] = closest[c]
            speed[c, i] = v_near[c]
        if ti.static(adding):
            density[i] += total
            moment[i] += ti.max(closest.w, 0.0) * (g + added.xyz).norm() / across


@ti.kernel
def count_marks(n: ti.i32, marks: i32_1d) -> ti.i32:
    """Particles whose mark is 1."""
    total = 0
    for i in range(n):
        total += marks[i]
    return total


@ti.kernel
def push_bodies(
    n: ti.i32,
    tasks: ti.i32,
    stride: ti.i32,
    count: ti.i32,
    support: ti.f32,
    factor: ti.f32,
    table: f32_2d,
    samples: f32_1d,
    shares: f32_2d,
    x: f32_2d,
    distance: f32_1d,
    gradient: f32_2d,
    pressure: f32_1d,
    sums: f64_2d,
):
    """Impulses of the pressures on the walls; `factor` is V dt."""
    size = (n + RANGES - 1) // RANGES
    for block in range(tasks * stride):
        if block % stride == 0:
            k = block // stride
            while k < RANGES:
                for i in range(k * size, ti.min(n, (k + 1) * size)):
                    if distance[i] < support and pressure[i] != 0.0:
                        p = ti.Vector([x[0, i], x[1, i], x[2, i]])
                        free = 1.0
                        if count == 1:
                            g = ti.Vector([gradient[0, i], gradient[1, i], gradient[2, i]])
                            add_impulse(table, sums, k, 0, p, factor * pressure[i] * g)
                        # Twice over the walls in one loop: first what they leave free together.
                        for again in range(ti.select(count == 1, 0, 2 * count)):
                            b = again % count
                            hit = flat(table, b, signed_distance(table, samples, b, p))
                            if hit.w < support:
                                own = body_share(table, shares, support, b, p, hit)
                                shared = is_open_ended(table, b)
                                if again < count and shared:
                                    free *= 1.0 - own.w
                                elif again >= count:
                                    others = ti.select(shared, free / ti.max(1.0 - own.w, 1e-6), 1.0)
                                    add_impulse(table, sums, k, b, p, factor * pressure[i] * others * own.xyz)
                k += tasks


@ti.kernel
def bear_pulls(
    n: ti.i32,
    tasks: ti.i32,
    stride: ti.i32,
    factor: ti.f32,
    table: f32_2d,
    x: f32_2d,
    nearest: i32_1d,
    phase: i32_2d,
    rest_density: f32_1d,
    pull: f32_2d,
    sums: f64_2d,
):
    """Impulses of the reaction to `pull` [m/s2] on the nearest walls; `factor` is V dt."""
    size = (n + RANGES - 1) // RANGES
    for block in range(tasks * stride):
        if block % stride == 0:
            k = block // stride
            while k < RANGES:
                for i in range(k * size, ti.min(n, (k + 1) * size)):
                    if nearest[i] >= 0:
                        p = ti.Vector([x[0, i], x[1, i], x[2, i]])
                        a = ti.Vector([pull[0, i], pull[1, i], pull[2, i]])
                        add_impulse(table, sums, k, nearest[i], p, -factor * rest_density[phase[0, i]] * a)
                k += tasks


class Walls:
    """Walls of `particles`: arrays by storage order, valid from one `measure` to the next.

    share      lambda, (capacity,)
    gradient   of lambda, into the solid [1/m], (3, capacity)
    flux       sum over walls of gradient . wall velocity [1/s], (capacity,)
    distance   to the nearest wall [m], negative in the solid, (capacity,); FAR where there is none
    normal     of the nearest wall, into free space, (3, capacity)
    speed      of the nearest wall where it is nearer than h [m/s], else 0, (3, capacity)
    nearest    row of the nearest wall, -1 where there is none, (capacity,)

    names      of the walls by row: the bodies, and "bounds" where the bounds are contained
    friction   by row: 0 slips, 1 sticks
    support    share and gradient are 0 beyond this distance [m]
    table, samples, shares, count   what the function `wall_terms` takes
    """

    def __init__(self, bodies: Bodies, bounds: Bounds, particles: Particles, params: WallParams) -> None:
        self._bodies, self._particles = bodies, particles
        self._contained = bounds.kind == "contained"
        self.names = (*bodies.names, BOUNDS) if self._contained else bodies.names
        self.count = len(self.names)
        self._least = LEAST * particles.spacing
        dimension = particles.dimension
        support = particles.h / particles.spacing
        self.support = reach(support, dimension) * particles.spacing
        shares = share_tables(support, dimension)
        self.shares: Any = ti.ndarray(ti.f32, shares.shape)
        self.shares.from_numpy(shares)
        self._rows = np.zeros((max(self.count, 1), WALL_WIDTH), np.float32)
        self._rows[:, FLAT] = float(dimension == 2)
        friction = np.array([params.friction_of(name) for name in self.names], np.float32)
        self._rows[: self.count, COULOMB] = friction / np.maximum(1.0 - friction, 1.0 / STICKS)
        self.friction: Any = ti.ndarray(ti.f32, max(self.count, 1))
        self.friction.from_numpy(friction if self.count else np.zeros(1, np.float32))
        if self._contained:
            pack_bounds(self._rows[-1], bounds)
            set_form(self._rows[-1], dimension)
        self.table: Any = ti.ndarray(ti.f32, self._rows.shape)
        self.samples = bodies.samples
        self._allocate(particles.columns.capacity)
        self._posed: NDArray[np.float32] | None = None
        self._fastest, self._dt = 0.0, 0.0
        deepest = (self._least + half_thickness(body) for body in bodies.params.values())
        self._piece = min(PIECE * particles.spacing, BEFORE_MIDDLE * min(deepest, default=math.inf))

    def _allocate(self, capacity: int) -> None:
        self.share: Any = ti.ndarray(ti.f32, capacity)
        self.gradient: Any = ti.ndarray(ti.f32, (3, capacity))
        self.flux: Any = ti.ndarray(ti.f32, capacity)
        self.distance: Any = ti.ndarray(ti.f32, capacity)
        self.normal: Any = ti.ndarray(ti.f32, (3, capacity))
        self.speed: Any = ti.ndarray(ti.f32, (3, capacity))
        self.nearest: Any = ti.ndarray(ti.i32, capacity)
        for array in (self.share, self.gradient, self.flux, self.normal, self.speed):
            array.fill(0.0)
        self.distance.fill(FAR)
        self.nearest.fill(-1)
        self._sums: Any = ti.ndarray(ti.f64, (RANGES, 6 * max(self.count, 1)))
        self._sums.fill(0.0)
        self._starts: Any = ti.ndarray(ti.f32, (workers()[0], 2 * max(self.count, 1)))
        self._clamped: Any = ti.ndarray(ti.i32, capacity)

    def measure(self, n: int, x: Any, density: Any = None) -> None:
        """Fill the arrays for `n` particles at `x` (3, capacity) [m], with the bodies as they are posed now.

        Impulses are counted from here on. Where `density` is given, the share is added to it.
        """
        if not self.count:
            return
        self._pose()
        self._sums.fill(0.0)
        particles = self._particles
        measure_walls(
            n, density is not None, self.count, self.support, particles.h, self.table, self.samples,
            self.shares, x, self.share, self.gradient, self.flux, self.distance, self.normal, self.speed,
            self.nearest, float(particles.dimension), self.share if density is None else density,
            particles.moment,
        )  # fmt: skip

    def push(self, n: int, x: Any, pressure: Any, dt: float) -> None:
        """Count the impulses of `pressure` (capacity,) [Pa] on the walls over `dt` [s]."""
        if self.count:
            push_bodies(
                n, *workers(), self.count, self.support, self._particles.volume * dt, self.table,
                self.samples, self.shares, x, self.distance, self.gradient,
                pressure, self._sums,
            )  # fmt: skip

    def bear(self, n: int, x: Any, pull: Any, dt: float) -> None:
        """Count on the nearest walls what pulls particles with `pull` (3, capacity) [m/s2] over `dt` [s]."""
        if self.count:
            particles = self._particles
            bear_pulls(
                n, *workers(), particles.volume * dt, self.table, x, self.nearest, particles["phase"],
                particles.rest_density, pull, self._sums,
            )  # fmt: skip

    def hold(self, n: int, x: Any, v: Any, dt: float) -> None:
        """Change velocities `v` (3, capacity) [m/s] such that x + dt v is not in a wall.

        `x` are the places that were measured, moved by at most MOVED spacings. What would end nearer to a
        wall than LEAST spacings, or than it is already, is stopped there, without a bounce, and rubs as the
        wall's friction says.
        """
        self._dt = dt
        if self.count:
            particles = self._particles
            hold_velocities(
                n, *workers(), RANGES, self.count, dt, self._least, self._piece,
                self._fastest, MOVED * particles.spacing, particles.volume, self.table, self.samples, x, v,
                self.distance, particles["phase"], particles.rest_density, self._starts, self._sums,
            )  # fmt: skip

    def shift(self, n: int, x: Any, v: Any, way: Any, lower: Any, length: Any) -> None:
        """Move `x` after x += dt v by `way` (3, capacity) [m], though not into a wall.

        lower, length: of a periodic box, in which it stays.
        """
        shift_places(
            n, self.count, self._dt, self._least, self._fastest, 2.0 * MOVED * self._particles.spacing,
            self.table, self.samples, lower, length, way, self.distance, x, v,
        )  # fmt: skip

    def clamp(self, n: int, x: Any, v: Any) -> int:
        """Move what is in a wall after x += dt v back out; how many that were: 0 in a sane run."""
        if not self.count:
            return 0
        clamp_places(
            n, self.count, self._dt, self._least, self._fastest, MOVED * self._particles.spacing, self.table,
            self.samples, x, v, self.distance, self._clamped,
        )  # fmt: skip
        return count_marks(n, self._clamped)

    def impulses(self) -> dict[str, NDArray[np.float64]]:
        """By wall: impulse [N s] and its moment about the body's origin [N m s] since `measure`, (6,)."""
        sums = self._sums.to_numpy().sum(axis=0).reshape(-1, 6)
        return {name: sums[b] for b, name in enumerate(self.names)}

    def _pose(self) -> None:
        """Take over the bodies' rows where they have changed."""
        rows = self._bodies.table.to_numpy()[: self._bodies.count]
        if self._posed is not None and np.array_equal(rows, self._posed):
            return
        self._posed = rows
        self._fastest = max((largest_speed(row) for row in rows), default=0.0)
        self._rows[: len(rows), :WIDTH] = rows
        for row in self._rows[: len(rows)]:
            set_form(row, self._particles.dimension)
        self.table.from_numpy(self._rows)
