"""Many small steps, each one pass over all constraints in turn: XPBD, for contact and tears.

    x = x_n + h v_n + h^2 a,    each constraint in turn: x += M^-1 grad C^T dlambda,    v = (x - x_n) / h

Macklin, Mueller and Chentanez 2016 (doi:10.1145/2994258.2994272), with the stiffness and the damper that
every spring has in N/m and N s/m (`compliant.py`), and small steps in place of iterations (Macklin et al.
2019, doi:10.1145/3309486.3340247). Walls have the last word in each step, and a spring that tears is left out
from then on, and so is bending across it.

Springs are taken **line by line, each line solved as a whole** (`colours.py`). One by one, as is usual, a
pull goes from spring to spring a step at a time, and what hangs is the softer the finer it is: a sheet of
1 m, 0.2 kg/m2 and 1000 N/m sags 7.8, 28 and 106 times what it should (0.0981 %) at 32, 64 and 128 cells a
side with steps of 1/1200 s. By lines it is 1.0010, 1.0017 and 1.0020 times, 0.9997, 1.0005 and 1.0008 at half
the step.

**All of a step is one launch**: lines are in colours, four for a sheet, and a crew of workers goes from one
to the next.

A step is 1/1200 s unless the scene says so, twenty in a frame of 60 a second: short beside what is seen, so
that damping by the step itself, h omega^2 / 2 as that of implicit Euler, takes 0.4 1/s of a swing of 5 Hz.

Limits: what no line runs along converges more slowly: a sheet of 32 cells between two corners sags by 0.0016
m too much, its largest strain, at the pins, is 1.8 times the true one (1.1 at 1/4800 s). Bending goes
difference by difference: right where 6 B h^2 / (m dx^2) is below 1, dx the cell and m the mass of a point,
as of cloth; stiff strips need shorter steps. With steps above 1/300 s lines may buckle. Spin is lost by O(h).
Solids are for explicit steps.
"""

from collections.abc import Iterator, Mapping
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tianim.lang import f32_1d, f32_2d, f64_1d, f64_2d, i32_1d, i32_2d, ti
from tianim.spatial.crew import MOST_TURNS, PIECE, Crew, Pace, meet, take
from tianim.systems.springs.arrays import constant, triple
from tianim.systems.springs.assembly import Assembly
from tianim.systems.springs.bends import bends_of, joining
from tianim.systems.springs.colours import in_colours, lines_of
from tianim.systems.springs.compliant import REST, move, solve_bend, solve_hinge, solve_line, solve_wall
from tianim.systems.springs.contact import Walls
from tianim.systems.springs.points import Points

Floats = NDArray[np.float64]
Ints = NDArray[np.int32]

# The passes of a step.
PREDICT, LINES, BENDS, HINGES, WALLS, FINISH = 0, 1, 2, 3, 4, 5


@ti.kernel
def substep(
    touching: ti.template(), tears: ti.template(), tasks: ti.i32, stride: ti.i32, first_turn: ti.i32,
    last_turn: ti.i32, h: ti.f64, crew: i32_1d, passes: i32_2d, line: i32_1d, link: i32_2d, entry: i32_1d,
    row: f32_2d, of_spring: f64_1d, sweep: f64_2d, corner: i32_2d, coefficient: f64_2d, strength: f64_2d,
    guard: i32_2d, of_bend: f64_2d, hinge: i32_2d, given: f32_2d, of_hinge: f64_1d, thickness: ti.f32,
    table: f32_2d, samples: f32_1d, count: ti.i32, bounds: f32_2d, friction: f32_1d, inverse_mass: f64_1d,
    external: f64_2d, start: f64_2d, relief: f64_2d, x: f64_2d, v: f64_2d,
):  # fmt: skip
    """Passes `first_turn` to `last_turn` of a step of h [s]."""
    for block in range(tasks * stride):
        if block % stride == 0:
            for turn in range(last_turn - first_turn):
                now = first_turn + turn
                kind, begin, end = passes[now, 0], passes[now, 1], passes[now, 2]
                first, each = passes[now, 3], passes[now, 4]
                piece = take(crew, turn)
                while begin + piece * each < end:
                    for i in range(begin + piece * each, ti.min(end, begin + (piece + 1) * each)):
                        if kind == LINES:
                            solve_line(
                                h, first, line, link, entry, row, inverse_mass, start, x, of_spring, sweep, i
                            )
                        elif kind == BENDS:
                            whole = 1
                            if ti.static(tears):
                                for g in range(guard.shape[1]):
                                    if guard[i, g] >= 0 and row[guard[i, g], 0] == 0.0:
                                        whole = 0
                            if whole == 1:
                                solve_bend(
                                    h, first, corner, coefficient, strength, inverse_mass, x, of_bend, i
                                )
                        elif kind == HINGES:
                            solve_hinge(h, first, hinge, given, inverse_mass, start, x, of_hinge, i)
                        elif kind == WALLS:
                            if ti.static(touching):
                                solve_wall(
                                    h, first, thickness, table, samples, count, bounds, friction,
                                    inverse_mass, start, x, relief, i,
                                )  # fmt: skip
                        elif kind == PREDICT:
                            for c in ti.static(range(3)):
                                start[i, c] = x[i, c]
                            by = h * triple(v, i)
                            if inverse_mass[i] > 0.0:
                                by += h * h * triple(external, i)
                            move(x, i, by)
                        elif inverse_mass[i] > 0.0:
                            for c in ti.static(range(3)):
                                v[i, c] = (x[i, c] - start[i, c] - relief[i, c]) / h
                    piece = take(crew, turn)
                meet(crew, tasks)


class XpbdSolver:
    """The solver `xpbd`."""

    name = "xpbd"
    longest = float("inf")

    def __init__(self, whole: Assembly, points: Points, walls: Walls, iterations: int, tears: bool) -> None:
        self._points, self._walls = points, walls
        n, springs = whole.count, whole.springs
        lines = lines_of(springs.ends, whole.position)
        by_colour, lines_at = in_colours([along for _, along in lines], n)
        lines = [lines[m] for m in by_colour]
        self._line = constant(np.cumsum([0, *(len(own) for own, _ in lines)]))
        pairs = [pair for _, along in lines for pair in pairwise(along)]
        self._link = constant(np.array(pairs, np.int32).reshape(-1, 2))
        self._entry = constant(points.entry[np.array([s for own, _ in lines for s in own], np.int64)])
        room = max(len(springs.ends), 1)
        self._of_spring: Any = ti.ndarray(ti.f64, room)
        self._sweep: Any = ti.ndarray(ti.f64, (room, REST + 1))
        corner, coefficient, strength = bends_of(whole)
        by_colour, bends_at = in_colours(corner.tolist(), n)
        corner = corner[by_colour]
        self._tears = tears and len(corner) > 0
        self._corner = constant(corner)
        self._coefficient, self._strength = _double(coefficient[by_colour]), _double(strength[by_colour])
        guards = joining(corner, points, n) if self._tears else np.zeros((0, 1), np.int32)
        self._guard = constant(guards)
        self._of_bend: Any = ti.ndarray(ti.f64, (max(len(corner), 1), 3))
        hinges = whole.hinges
        by_colour, hinges_at = in_colours(hinges.points.tolist(), n)
        self._hinge = constant(hinges.points[by_colour])
        given = np.stack([hinges.stiffness, hinges.angle, hinges.damping], axis=1)
        self._given = constant(given[by_colour])
        self._of_hinge: Any = ti.ndarray(ti.f64, max(len(by_colour), 1))
        self._start, self._relief = (ti.ndarray(ti.f64, (points.capacity, 3)) for _ in range(2))
        self._relief.fill(0.0)
        colours = {BENDS: bends_at, HINGES: hinges_at, LINES: lines_at}
        if walls.any:
            colours[WALLS] = np.array([0, n], np.int32)
        turns = list(_turns(n, colours, iterations, self._line.to_numpy()))
        self._turns = len(turns)
        self._passes = constant(np.array(turns))
        self._crew, self._pace = Crew(n), Pace()

    def hold(self, held: Any) -> None:
        """Nothing to prepare."""

    def forget(self) -> None:
        """Nothing is remembered."""

    def state(self) -> dict[str, NDArray[Any]]:
        """Nothing is remembered."""
        return {}

    def restore(self, state: Mapping[str, NDArray[Any]]) -> None:
        """Nothing is remembered."""

    def step(self, time: float, dt: float) -> None:
        """Go on by dt [s]."""
        crew = self._crew
        tasks = self._pace.begin(crew.tasks_for(self._points.count))
        at_once = MOST_TURNS if crew.works else 1
        for first in range(0, self._turns, at_once):
            crew.begin()
            self._go(tasks, first, min(first + at_once, self._turns), dt)
        self._pace.end()

    def _go(self, tasks: int, first: int, last: int, dt: float) -> None:
        p, walls = self._points, self._walls
        substep(
            walls.any, self._tears, tasks, self._crew.stride, first, last, dt, self._crew.array, self._passes,
            self._line, self._link, self._entry, p.row, self._of_spring, self._sweep, self._corner,
            self._coefficient, self._strength, self._guard, self._of_bend, self._hinge, self._given,
            self._of_hinge, walls.thickness, walls.bodies.table, walls.bodies.samples, walls.count,
            walls.bounds, walls.friction, p.inverse_mass, p.external, self._start, self._relief, p.x, p.v,
        )  # fmt: skip


def _turns(
    n: int, colours: Mapping[int, Ints], iterations: int, line: Ints
) -> Iterator[tuple[int, int, int, int, int]]:
    """The passes of a step: what, from which to which, whether for the first time, how many a piece."""
    yield PREDICT, 0, n, 1, PIECE
    for iteration in range(iterations):
        for kind, starts in colours.items():
            for begin, end in pairwise(starts.tolist()):
                each = PIECE
                if kind == LINES:
                    each = max(1, PIECE * (end - begin) // (line[end] - line[begin]))
                yield kind, begin, end, int(iteration == 0), each
    yield FINISH, 0, n, 1, PIECE


def _double(values: Floats) -> Any:
    """An array of float64; one row where there is none."""
    array = ti.ndarray(ti.f64, (max(len(values), 1), *values.shape[1:]))
    if len(values):
        array.from_numpy(np.ascontiguousarray(values))
    return array
