"""NeighborGrid: the one neighbour search. Particles in cell order, candidates in one long run.

Space is cut into cells at least one radius wide; the neighbours of a particle lie in the 27
cells around it (9 in 2D). Cell coordinates are taken modulo the number of cells, which makes
one code of three domains: a periodic box (the wrapped cells carry their image's shift), a
bounded box (dense cells, nothing wraps that is near), and open space (far apart places share
a cell; the distance test rejects the strangers). No table can overflow and nothing is hashed.

    cell c = floor((x - lower) / size) mod shape,   index = (c_z * n_y + c_y) * n_x + c_x

*Sort.* A counting sort, stable from the order held before (checkpoints hold that order), by
one histogram a task: the result does not depend on the number of threads.

*Walk.* A kernel goes along the rows of cells (all c_x at one c_y, c_z). For a row it first
copies the row and its 8 neighbour rows (2 in 2D) into scratch, x-slice by x-slice: the *tube*.
The candidates of the cell in slice s are then the contiguous run of slices s - 1 to s + 1, read
by a long branchless loop. Copying each particle 9 times instead of 27 (a gather for each cell)
and scanning one run instead of 9 is what makes it fast: at 20 neighbours of 131 candidates in 3D,
88 ns a particle against 109 for 9 separate runs and 106 for a gather a cell (2 cores, 10^6).

*Exactness.* Differences of near coordinates are exact in float32 (Sterbenz), so that pairs at
r (1 - 1e-6) and r (1 + 1e-6) fall on the right side wherever they are. Coordinates that differ by
the length of a periodic box are not near: where a tube meets the seam, cells at the upper side
are held relative to it and cells at the lower side relative to that, which is exact too.

A kernel that walks:

    for each task:                                         # see `flock` in systems/boids
        while there are pieces to take:
            for row in range(first_row(piece), first_row(piece + 1)):
                gather the tube, then for each cell of the row, for each particle i of the cell:
                    for j in range(begin, begin + rounded): test and use scratch[:, j]

Limits: a periodic box must be at least 3.003 radii wide on every axis that has more than one cell.
"""

import math

import numpy as np

from tianim.errors import SceneError
from tianim.lang import f32_1d, f32_2d, i32_1d, i32_2d, ti, workers
from tianim.spatial.columns import Columns, sorts_serially, staggered
from tianim.spatial.tubes import (
    COUNT,
    INVERSE,
    LANES,
    LOWER,
    NX,
    NY,
    NZ,
    PERIODIC,
    STRIDE,
    TASKS,
    largest_tube,
    share,
)
from tianim.system import Bounds

# Cells are a little wider than the radius: rounding of the size, or of a distance that is just the
# radius, must not put two neighbours two cells apart. Cell coordinates themselves are exact.
CELL_MARGIN = 1.001
# An open domain gets about this many cells for each particle, a box at most: where it is larger,
# far apart places share a cell. Periodic cells cannot, they become wider instead: hence more of them.
CELLS_PER_PARTICLE = 2
PERIODIC_CELLS_PER_PARTICLE = 8
FEWEST_CELLS = 4096  # that a box may have in any case
MIN_CELLS = 3  # on an axis
NARROWEST = MIN_CELLS * CELL_MARGIN  # a periodic box, in radii
PAGE_OF_CANDIDATES = 4096


@ti.func
def cell_coordinate(x, axis, shape: ti.template(), geometry: ti.template()):
    """Cell of coordinate x [m] on an axis: clamped where periodic, modulo the shape elsewhere.

    In float64: float32 would lose neighbours from some 30,000 cells off the corner on.
    """
    n = shape[axis]
    from_corner = ti.cast(x, ti.f64) - ti.cast(geometry[LOWER + axis], ti.f64)
    c = ti.floor(from_corner * ti.cast(geometry[INVERSE + axis], ti.f64))
    if shape[PERIODIC] == 0:
        c -= ti.floor(c / n) * n
    return ti.min(ti.max(ti.cast(c, ti.i32), 0), n - 1)


@ti.kernel
def sort_order(
    serial: ti.template(),
    shape: i32_1d,
    geometry: f32_1d,
    x: f32_2d,
    cell: i32_1d,
    histogram: i32_2d,
    start: i32_1d,
    destination: i32_1d,
):
    """Counting sort by cell, stable: where each particle goes, and where each cell starts."""
    n, tasks, stride = shape[COUNT], shape[TASKS], shape[STRIDE]
    cells = shape[NX] * shape[NY] * shape[NZ]
    ti.loop_config(serialize=serial)
    for task_block in range(tasks * stride):
        if task_block % stride == 0:
            t = task_block // stride
            for c in range(cells):
                histogram[t, c] = 0
            for i in range(share(n, t, tasks), share(n, t + 1, tasks)):
                cx = cell_coordinate(x[0, i], 0, shape, geometry)
                cy = cell_coordinate(x[1, i], 1, shape, geometry)
                cz = cell_coordinate(x[2, i], 2, shape, geometry)
                c = (cz * shape[NY] + cy) * shape[NX] + cx
                cell[i] = c
                # Not `+=`: the compiler makes that an atomic, which makes this more than twice as slow.
                histogram[t, c] = histogram[t, c] + 1
    ti.loop_config(serialize=True)
    for _ in range(1):
        total = 0
        for c in range(cells):
            start[c] = total
            for t in range(tasks):
                here = histogram[t, c]
                histogram[t, c] = total
                total += here
        start[cells] = total
    ti.loop_config(serialize=serial)
    for task_block in range(tasks * stride):
        if task_block % stride == 0:
            t = task_block // stride
            for i in range(share(n, t, tasks), share(n, t + 1, tasks)):
                c = cell[i]
                place = histogram[t, c]
                destination[i] = place
                histogram[t, c] = place + 1


def at_most(cells: list[int], most: int) -> list[int]:
    """Cells an axis, the longest axes cut until there are at most `most` in all."""
    low, high = MIN_CELLS, max(cells)
    while low < high:
        middle = (low + high + 1) // 2
        if math.prod(min(n, middle) for n in cells) <= most:
            low = middle
        else:
            high = middle - 1
    return [min(n, low) for n in cells]


class NeighborGrid:
    """Cells over a domain: `sort` orders the columns and fills `start`, kernels then walk.

    Kernels get `shape`, `geometry`, `start`, `scratch` and `offset`. There is room for as many
    particles as it was made for; `count` follows the columns.
    """

    def __init__(
        self, count: int, dimension: int, bounds: Bounds, radius: float, tagged: bool = False
    ) -> None:
        self.count = self.room = count
        self.dimension = dimension
        self.bounds = bounds
        self.tagged = tagged
        self.tasks, self.stride = workers()
        self.radius = 0.0
        self.cell = ti.ndarray(ti.i32, staggered(count))
        self.destination = ti.ndarray(ti.i32, staggered(count))
        self.shape = ti.ndarray(ti.i32, 9)
        self.geometry = ti.ndarray(ti.f32, 12)
        self._cells = 0
        self._columns = 0
        self._capacity = 0
        self.resize(radius)

    def resize(self, radius: float) -> None:
        """Cut the domain anew for another radius [m]; a no-op when it is the same."""
        if radius == self.radius:
            return
        self.radius = radius
        cells, lower, size = self._cut(radius)
        self.cells = cells
        sides = np.zeros((2, 3))
        if self.bounds.kind == "periodic":
            sides[:, : self.dimension] = np.array([self.bounds.lower, self.bounds.upper])[:, : self.dimension]
        self.geometry.from_numpy(np.array([*lower, *(1.0 / np.array(size)), *sides.ravel()], np.float32))
        if math.prod(cells) > self._cells:
            self._cells = math.prod(cells)
            self.start = ti.ndarray(ti.i32, self._cells + 1)
            self.histogram = ti.ndarray(ti.i32, (self.tasks, staggered(self._cells)))
        if cells[0] > self._columns:
            self._columns = cells[0]
            self.offset = ti.ndarray(ti.i32, (self.tasks, self._columns + 5))
        self._reserve(self._capacity or PAGE_OF_CANDIDATES)

    def _cut(self, radius: float) -> tuple[tuple[int, int, int], list[float], list[float]]:
        """Cells an axis, lower corner and cell size."""
        size = radius * CELL_MARGIN
        open_cells = round((CELLS_PER_PARTICLE * max(self.room, 1)) ** (1 / self.dimension))
        cells, lower, sizes, lengths = [1, 1, 1], [0.0] * 3, [size] * 3, [size] * 3
        periodic = self.bounds.kind == "periodic"
        for axis in range(self.dimension):
            if self.bounds.lower is None or self.bounds.upper is None:
                cells[axis] = max(open_cells, MIN_CELLS)
                continue
            lower[axis] = self.bounds.lower[axis]
            lengths[axis] = self.bounds.upper[axis] - lower[axis]
            fit = int(lengths[axis] / size)
            if periodic and fit < MIN_CELLS:
                raise SceneError(
                    f"bounds: periodic length {lengths[axis]:g} m on axis {'xyz'[axis]} is less than "
                    f"{NARROWEST:g} times the neighbour radius {radius:g} m"
                )
            cells[axis] = fit if periodic else max(fit + 1, MIN_CELLS)
        if self.bounds.lower is not None:
            each = PERIODIC_CELLS_PER_PARTICLE if periodic else CELLS_PER_PARTICLE
            cells = at_most(cells, max(each * self.room, FEWEST_CELLS))
        if periodic:
            sizes = [length / n for length, n in zip(lengths, cells, strict=True)]
        return (cells[0], cells[1], cells[2]), lower, sizes

    def _reserve(self, candidates: int) -> None:
        """Scratch for tubes of that many candidates a task."""
        if candidates > self._capacity:
            self._capacity = staggered(candidates + LANES)
            rows = 7 if self.tagged else 6
            self.scratch = ti.ndarray(ti.f32, (rows, self.tasks * self._capacity + LANES))
        self.shape.from_numpy(
            np.array(
                [
                    *self.cells,
                    self.count,
                    self.tasks,
                    self.stride,
                    self._capacity,
                    self.bounds.kind == "periodic",
                    0,
                ],
                np.int32,
            )
        )

    def sort(self, columns: Columns) -> None:
        """Put the columns into cell order; afterwards `start` says where each cell begins."""
        if columns.count != self.count:
            self._follow(columns.count)
        sort_order(
            sorts_serially(self.count),
            self.shape,
            self.geometry,
            columns["position"],
            self.cell,
            self.histogram,
            self.start,
            self.destination,
        )
        columns.permute(self.destination)
        needed = largest_tube(self.dimension, self.shape, self.start)
        if needed + LANES > self._capacity:
            self._reserve(2 * needed)

    def _follow(self, count: int) -> None:
        """Particles came or went."""
        if count > self.room:
            raise ValueError(f"{count} particles in a grid for {self.room}")
        self.count = count
        self.shape[COUNT] = count

    def memory_bytes(self) -> int:
        """Bytes of cells and scratch."""
        return 4 * (
            2 * staggered(self.room)
            + self._cells
            + self.tasks * staggered(self._cells)
            + self.scratch.shape[0] * self.scratch.shape[1]
        )
