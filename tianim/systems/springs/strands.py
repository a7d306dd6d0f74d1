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
stiffness times what it lacks, and held by friction until that slides. At the end of the step every segment
is as long as it may be and every point outside, each turned about the one before it (`strand_walls.py`).

Strands do not wait for each other: all iterations of all of them are one launch. 2,000 of 32 points take
7 to 8 ms a step on 2 cores (processor time over two); an iteration without walls is 65 ns a point, most of it
waiting for one block of the band (`strand_band.py`) after another.

Limits: strands have no twist. What they do to each other comes after the step (`strand_contact.py`).
"""

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tianim.lang import f32_1d, f32_2d, f64_1d, f64_2d, i32_1d, ti, workers
from tianim.systems.springs.arrays import constant, triple
from tianim.systems.springs.assembly import Assembly
from tianim.systems.springs.contact import Walls, wall_velocity
from tianim.systems.springs.params import SpringsParams
from tianim.systems.springs.points import Points, entries_before
from tianim.systems.springs.strand_band import WIDTH, eliminate, substitute, zero
from tianim.systems.springs.strand_walls import KNOWN, look, met, settle

# Stiffness of contact over that of the point's springs and mass together.
PRESSED = 1.0
# Most that one end of a segment goes past the other in an iteration, in lengths of the segment: what turns is
# stretched by half the square of it.
MOST_TURN = 0.2
# Strain limit of what has none.
UNLIMITED = 1e6
# Rows between what two tasks write.
APART = 8


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
def segment(
    i, b, back: ti.template(), row: ti.template(), tension: ti.template(), base: ti.template(),
    x: ti.template(),
):  # fmt: skip
    """The spring to point i from the one before, which it pulls by f: f, its stiffness H, and k."""
    e = back[i]
    d = triple(x, i) - triple(x, i - 1)
    moved = d - (triple(base, i) - triple(base, i - 1))
    inverse = 1.0 / ti.sqrt(ti.max(d.norm_sqr(), 1e-30))
    n = d * inverse
    k, damper, q = row[e, 0], row[e, 2] / b, row[e, 3]
    across = q + ti.abs(tension[i]) * inverse
    H = (k + damper + q - across) * n.outer_product(n)
    for a in ti.static(range(3)):
        H[a, a] += across
    return (k * (1.0 - row[e, 1] * inverse) + q) * d + (damper * moved.dot(n)) * n, H, k


@ti.func
def bending(i, back2: ti.template(), row: ti.template()):
    """Stiffness [N/m] of bending between point i and the second before it."""
    q = ti.cast(0.0, ti.f64)
    if back2[i] >= 0:
        q = row[back2[i], 3]
    return q


@ti.func
def solve(
    begin, end, at, back: ti.template(), row: ti.template(), band: ti.template(), z: ti.template(),
    tension: ti.template(), x: ti.template(),
):  # fmt: skip
    """Back up the strand. Tensions that the equations leave; no segment turns by more than MOST_TURN."""
    part = ti.cast(1.0, ti.f64)
    after, after2 = ti.Vector([0.0, 0.0, 0.0], ti.f64), ti.Vector([0.0, 0.0, 0.0], ti.f64)
    for up in range(end - begin):
        i = end - 1 - up
        own = substitute(band, at + i - begin, after, after2)
        for c in ti.static(range(3)):
            z[at + i - begin, c] = own[c]
        if up > 0:
            turned, d = after - own, triple(x, i + 1) - triple(x, i)
            length, e = d.norm(), back[i + 1]
            part = ti.min(part, MOST_TURN * length / ti.max(turned.norm(), 1e-20))
            longer = d.dot(turned) / ti.max(length, 1e-20)
            tension[i + 1] = row[e, 0] * (length - row[e, 1] + longer)
        after, after2 = own, after
    for i in range(begin, end):
        for c in ti.static(range(3)):
            x[i, c] = x[i, c] + part * z[at + i - begin, c]


@ti.kernel
def newton(
    touching: ti.template(), tasks: ti.i32, stride: ti.i32, strands: ti.i32, longest: ti.i32,
    iterations: ti.i32, limits: f32_1d, b: ti.f64, first: i32_1d, back: i32_1d, back2: i32_1d, row: f32_2d,
    inverse_mass: f64_1d, base: f64_2d, y: f64_2d, x: f64_2d, v: f64_2d, band: f64_2d, z: f64_2d,
    known: f32_2d, turn: i32_1d, tension: f64_1d, thickness: ti.f32, table: f32_2d, samples: f32_1d,
    count: ti.i32, bounds: f32_2d, friction: f32_1d,
):  # fmt: skip
    """All iterations of each strand, and the velocities that come of it. Tasks take strands in turn."""
    turn[0] = 0
    for block in range(tasks * stride):
        if block % stride == 0:
            at, h = block // stride * longest, ti.cast(b, ti.f32)  # h: for the bodies
            strand = ti.atomic_add(turn[0], 1)
            while strand < strands:
                begin, end = first[strand], first[strand + 1]
                if ti.static(touching):
                    for i in range(begin, end):
                        place = ti.cast(triple(base, i), ti.f32)
                        look(table, samples, count, bounds, thickness, h, place, known, at + i - begin)
                for _ in range(iterations):
                    own, own2, last, before = zero(), zero(), zero(), zero()
                    r1, r2 = ti.Vector([0.0, 0.0, 0.0], ti.f64), ti.Vector([0.0, 0.0, 0.0], ti.f64)
                    pull = ti.Vector([0.0, 0.0, 0.0], ti.f64)
                    stiffness = ti.cast(0.0, ti.f64)
                    free1, free2 = False, False
                    for i in range(begin, end):
                        p = at + i - begin
                        D, A, r, far, stiffest = before, zero(), -pull, ti.cast(0.0, ti.f64), stiffness
                        beside = before
                        if i + 1 < end:
                            pull, before, stiffness = segment(i + 1, b, back, row, tension, base, x)
                            r += pull
                            D += before
                            stiffest += stiffness
                        if i + 2 < end:
                            q = bending(i + 2, back2, row)
                            r += q * (triple(x, i + 2) - triple(x, i))
                            for a in ti.static(range(3)):
                                D[a, a] += q
                        if i - 2 >= begin:
                            q = bending(i, back2, row)
                            r += q * (triple(x, i - 2) - triple(x, i))
                            far = ti.select(free2, -q, 0.0)
                            for a in ti.static(range(3)):
                                D[a, a] += q
                        if free1:
                            A = -beside
                        free1, free2 = inverse_mass[i] > 0.0, free1
                        if free1:
                            heavy = 1.0 / (inverse_mass[i] * b * b)
                            stiffest += heavy
                            for c in ti.static(range(3)):
                                D[c, c] += heavy
                                r[c] += heavy * (y[i, c] - x[i, c])
                            if ti.static(touching):
                                here, there = ti.cast(triple(base, i), ti.f32), ti.cast(triple(x, i), ti.f32)
                                hit, which = met(
                                    table, samples, count, bounds, thickness, h, here, there, known, p
                                )  # fmt: skip
                                if hit.w < 0.0:
                                    stiff = PRESSED * ti.cast(stiffest, ti.f32)
                                    wall = wall_velocity(table, samples, count, which, there)
                                    slid = there - here - h * wall
                                    slid -= slid.dot(hit.xyz) * hit.xyz
                                    most = -friction[which] * stiff * hit.w / ti.max(slid.norm(), 1e-20)
                                    held = ti.min(stiff, most)
                                    r -= stiff * hit.w * hit.xyz + held * slid
                                    D += (stiff - held) * hit.xyz.outer_product(hit.xyz)
                                    for a in ti.static(range(3)):
                                        D[a, a] += held
                        else:
                            A, D, far = zero(), zero(), ti.cast(0.0, ti.f64)
                            for c in ti.static(range(3)):
                                D[c, c], r[c] = 1.0, 0.0
                        new, L, s = eliminate(band, p, D, A, far, r, own, own2, last, r1, r2)
                        own, own2, last, r1, r2 = new, own, L, s, r1
                    solve(begin, end, at, back, row, band, z, tension, x)
                settle(
                    touching, strand, b, limits[strand], first, back, row, inverse_mass, base, x, v,
                    thickness, table, samples, count, bounds, known, begin - at,
                )  # fmt: skip
                strand = ti.atomic_add(turn[0], 1)


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
        self._tension: Any = ti.ndarray(ti.f64, points.capacity)
        self._tension.fill(0.0)
        self._tasks, self._stride = workers()
        self._longest = max(len(chain) for chain in chains) + APART
        rows = self._tasks * self._longest
        self._band: Any = ti.ndarray(ti.f64, (rows, WIDTH))
        self._band.fill(0.0)
        self._z: Any = ti.ndarray(ti.f64, (rows, 3))
        self._known: Any = ti.ndarray(ti.f32, (rows, KNOWN))
        self._turn: Any = ti.ndarray(ti.i32, 1)
        self._back, self._back2 = (constant(entries_before(points, k)) for k in (1, 2))

    def hold(self, held: NDArray[np.bool_]) -> None:
        """Nothing to prepare."""

    def step(self, time: float, dt: float) -> None:
        """Go on by dt [s]."""
        p, walls = self._points, self._walls
        start_step(p.count, dt, p.inverse_mass, p.external, p.x, p.v, self._base, self._y)
        newton(
            walls.any, self._tasks, self._stride, self._count, self._longest, self._iterations, self._limits,
            dt, self._first, self._back, self._back2, p.row, p.inverse_mass, self._base, self._y,
            p.x, p.v, self._band, self._z, self._known, self._turn, self._tension, walls.thickness,
            walls.bodies.table, walls.bodies.samples, walls.count, walls.bounds, walls.friction,
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
