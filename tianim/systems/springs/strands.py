"""Ropes and hair: a step of each strand by Newton's method, its band of equations solved directly.

    (M / b^2 + H) dx = r,     H_s = (k + c / b) n n^T + |T| / |d| (I - n n^T)

r is the same as in `projective.py`, with the b and X of implicit Euler. A strand couples each point to two
before it, the second through bending alone, so that the matrix is a band of 3 x 3 blocks, and L D L^T of it
is one walk along the strand and one back, in float64: stiffness over inertia may be a million. A chain of
any stiffness is as long as it should be after two or three iterations (Baraff and Witkin 1998,
doi:10.1145/280814.280821), where relaxing spring by spring takes as many as it has points.

T is the tension that the linear equations of the iteration before left in a spring: k (|d| - l) of a stiff
one would be wrong by far until it has its length, and hold the strand stiff across. What is pressed together
counts as stiff across, not as the negative that it is, and no segment turns far in an iteration: so a strand
that stands on its head buckles, and does not burst.

Contact is part of the same equations: a point that is too near is pushed by `PRESSED` times its springs'
stiffness times what it lacks, and held by friction until that slides.

Strands do not wait for each other: all iterations of all of them are one launch.

Limits: strands do not touch each other and have no twist.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tianim.lang import f32_1d, f32_2d, f64_1d, f64_2d, i32_1d, ti
from tianim.systems.springs.arrays import constant
from tianim.systems.springs.assembly import Assembly
from tianim.systems.springs.contact import Walls, met_wall, wall_velocity
from tianim.systems.springs.params import SpringsParams
from tianim.systems.springs.points import Points

# Stiffness of contact over that of the point's springs and mass together.
PRESSED = 1.0
# Most that one end of a segment goes past the other in an iteration, in lengths of the segment: what turns is
# stretched by half the square of it.
MOST_TURN = 0.2
# Turns of length and body about each point at the end: one undoes a little of the other.
SETTLE = 5
# Strain limit of what has none.
UNLIMITED = 1e6
# Floats of a point: the inverse of D (6, symmetric), L of the point before (9), of the one before that (9).
WIDTH = 24


@ti.func
def _inverse(m):
    """Of a symmetric 3 x 3 matrix."""
    a = m[1, 1] * m[2, 2] - m[1, 2] * m[1, 2]
    b = m[0, 2] * m[1, 2] - m[0, 1] * m[2, 2]
    c = m[0, 1] * m[1, 2] - m[0, 2] * m[1, 1]
    d = m[0, 0] * m[2, 2] - m[0, 2] * m[0, 2]
    e = m[0, 1] * m[0, 2] - m[0, 0] * m[1, 2]
    f = m[0, 0] * m[1, 1] - m[0, 1] * m[0, 1]
    s = 1.0 / (m[0, 0] * a + m[0, 1] * b + m[0, 2] * c)
    return ti.Matrix([[a * s, b * s, c * s], [b * s, d * s, e * s], [c * s, e * s, f * s]])


@ti.func
def _triple(array: ti.template(), i):
    return ti.Vector([array[i, 0], array[i, 1], array[i, 2]])


@ti.kernel
def start_step(
    n: ti.i32, dt: ti.f64, inverse_mass: f64_1d, external: f64_2d, x: f64_2d, v: f64_2d, base: f64_2d,
    y: f64_2d,
):  # fmt: skip
    """Base X = x and inertial place y. The first guess leaves out the forces, which the springs may bear."""
    for i in range(n):
        for c in ti.static(range(3)):
            base[i, c] = x[i, c]
            x[i, c] += dt * v[i, c]
            y[i, c] = x[i, c]
            if inverse_mass[i] > 0.0:
                y[i, c] += dt * dt * external[i, c]


@ti.func
def _stored(band: ti.template(), p):
    """The inverse of D of point p."""
    return ti.Matrix([
        [band[p, 0], band[p, 1], band[p, 2]], [band[p, 1], band[p, 3], band[p, 4]],
        [band[p, 2], band[p, 4], band[p, 5]],
    ])  # fmt: skip


@ti.func
def settle(
    touching: ti.template(), strand, b, limit, first: ti.template(), start: ti.template(),
    neighbour: ti.template(), row: ti.template(), inverse_mass: ti.template(), base: ti.template(),
    x: ti.template(), v: ti.template(), thickness, table: ti.template(), samples: ti.template(), count,
    bounds: ti.template(),
):  # fmt: skip
    """From the root on, no segment is longer or shorter than the limit, and none is in a body; velocities."""
    h = ti.cast(b, ti.f32)
    for i in range(first[strand], first[strand + 1]):
        if inverse_mass[i] > 0.0:
            for _ in range(SETTLE):
                if i > first[strand]:
                    d = _triple(x, i) - _triple(x, i - 1)
                    length = ti.max(d.norm(), 1e-20)
                    for e in range(start[i], start[i + 1]):
                        if neighbour[e] == i - 1:
                            rest = row[e, 1]
                            kept = ti.min(ti.max(length, rest * (1.0 - limit)), rest * (1.0 + limit))
                            for c in ti.static(range(3)):
                                x[i, c] = x[i - 1, c] + d[c] * kept / length
                if ti.static(touching):
                    begin, end = ti.cast(_triple(base, i), ti.f32), ti.cast(_triple(x, i), ti.f32)
                    hit, _which = met_wall(table, samples, count, bounds, thickness, h, begin, end)
                    for c in ti.static(range(3)):
                        x[i, c] = x[i, c] + ti.max(thickness - hit.w, 0.0) * hit[c]
            for c in ti.static(range(3)):
                v[i, c] = (x[i, c] - base[i, c]) / b


@ti.kernel
def newton(
    touching: ti.template(), strands: ti.i32, iterations: ti.i32, limits: f32_1d, b: ti.f64,
    first: i32_1d, start: i32_1d, neighbour: i32_1d,
    row: f32_2d, inverse_mass: f64_1d, base: f64_2d, y: f64_2d, x: f64_2d, v: f64_2d,
    band: f64_2d, z: f64_2d, tension: f64_1d, thickness: ti.f32, table: f32_2d,
    samples: f32_1d, count: ti.i32, bounds: f32_2d, friction: f32_1d,
):  # fmt: skip
    """All iterations of each strand, and the velocities that come of it."""
    for strand in range(strands):
        h = ti.cast(b, ti.f32)  # for the bodies
        for _ in range(iterations):
            # Down the strand: residual, blocks, L, D and L^-1 r.
            last = ti.Matrix(
                [[0.0, 0.0, 0.0], [0.0, 0.0, 0.0], [0.0, 0.0, 0.0]], ti.f64
            )  # L of the point before
            for i in range(first[strand], first[strand + 1]):
                r = ti.Vector([0.0, 0.0, 0.0], ti.f64)
                D = ti.Matrix([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]], ti.f64)
                A = ti.Matrix([[0.0, 0.0, 0.0], [0.0, 0.0, 0.0], [0.0, 0.0, 0.0]], ti.f64)
                far = ti.cast(0.0, ti.f64)
                if inverse_mass[i] > 0.0:
                    heavy = 1.0 / (inverse_mass[i] * b * b)
                    D *= heavy
                    stiffest = heavy
                    for c in ti.static(range(3)):
                        r[c] = heavy * (y[i, c] - x[i, c])
                    for e in range(start[i], start[i + 1]):
                        j = neighbour[e]
                        d = _triple(x, j) - _triple(x, i)
                        moved = d - (_triple(base, j) - _triple(base, i))
                        inverse = 1.0 / ti.sqrt(ti.max(d.norm_sqr(), 1e-30))
                        n = d * inverse
                        k, damper, q = row[e, 0], row[e, 2] / b, row[e, 3]
                        slack = 1.0 - row[e, 1] * inverse
                        r += (k * slack + q) * d + (damper * moved.dot(n)) * n
                        across = q
                        if j == i - 1:
                            across += ti.abs(tension[i]) * inverse
                        if j == i + 1:
                            across += ti.abs(tension[j]) * inverse
                        along = k + damper + q - across
                        H = along * n.outer_product(n)
                        for a in ti.static(range(3)):
                            H[a, a] += across
                        D += H
                        stiffest += k
                        if inverse_mass[j] > 0.0:
                            if j == i - 1:
                                A = -H
                            if j == i - 2:
                                far = -q
                    if ti.static(touching):
                        begin, end = ti.cast(_triple(base, i), ti.f32), ti.cast(_triple(x, i), ti.f32)
                        hit, which = met_wall(table, samples, count, bounds, thickness, h, begin, end)
                        depth = thickness - hit.w
                        if depth > 0.0:
                            stiff = PRESSED * ti.cast(stiffest, ti.f32)
                            slid = end - begin - h * wall_velocity(table, samples, count, which, end)
                            slid -= slid.dot(hit.xyz) * hit.xyz
                            held = ti.min(stiff, friction[which] * stiff * depth / ti.max(slid.norm(), 1e-20))
                            r += stiff * depth * hit.xyz - held * slid
                            D += (stiff - held) * hit.xyz.outer_product(hit.xyz)
                            for a in ti.static(range(3)):
                                D[a, a] += held
                L2 = ti.Matrix([[0.0, 0.0, 0.0], [0.0, 0.0, 0.0], [0.0, 0.0, 0.0]], ti.f64)
                if far != 0.0:
                    p = i - 2
                    L2 = far * _stored(band, p)
                    A -= far * last.transpose()
                    D -= far * L2
                    r -= L2 @ _triple(z, p)
                L1 = ti.Matrix([[0.0, 0.0, 0.0], [0.0, 0.0, 0.0], [0.0, 0.0, 0.0]], ti.f64)
                if i > first[strand]:
                    p = i - 1
                    L1 = A @ _stored(band, p)
                    D -= L1 @ A.transpose()
                    r -= L1 @ _triple(z, p)
                own = _inverse(D)
                band[i, 0], band[i, 1], band[i, 2] = own[0, 0], own[0, 1], own[0, 2]
                band[i, 3], band[i, 4], band[i, 5] = own[1, 1], own[1, 2], own[2, 2]
                for a in ti.static(range(3)):
                    for c in ti.static(range(3)):
                        band[i, 6 + 3 * a + c] = L1[a, c]
                        band[i, 15 + 3 * a + c] = L2[a, c]
                    z[i, a] = r[a]
                last = L1
            # And back: D^-1, then what the points after it take.
            total = first[strand + 1] - first[strand]
            for back in range(total):
                i = first[strand + 1] - 1 - back
                s = _stored(band, i) @ _triple(z, i)
                for ahead in ti.static(range(1, 3)):
                    if back >= ahead:
                        j = i + ahead
                        at = 6 + 9 * (ahead - 1)
                        for a in ti.static(range(3)):
                            for c in ti.static(range(3)):
                                s[c] -= band[j, at + 3 * a + c] * z[j, a]
                for c in ti.static(range(3)):
                    z[i, c] = s[c]
            # No segment turns by more than MOST_TURN.
            part = ti.cast(1.0, ti.f64)
            for i in range(first[strand] + 1, first[strand + 1]):
                turned = (_triple(z, i) - _triple(z, i - 1)).norm()
                d = _triple(x, i) - _triple(x, i - 1)
                length = d.norm()
                part = ti.min(part, MOST_TURN * length / ti.max(turned, 1e-20))
                for e in range(start[i], start[i + 1]):
                    if neighbour[e] == i - 1:
                        longer = d.dot(_triple(z, i) - _triple(z, i - 1)) / ti.max(length, 1e-20)
                        tension[i] = row[e, 0] * (length - row[e, 1] + longer)
            for i in range(first[strand], first[strand + 1]):
                for c in ti.static(range(3)):
                    x[i, c] = x[i, c] + part * z[i, c]
        settle(
            touching, strand, b, limits[strand], first, start, neighbour, row, inverse_mass, base, x, v,
            thickness, table, samples, count, bounds,
        )  # fmt: skip


class StrandSolver:
    """The solver `strands`, for pieces that are chains."""

    name = "strands"
    longest = float("inf")

    def __init__(self, params: SpringsParams, whole: Assembly, points: Points, walls: Walls) -> None:
        self._points, self._walls, self._iterations = points, walls, params.strands.iterations
        chains: list[NDArray[np.int32]] = []
        limits: list[float] = []
        for name, piece in whole.pieces.items():
            chains += [chain + whole.first[name] for chain in piece.chains]
            limits += [params.pieces[name].strain_limit or UNLIMITED] * len(piece.chains)
        self._limits = constant(np.array(limits))
        first = np.array([*(int(chain[0]) for chain in chains), whole.count], np.int32)
        self._count = len(chains)
        self._first = constant(first)
        room = (points.capacity, 3)
        self._base, self._y = (ti.ndarray(ti.f64, room) for _ in range(2))
        self._z: Any = ti.ndarray(ti.f64, room)
        self._tension: Any = ti.ndarray(ti.f64, points.capacity)
        self._tension.fill(0.0)
        self._band: Any = ti.ndarray(ti.f64, (points.capacity, WIDTH))

    def hold(self, held: NDArray[np.bool_]) -> None:
        """Nothing to prepare."""

    def step(self, time: float, dt: float) -> None:
        """Go on by dt [s]."""
        p, walls = self._points, self._walls
        start_step(p.count, dt, p.inverse_mass, p.external, p.x, p.v, self._base, self._y)
        newton(
            walls.any, self._count, self._iterations, self._limits, dt, self._first, p.start, p.neighbour,
            p.row, p.inverse_mass, self._base, self._y, p.x, p.v, self._band, self._z, self._tension,
            walls.thickness, walls.bodies.table, walls.bodies.samples, walls.count, walls.bounds,
            walls.friction,
        )  # fmt: skip

    def forget(self) -> None:
        """Tensions are found anew."""

    def state(self) -> dict[str, NDArray[Any]]:
        """Tensions, which the first iteration of a step begins with."""
        return {"tension": self._tension.to_numpy()[: self._points.count]}

    def restore(self, state: Mapping[str, NDArray[Any]]) -> None:
        """Take over what `state` gave."""
        tension = np.zeros(self._points.capacity)
        tension[: self._points.count] = state["tension"]
        self._tension.from_numpy(tension)
