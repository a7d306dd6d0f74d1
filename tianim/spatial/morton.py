"""Stars on a lattice, in Morton order: what the octree is cut from.

Positions become integers of 31 bits an axis over the cube that holds all of them. Differences of
integers are exact wherever in the cube two stars are: float32 positions relative to the middle of
the cube would lose 64 times as much. The Morton key interleaves the upper 21 bits of the three, so
that the stars of any cube of the octree stand next to each other once sorted.

The sort is a radix sort from the lowest digit, with a histogram for each task: it is stable, so
the order does not depend on the number of threads. Ten levels suffice for nearly all stars: the
upper half of the key is sorted first, the few runs that share it are mended in place, and only where
many stars share it (a star far out makes the cube wide) all digits are sorted.
"""

from typing import Any

from tianim.lang import f32_1d, f64_1d, f64_2d, i32_1d, i32_2d, i64_1d, ti, workers
from tianim.spatial.columns import sorts_serially, staggered
from tianim.spatial.tubes import share

LEVELS = 21  # of the octree that keys can tell: 63 bits
DROPPED = 10  # of the 31 bits of a lattice coordinate, those that the key leaves out
LATTICE = 2.0**31 - 1024.0  # lattice steps across the cube; one more must not overflow
DIGIT = 11  # bits a pass of the sort
DIGITS = 1 << DIGIT
# Passes over the lower and over the upper half of the key.
LOW_PASSES = HIGH_PASSES = 3
HIGH_SHIFT = DIGIT * LOW_PASSES
# Stars that share the upper half are put in order where they stand, unless one run is longer than this.
LONGEST_RUN = 2048
# Sums over all stars are made of so many parts, whatever the number of threads.
PARTS = 64
# Entries of the array that describes the cube: lower corner, side, total mass.
LOWER, SIDE, MASS = 0, 3, 4


@ti.func
def spread(v):
    """The 21 lowest bits of v, two empty bits between each."""
    k = ti.cast(v, ti.i64) & ti.i64(0x1FFFFF)
    k = (k | (k << 32)) & ti.i64(0x1F00000000FFFF)
    k = (k | (k << 16)) & ti.i64(0x1F0000FF0000FF)
    k = (k | (k << 8)) & ti.i64(0x100F00F00F00F00F)
    k = (k | (k << 4)) & ti.i64(0x10C30C30C30C30C3)
    return (k | (k << 2)) & ti.i64(0x1249249249249249)


@ti.kernel
def measure_cube(
    serial: ti.template(),
    n: ti.i32,
    tasks: ti.i32,
    stride: ti.i32,
    x: f64_2d,
    mass: f64_1d,
    parts: f64_2d,
    cube: f64_1d,
):
    """The cube around all stars, slightly larger, and their total mass."""
    ti.loop_config(serialize=serial)
    for task_block in range(tasks * stride):
        if task_block % stride == 0:
            t = task_block // stride
            for p in range(share(PARTS, t, tasks), share(PARTS, t + 1, tasks)):
                begin, end = share(n, p, PARTS), share(n, p + 1, PARTS)
                total, infinite = ti.f64(0.0), ti.f64(ti.math.inf)
                x0, y0, z0, x1, y1, z1 = infinite, infinite, infinite, -infinite, -infinite, -infinite
                # One loop for all: each sum waits for itself, not for the others.
                for i in range(begin, end):
                    total += mass[i]
                    x0, x1 = ti.min(x0, x[0, i]), ti.max(x1, x[0, i])
                    y0, y1 = ti.min(y0, x[1, i]), ti.max(y1, x[1, i])
                    z0, z1 = ti.min(z0, x[2, i]), ti.max(z1, x[2, i])
                parts[0, p], parts[1, p], parts[2, p] = x0, y0, z0
                parts[3, p], parts[4, p], parts[5, p] = x1, y1, z1
                parts[6, p] = total
    ti.loop_config(serialize=True)
    for _ in range(1):
        side, total = ti.f64(0.0), ti.f64(0.0)
        for c in range(3):
            low, high = ti.f64(ti.math.inf), ti.f64(-ti.math.inf)
            for p in range(PARTS):
                low = ti.min(low, parts[c, p])
                high = ti.max(high, parts[3 + c, p])
            cube[LOWER + c] = low
            side = ti.max(side, (high - low) * 1.000001)
            side = ti.max(side, 1e-12 * ti.max(ti.abs(low), ti.abs(high)))
        for p in range(PARTS):
            total += parts[6, p]
        cube[SIDE] = ti.select(side > 0.0, side, 1.0)
        cube[MASS] = ti.select(total > 0.0, total, 1.0)


@ti.func
def on_lattice(x, lower, scale):
    """A coordinate in lattice steps, `scale` of them a unit of length."""
    return ti.cast(ti.min(ti.max((x - lower) * scale, 0.0), LATTICE), ti.i32)


@ti.kernel
def make_keys(
    serial: ti.template(),
    n: ti.i32,
    lx: ti.f64,
    ly: ti.f64,
    lz: ti.f64,
    scale: ti.f64,
    x: f64_2d,
    key: i64_1d,
    order: i32_1d,
):
    """Morton keys in id order."""
    ti.loop_config(serialize=serial)
    for i in range(n):
        kx = spread(on_lattice(x[0, i], lx, scale) >> DROPPED)
        ky = spread(on_lattice(x[1, i], ly, scale) >> DROPPED)
        kz = spread(on_lattice(x[2, i], lz, scale) >> DROPPED)
        key[i] = (kz << 2) | (ky << 1) | kx
        order[i] = i


@ti.kernel
def sort_digit(
    serial: ti.template(),
    n: ti.i32,
    tasks: ti.i32,
    stride: ti.i32,
    shift: ti.i32,
    key: i64_1d,
    order: i32_1d,
    histogram: i32_2d,
    key_out: i64_1d,
    order_out: i32_1d,
):
    """One pass of the radix sort: stable by the digit at `shift`."""
    ti.loop_config(serialize=serial)
    for task_block in range(tasks * stride):
        if task_block % stride == 0:
            t = task_block // stride
            for d in range(DIGITS):
                histogram[t, d] = 0
            for i in range(share(n, t, tasks), share(n, t + 1, tasks)):
                d = ti.cast((key[i] >> shift) & (DIGITS - 1), ti.i32)
                histogram[t, d] = histogram[t, d] + 1  # `+=` would be an atomic
    ti.loop_config(serialize=True)
    for _ in range(1):
        total = 0
        for d in range(DIGITS):
            for t in range(tasks):
                here = histogram[t, d]
                histogram[t, d] = total
                total += here
    ti.loop_config(serialize=serial)
    for task_block in range(tasks * stride):
        if task_block % stride == 0:
            t = task_block // stride
            for i in range(share(n, t, tasks), share(n, t + 1, tasks)):
                k = key[i]
                d = ti.cast((k >> shift) & (DIGITS - 1), ti.i32)
                place = histogram[t, d]
                histogram[t, d] = place + 1
                key_out[place] = k
                order_out[place] = order[i]


@ti.kernel
def mend_runs(
    n: ti.i32,
    tasks: ti.i32,
    stride: ti.i32,
    serial: ti.template(),
    shortest: ti.i32,
    key: i64_1d,
    order: i32_1d,
    longest: i32_1d,
):
    """Sort runs of more than `shortest` stars that share the upper half of the key, by key, then by id.

    longest[t] is the longest run of task t; one above LONGEST_RUN is left as it is.
    """
    ti.loop_config(serialize=serial)
    for task_block in range(tasks * stride):
        if task_block % stride == 0:
            t = task_block // stride
            found = 0
            i, stop = share(n, t, tasks), share(n, t + 1, tasks)
            while i > 0 and i < stop and (key[i] >> HIGH_SHIFT) == (key[i - 1] >> HIGH_SHIFT):
                i += 1  # the run of the task before
            while i < stop:
                prefix = key[i] >> HIGH_SHIFT
                end = i + 1
                while end < n and (key[end] >> HIGH_SHIFT) == prefix:
                    end += 1
                if end - i > shortest:
                    found = ti.max(found, end - i)
                    if end - i <= LONGEST_RUN:
                        sort_run(i, end, key, order)
                i = end
            longest[t] = found


@ti.func
def sort_run(begin, end, key: ti.template(), order: ti.template()):
    """Shell's sort of a short run in place."""
    gap = 1
    while 3 * gap + 1 < end - begin:
        gap = 3 * gap + 1
    while gap > 0:
        for i in range(begin + gap, end):
            k, o, j = key[i], order[i], i - gap
            while j >= begin and (key[j] > k or (key[j] == k and order[j] > o)):
                key[j + gap], order[j + gap] = key[j], order[j]
                j -= gap
            key[j + gap], order[j + gap] = k, o
        gap //= 3


@ti.kernel
def gather_stars(
    serial: ti.template(),
    n: ti.i32,
    lx: ti.f64,
    ly: ti.f64,
    lz: ti.f64,
    scale: ti.f64,
    over_total: ti.f64,
    x: f64_2d,
    mass: f64_1d,
    order: i32_1d,
    lattice: i32_2d,
    weight: f32_1d,
):
    """Lattice coordinates and mass over total mass, in Morton order."""
    ti.loop_config(serialize=serial)
    for k in range(n):
        i = order[k]
        lattice[0, k] = on_lattice(x[0, i], lx, scale)
        lattice[1, k] = on_lattice(x[1, i], ly, scale)
        lattice[2, k] = on_lattice(x[2, i], lz, scale)
        weight[k] = ti.cast(mass[i] * over_total, ti.f32)


class Cube:
    """The cube around `count` stars: `lower` corner, `side`, `scale` in lattice steps, total `mass`."""

    def __init__(self, count: int) -> None:
        self.count = count
        self.serial = sorts_serially(count)
        self.tasks, self.stride = workers()
        self._parts = ti.ndarray(ti.f64, (7, PARTS))
        self._cube = ti.ndarray(ti.f64, 8)
        self.lower, self.side, self.mass = (0.0, 0.0, 0.0), 1.0, 1.0

    @property
    def scale(self) -> float:
        """Lattice steps a unit of length."""
        return LATTICE / self.side

    def measure(self, x: Any, mass: Any) -> None:
        """Measure the stars at x f64 (3, n) with mass f64 (n,)."""
        measure_cube(self.serial, self.count, self.tasks, self.stride, x, mass, self._parts, self._cube)
        values = self._cube.to_numpy().tolist()
        self.lower, self.side, self.mass = tuple(values[LOWER : LOWER + 3]), values[SIDE], values[MASS]


class Sorter:
    """Puts `count` stars in Morton order. After `sort`, order[0] holds the ids and key[0] the keys."""

    def __init__(self, count: int) -> None:
        self.count = count
        self.cube = Cube(count)
        self.serial, self.tasks, self.stride = self.cube.serial, self.cube.tasks, self.cube.stride
        capacity = staggered(count)
        self.key = [ti.ndarray(ti.i64, capacity) for _ in range(2)]
        self.order = [ti.ndarray(ti.i32, capacity) for _ in range(2)]
        self._histogram = ti.ndarray(ti.i32, (self.tasks, DIGITS + 16))
        self._longest = ti.ndarray(ti.i32, self.tasks)

    def sort(self, x: Any, mass: Any, shortest: int) -> None:
        """Sort by key; runs of up to `shortest` stars that share ten levels may stand in any order."""
        self.cube.measure(x, mass)
        self._make_keys(x)
        self._passes(range(LOW_PASSES, LOW_PASSES + HIGH_PASSES))
        mend_runs(
            self.count,
            self.tasks,
            self.stride,
            self.serial,
            shortest,
            self.key[0],
            self.order[0],
            self._longest,
        )
        if int(self._longest.to_numpy().max()) > LONGEST_RUN:
            self._make_keys(x)
            self._passes(range(LOW_PASSES + HIGH_PASSES))

    def gather(self, x: Any, mass: Any, lattice: Any, weight: Any) -> None:
        """Places i32 (3, n) in lattice steps and masses f32 (n,) over the total, in the order of the sort."""
        gather_stars(
            self.serial, self.count, *self.cube.lower, self.cube.scale, 1.0 / self.cube.mass,
            x, mass, self.order[0], lattice, weight,
        )  # fmt: skip

    def _make_keys(self, x: Any) -> None:
        cube = self.cube
        make_keys(self.serial, self.count, *cube.lower, cube.scale, x, self.key[0], self.order[0])

    def _passes(self, digits: range) -> None:
        key, order = self.key, self.order
        for digit in digits:
            sort_digit(
                self.serial, self.count, self.tasks, self.stride, DIGIT * digit,
                key[0], order[0], self._histogram, key[1], order[1],
            )  # fmt: skip
            key.reverse()
            order.reverse()

    def memory_bytes(self) -> int:
        """Bytes of the arrays."""
        return 24 * staggered(self.count)
