"""The pressures that keep a fluid from being compressed: one linear system, solved for two ends.

    a_i = -(1/rho_i) [ sum_j (P_i + P_j) G_ij + 2 P_i g_i ],        g_i = grad lambda_i of the walls
    (A P)_i = sum_j G_ij . (a_i - a_j) + g_i . a_i                  what P does to the rate of delta
    find P >= 0 with  r_i = b_i + (A P)_i <= 0,  equal where P_i > 0

by relaxed Jacobi iterations, P_i <- max(0, P_i + omega r_i / D_i), D the diagonal of -A. After DFSPH
(Bender & Koschier 2017, doi:10.1109/TVCG.2016.2578335) there are two solves a step:

    motion   b = (D delta / D t) / dt + min(delta - 1, 0) / dt^2     the velocities get dt a
    drift    b = (D delta / D t) / dt + (delta - 1) / dt^2           the places get dt^2 a, velocities nothing

The first makes the velocities free of divergence where the fluid is dense, and lets what is apart come
together; it starts from the pressures of the last step, and its P is the pressure in Pa. The second takes
away what compression is left. In DFSPH that becomes velocity: a start that is 1 % too dense then bursts at
metres a second. As a mere displacement it feeds no energy into the fluid.

An iteration is two passes over the stored pairs: accelerations, then pressures. The whole solve is one
kernel, in which tasks meet at barriers (see crew.py). The error is the mean of max(r, 0) dt^2, the relative
compression that is left.
"""

from dataclasses import dataclass
from typing import Any

from tianim.lang import f32_1d, f32_2d, i32_1d, i32_2d, ti
from tianim.systems.fluid.crew import MOST_TURNS, Crew, first_of, last_of, meet, pieces, take
from tianim.systems.fluid.pairs import Pairs
from tianim.systems.fluid.particles import Particles

MOTION, DRIFT = 0, 1
RELAXATION = 0.5
# Diagonals below this part of that of a particle with one neighbour belong to lone particles.
LONE = 1e-6
MOST_ITERATIONS = (MOST_TURNS - 4) // 2


@ti.func
def prepare(
    stage: ti.template(),
    i,
    dt,
    inverse_rho: ti.template(),
    phase: ti.template(),
    begin: ti.template(),
    end: ti.template(),
    neighbour: ti.template(),
    gradient: ti.template(),
    wall: ti.template(),
    flux: ti.template(),
    v: ti.template(),
    density: ti.template(),
    diagonal: ti.template(),
    source: ti.template(),
    lone,
    warm: ti.template(),
):
    """Source and first pressure of particle i, in the first stage the diagonal too; gives max(b, 0)."""
    a, b, c = v[0, i], v[1, i], v[2, i]
    rate, square = 0.0, 0.0
    s = ti.Vector([0.0, 0.0, 0.0])
    for k in range(begin[i], end[i]):
        j = neighbour[k]
        x, y, z = gradient[0, k], gradient[1, k], gradient[2, k]
        rate += x * (a - v[0, j]) + y * (b - v[1, j]) + z * (c - v[2, j])
        if ti.static(stage == MOTION):
            square += (x * x + y * y + z * z) * inverse_rho[phase[0, j]]
            s[0] += x
            s[1] += y
            s[2] += z
    g = ti.Vector([wall[0, i], wall[1, i], wall[2, i]])
    rate += g[0] * a + g[1] * b + g[2] * c - flux[i]
    if ti.static(stage == MOTION):
        diagonal[i] = square + inverse_rho[phase[0, i]] * (s + g).dot(s + 2.0 * g)
        source[i] = rate / dt + ti.min(density[i] - 1.0, 0.0) / (dt * dt)
    else:
        source[i] = rate / dt + (density[i] - 1.0) / (dt * dt)
    return ti.select(diagonal[i] > lone, ti.max(source[i], 0.0), 0.0)


@ti.func
def accelerate(
    i,
    row: ti.template(),
    inverse_rho: ti.template(),
    phase: ti.template(),
    begin: ti.template(),
    end: ti.template(),
    neighbour: ti.template(),
    gradient: ti.template(),
    wall: ti.template(),
    warm: ti.template(),
    push: ti.template(),
):
    """Acceleration of particle i by the pressures of now."""
    p = warm[row, i]
    x, y, z = 2.0 * p * wall[0, i], 2.0 * p * wall[1, i], 2.0 * p * wall[2, i]
    for k in range(begin[i], end[i]):
        both = p + warm[row, neighbour[k]]
        x += both * gradient[0, k]
        y += both * gradient[1, k]
        z += both * gradient[2, k]
    w = -inverse_rho[phase[0, i]]
    push[0, i], push[1, i], push[2, i] = w * x, w * y, w * z


@ti.func
def relax(
    i,
    row: ti.template(),
    lone,
    begin: ti.template(),
    end: ti.template(),
    neighbour: ti.template(),
    gradient: ti.template(),
    wall: ti.template(),
    diagonal: ti.template(),
    source: ti.template(),
    warm: ti.template(),
    push: ti.template(),
):
    """One relaxation of the pressure of particle i; how much it was compressed before, max(r, 0)."""
    a, b, c = push[0, i], push[1, i], push[2, i]
    r = source[i] + wall[0, i] * a + wall[1, i] * b + wall[2, i] * c
    for k in range(begin[i], end[i]):
        j = neighbour[k]
        r += (
            gradient[0, k] * (a - push[0, j])
            + gradient[1, k] * (b - push[1, j])
            + gradient[2, k] * (c - push[2, j])
        )
    d = diagonal[i]
    p = ti.max(warm[row, i] + RELAXATION * r / ti.max(d, lone), 0.0)
    warm[row, i] = ti.select(d > lone, p, 0.0)
    return ti.select(d > lone, ti.max(r, 0.0), 0.0)


@ti.func
def mean_of(which, n, sums: ti.template()):
    """Mean over the particles of what was summed by piece."""
    total = 0.0
    for k in range(pieces(n)):
        total += sums[which, k]
    return total / n


@ti.kernel
def solve(
    stage: ti.template(),
    n: ti.i32,
    dt: ti.f32,
    lone: ti.f32,
    tolerance: ti.f32,
    least: ti.i32,
    most: ti.i32,
    tasks: ti.i32,
    stride: ti.i32,
    crew: i32_1d,
    sums: f32_2d,
    inverse_rho: f32_1d,
    phase: i32_2d,
    begin: i32_1d,
    end: i32_1d,
    neighbour: i32_1d,
    gradient: f32_2d,
    wall: f32_2d,
    flux: f32_1d,
    density: f32_1d,
    diagonal: f32_1d,
    source: f32_1d,
    warm: f32_2d,
    push: f32_2d,
    v: f32_2d,
    pressure: f32_1d,
    report: f32_1d,
):
    """Prepare, iterate until the mean compression is at most `tolerance`; in the first stage v gets dt a.

    In the second, dt^2 `push` is the displacement, and there is none where it takes no iterations.
    report: iterations, mean compression that is left, and without any pressure.
    """
    for block in range(tasks * stride):
        if block % stride == 0:
            turn = 0
            piece = take(crew, turn)
            while piece < pieces(n):
                total = 0.0
                for i in range(first_of(piece), last_of(piece, n)):
                    total += prepare(
                        stage, i, dt, inverse_rho, phase, begin, end, neighbour, gradient, wall,
                        flux, v, density, diagonal, source, lone, warm,
                    )  # fmt: skip
                sums[1, piece] = total
                piece = take(crew, turn)
            meet(crew, tasks)
            error = mean_of(1, n, sums) * dt * dt
            if block == 0:
                report[2] = error
            iteration = 0
            working = stage == MOTION or error > tolerance
            while working:
                turn += 1
                piece = take(crew, turn)
                while piece < pieces(n):
                    for i in range(first_of(piece), last_of(piece, n)):
                        accelerate(
                            i, stage, inverse_rho, phase, begin, end, neighbour, gradient, wall, warm, push
                        )
                    piece = take(crew, turn)
                meet(crew, tasks)
                turn += 1
                piece = take(crew, turn)
                while piece < pieces(n):
                    total = 0.0
                    for i in range(first_of(piece), last_of(piece, n)):
                        total += relax(
                            i, stage, lone, begin, end, neighbour, gradient, wall, diagonal, source, warm, push
                        )
                    sums[iteration % 2, piece] = total
                    piece = take(crew, turn)
                meet(crew, tasks)
                error = mean_of(iteration % 2, n, sums) * dt * dt
                iteration += 1
                working = iteration < most and (error > tolerance or iteration < least)
            if ti.static(stage == MOTION):
                turn += 1
                piece = take(crew, turn)
                while piece < pieces(n):
                    for i in range(first_of(piece), last_of(piece, n)):
                        pressure[i] = warm[stage, i]
                        for c in ti.static(range(3)):
                            v[c, i] += dt * push[c, i]
                    piece = take(crew, turn)
            if block == 0:
                report[0] = iteration
                report[1] = error


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

    def __init__(self, particles: Particles, pairs: Pairs, walls: Any) -> None:
        self._particles, self._pairs, self._walls = particles, pairs, walls
        capacity = particles.columns.capacity
        self._crew = Crew(capacity)
        self._diagonal: Any = ti.ndarray(ti.f32, capacity)
        self._source: Any = ti.ndarray(ti.f32, capacity)
        self.push: Any = ti.ndarray(ti.f32, (3, capacity))
        self._report: Any = ti.ndarray(ti.f32, 3)
        rho = particles.rest_density.to_numpy()
        self._inverse_rho: Any = ti.ndarray(ti.f32, len(rho))
        self._inverse_rho.from_numpy((1.0 / rho).astype(rho.dtype))
        self._lone = LONE / (float(rho.max()) * particles.h**2)

    def solve(self, stage: int, dt: float, tolerance: float, least: int, most: int) -> Solved:
        """Solve one of the two systems; the divergence comes first, for it prepares the diagonal."""
        particles, pairs, walls, crew = self._particles, self._pairs, self._walls, self._crew
        crew.begin()
        solve(
            stage, particles.count, dt, self._lone, tolerance, least,
            min(most, MOST_ITERATIONS), crew.tasks, crew.stride, crew.array, crew.sums, self._inverse_rho,
            particles["phase"], pairs.begin, pairs.end, pairs.neighbour, pairs.gradient, walls.gradient,
            walls.flux, particles.density, self._diagonal, self._source, particles["warm"], self.push,
            particles["velocity"], particles.pressure, self._report,
        )  # fmt: skip
        iterations, error, first = (float(value) for value in self._report.to_numpy())
        return Solved(int(iterations), error, first)
