"""Few long steps: projective dynamics, a quasi-Newton method whose matrix is factored once.

    minimise  1/2 (x - y)^T M (x - y) / b^2 + E(x),     z = A^-1 r,   r = M (y - x) / b^2 + f(x)
    A = M / b^2 + sum_s (k_s + c_s / b) G_s^T G_s + Q

A takes every spring as stiff in all directions: above the true Hessian, so that x + z never goes too far, and
the same for all axes and for the whole run. How far x goes along z, and on as it went before, `descent.py`
says (Liu et al. 2013, doi:10.1145/2508363.2508406; Bouaziz et al. 2014, doi:10.1145/2601097.2601116). In
this form, with the true forces f in r, what it converges to does not depend on A, and float32 is enough for
the solve.

    implicit Euler   y = x_n + h v_n + h^2 g,                                          b = h
    BDF2             y = X + b V + b^2 g,  X = (4 x_n - x_n-1) / 3, V likewise of v,   b = 2 h / 3

and v = (x - X) / b. Implicit Euler calms waves that are short for its step; BDF2 does far less. It needs two
steps of one length: after another length, a pin that came or went, or a contact, one is implicit Euler.

**All iterations of a step are one launch**: in each, the workers take pieces of the points for r, then solve
their branches of the factor (`factor.py`), meeting six times.

Limits: springs that are turned far within a step take more iterations; ropes of many points, stiff and light,
are the worst case.
"""

from collections.abc import Mapping
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from tianim.lang import f32_1d, f32_2d, f64_1d, f64_2d, i32_1d, i32_2d, ti
from tianim.spatial.crew import MOST_TURNS, PIECE, Crew, Pace, first_of, last_of, meet, pieces, take
from tianim.systems.springs.assembly import Assembly, implicit_matrix
from tianim.systems.springs.contact import Walls
from tianim.systems.springs.contact_forces import WIDTH, forget_planes, lack_at, part, press
from tianim.systems.springs.descent import PP, PR, SUMS, ZP, ZR, ZZ, curved, lengths
from tianim.systems.springs.factor import Factor, backward_row, factorise, forward_row
from tianim.systems.springs.points import Points

# The passes of an iteration.
RESIDUAL, FORWARD, TOP, BACKWARD, CURVE, MOVE, TOUCH, PRESS = 0, 1, 2, 3, 4, 5, 6, 7
# A single step of BDF2, implicit Euler with the factor of 2/3 of its step, leaves 5/9 an iteration where
# inertia outweighs springs: so many times the iterations leave as little as in other steps.
SINGLE = 3
# Iterations of a step, free, and where contact is to settle or springs are to tear in their order. Where
# pieces touch each other, contacts push after each, or, where there are more than DENSE a point, after INNER:
# what is wrung tight strains half as much so, and what lies in folds is not driven apart.
FREE, TAXED, INNER, DENSE = 3, 5, 3, 0.25
# Steps are of one length that differ by less than this part of it; the factor is made for one rounded so.
SAME, DIGITS = 1e-9, 9


@ti.kernel
def predict(
    n: ti.i32, dt: ti.f64, b: ti.f64, two: ti.i32, single: ti.i32, inverse_mass: f64_1d, external: f64_2d,
    x: f64_2d, v: f64_2d, touched: i32_1d, x_before: f64_2d, v_before: f64_2d, base: f64_2d, y: f64_2d,
):  # fmt: skip
    """Base X, inertial place y, and a first guess of x; `two` steps are remembered or one.

    The guess goes on with v, so that what rests is its own solution and stays, however few iterations there
    are. Where the factor is not of this step (`single`) it is y, for inertia is what converges slowly there.
    Points that are held go with their velocity. Those that touched something count as if they had always gone
    as they do: two steps would throw them back.
    """
    for i in range(n):
        for c in ti.static(range(3)):
            X, V = x[i, c], v[i, c]
            if two == 1 and touched[i] == 1:
                X = x[i, c] + (dt - b) * v[i, c]
            elif two == 1:
                X = (4.0 * x[i, c] - x_before[i, c]) / 3.0
                V = (4.0 * v[i, c] - v_before[i, c]) / 3.0
            x_before[i, c] = x[i, c]
            v_before[i, c] = v[i, c]
            y[i, c] = X + b * V + b * b * external[i, c]
            if inverse_mass[i] == 0.0:
                y[i, c] = x[i, c] + dt * v[i, c]
                X = y[i, c] - b * v[i, c]
            base[i, c] = X
            x[i, c] = ti.select(single == 1 or inverse_mass[i] == 0.0, y[i, c], x[i, c] + dt * v[i, c])


@ti.kernel
def finish(n: ti.i32, b: ti.f64, inverse_mass: f64_1d, base: f64_2d, x: f64_2d, v: f64_2d):
    """Velocities, (x - X) / b."""
    for i in range(n):
        if inverse_mass[i] > 0.0:
            for c in ti.static(range(3)):
                v[i, c] = (x[i, c] - base[i, c]) / b


@ti.func
def residual_at(
    damped: ti.template(), b, start: ti.template(), neighbour: ti.template(), row: ti.template(),
    inverse_mass: ti.template(), base: ti.template(), y: ti.template(), x: ti.template(),
    force: ti.template(), i,
):  # fmt: skip
    """r_i [N]; 0 where i is held."""
    r = ti.Vector([0.0, 0.0, 0.0])
    if inverse_mass[i] > 0.0:
        f = ti.Vector([0.0, 0.0, 0.0], ti.f64)
        for e in range(start[i], start[i + 1]):
            j = neighbour[e]
            dx = ti.cast(x[j, 0] - x[i, 0], ti.f32)
            dy = ti.cast(x[j, 1] - x[i, 1], ti.f32)
            dz = ti.cast(x[j, 2] - x[i, 2], ti.f32)
            inverse = 1.0 / ti.sqrt(ti.max(dx * dx + dy * dy + dz * dz, 1e-30))
            s = row[e, 0] * (1.0 - row[e, 1] * inverse) + row[e, 3]
            f += ti.Vector([s * dx, s * dy, s * dz])
            if ti.static(damped):
                bx = ti.cast(base[j, 0] - base[i, 0], ti.f32)
                by = ti.cast(base[j, 1] - base[i, 1], ti.f32)
                bz = ti.cast(base[j, 2] - base[i, 2], ti.f32)
                closing = (dx - bx) * bx + (dy - by) * by + (dz - bz) * bz
                s = row[e, 2] * closing / (ti.cast(b, ti.f32) * ti.max(bx * bx + by * by + bz * bz, 1e-30))
                f += ti.Vector([s * bx, s * by, s * bz])
        heavy = 1.0 / (inverse_mass[i] * b * b)
        for c in ti.static(range(3)):
            r[c] = ti.cast(f[c] + heavy * (y[i, c] - x[i, c]), ti.f32) + force[i, c]
    return r


@ti.kernel
def relax(
    damped: ti.template(), touching: ti.template(), passes: ti.i32, tasks: ti.i32, stride: ti.i32,
    first_turn: ti.i32, last_turn: ti.i32, calm: ti.i32, n: ti.i32, b: ti.f64, crew: i32_1d, start: i32_1d,
    neighbour: i32_1d, row: f32_2d, inverse_mass: f64_1d, base: f64_2d, y: f64_2d, x: f64_2d,
    place: i32_1d, row_start: i32_1d, column: i32_1d, row_value: f32_1d,
    column_start: i32_1d, below: i32_1d, column_value: f32_1d, inverse: f32_1d,
    bins: ti.i32, range_start: i32_1d, ranges: i32_2d, top_count: ti.i32, tops: i32_1d, z: f32_2d,
    dt: ti.f32, thickness: ti.f32, table: f32_2d, samples: f32_1d, count: ti.i32, bounds: f32_2d,
    friction: f32_1d, x_before: f64_2d, force: f32_2d, lack: f32_2d,
    normal: f32_2d, plane: f64_2d, r: f32_2d, p: f32_2d, hz: f32_2d, hp: f32_2d, sums: f64_2d,
):  # fmt: skip
    """Iterations of x += a A^-1 r + c p, turn by turn."""
    for block in range(tasks * stride):
        if block % stride == 0:
            task = block // stride
            for turn in range(first_turn, last_turn):
                work, farther = turn % passes, passes <= turn and turn < calm
                if work == RESIDUAL:
                    piece = take(crew, turn - first_turn)
                    while piece < pieces(n):
                        for i in range(first_of(piece), last_of(piece, n)):
                            own = residual_at(
                                damped, b, start, neighbour, row, inverse_mass, base, y, x, force, i
                            )
                            k = place[i]
                            for c in ti.static(range(3)):
                                z[k, c] = r[i, c] = own[c]
                        piece = take(crew, turn - first_turn)
                elif work == FORWARD:
                    own = task
                    while own < bins:
                        for k in range(range_start[own], range_start[own + 1]):
                            for i in range(ranges[k, 0], ranges[k, 1]):
                                forward_row(row_start, column, row_value, z, i)
                        own += tasks
                elif work == TOP:
                    if task == 0:
                        for k in range(top_count):
                            forward_row(row_start, column, row_value, z, tops[k])
                        for k in range(top_count):
                            i = tops[top_count - 1 - k]
                            backward_row(column_start, below, column_value, inverse, z, i)
                elif work == BACKWARD:
                    own = task
                    while own < bins:
                        for k in range(range_start[own], range_start[own + 1]):
                            for back in range(ranges[k, 1] - ranges[k, 0]):
                                i = ranges[k, 1] - 1 - back
                                backward_row(column_start, below, column_value, inverse, z, i)
                        own += tasks
                elif work == CURVE:
                    if farther:
                        piece = take(crew, turn - first_turn)
                        while piece < pieces(n):
                            total = ti.Vector([0.0, 0.0, 0.0, 0.0, 0.0], ti.f64)
                            for i in range(first_of(piece), last_of(piece, n)):
                                own = curved(
                                    damped, b, start, neighbour, row, inverse_mass, base, x, place, z, i
                                )
                                k = place[i]
                                for c in ti.static(range(3)):
                                    hz[i, c] = own[c]
                                    total[ZZ] += z[k, c] * own[c]
                                    total[ZP] += z[k, c] * hp[i, c]
                                    total[PP] += p[i, c] * hp[i, c]
                                    total[ZR] += z[k, c] * r[i, c]
                                    total[PR] += p[i, c] * r[i, c]
                            for s in ti.static(range(SUMS)):
                                sums[s, piece] = total[s]
                            piece = take(crew, turn - first_turn)
                elif work == MOVE:
                    a, c = ti.cast(1.0, ti.f64), ti.cast(0.0, ti.f64)
                    if farther:
                        a, c = lengths(n, sums)
                    piece = take(crew, turn - first_turn)
                    while piece < pieces(n):
                        for i in range(first_of(piece), last_of(piece, n)):
                            k = place[i]
                            for axis in ti.static(range(3)):
                                d, hd = ti.cast(z[k, axis], ti.f64), 0.0
                                if farther:
                                    d = a * d + c * p[i, axis]
                                    hd = ti.cast(a * hz[i, axis] + c * hp[i, axis], ti.f32)
                                # Not +=, which would be atomic.
                                x[i, axis] = x[i, axis] + d
                                p[i, axis] = ti.select(farther, ti.cast(d, ti.f32), 0.0)
                                hp[i, axis] = hd
                        piece = take(crew, turn - first_turn)
                else:
                    if ti.static(touching):
                        piece = take(crew, turn - first_turn)
                        while piece < pieces(n):
                            for i in range(first_of(piece), last_of(piece, n)):
                                if work == TOUCH:
                                    lack[i, 3] = -1.0
                                    if inverse_mass[i] > 0.0:
                                        lack_at(
                                            thickness, dt, table, samples, count, bounds, friction, x_before,
                                            x, force, lack, normal, plane, i,
                                        )  # fmt: skip
                                elif inverse_mass[i] > 0.0:
                                    press(
                                        b, start, neighbour, row, inverse_mass, lack, normal, force,
                                        i,
                                    )  # fmt: skip
                            piece = take(crew, turn - first_turn)
                meet(crew, tasks)


class Between(Protocol):
    """What pushes points between the iterations, and their inertial places y (n, 3) with them."""

    def foresee(self, b: float, y: Any) -> int:
        """How many contacts there are to push in the step that begins, of inertia m / b^2."""

    def push_apart(self) -> None:
        """Push."""


class ProjectiveSolver:
    """The solver `projective`.

    touched  (capacity,) which points have touched something in the last step
    """

    name = "projective"
    longest = float("inf")

    def __init__(
        self, whole: Assembly, points: Points, walls: Walls, scheme: str | None, iterations: int | None,
        tears: bool,
    ) -> None:  # fmt: skip
        """What is left out of scheme and iterations is as suits; `tears`: whether springs may."""
        self._walls = walls
        self._whole, self._points = whole, points
        self._two_steps = (scheme or ("implicit_euler" if walls.any else "bdf2")) == "bdf2"
        self._iterations = iterations or (TAXED if walls.any or tears else FREE)
        self._damped = bool(whole.springs.damping.any())
        room = (points.capacity, 3)
        self._base, self._y, self._x_before, self._v_before = (ti.ndarray(ti.f64, room) for _ in range(4))
        for array in (self._base, self._y, self._x_before, self._v_before):
            array.fill(0.0)
        self.touched: Any = ti.ndarray(ti.i32, points.capacity)
        self.touched.fill(0)
        self._force, self._normal = (ti.ndarray(ti.f32, room) for _ in range(2))
        self._force.fill(0.0)
        self._plane: Any = ti.ndarray(ti.f64, (points.capacity, WIDTH))
        self._lack: Any = ti.ndarray(ti.f32, (points.capacity, 4))
        self._z, self._r, self._p, self._hz, self._hp = (ti.ndarray(ti.f32, room) for _ in range(5))
        self._sums: Any = ti.ndarray(ti.f64, (SUMS, max(1, -(-points.count // PIECE))))
        self._passes = 8 if walls.any else 6
        self._crew, self._pace = Crew(points.count), Pace()
        self._tasks = 1
        self._held = np.zeros(whole.count, np.bool_)
        self._factor: Factor | None = None
        self._factored_for = 0.0
        self._last_dt = 0.0
        self.between: Between | None = None

    def hold(self, held: NDArray[np.bool_]) -> None:
        """Other points are held: the matrix changes."""
        if not np.array_equal(held, self._held):
            self._held, self._factor, self._last_dt = held.copy(), None, 0.0

    def step(self, time: float, dt: float) -> None:
        """Go on by dt [s]."""
        points, n = self._points, self._points.count
        two = self._two_steps and abs(dt - self._last_dt) < SAME * dt
        b = 2.0 * dt / 3.0 if two else dt
        single = self._two_steps and not two
        factor = self._factor_for(2.0 * dt / 3.0 if self._two_steps else dt)
        predict(
            n, dt, b, int(two), int(single), points.inverse_mass, points.external, points.x, points.v,
            self.touched, self._x_before, self._v_before, self._base, self._y,
        )  # fmt: skip
        if self._walls.any:
            forget_planes(n, self._plane)
        self._tasks = self._pace.begin(self._crew.tasks_for(n))
        contacts = 0 if self.between is None else self.between.foresee(b, self._y)
        iterations = self._iterations * (SINGLE if single else 1)
        calm = iterations - 1 if self._walls.any else iterations
        if contacts and self.between is not None:
            inner = INNER if contacts > DENSE * n else 1
            for _ in range(iterations):
                self._relax_by(inner, inner, factor, dt, b)
                self.between.push_apart()
        else:
            self._relax_by(iterations, calm, factor, dt, b)
        self._pace.end()
        finish(n, b, points.inverse_mass, self._base, points.x, points.v)
        if self._walls.any:
            self._part(dt)
        self._last_dt = dt

    def _relax_by(self, iterations: int, calm: int, factor: Factor, dt: float, b: float) -> None:
        """So many iterations. The first, and those from `calm` on, go z."""
        turns = self._passes * iterations
        at_once = self._passes * (MOST_TURNS // self._passes) if self._crew.works else 1
        for first in range(0, turns, at_once):
            self._crew.begin()
            self._relax(factor, dt, b, first, min(first + at_once, turns), calm * self._passes)

    def _factor_for(self, b: float) -> Factor:
        """The factor for this b: a smaller one than that of a step only slows convergence."""
        b = float(f"{b:.{DIGITS}g}")  # a step of the same length may differ in its last bit
        if self._factor is None or b != self._factored_for:
            matrix = implicit_matrix(self._whole, self._held, b)
            self._factor, self._factored_for = factorise(matrix, self._whole.position), b
        return self._factor

    def _part(self, dt: float) -> None:
        p, walls = self._points, self._walls
        part(
            p.count, dt, walls.thickness, walls.bodies.table, walls.bodies.samples, walls.count, walls.bounds,
            p.inverse_mass, self._x_before, self._force, p.x, p.v, self.touched,
        )  # fmt: skip

    def _relax(self, factor: Factor, dt: float, b: float, first: int, last: int, calm: int) -> None:
        p, crew, walls = self._points, self._crew, self._walls
        relax(
            self._damped, walls.any, self._passes, self._tasks, crew.stride, first, last,
            calm, p.count, b, crew.array, p.start, p.neighbour, p.row, p.inverse_mass,
            self._base, self._y, p.x, factor.place, factor.row_start, factor.row,
            factor.row_value, factor.column_start, factor.column, factor.column_value, factor.inverse,
            factor.bins, factor.range_start, factor.ranges, factor.top_count, factor.tops, self._z, dt,
            walls.thickness, walls.bodies.table, walls.bodies.samples, walls.count, walls.bounds,
            walls.friction, self._x_before, self._force, self._lack, self._normal,
            self._plane, self._r, self._p, self._hz, self._hp, self._sums,
        )  # fmt: skip

    def forget(self) -> None:
        """The step before no longer counts: places or velocities were set."""
        self._last_dt = 0.0

    def state(self) -> dict[str, NDArray[Any]]:
        """The step before, which BDF2 goes on from."""
        p = self._points
        return {
            "x_before": p.read(self._x_before), "v_before": p.read(self._v_before),
            "last_dt": np.array([self._last_dt]), "contact_force": self._force.to_numpy()[: p.count],
            "touched": self.touched.to_numpy()[: p.count],
        }  # fmt: skip

    def restore(self, state: Mapping[str, NDArray[Any]]) -> None:
        """Take over what `state` gave."""
        for name, array in (
            ("x_before", self._x_before), ("v_before", self._v_before), ("contact_force", self._force)
        ):  # fmt: skip
            self._points.write(array, np.asarray(state[name]))
        touched = np.zeros(self._points.capacity, np.int32)
        touched[: self._points.count] = state["touched"]
        self.touched.from_numpy(touched)
        self._last_dt = float(state["last_dt"][0])
