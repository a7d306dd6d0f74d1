"""Viscosity: friction between neighbours along the line that joins them.

    rho_i a_i = - sum_j mu_ij w_ij (v_ij . x_ij) x_ij
    mu_ij = 2 mu_i mu_j / (mu_i + mu_j): the stress is the same on both sides of an interface

The force of a pair lies on its line (Monaghan 2005, doi:10.1088/0034-4885/68/8/R01; Weiler et al. 2018,
doi:10.1111/cgf.13349), so that momentum and angular momentum are kept and a turning body feels nothing. In
a fluid without divergence it is mu times the Laplacian. The weight and the walls' part: viscous_pairs.py.

One step, explicit:  v += dt a(v), for dt up to `EXPLICIT` d^2 / nu;   implicit:  v = v* + dt a(v), for any dt
(viscous_solve.py). Poiseuille flow at 40 particles across is right to 2 %.

Cost in 3D on 2 cores, CPU time over two in ns a particle (27 neighbours): explicit 37; implicit 210 to begin
and 28 an iteration, of which lava at 250 d^2 / nu a step takes a dozen.
"""

import math
from typing import Any

import numpy as np

from tianim.lang import f32_1d, f32_2d, i32_1d, i32_2d, ti
from tianim.spatial.crew import PIECE, Crew
from tianim.systems.fluid.pairs import Pairs
from tianim.systems.fluid.params import FluidParams
from tianim.systems.fluid.particles import CHANGE, Particles
from tianim.systems.fluid.viscous_pairs import (
    DRAG_SAMPLES,
    SOFTENING,
    difference,
    drag_table,
    pair_scale,
    pair_weight,
    wall_rate,
)
from tianim.systems.fluid.viscous_solve import (
    MOST_ITERATIONS,
    SUMS,
    WORK_ROWS,
    add_last_change,
    add_pull,
    finish,
    prepare_implicit,
    solve_by_launches,
    solve_implicit,
)

# Largest explicit step in d^2 / nu. The diagonal of the operator is 6 nu / d^2 on a lattice, so that its
# largest eigenvalue is at most 12: stable below 1/6; closer pairs than on a lattice have the rest.
EXPLICIT = 0.1


@ti.kernel
def add_viscosity(
    dimension: ti.template(),
    periodic: ti.template(),
    walled: ti.template(),
    n: ti.i32,
    inverse_h: ti.f32,
    softening: ti.f32,
    scale: ti.f32,
    length: f32_1d,
    mu: f32_2d,
    rho: f32_1d,
    phase: i32_2d,
    x: f32_2d,
    v: f32_2d,
    begin: i32_1d,
    end: i32_1d,
    neighbour: i32_1d,
    distance: f32_1d,
    normal: f32_2d,
    speed: f32_2d,
    nearest: i32_1d,
    friction: f32_1d,
    drag: f32_1d,
    acceleration: f32_2d,
    pull: f32_2d,
):
    """Add the viscous acceleration of the velocities of now; that by walls to `pull` too [m/s2].

    mu[p, q]: of a pair of phases, over d^2; `scale` is C, `softening` [m2].
    """
    for i in range(n):
        own = phase[0, i]
        a, b, c = x[0, i], x[1, i], x[2, i]
        v0, v1, v2 = v[0, i], v[1, i], v[2, i]
        s0, s1, s2 = 0.0, 0.0, 0.0
        for k in range(begin[i], end[i]):
            j = neighbour[k]
            dx = difference(periodic, a - x[0, j], length[0])
            dy = difference(periodic, b - x[1, j], length[1])
            r2, along = dx * dx + dy * dy, (v0 - v[0, j]) * dx + (v1 - v[1, j]) * dy
            dz = 0.0
            if ti.static(dimension == 3):
                dz = difference(periodic, c - x[2, j], length[2])
                r2 += dz * dz
                along += (v2 - v[2, j]) * dz
            w = pair_weight(r2, inverse_h, softening) * mu[own, phase[0, j]] * along
            s0 += w * dx
            s1 += w * dy
            s2 += w * dz
        lightness = 1.0 / rho[own]
        acceleration[0, i] -= scale * lightness * s0
        acceleration[1, i] -= scale * lightness * s1
        acceleration[2, i] -= scale * lightness * s2
        if ti.static(walled):
            rate = wall_rate(i, inverse_h, lightness * mu[own, own], distance, nearest, friction, drag)
            g = ti.Vector([normal[0, i], normal[1, i], normal[2, i]])
            u = ti.Vector([v0 - speed[0, i], v1 - speed[1, i], v2 - speed[2, i]])
            u -= u.dot(g) * g
            for k in ti.static(range(3)):
                pull[k, i] -= rate * u[k]
                acceleration[k, i] -= rate * u[k]


def explicit_limit(viscosity: float, spacing: float) -> float:
    """Largest explicit step [s] for a kinematic viscosity [m2/s], infinite without."""
    return EXPLICIT * spacing * spacing / viscosity if viscosity > 0.0 else math.inf


def may_be_implicit(params: FluidParams) -> bool:
    """Whether steps of this fluid may become too long for an explicit viscosity."""
    most = max(phase.viscosity for phase in params.all_phases()) + params.calming
    # A pair of phases has up to twice the viscosity of one.
    return explicit_limit(2.0 * most, params.spacing) < params.time_step.largest


class Viscosity:
    """Viscosity of all phases, and the drag of walls that do not let the fluid slip.

    explicit_limit  largest step for `add` [s], infinite without viscosity
    iterations      of the last implicit solve, 0 where there was none; `error` is what it left
    walled          whether some wall does not let the fluid slip
    """

    def __init__(self, phases: Any, particles: Particles, pairs: Pairs, walls: Any) -> None:
        self._particles, self._pairs, self._walls = particles, pairs, walls
        self._periodic = bool(pairs.length.to_numpy().any())
        d, dimension = particles.spacing, particles.dimension
        rho = np.array([phase.density for phase in phases])
        mu = rho * np.array([phase.viscosity for phase in phases])
        shared = 2.0 * mu[:, None] * mu / np.maximum(mu[:, None] + mu, np.finfo(float).tiny)
        most = float((shared / rho[:, None]).max())
        self.active = most > 0.0
        self.explicit_limit = explicit_limit(most, d)
        self.walled = self.active and bool((walls.friction.to_numpy() > 0.0).any())
        support = particles.h / d
        self._mu: Any = ti.ndarray(ti.f32, shared.shape)
        self._mu.from_numpy((shared / (d * d)).astype(np.float32))
        self._softening = (SOFTENING * d) ** 2
        self._scale = pair_scale(support, dimension)
        self._drag: Any = ti.ndarray(ti.f32, DRAG_SAMPLES + 1)
        self._drag.from_numpy(drag_table(support, dimension))
        self._work: Any = None
        self._pair: Any = None
        self._unknown: Any = None
        self.iterations, self.error = 0, 0.0

    def _common(self) -> tuple[Any, ...]:
        particles, pairs, walls = self._particles, self._pairs, self._walls
        return (
            particles["phase"], particles["position"], particles["velocity"], pairs.begin, pairs.end,
            pairs.neighbour, walls.distance, walls.normal, walls.speed, walls.nearest, walls.friction,
            self._drag,
        )  # fmt: skip

    def add(self, pull: Any) -> None:
        """Add the viscous acceleration of the velocities of now to that of the particles.

        What walls do is added to `pull` (3, capacity) [m/s2] too.
        """
        particles = self._particles
        self.iterations, self.error = 0, 0.0
        add_viscosity(
            particles.dimension, self._periodic, self.walled, particles.count, 1.0 / particles.h,
            self._softening, self._scale, self._pairs.length, self._mu, particles.rest_density,
            *self._common(), particles.acceleration, pull,
        )  # fmt: skip

    def relax(self, dt: float, tolerance: float, most: int, pull: Any) -> None:
        """Make the velocities what they are after `dt` [s] of viscosity, whatever its length."""
        particles, pairs, n = self._particles, self._pairs, self._particles.count
        self._make_room()
        change = self._last_change()
        add_last_change(n, change, particles["velocity"])
        prepare_implicit(
            particles.dimension, self._periodic, self.walled, n, dt, 1.0 / particles.h, self._softening,
            self._scale, pairs.length, self._mu, particles.rest_density, *self._common(), change,
            self._pair, self._work,
        )  # fmt: skip
        arrays = (
            self._sums, particles.rest_density, particles["phase"], pairs.begin, pairs.end, pairs.neighbour,
            self._pair, self._walls.normal, particles["velocity"], self._work,
        )  # fmt: skip
        crew, most = self._crew, min(most, MOST_ITERATIONS)
        if crew.works:
            crew.begin()
            tasks = crew.tasks_for(n)
            solve_implicit(n, tolerance, most, tasks, crew.stride, crew.array, self._report, *arrays)
            iterations, self.error = (float(value) for value in self._report.to_numpy())
        else:
            iterations, self.error = solve_by_launches(n, tolerance, most, *arrays)
        self.iterations = int(iterations)
        finish(n, particles["velocity"], change, self._work)
        if self.walled:
            walls = self._walls
            add_pull(
                n, dt, particles.rest_density, particles["phase"], particles["velocity"], walls.normal,
                walls.speed, self._work, pull,
            )  # fmt: skip

    def _last_change(self) -> Any:
        """The column to start from; where the particles have none, zeros."""
        columns = self._particles.columns
        if CHANGE in columns.widths:
            return columns[CHANGE]
        if self._unknown is None:
            self._unknown = ti.ndarray(ti.f32, (3, columns.capacity))
        self._unknown.fill(0.0)
        return self._unknown

    def _make_room(self) -> None:
        """Arrays of the implicit solve: made when it is first used, the pairs' when their rows grow."""
        capacity = self._particles.columns.capacity
        if self._work is None:
            self._crew = Crew(1)
            self._work = ti.ndarray(ti.f32, (WORK_ROWS, capacity))
            self._sums: Any = ti.ndarray(ti.f64, (SUMS, -(-capacity // PIECE)))
            self._report: Any = ti.ndarray(ti.f32, 2)
        room = self._pairs.neighbour.shape[0]
        if self._pair is None or self._pair.shape[1] < room:
            self._pair = ti.ndarray(ti.f32, (3, room))
