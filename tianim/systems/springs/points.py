"""The points of all pieces, as kernels see them, and who holds them.

Places and velocities are float64, (n, 3): what stretches a spring is a small difference of places, of which
float32 would leave too little in fine sheets. A point's three numbers lie together, for neighbours are
gathered and share no cache line anyway.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from tianim.lang import f64_1d, f64_2d, i32_1d, ti
from tianim.systems.springs.arrays import copy
from tianim.systems.springs.assembly import Assembly, rows_of

Floats = NDArray[np.float64]


@ti.kernel
def lead(n: ti.i32, dt: ti.f64, which: i32_1d, target: f64_2d, x: f64_2d, v: f64_2d):
    """Velocities that bring the points `which` to `target` in `dt`."""
    for k in range(n):
        i = which[k]
        for c in ti.static(range(3)):
            v[i, c] = (target[k, c] - x[i, c]) / dt


@ti.kernel
def settle(n: ti.i32, which: i32_1d, target: f64_2d, x: f64_2d):
    """The points `which` at `target`."""
    for k in range(n):
        i = which[k]
        for c in ti.static(range(3)):
            x[i, c] = target[k, c]


@ti.kernel
def set_external(n: ti.i32, gx: ti.f64, gy: ti.f64, gz: ti.f64, drag: ti.f64, v: f64_2d, external: f64_2d):
    """Gravity and drag onto all points [m/s2]."""
    for i in range(n):
        external[i, 0] = gx - drag * v[i, 0]
        external[i, 1] = gy - drag * v[i, 1]
        external[i, 2] = gz - drag * v[i, 2]


@ti.kernel
def push(
    n: ti.i32, fx: ti.f64, fy: ti.f64, fz: ti.f64, which: i32_1d, inverse_mass: f64_1d, external: f64_2d
):
    """A force [N] on each of the points `which`."""
    ti.loop_config(serialize=True)
    for k in range(n):
        i = which[k]
        external[i, 0] += fx * inverse_mass[i]
        external[i, 1] += fy * inverse_mass[i]
        external[i, 2] += fz * inverse_mass[i]


class Points:
    """Places, velocities, rows.

    x, v          (capacity, 3) float64 [m], [m/s]
    external      (capacity, 3) float64, accelerations beside the springs' [m/s2]
    inverse_mass  (capacity,) float64 [1/kg], 0 where a point is held
    start, neighbour, row  see assembly.py
    entry, back_entry      see `Rows`
    weight        size of gravity now [m/s2]
    """

    def __init__(self, whole: Assembly) -> None:
        self.count = n = whole.count
        self.capacity = max(n, 1)
        self.mass = whole.mass
        self.x, self.v, self.external = (ti.ndarray(ti.f64, (self.capacity, 3)) for _ in range(3))
        self.inverse_mass: Any = ti.ndarray(ti.f64, self.capacity)
        rows = rows_of(whole)
        start, neighbour, row = rows.start, rows.neighbour, rows.coefficient
        self.entry, self.back_entry = rows.entry, rows.back_entry
        self.start: Any = ti.ndarray(ti.i32, n + 1)
        self.neighbour: Any = ti.ndarray(ti.i32, max(len(neighbour), 1))
        self.row: Any = ti.ndarray(ti.f32, (max(len(neighbour), 1), 4))
        self.start.from_numpy(start)
        if len(neighbour):
            self.neighbour.from_numpy(neighbour)
            self.row.from_numpy(row)
        self.write(self.x, whole.position)
        self.write(self.v, whole.velocity)
        self.external.fill(0.0)
        self.weight = 0.0
        self.hold(np.zeros(n, np.bool_))

    def hold(self, held: NDArray[np.bool_]) -> None:
        """These points move as they are told to."""
        inverse = np.zeros(self.capacity)
        inverse[: self.count] = np.where(held, 0.0, 1.0 / self.mass)
        self.inverse_mass.from_numpy(inverse)

    def read(self, array: Any) -> Floats:
        """(n, 3) float64."""
        values = np.empty((self.count, 3))
        copy(self.count, array, values)
        return values

    def write(self, array: Any, values: Floats) -> None:
        """Set from (n, 3)."""
        padded = np.zeros((self.capacity, 3), np.float64 if array.dtype == ti.f64 else np.float32)
        padded[: self.count] = values
        array.from_numpy(padded)


class Held:
    """Points that are held now, and where they are to be: (k,) and (k, 3)."""

    def __init__(self) -> None:
        self.count = 0
        self._which: Any = None
        self._target: Any = None

    def choose(self, which: NDArray[np.int32]) -> None:
        """These points from now on."""
        self.count = len(which)
        if self.count:
            self._which = ti.ndarray(ti.i32, self.count)
            self._which.from_numpy(which)
            self._target = ti.ndarray(ti.f64, (self.count, 3))

    def lead(self, points: Points, target: Floats, dt: float) -> None:
        """Velocities that bring them to `target` in dt."""
        if self.count:
            self._target.from_numpy(np.ascontiguousarray(target))
            lead(self.count, dt, self._which, self._target, points.x, points.v)

    def settle(self, points: Points) -> None:
        """Exactly where they were led."""
        if self.count:
            settle(self.count, self._which, self._target, points.x)


def entries_before(points: Points, far: int = 1) -> NDArray[np.int32]:
    """Of each point the entry in its row that is of the point `far` before; -1 for none."""
    start, neighbour = points.start.to_numpy(), points.neighbour.to_numpy()[: points.start[points.count]]
    owner = np.repeat(np.arange(points.count), np.diff(start))
    found = np.full(points.count, -1, np.int32)
    before = np.flatnonzero(neighbour == owner - far)
    found[owner[before]] = before
    return found
