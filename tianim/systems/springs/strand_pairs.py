"""Which segments of strands may meet in a step: a grid of the boxes that they sweep.

A segment is written into every cell that its box meets, the box of its two ends at the start and at the end
of the step with a margin. A pair is looked at in one cell only, that of the lower corner of what their boxes
share. It is left out where it cannot meet, by ever closer tests:

    |c + t u| > r_a + r_b + H   for 0 <= t <= 1     balls about their middles, c and u relative
    gap - reach > H                                 their distance, and how far it may shrink (`closest.py`)

Cell coordinates are taken modulo the grid's: strangers in a cell fail the tests. Cells are as large as the
mean box; where one box is much larger, so large that it never meets itself around the grid.

On one strand, pairs whose middles are nearer along it than pi / 2 H are left out: half a turn of the
tightest bend that a tube of thickness H has. Cells are cut into PIECES, each with room of its own in the
list: the order of pairs does not depend on the number of threads.
"""

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tianim.lang import f32_1d, f32_2d, f64_1d, f64_2d, i32_1d, i32_2d, ti, workers
from tianim.systems.springs.arrays import constant, triple
from tianim.systems.springs.closest import EDGE_EDGE, between, edge_edge, reach

Ints = NDArray[np.int32]

PIECES = 64
FIRST_ROOM = 64  # pairs of a piece at the start
TURN = PIECES  # place of the turn in the array of counts
# Columns of what a segment sweeps: its box, its middle, the way of that, the radius about it with margin.
LOW, HIGH, MIDDLE, WAY, RADIUS, SWEPT = 0, 3, 6, 9, 12, 13
# A box is at most this part of the grid across; cells an axis are at least so many.
SPAN, FEWEST = 0.5, 8


@ti.kernel
def sweep(
    m: ti.i32, margin: ti.f32, across: ti.i32, segment: i32_1d, start: f64_2d, end: f64_2d, swept: f32_2d,
    cell: f32_1d,
):  # fmt: skip
    """What each segment sweeps, and the size of cells."""
    for k in range(m):
        a, b = segment[k], segment[k] + 1
        middle, way = ti.Vector([0.0, 0.0, 0.0], ti.f64), ti.Vector([0.0, 0.0, 0.0], ti.f64)
        most = ti.cast(0.0, ti.f32)
        for c in ti.static(range(3)):
            low = ti.min(start[a, c], start[b, c], end[a, c], end[b, c])
            high = ti.max(start[a, c], start[b, c], end[a, c], end[b, c])
            # Places are rounded to float32.
            wide = margin + 1e-6 * ti.cast(ti.max(ti.abs(low), ti.abs(high)), ti.f32)
            swept[k, LOW + c], swept[k, HIGH + c] = ti.cast(low, ti.f32) - wide, ti.cast(high, ti.f32) + wide
            middle[c] = 0.5 * (start[a, c] + start[b, c])
            way[c] = 0.5 * (end[a, c] + end[b, c]) - middle[c]
            swept[k, MIDDLE + c], swept[k, WAY + c] = ti.cast(middle[c], ti.f32), ti.cast(way[c], ti.f32)
            most = ti.max(most, wide)
        half = ti.max((triple(start, b) - triple(start, a)).norm(), (triple(end, b) - triple(end, a)).norm())
        swept[k, RADIUS] = ti.cast(0.5 * half, ti.f32) + most
    ti.loop_config(serialize=True)
    for _ in range(1):
        total, longest = ti.cast(0.0, ti.f64), 0.0
        for k in range(m):
            size = 0.0
            for c in ti.static(range(3)):
                size = ti.max(size, swept[k, HIGH + c] - swept[k, LOW + c])
            total += size
            longest = ti.max(longest, size)
        cell[0] = ti.max(ti.cast(total / m, ti.f32), longest / (SPAN * across))


@ti.func
def cell_of(x, size):
    """Of a coordinate, in cells."""
    return ti.cast(ti.floor(x / size), ti.i32)


@ti.func
def slot_of(x, y, z, across):
    """Place of a cell in the grid; `across` is a power of two."""
    return ((x & (across - 1)) * across + (y & (across - 1))) * across + (z & (across - 1))


@ti.kernel
def fill(
    m: ti.i32, across: ti.i32, room: ti.i32, cell: f32_1d, swept: f32_2d, first: i32_1d, entry: i32_1d
) -> ti.i32:
    """Counting sort of the segments by the cells that their boxes meet; how many entries there are."""
    total = 0
    ti.loop_config(serialize=True)
    for _ in range(1):
        size, slots = cell[0], across * across * across
        for s in range(slots + 1):
            first[s] = 0
        for go in range(2):  # count, then write
            for k in range(m):
                x0, x1 = cell_of(swept[k, 0], size), cell_of(swept[k, 3], size)
                y0, y1 = cell_of(swept[k, 1], size), cell_of(swept[k, 4], size)
                z0, z1 = cell_of(swept[k, 2], size), cell_of(swept[k, 5], size)
                for x in range(x0, x1 + 1):
                    for y in range(y0, y1 + 1):
                        for z in range(z0, z1 + 1):
                            s = slot_of(x, y, z, across)
                            place = first[s]
                            first[s] = place + 1
                            if go == 1 and place < room:
                                entry[place] = k
            if go == 0:
                for s in range(slots):
                    here = first[s]
                    first[s] = total
                    total += here
    return total


@ti.kernel
def find(
    tasks: ti.i32, stride: ti.i32, room: ti.i32, across: ti.i32, thickness: ti.f64, cell: f32_1d,
    segment: i32_1d, strand: i32_1d, skip: i32_1d, swept: f32_2d, first: i32_1d, entry: i32_1d,
    start: f64_2d, end: f64_2d, pair: i32_2d, gap: f64_1d, count: i32_1d,
):  # fmt: skip
    """All pairs that may come as near as the thickness, piece by piece; counts go on where room ends."""
    count[TURN] = 0
    for block in range(tasks * stride):
        if block % stride == 0:
            slots, size = across * across * across, cell[0]
            piece = ti.atomic_add(count[TURN], 1)
            while piece < PIECES:
                found = 0
                for s in range(piece * slots // PIECES, (piece + 1) * slots // PIECES):
                    # After `fill`, a cell begins where the one before it ends.
                    begin = 0
                    if s > 0:
                        begin = first[s - 1]
                    for e in range(begin, first[s]):
                        i = entry[e]
                        for f in range(e + 1, first[s]):
                            j = entry[f]
                            apart, once = False, ti.Vector([0, 0, 0])
                            for c in ti.static(range(3)):
                                low = ti.max(swept[i, LOW + c], swept[j, LOW + c])
                                apart |= low > ti.min(swept[i, HIGH + c], swept[j, HIGH + c])
                                once[c] = cell_of(low, size)
                            apart |= slot_of(once.x, once.y, once.z, across) != s
                            apart |= strand[i] == strand[j] and ti.abs(i - j) < skip[i]
                            if not apart:
                                c, u = ti.Vector([0.0, 0.0, 0.0]), ti.Vector([0.0, 0.0, 0.0])
                                for d in ti.static(range(3)):
                                    c[d] = swept[j, MIDDLE + d] - swept[i, MIDDLE + d]
                                    u[d] = swept[j, WAY + d] - swept[i, WAY + d]
                                t = ti.min(ti.max(-c.dot(u) / ti.max(u.norm_sqr(), 1e-30), 0.0), 1.0)
                                far = swept[i, RADIUS] + swept[j, RADIUS]
                                if (c + t * u).norm_sqr() <= far * far:
                                    a, b = segment[i], segment[j]
                                    xa, xb, xc, xd = (
                                        triple(start, a), triple(start, a + 1), triple(start, b),
                                        triple(start, b + 1),
                                    )  # fmt: skip
                                    there = between(edge_edge(xa, xb, xc, xd), xa, xb, xc, xd).norm()
                                    most = reach(
                                        EDGE_EDGE, triple(end, a) - xa, triple(end, a + 1) - xb,
                                        triple(end, b) - xc, triple(end, b + 1) - xd,
                                    )  # fmt: skip
                                    if there - most <= thickness:
                                        if found < room:
                                            k = piece * room + found
                                            pair[k, 0], pair[k, 1], gap[k] = a, b, there
                                        found += 1
                count[piece] = found
                piece = ti.atomic_add(count[TURN], 1)


class StrandPairs:
    """The list: `pair` (PIECES * room, 2) with the first points of two segments, `count` (PIECES + 1,).

    gap, flag   of each pair, its distance at the start of the step, and what `strand_contact.py` makes of it
    """

    def __init__(self, chains: list[Ints], lengths: list[float], thickness: float) -> None:
        """Chains of points one after another, the length of their segments."""
        self.tasks, self.stride = workers()
        segments = np.concatenate([chain[:-1] for chain in chains])
        turns = [max(math.ceil(0.5 * math.pi * thickness / length), 2) for length in lengths]
        counts = [len(chain) - 1 for chain in chains]
        self._count = len(segments)
        self._segment = constant(segments)
        self._strand = constant(np.repeat(np.arange(len(chains)), counts))
        self._skip = constant(np.repeat(turns, counts))
        # About two cells for each segment.
        self._across = max(FEWEST, 1 << round(math.log2(2 * self._count) / 3.0))
        self._swept: Any = ti.ndarray(ti.f32, (self._count, SWEPT))
        self._cell: Any = ti.ndarray(ti.f32, 1)
        self._first: Any = ti.ndarray(ti.i32, self._across**3 + 1)
        self._entry: Any = ti.ndarray(ti.i32, 8 * self._count)
        self.count: Any = ti.ndarray(ti.i32, PIECES + 1)
        self._make_room(FIRST_ROOM)

    def _make_room(self, room: int) -> None:
        self.room = room
        self.pair: Any = ti.ndarray(ti.i32, (PIECES * room, 2))
        self.gap: Any = ti.ndarray(ti.f64, PIECES * room)
        self.flag: Any = ti.ndarray(ti.f32, PIECES * room)

    def find(self, start: Any, end: Any, near: float) -> int:
        """All pairs that may come as near as `near` on their way from `start` to `end`; how many."""
        sweep(self._count, 0.5 * near, self._across, self._segment, start, end, self._swept, self._cell)
        while True:
            room = self._entry.shape[0]
            entries = fill(self._count, self._across, room, self._cell, self._swept, self._first, self._entry)
            if entries <= room:
                break
            self._entry = ti.ndarray(ti.i32, int(1.5 * entries))
        while True:
            find(
                self.tasks, self.stride, self.room, self._across, near, self._cell, self._segment,
                self._strand, self._skip, self._swept, self._first, self._entry, start, end, self.pair,
                self.gap, self.count,
            )  # fmt: skip
            counts = self.count.to_numpy()[:PIECES]
            if counts.max() <= self.room:
                return int(counts.sum())
            self._make_room(int(1.5 * counts.max()))
