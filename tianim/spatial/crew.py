"""A crew: tasks that stay in one kernel and meet at a barrier between its passes.

An iteration of a pressure solver is two passes of a millisecond. Launched one by one, such a pass finds
the other workers asleep and runs on one core. In a crew each worker runs one task to the end of the
whole solve; between passes they meet, spinning for the microseconds that one waits for the other. At
27,000 particles an iteration takes 0.045 us a particle instead of 0.09 (2 cores, wall time).

    for block in range(tasks * stride):                    # one task on each worker
        if block % stride == 0:
            turn = 0
            for iteration in range(most):
                piece = take(crew, turn)
                while piece < pieces(n):
                    for i in range(first_of(piece), last_of(piece, n)): ...
                    piece = take(crew, turn)
                turn += 1
                meet(crew, tasks)

Pieces are taken in turn, so that a worker that is held up does fewer; sums are kept by piece and added
in their order, so that results do not depend on the number of workers.

Limits: as many workers must run at once as there are tasks, which holds on a CPU (a thread a task). On
other back ends the same passes are launched one by one.
"""

import time
from typing import Any

from tianim.lang import CPU_BLOCK, i32_1d, ti, workers

# A pace that seems slower is tried again after so many steps.
PROBE = 48
PIECE = 512  # particles taken at a time
PIECES_A_TASK = 4  # at least
MOST_TURNS = 1024  # passes of one kernel
# Places in the array: apart, so that they lie on cache lines of their own.
ARRIVED, ROUND, TURNS = 0, 32, 64


@ti.func
def pieces(n):
    """Pieces of n particles."""
    return (n + PIECE - 1) // PIECE


@ti.func
def first_of(piece):
    """First particle of a piece."""
    return piece * PIECE


@ti.func
def last_of(piece, n):
    """One past the last particle of a piece."""
    return ti.min(n, (piece + 1) * PIECE)


@ti.func
def take(crew: ti.template(), turn):
    """The next piece of a pass that no task has taken yet."""
    return ti.atomic_add(crew[TURNS + turn], 1)


@ti.func
def meet(crew: ti.template(), tasks):
    """Wait until all tasks are here."""
    now = ti.atomic_add(crew[ROUND], 0)
    if ti.atomic_add(crew[ARRIVED], 1) == tasks - 1:
        crew[ARRIVED] = 0
        ti.atomic_add(crew[ROUND], 1)
    else:
        while ti.atomic_add(crew[ROUND], 0) == now:
            pass


@ti.kernel
def reset(crew: i32_1d):
    """All turns are to be taken anew."""
    ti.loop_config(serialize=True)
    for k in range(crew.shape[0]):
        crew[k] = 0


class Pace:
    """How many tasks a step takes: all, or one where the others are waited for too long.

    On a busy machine a worker that is held up keeps all others spinning, and a step may take 30 times as
    long as by one alone. Both ways are timed, the slower one again every PROBE steps. Results must not depend
    on it.
    """

    def __init__(self) -> None:
        self._seconds: dict[bool, float] = {}
        self._since = 0
        self._together = True
        self._warm = False
        self._started = 0.0

    def begin(self, tasks: int) -> int:
        """Tasks of the step that begins, of so many that there might be."""
        self._together = len(self._seconds) == 0
        if len(self._seconds) == 2:
            self._since += 1
            quicker = self._seconds[True] <= self._seconds[False]
            self._together = quicker if self._since % PROBE else not quicker
        self._started = time.perf_counter()
        return tasks if self._together else 1

    def end(self) -> None:
        """The step is done."""
        took, before = time.perf_counter() - self._started, self._seconds.get(self._together)
        if self._warm:  # the first compiles
            self._seconds[self._together] = took if before is None else min(took, 0.5 * (before + took))
        self._warm = True


class Crew:
    """The array that tasks share, and how many they are. `sums` gives room for sums by piece."""

    def __init__(self, capacity: int) -> None:
        self.tasks, self.stride = workers()
        self.works = self.stride == CPU_BLOCK
        self.array: Any = ti.ndarray(ti.i32, TURNS + MOST_TURNS)
        self.array.fill(0)
        # Two of each of two sums, used in turn: a task may still read one while another writes the next.
        self.sums: Any = ti.ndarray(ti.f32, (4, -(-max(capacity, 1) // PIECE)))

    def tasks_for(self, n: int) -> int:
        """Tasks for n particles: few of them are done before others have been waited for."""
        return max(1, min(self.tasks, n // (PIECE * PIECES_A_TASK)))

    def begin(self) -> None:
        """Before each kernel that uses the crew."""
        reset(self.array)
