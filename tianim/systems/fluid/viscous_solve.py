"""Implicit viscosity: the velocities after a step of any length, by conjugate gradients.

    rho_i v_i + dt sum_j mu_ij w_ij (v_ij . x_ij) x_ij + walls = rho_i v*_i

is linear with a symmetric positive matrix. A pair stores e_ij = sqrt(dt mu_ij w_ij) x_ij, so that a product
with the matrix reads three numbers a pair. Preconditioned by the 3 x 3 blocks of its diagonal (Weiler et al.
2018, doi:10.1111/cgf.13349); two passes an iteration (Chronopoulos & Gear 1989,
doi:10.1016/0377-0427(89)90045-9), the whole solve one kernel (crew.py). It starts from v* and the change of
the last step: where a flow is steady, that is all there is to find.
"""

import math
from typing import Any

from tianim.lang import f32_1d, f32_2d, f64_2d, i32_1d, i32_2d, ti
from tianim.spatial.crew import MOST_TURNS, PIECE, first_of, last_of, meet, pieces, take
from tianim.systems.fluid.viscous_pairs import difference, pair_weight, wall_rate

# Rows of the work array: conjugate gradients (Chronopoulos & Gear), inverse blocks, walls.
Z, W, P, S, X, R, BLOCK, HOLD, WORK_ROWS = 0, 3, 6, 9, 12, 15, 18, 24, 25
SUMS = 5
MOST_ITERATIONS = MOST_TURNS // 2 - 4
# Changes of velocity below this part of the mean velocity are rounding errors.
ROUNDING = 1e-6


@ti.func
def triple(work: ti.template(), row: ti.template(), i):
    """Three rows of the work array as a vector."""
    return ti.Vector([work[row, i], work[row + 1, i], work[row + 2, i]])


@ti.func
def set_triple(work: ti.template(), row: ti.template(), i, value):
    """Write a vector into three rows of the work array."""
    for c in ti.static(range(3)):
        work[row + c, i] = value[c]


@ti.func
def precondition(work: ti.template(), i, r):
    """The inverse of the block of particle i, times r."""
    a, b, c = work[BLOCK, i], work[BLOCK + 1, i], work[BLOCK + 2, i]
    d, e, f = work[BLOCK + 3, i], work[BLOCK + 4, i], work[BLOCK + 5, i]
    return ti.Vector(
        [a * r[0] + d * r[1] + f * r[2], d * r[0] + b * r[1] + e * r[2], f * r[0] + e * r[1] + c * r[2]]
    )


@ti.kernel
def add_last_change(n: ti.i32, change: f32_2d, v: f32_2d):
    """V += the change of the last step."""
    for i in range(n):
        for c in ti.static(range(3)):
            v[c, i] += change[c, i]


@ti.kernel
def prepare_implicit(
    dimension: ti.template(),
    periodic: ti.template(),
    walled: ti.template(),
    n: ti.i32,
    dt: ti.f32,
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
    change: f32_2d,
    pair: f32_2d,
    work: f32_2d,
):
    """Vectors e of all pairs, inverse blocks, and the residual of v = v* + change, in R.

    In P, for the stop rule, what `change` is in terms of preconditioned residuals.
    """
    for i in range(n):
        own = phase[0, i]
        density = rho[own]
        a, b, c = x[0, i], x[1, i], x[2, i]
        xx, yy, zz, xy, yz, xz = density, density, density, 0.0, 0.0, 0.0
        r = ti.Vector([0.0, 0.0, 0.0])
        for k in range(begin[i], end[i]):
            j = neighbour[k]
            dx = difference(periodic, a - x[0, j], length[0])
            dy = difference(periodic, b - x[1, j], length[1])
            dz = 0.0
            if ti.static(dimension == 3):
                dz = difference(periodic, c - x[2, j], length[2])
            r2 = dx * dx + dy * dy + dz * dz
            w = ti.sqrt(dt * scale * mu[own, phase[0, j]] * pair_weight(r2, inverse_h, softening))
            dx, dy, dz = w * dx, w * dy, w * dz
            pair[0, k], pair[1, k], pair[2, k] = dx, dy, dz
            xx, yy, zz = xx + dx * dx, yy + dy * dy, zz + dz * dz
            xy, yz, xz = xy + dx * dy, yz + dy * dz, xz + dx * dz
            along = (v[0, i] - v[0, j]) * dx + (v[1, i] - v[1, j]) * dy + (v[2, i] - v[2, j]) * dz
            r -= along * ti.Vector([dx, dy, dz])
        work[HOLD, i] = 0.0
        if ti.static(walled):
            hold = (
                dt
                * density
                * wall_rate(i, inverse_h, mu[own, own] / density, distance, nearest, friction, drag)
            )
            g = ti.Vector([normal[0, i], normal[1, i], normal[2, i]])
            u = ti.Vector([v[0, i] - speed[0, i], v[1, i] - speed[1, i], v[2, i] - speed[2, i]])
            r -= hold * (u - u.dot(g) * g)
            xx, yy, zz = (
                xx + hold * (1.0 - g[0] * g[0]),
                yy + hold * (1.0 - g[1] * g[1]),
                zz + hold * (1.0 - g[2] * g[2]),
            )
            xy, yz, xz = xy - hold * g[0] * g[1], yz - hold * g[1] * g[2], xz - hold * g[0] * g[2]
            work[HOLD, i] = hold
        A, B, C = yy * zz - yz * yz, xz * yz - xy * zz, xy * yz - xz * yy
        inverse = 1.0 / (xx * A + xy * B + xz * C)
        work[BLOCK, i], work[BLOCK + 3, i], work[BLOCK + 5, i] = A * inverse, B * inverse, C * inverse
        work[BLOCK + 1, i], work[BLOCK + 2, i] = (xx * zz - xz * xz) * inverse, (xx * yy - xy * xy) * inverse
        work[BLOCK + 4, i] = (xy * xz - xx * yz) * inverse
        changed = density * ti.Vector([change[0, i], change[1, i], change[2, i]])
        r -= changed
        set_triple(work, R, i, r)
        set_triple(work, Z, i, precondition(work, i, r))
        set_triple(work, P, i, precondition(work, i, changed))
        zero = ti.Vector([0.0, 0.0, 0.0])
        set_triple(work, S, i, zero)
        set_triple(work, X, i, zero)


@ti.func
def apply_matrix(
    i,
    density,
    begin: ti.template(),
    end: ti.template(),
    neighbour: ti.template(),
    pair: ti.template(),
    normal: ti.template(),
    work: ti.template(),
):
    """Row i of the matrix times z."""
    a, b, c = work[Z, i], work[Z + 1, i], work[Z + 2, i]
    s0, s1, s2 = density * a, density * b, density * c
    for k in range(begin[i], end[i]):
        j = neighbour[k]
        e0, e1, e2 = pair[0, k], pair[1, k], pair[2, k]
        along = e0 * (a - work[Z, j]) + e1 * (b - work[Z + 1, j]) + e2 * (c - work[Z + 2, j])
        s0 += along * e0
        s1 += along * e1
        s2 += along * e2
    hold = work[HOLD, i]
    across = hold * (a * normal[0, i] + b * normal[1, i] + c * normal[2, i])
    return ti.Vector([
        s0 + hold * a - across * normal[0, i],
        s1 + hold * b - across * normal[1, i],
        s2 + hold * c - across * normal[2, i],
    ])  # fmt: skip


@ti.func
def multiply(
    piece,
    n,
    sums: ti.template(),
    rho: ti.template(),
    phase: ti.template(),
    begin: ti.template(),
    end: ti.template(),
    neighbour: ti.template(),
    pair: ti.template(),
    normal: ti.template(),
    v: ti.template(),
    work: ti.template(),
):
    """W = M Z for a piece of the particles, and its sums r.z, w.z, z.z, v.v and p.p."""
    rz, wz, zz, vv, pp = ti.f64(0.0), ti.f64(0.0), ti.f64(0.0), ti.f64(0.0), ti.f64(0.0)
    for i in range(first_of(piece), last_of(piece, n)):
        w = apply_matrix(i, rho[phase[0, i]], begin, end, neighbour, pair, normal, work)
        z, p = triple(work, Z, i), triple(work, P, i)
        set_triple(work, W, i, w)
        rz += triple(work, R, i).dot(z)
        wz += w.dot(z)
        zz += z.dot(z)
        vv += v[0, i] * v[0, i] + v[1, i] * v[1, i] + v[2, i] * v[2, i]
        pp += p.dot(p)
    sums[0, piece], sums[1, piece], sums[2, piece], sums[3, piece], sums[4, piece] = rz, wz, zz, vv, pp


@ti.func
def advance(piece, n, alpha, beta, work: ti.template()):
    """One step along the search direction for a piece of the particles."""
    for i in range(first_of(piece), last_of(piece, n)):
        p = triple(work, Z, i) + beta * triple(work, P, i)
        s = triple(work, W, i) + beta * triple(work, S, i)
        r = triple(work, R, i) - alpha * s
        set_triple(work, P, i, p)
        set_triple(work, S, i, s)
        set_triple(work, R, i, r)
        set_triple(work, X, i, triple(work, X, i) + alpha * p)
        set_triple(work, Z, i, precondition(work, i, r))


@ti.func
def total_of(row, n, sums: ti.template()):
    """What was summed by piece, summed in order of the pieces."""
    total = ti.f64(0.0)
    for k in range(pieces(n)):
        total += sums[row, k]
    return total


@ti.kernel
def solve_implicit(
    n: ti.i32,
    tolerance: ti.f32,
    most: ti.i32,
    tasks: ti.i32,
    stride: ti.i32,
    crew: i32_1d,
    report: f32_1d,
    sums: f64_2d,
    rho: f32_1d,
    phase: i32_2d,
    begin: i32_1d,
    end: i32_1d,
    neighbour: i32_1d,
    pair: f32_2d,
    normal: f32_2d,
    v: f32_2d,
    work: f32_2d,
):
    """Conjugate gradients; X is what v = v* + change still lacks. report: iterations, error.

    The error is the preconditioned residual, which is about the velocity that is still to be changed, over
    what it is at first or what the change is, whichever is more.
    """
    for block in range(tasks * stride):
        if block % stride == 0:
            turn, iteration = 0, 0
            alpha, gamma, first, error, working = ti.f64(1.0), ti.f64(1.0), ti.f64(0.0), ti.f64(0.0), True
            while working:
                piece = take(crew, turn)
                while piece < pieces(n):
                    multiply(piece, n, sums, rho, phase, begin, end, neighbour, pair, normal, v, work)
                    piece = take(crew, turn)
                turn += 1
                meet(crew, tasks)
                rz, wz, error = total_of(0, n, sums), total_of(1, n, sums), total_of(2, n, sums)
                beta = ti.f64(0.0)
                if iteration == 0:
                    first = ti.max(error, total_of(4, n, sums))
                else:
                    beta = rz / gamma
                enough = ti.max(tolerance * tolerance * first, ROUNDING * ROUNDING * total_of(3, n, sums))
                working = error > enough and iteration < most
                if working:
                    alpha = rz / (wz - beta * rz / alpha)
                    gamma = rz
                    piece = take(crew, turn)
                    while piece < pieces(n):
                        advance(piece, n, ti.cast(alpha, ti.f32), ti.cast(beta, ti.f32), work)
                        piece = take(crew, turn)
                    turn += 1
                    iteration += 1
                    meet(crew, tasks)
            if block == 0:
                report[0] = iteration
                report[1] = ti.cast(ti.sqrt(error / ti.max(first, 1e-300)), ti.f32)


@ti.kernel
def launch_multiply(
    n: ti.i32,
    sums: f64_2d,
    rho: f32_1d,
    phase: i32_2d,
    begin: i32_1d,
    end: i32_1d,
    neighbour: i32_1d,
    pair: f32_2d,
    normal: f32_2d,
    v: f32_2d,
    work: f32_2d,
):
    """One product by itself, for back ends on which tasks cannot meet."""
    for piece in range(pieces(n)):
        multiply(piece, n, sums, rho, phase, begin, end, neighbour, pair, normal, v, work)


@ti.kernel
def launch_advance(n: ti.i32, alpha: ti.f32, beta: ti.f32, work: f32_2d):
    """One step by itself."""
    for piece in range(pieces(n)):
        advance(piece, n, alpha, beta, work)


@ti.kernel
def finish(n: ti.i32, v: f32_2d, change: f32_2d, work: f32_2d):
    """Add what was lacking to the velocities and to their change."""
    for i in range(n):
        for c in ti.static(range(3)):
            v[c, i] += work[X + c, i]
            change[c, i] += work[X + c, i]


def solve_by_launches(n: int, tolerance: float, most: int, sums: Any, *arrays: Any) -> tuple[float, float]:
    """As `solve_implicit`, a launch a pass: iterations, error. `arrays` is what `launch_multiply` takes."""
    alpha = gamma = 1.0
    first, iteration = 0.0, 0
    while True:
        launch_multiply(n, sums, *arrays)
        rz, wz, error, vv, pp = sums.to_numpy()[:, : -(-n // PIECE)].sum(axis=1).tolist()
        first = max(error, pp) if iteration == 0 else first
        if error <= max(tolerance**2 * first, ROUNDING**2 * vv) or iteration == most:
            return float(iteration), math.sqrt(error / max(first, 1e-300))
        beta = rz / gamma if iteration else 0.0
        alpha = rz / (wz - beta * rz / alpha)
        gamma = rz
        launch_advance(n, alpha, beta, arrays[-1])
        iteration += 1


@ti.kernel
def add_pull(
    n: ti.i32, dt: ti.f32, rho: f32_1d, phase: i32_2d, v: f32_2d, normal: f32_2d, speed: f32_2d, work: f32_2d,
    pull: f32_2d,
):  # fmt: skip
    """What walls did to the velocities of an implicit step, as an acceleration [m/s2], added to `pull`."""
    for i in range(n):
        g = ti.Vector([normal[0, i], normal[1, i], normal[2, i]])
        u = ti.Vector([v[0, i] - speed[0, i], v[1, i] - speed[1, i], v[2, i] - speed[2, i]])
        u = work[HOLD, i] / (dt * rho[phase[0, i]]) * (u - u.dot(g) * g)
        for c in ti.static(range(3)):
            pull[c, i] -= u[c]
