"""The pressures that keep a fluid from being compressed: one linear system, solved for two ends.

    a_i = -(1/rho_i) [ sum_j (P_i + P_j) G_ij + P_i g_i ],          g_i = grad lambda_i of the walls
    (A P)_i = sum_j G_ij . (a_i - a_j) + g_i . a_i                  what P does to the rate of delta
    find P >= 0 with  r_i = b_i + (A P)_i <= 0,  equal where P_i > 0

After DFSPH (Bender & Koschier 2017, doi:10.1109/TVCG.2016.2578335) there are two solves a step:

    motion   b = (D delta / D t) / dt - what gaps may shut      the velocities get dt a
    drift    b = (D delta / D t) / dt + (delta - 1) / dt^2      the places get dt^2 a, velocities nothing

The first makes the velocities free of divergence where the fluid is dense, and lets what is apart come
together; its P is the pressure in Pa. The second takes away what compression is left. In DFSPH that
becomes velocity: a start that is 1 % too dense then bursts at metres a second. As a mere displacement it
feeds no energy into the fluid. Forces are the transpose of rates, walls included, so that pressures
do no work on a flow that keeps its density; a mirror at the wall, 2 P_i g_i, would stir a tank at rest.

Solved by projected Jacobi iterations, P <- max(0, P + omega r / D), D the diagonal of -A, omega one
over the largest eigenvalue of D^-1 A, hastened by
Nesterov's momentum, begun anew where it leads uphill (O'Donoghue & Candes 2015,
doi:10.1007/s10208-013-9150-3); from the pressures of the last step. An iteration is two passes over the
stored pairs: accelerations, then pressures; in both the own part of the sums is taken out, P_i and a_i
times the sum of the gradients, so that a pair costs three multiplications. What the last pressures do is
what the particles get. The whole solve is one kernel, in which tasks meet at
barriers (see crew.py). The error is the mean of what is left of r, dt^2 |r| where P > 0 or r > 0: pressure
that is too high counts as well as compression, for it too becomes velocity.

Where space is periodic along all axes there need be no surface, and pressures are of both signs in dense
fluid: of its pressure only differences are known, and a fluid that cannot pull would tear in every whirl.
Gradients are corrected there (see correction.py).
"""

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np

from tianim.lang import ti
from tianim.math.smoothing import spline_slopes
from tianim.spatial.crew import MOST_TURNS, PIECE, Crew
from tianim.systems.fluid.correction import Correction
from tianim.systems.fluid.pairs import Pairs
from tianim.systems.fluid.particles import Particles
from tianim.systems.fluid.pressure_passes import (
    ACCELERATE,
    DRIFT,
    FINISH,
    GROWTH,
    MOTION,
    PREPARE,
    RELAX,
    SLOWER,
    launch,
    solve,
)

__all__ = ["DRIFT", "MOTION", "PressureSolver", "Solved"]

# Diagonals below this part of that of a particle with one neighbour belong to lone particles.
LONE = 1e-6
UNBOUNDED = 1e30
WAVES = 25  # along each axis, in the search for the largest eigenvalue
MOST_ITERATIONS = (MOST_TURNS - 4) // 2


# Particles out of order may have an eigenvalue somewhat larger than the lattice's.
STABLE = 0.98


@lru_cache(maxsize=8)
def largest_eigenvalue(support: float, dimension: int) -> float:
    """Of D^-1 A on the lattice: over all waves k, |sum_j G_j sin(k . x_j)|^2 / sum_j |G_j|^2."""
    reach = np.arange(-math.ceil(support), math.ceil(support) + 1.0)
    x = np.stack(np.meshgrid(*[reach] * dimension, indexing="ij"), axis=-1).reshape(-1, dimension)
    r = np.linalg.norm(x, axis=1)
    x, r = x[(r > 0.0) & (r < support)], r[(r > 0.0) & (r < support)]
    gradient = (spline_slopes(r / support, dimension) / r)[:, None] * x
    wave = np.linspace(0.0, math.pi, WAVES)
    k = np.stack(np.meshgrid(*[wave] * dimension, indexing="ij"), axis=-1).reshape(-1, dimension)
    amplitude = np.sin(k @ x.T) @ gradient
    return float((amplitude**2).sum(axis=1).max() / (gradient**2).sum())


@dataclass(frozen=True)
class Solved:
    """Iterations of a solve, and the mean compression before and after."""

    iterations: int
    error: float
    first_error: float


class PressureSolver:
    """Solves for the pressures of `particles`.

    push  their acceleration after a solve [m/s2], (3, capacity)
    """

    def __init__(self, particles: Particles, pairs: Pairs, walls: Any, full: bool = False) -> None:
        """`full`: no surface is anywhere, so that pressures are of both signs."""
        self._particles, self._pairs, self._walls = particles, pairs, walls
        capacity = particles.columns.capacity
        self._crew = Crew(capacity)
        self._correction = Correction(particles, pairs, walls) if full else None
        self._total: Any = ti.ndarray(ti.f32, (3, capacity))
        self._diagonal: Any = ti.ndarray(ti.f32, capacity)
        self._source: Any = ti.ndarray(ti.f32, capacity)
        self._last: Any = ti.ndarray(ti.f32, capacity)
        self.push: Any = ti.ndarray(ti.f32, (3, capacity))
        self._report: Any = ti.ndarray(ti.f32, 3)
        rho = particles.rest_density.to_numpy()
        self._inverse_rho: Any = ti.ndarray(ti.f32, len(rho))
        self._inverse_rho.from_numpy((1.0 / rho).astype(rho.dtype))
        self._relaxation = STABLE / largest_eigenvalue(particles.h / particles.spacing, particles.dimension)
        self._lowest = -UNBOUNDED if full else 0.0
        self._lone = LONE / (float(rho.max()) * particles.h**2)

    def solve(self, stage: int, dt: float, tolerance: float, least: int, most: int) -> Solved:
        """Solve for the motion or, after it, the drift."""
        crew, report, n = self._crew, self._report, self._particles.count
        most = min(most, MOST_ITERATIONS)
        if stage == MOTION and self._correction:
            self._correction.find()
        if not crew.works:
            return self._solve_by_passes(stage, dt, tolerance, least, most)
        crew.begin()
        solve(
            stage, n, dt, self._lone, self._lowest, self._relaxation, tolerance, least, most,
            crew.tasks_for(n), crew.stride, crew.array, crew.sums, *self._arrays(stage), report,
        )  # fmt: skip
        iterations, error, first = (float(value) for value in report.to_numpy())
        return Solved(int(iterations), error, first)

    def _solve_by_passes(self, stage: int, dt: float, tolerance: float, least: int, most: int) -> Solved:
        """The same, a launch a pass."""
        first = error = self._launch(PREPARE, stage, dt, self._relaxation, 0.0)[0]
        iterations, pace, momentum, omega, best = 0, 1.0, 0.0, self._relaxation, math.inf
        while iterations < most and (error > tolerance or (stage == MOTION and iterations < max(least, 1))):
            if stage == DRIFT or iterations:
                self._launch(ACCELERATE, stage, dt, omega, momentum)
            error, progress = self._launch(RELAX, stage, dt, omega, momentum)
            faster, grows = 0.5 * (1.0 + math.sqrt(1.0 + 4.0 * pace * pace)), error > GROWTH * best
            pace, momentum = (faster, (pace - 1.0) / faster) if progress >= 0.0 and not grows else (1.0, 0.0)
            omega, best = (SLOWER * omega, error) if grows else (omega, min(best, error))
            iterations += 1
        if iterations:
            self._launch(FINISH, stage, dt, omega, momentum)
        return Solved(iterations, error, first)

    def _launch(self, work: int, stage: int, dt: float, omega: float, momentum: float) -> tuple[float, float]:
        """One pass; what is left of r as a compression, and the progress, means over the particles."""
        n, sums = self._particles.count, self._crew.sums
        launch(work, stage, n, dt, self._lone, self._lowest, omega, momentum, sums, *self._arrays(stage))
        left, progress = sums.to_numpy()[:2, : -(-n // PIECE)].sum(axis=1, dtype=np.float64) / n
        return float(left) * dt * dt, float(progress)

    def _arrays(self, stage: int) -> tuple[Any, ...]:
        """What every pass reads and writes, as the kernels take them."""
        particles, pairs, walls = self._particles, self._pairs, self._walls
        gradient, back = pairs.gradient, pairs.gradient
        if stage == MOTION and self._correction:
            gradient, back = self._correction.gradient, self._correction.back
        return (
            self._inverse_rho, particles["phase"], pairs.begin, pairs.end, pairs.neighbour, gradient, back,
            walls.gradient, walls.flux, self._total, particles.density, self._diagonal, self._source,
            particles["warm"], self._last, self.push, particles["velocity"], particles.pressure,
        )  # fmt: skip
