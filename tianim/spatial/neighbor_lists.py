"""NeighborLists: who is near whom, written down once and read for many steps.

The lists hold every pair within radius + skin. They stay complete for the radius until some
particle has moved more than half the skin since they were built, or particles came or went; only
then are the particles sorted and the lists built again. Between builds nothing is re-sorted: the
rows hold places in storage, and a system must leave the order of its columns alone.

    row of particle i:  neighbour[offset[i] .. offset[i + 1]),   pairs = offset[n]

Each pair stands in both rows, a particle is not its own neighbour, and the order within a row
depends on the order of storage alone, not on the number of threads. Built in three passes
(count, scan, fill) over the tubes of the grid, so that nothing can overflow: `neighbour` grows
to what the count asks for.

A kernel that reads them tests the distance again, since a row holds pairs up to radius + skin:

    for k in range(offset[i], offset[i + 1]):
        j = neighbour[k]
        d = nearest_image(x[c, j] - x[c, i], length[c])        # in periodic bounds
        w = ti.select(d.d < radius * radius, 1.0, 0.0)

When they pay: boids' three rules, 10^5 in 3D with 20 neighbours on 2 cores, CPU time over two in ns a
particle: the direct walk takes 107 and its sort 16, each step. A build with a skin of 0.1 radii takes
285 (sort 16, count 54, fill 213), a skin of 0.2 radii 380; reading 44 or 51, and asking whether
something has moved 3. So lists win when a build serves four steps or more, which a flock that
crosses half a skin in one step never gives: boids walk directly.

Limits: at most 2^24 particles (the tubes carry places as float32) and 2^31 - 1 pairs.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tianim.errors import SceneError
from tianim.lang import f32_1d, f32_2d, i32_1d, i32_2d, i64_1d, ti
from tianim.spatial.columns import Columns, staggered
from tianim.spatial.grid import NeighborGrid
from tianim.spatial.tubes import (
    NX,
    PLACES,
    STRIDE,
    TASKS,
    TURN,
    first_row,
    gather_tube,
    pieces,
    rounded,
    share,
    slice_of,
    take_turn,
)
from tianim.system import Bounds

# A float32 holds every whole number up to here.
MOST_PARTICLES = 1 << 24
MOST_PAIRS = (1 << 31) - 1
# Room beyond the pairs of a build, so that a gas that stirs does not allocate at every build.
HEADROOM = 1.25


@ti.func
def wrapped(x, lower, length):
    """A coordinate brought back into a periodic box; a `length` of 0 stands for no period."""
    turns = ti.floor((x - lower) / ti.max(length, 1e-30))
    return x - ti.select(length > 0.0, turns * length, 0.0)


@ti.func
def nearest_image(d, length):
    """Difference d of two coordinates [m] to the nearest image; `length` of the box, 0: no images."""
    images = length * ti.floor(d / ti.max(length, 1e-30) + 0.5)
    return d - ti.select(length > 0.0, images, 0.0)


@ti.func
def is_near(dimension: ti.template(), reach, scratch: ti.template(), me, j):
    """Whether candidate j of a tube is another than `me`, and nearer than sqrt(reach)."""
    dx, dy, dz = scratch[0, j] - scratch[0, me], scratch[1, j] - scratch[1, me], 0.0
    if ti.static(dimension == 3):
        dz = scratch[2, j] - scratch[2, me]
    return (dx * dx + dy * dy + dz * dz < reach) & (j != me)


@ti.func
def list_run(
    dimension: ti.template(), reach, scratch: ti.template(), me, begin, end, task, line: ti.template()
):
    """The candidates from `begin` to `end` that are near `me`, into the task's line; how many they are.

    32 at a time are tested without a branch, which runs in vectors, into the bits of a word; then only
    the bits that are set cost anything. An append that tests one by one takes twice as long.
    """
    near = 0
    for word in range((end - begin + 31) // 32):
        first = begin + 32 * word
        bits = ti.u32(0)
        for k in range(32):
            hit = is_near(dimension, reach, scratch, me, first + k) & (first + k < end)
            bits |= ti.select(hit, ti.u32(1) << ti.cast(k, ti.u32), ti.u32(0))
        while bits != ti.u32(0):
            k = 31 - ti.math.clz(ti.cast(bits, ti.i32))
            bits ^= ti.u32(1) << ti.cast(k, ti.u32)
            line[task, near] = first + k
            near += 1
    return near


@ti.kernel
def list_neighbours(
    dimension: ti.template(),
    writing: ti.template(),
    reach: ti.f32,
    shape: i32_1d,
    geometry: f32_1d,
    start: i32_1d,
    x: f32_2d,
    place: i32_2d,
    scratch: f32_2d,
    tube: i32_2d,
    count: i32_1d,
    line: i32_2d,
    offset: i32_1d,
    neighbour: i32_1d,
):
    """count[i]: particles nearer than sqrt(reach); where `writing`, their places into row i instead.

    A row is appended to the task's `line`, then copied.
    """
    nx = shape[NX]
    shape[TURN] = 0
    for block in range(shape[TASKS] * shape[STRIDE]):
        if block % shape[STRIDE] == 0:
            task = block // shape[STRIDE]
            piece = take_turn(shape)
            while piece < pieces(shape):
                for row in range(first_row(piece, shape, start), first_row(piece + 1, shape, start)):
                    if start[row * nx + nx] == start[row * nx]:
                        continue
                    gather_tube(
                        dimension, PLACES, task, row, shape, geometry, start, x, x, place, scratch, tube
                    )
                    for column in range(nx):
                        cell, s = row * nx + column, slice_of(column, nx)
                        begin, end = tube[task, s - 1], tube[task, s + 2]
                        for i in range(start[cell], start[cell + 1]):
                            me = tube[task, s] + i - start[cell]
                            near = 0
                            if ti.static(writing):
                                near = list_run(dimension, reach, scratch, me, begin, end, task, line)
                                first = offset[i]
                                for k in range(near):
                                    neighbour[first + k] = ti.cast(scratch[6, line[task, k]], ti.i32)
                            else:
                                for j in range(begin, begin + rounded(end - begin)):
                                    near += ti.select(
                                        is_near(dimension, reach, scratch, me, j) & (j < end), 1, 0
                                    )
                                count[i] = near
                piece = take_turn(shape)


@ti.kernel
def scan(n: ti.i32, count: i32_1d, offset: i32_1d, summary: i64_1d):
    """offset[i]: neighbours of all particles before i; summary: all pairs, the longest row."""
    total, longest = ti.i64(0), 0
    ti.loop_config(serialize=True)
    for i in range(n):
        offset[i] = ti.cast(total, ti.i32)
        total += count[i]
        longest = ti.max(longest, count[i])
    offset[n] = ti.cast(total, ti.i32)
    summary[0] = total
    summary[1] = longest


@ti.kernel
def largest_move(
    n: ti.i32, pieces: ti.i32, stride: ti.i32, length: f32_1d, x: f32_2d, built: f32_2d, out: f32_1d
):
    """out[p]: largest square of a way [m2] since the build among piece p of the particles."""
    for block in range(pieces * stride):
        if block % stride == 0:
            piece = block // stride
            largest = 0.0
            for i in range(share(n, piece, pieces), share(n, piece + 1, pieces)):
                r2 = 0.0
                for c in ti.static(range(3)):
                    d = nearest_image(x[c, i] - built[c, i], length[c])
                    r2 += d * d
                largest = ti.max(largest, r2)
            out[piece] = largest


@ti.kernel
def number_places(n: ti.i32, place: i32_2d):
    """place[0, i] = i."""
    for i in range(n):
        place[0, i] = i


@ti.kernel
def copy_positions(n: ti.i32, x: f32_2d, built: f32_2d):
    """Copy x into `built`."""
    for i in range(n):
        for c in ti.static(range(3)):
            built[c, i] = x[c, i]


class NeighborLists:
    """Rows of neighbours in storage order; see the module for what kernels read.

    offset     (n + 1,) int32
    neighbour  (capacity,) int32, places in storage; a build may replace it by a larger one
    length     (3,) float32 [m], the periodic box for `nearest_image`, 0 where there are no images
    pairs      entries in use

    There is room for as many particles as they were made for; `count` follows the columns.
    """

    def __init__(self, count: int, dimension: int, bounds: Bounds, radius: float, skin: float) -> None:
        if count > MOST_PARTICLES:
            raise SceneError(f"stored neighbour lists: {count:,} particles, at most {MOST_PARTICLES:,}")
        self.count = self.room = count
        self.dimension = dimension
        self.radius, self.skin = radius, skin
        self.grid = NeighborGrid(count, dimension, bounds, radius + skin, tagged=True)
        self.pairs = 0
        self.offset = ti.ndarray(ti.i32, count + 1)
        self.neighbour = ti.ndarray(ti.i32, staggered(count))
        self.length = ti.ndarray(ti.f32, 3)
        if bounds.kind == "periodic" and bounds.lower is not None and bounds.upper is not None:
            box = np.subtract(bounds.upper, bounds.lower)
            self.length.from_numpy(np.where(np.arange(3) < dimension, box, 0.0).astype(np.float32))
        self._reference = ti.ndarray(ti.f32, (3, staggered(count)))
        self._place = ti.ndarray(ti.i32, (1, staggered(count)))
        number_places(count, self._place)
        self._near = ti.ndarray(ti.i32, staggered(count))
        self._summary = ti.ndarray(ti.i64, 2)
        self._line = ti.ndarray(ti.i32, (self.grid.tasks, staggered(1)))
        self._moves = ti.ndarray(ti.f32, self.grid.tasks)
        self._built = False
        self._changes = 0

    def needs_rebuild(self, columns: Columns) -> bool:
        """Whether a particle has moved more than half the skin, some came or went, or nothing was built."""
        if not self._built or (columns.count, columns.changes) != (self.count, self._changes):
            return True
        tasks, stride = self.grid.tasks, self.grid.stride
        largest_move(
            self.count, tasks, stride, self.length, columns["position"], self._reference, self._moves
        )
        return bool(self._moves.to_numpy().max() > (0.5 * self.skin) ** 2)

    def update(self, columns: Columns) -> bool:
        """Build where it is needed; whether it was, and the columns have a new order."""
        needed = self.needs_rebuild(columns)
        if needed:
            self.build(columns)
        return needed

    def build(self, columns: Columns) -> None:
        """Put the columns into cell order and list their neighbours."""
        self.grid.sort(columns)
        self.count, self._changes = columns.count, columns.changes
        copy_positions(self.count, columns["position"], self._reference)
        self._list()

    def state(self) -> dict[str, NDArray[Any]]:
        """Positions at the last build, (3, n) in storage order: what a checkpoint holds of lists."""
        return {"built": self._reference.to_numpy()[:, : self.count if self._built else 0]}

    def restore(self, state: Mapping[str, NDArray[Any]]) -> None:
        """Make the lists that were in use when `state` was taken; the columns are left alone."""
        built = np.asarray(state["built"], np.float32)
        self._built = False
        count = built.shape[1]
        if count == 0:
            return
        # They are in cell order already, so that the stable sort keeps every particle where it is.
        again = Columns(count, {"position": 3})
        again.restore({"id": np.arange(count, dtype=np.int32)[None], "position": built})
        self.build(again)

    def memory_bytes(self) -> int:
        """Bytes of lists, places and the grid."""
        lists = self.offset.shape[0] + self.neighbour.shape[0] + 5 * staggered(self.room)
        return 4 * (lists + self._line.shape[0] * self._line.shape[1]) + self.grid.memory_bytes()

    def _list(self) -> None:
        self._walk(False)
        scan(self.count, self._near, self.offset, self._summary)
        self.pairs, longest = (int(value) for value in self._summary.to_numpy())
        self._reserve(longest)
        self._walk(True)
        self._built = True

    def _walk(self, writing: bool) -> None:
        """Count the neighbours, or write them down."""
        grid, reach = self.grid, (self.radius + self.skin) ** 2
        list_neighbours(
            self.dimension, writing, reach, grid.shape, grid.geometry, grid.start, self._reference,
            self._place, grid.scratch, grid.offset, self._near, self._line, self.offset, self.neighbour,
        )  # fmt: skip

    def _reserve(self, longest: int) -> None:
        """Room for the pairs and for the longest row, whose append writes one place beyond it."""
        if self.pairs > MOST_PAIRS:
            raise SceneError(f"stored neighbour lists: {self.pairs:,} pairs, at most {MOST_PAIRS:,}")
        if self.pairs > self.neighbour.shape[0]:
            room = min(int(HEADROOM * self.pairs), MOST_PAIRS)
            self.neighbour = ti.ndarray(ti.i32, room)
        if longest >= self._line.shape[1]:
            self._line = ti.ndarray(ti.i32, (self.grid.tasks, staggered(longest + 1)))
