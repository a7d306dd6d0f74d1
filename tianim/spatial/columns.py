"""Columns: per-particle arrays, allocated, sorted together and copied in and out in id order.

A vector quantity is one scalar array of shape (k, capacity), component-contiguous, so that
inner loops over particles vectorise; the capacity is staggered so that the rows do not fall
on the same cache sets (4 KiB aliasing made a permutation 3.5 times slower). A particle keeps
its id (0 to n - 1) while the sort moves it; NumPy sees every array in id order.

Every array has a twin of the same shape, the target of the next sort: the pair costs twice
the memory and spares a copy.

Where there is room for more, particles may come (`append`) and go (`remove`). An id is never used
again; NumPy then sees the particles that there are, in the order of their ids, which have gaps.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tianim.buffers import new_array
from tianim.errors import SceneError
from tianim.lang import CPU_BLOCK, f32_2d, i32_1d, i32_2d, ti, workers

# Floats between the ends of two rows: five cache lines over a multiple of 4 KiB.
STAGGER = 80
PAGE = 1024  # floats in 4 KiB
MOST_IDS = (1 << 31) - 1
# Fewer particles are sorted by one core: waking the others costs more (10,000: 0.4 ms, not 0.6).
SERIAL_BELOW = 32_768


def staggered(count: int) -> int:
    """Capacity for `count` particles whose rows start on different cache sets."""
    return -(-max(count, 1) // PAGE) * PAGE + STAGGER


def sorts_serially(count: int) -> bool:
    """Whether one core sorts so many particles faster than all."""
    return count < SERIAL_BELOW and workers()[1] == CPU_BLOCK


@ti.kernel
def permute_f32(
    serial: ti.template(), n: ti.i32, rows: ti.i32, destination: i32_1d, source: f32_2d, target: f32_2d
):
    """Move particle i to destination[i], float rows."""
    ti.loop_config(serialize=serial)
    for i in range(n):
        d = destination[i]
        for c in range(rows):
            target[c, d] = source[c, i]


@ti.kernel
def permute_i32(
    serial: ti.template(), n: ti.i32, rows: ti.i32, destination: i32_1d, source: i32_2d, target: i32_2d
):
    """Move particle i to destination[i], integer rows."""
    ti.loop_config(serialize=serial)
    for i in range(n):
        d = destination[i]
        for c in range(rows):
            target[c, d] = source[c, i]


@ti.kernel
def permute_moving(
    serial: ti.template(),
    n: ti.i32,
    destination: i32_1d,
    identity: i32_2d,
    x: f32_2d,
    v: f32_2d,
    identity2: i32_2d,
    x2: f32_2d,
    v2: f32_2d,
):
    """Id, position and velocity at once: a launch costs 30 us, as much as sorting 10,000 ids."""
    ti.loop_config(serialize=serial)
    for i in range(n):
        d = destination[i]
        identity2[0, d] = identity[0, i]
        for c in ti.static(range(3)):
            x2[c, d] = x[c, i]
            v2[c, d] = v[c, i]


@ti.kernel
def to_id_order_f32(n: ti.i32, rows: ti.i32, identity: i32_2d, source: f32_2d, out: f32_2d):
    """Rows in storage order into out (n, rows) in id order."""
    for i in range(n):
        k = identity[0, i]
        for c in range(rows):
            out[k, c] = source[c, i]


@ti.kernel
def to_id_order_i32(n: ti.i32, rows: ti.i32, identity: i32_2d, source: i32_2d, out: i32_2d):
    """Rows in storage order into out (n, rows) in id order."""
    for i in range(n):
        k = identity[0, i]
        for c in range(rows):
            out[k, c] = source[c, i]


@ti.kernel
def from_id_order_f32(n: ti.i32, rows: ti.i32, identity: i32_2d, values: f32_2d, target: f32_2d):
    """Values (n, rows) in id order into rows in storage order."""
    for i in range(n):
        k = identity[0, i]
        for c in range(rows):
            target[c, i] = values[k, c]


@ti.kernel
def from_id_order_i32(n: ti.i32, rows: ti.i32, identity: i32_2d, values: i32_2d, target: i32_2d):
    """Values (n, rows) in id order into rows in storage order."""
    for i in range(n):
        k = identity[0, i]
        for c in range(rows):
            target[c, i] = values[k, c]


@ti.kernel
def compact(n: ti.i32, keep: i32_1d, destination: i32_1d) -> ti.i32:
    """Places that bring those to be kept to the front and the others behind, each in their order."""
    kept = 0
    ti.loop_config(serialize=True)
    for i in range(n):
        kept += ti.select(keep[i] != 0, 1, 0)
    front, behind = 0, kept
    ti.loop_config(serialize=True)
    for i in range(n):
        stays = keep[i] != 0
        destination[i] = ti.select(stays, front, behind)
        front += ti.select(stays, 1, 0)
        behind += ti.select(stays, 0, 1)
    return kept


@ti.kernel
def put_f32(first: ti.i32, n: ti.i32, rows: ti.i32, values: f32_2d, target: f32_2d):
    """Values (n, rows) into the places from `first` on."""
    for i in range(n):
        for c in range(rows):
            target[c, first + i] = values[i, c]


@ti.kernel
def put_i32(first: ti.i32, n: ti.i32, rows: ti.i32, values: i32_2d, target: i32_2d):
    """Values (n, rows) into the places from `first` on."""
    for i in range(n):
        for c in range(rows):
            target[c, first + i] = values[i, c]


class Columns:
    """Per-particle arrays that are sorted together.

    `columns["position"]` is the compiler's array, shape (rows, capacity). "id" (int32) is
    always there. `widths` gives the rows of each array: positive for float32, negative for int32.

    count    particles that there are
    room     the most that there may be; where it is left out, `count` never changes
    issued   ids given so far: the next particle gets this one
    changes  how often particles came or went, since the start or the last restore
    """

    def __init__(self, count: int, widths: Mapping[str, int], room: int | None = None) -> None:
        self.count = self.issued = count
        self.room = count if room is None else room
        self._least = count if room is None else 0
        self.changes = 0
        self.capacity = staggered(self.room)
        self.widths = {"id": -1, **widths}
        self._now: dict[str, Any] = {}
        self._next: dict[str, Any] = {}
        for name, width in self.widths.items():
            dtype = ti.f32 if width > 0 else ti.i32
            self._now[name] = ti.ndarray(dtype, (abs(width), self.capacity))
            self._next[name] = ti.ndarray(dtype, (abs(width), self.capacity))
        self.restore(
            {name: np.zeros((abs(width), count), self.dtype(name)) for name, width in self.widths.items()}
        )
        self._now["id"].from_numpy(self._padded(np.arange(count, dtype=np.int32)[None]))
        self._rank: NDArray[np.int32] | None = None
        self._destination: Any = None

    def __getitem__(self, name: str) -> Any:
        return self._now[name]

    def dtype(self, name: str) -> type[np.float32] | type[np.int32]:
        """float32 or int32."""
        return np.float32 if self.widths[name] > 0 else np.int32

    def bytes_per_particle(self) -> int:
        """Bytes that one particle takes here, both copies."""
        return 8 * sum(abs(width) for width in self.widths.values())

    def permute(self, destination: Any) -> None:
        """Move particle i to `destination[i]` in every array."""
        serial = sorts_serially(self.count)
        rest = dict(self.widths)
        if rest.get("position") == 3 and rest.get("velocity") == 3:
            permute_moving(
                serial, self.count, destination, self["id"], self["position"], self["velocity"],
                self._next["id"], self._next["position"], self._next["velocity"],
            )  # fmt: skip
            del rest["id"], rest["position"], rest["velocity"]
        for name, width in rest.items():
            kernel = permute_f32 if width > 0 else permute_i32
            kernel(serial, self.count, abs(width), destination, self._now[name], self._next[name])
        self._now, self._next = self._next, self._now
        self._rank = None

    def append(self, count: int, values: Mapping[str, NDArray[Any]]) -> None:
        """New particles behind the others, with new ids; `values` (count,) or (count, rows), others 0."""
        if count > self.room - self.count or self.issued + count > MOST_IDS:
            raise ValueError(f"{count} more than {self.count} particles: there is room for {self.room}")
        ids = np.arange(self.issued, self.issued + count, dtype=np.int32)
        if count == 0:
            return
        for name, width in self.widths.items():
            rows = abs(width)
            given = ids if name == "id" else values.get(name, np.zeros((count, rows)))
            new = np.ascontiguousarray(given, self.dtype(name)).reshape(count, rows)
            (put_f32 if width > 0 else put_i32)(self.count, count, rows, new, self._now[name])
        self.count += count
        self.issued += count
        self.changes += 1
        self._rank = None

    def remove(self, keep: Any) -> int:
        """Take away the particles where `keep` (count,) int32, in storage order, is 0; how many.

        The others keep their order.
        """
        if self._destination is None:
            self._destination = ti.ndarray(ti.i32, self.capacity)
        removed = self.count - (compact(self.count, keep, self._destination) if self.count else 0)
        if removed:
            self.permute(self._destination)
            self.count -= removed
            self.changes += 1
        return removed

    def _order(self) -> Any:
        """(1, n): place of each stored particle in the order of ids; the ids where they have no gaps."""
        if self.issued == self.count:
            return self["id"]
        if self._rank is None:
            ids = self["id"].to_numpy()[0, : self.count]
            self._rank = np.empty((1, self.count), np.int32)
            self._rank[0, np.argsort(ids)] = np.arange(self.count, dtype=np.int32)
        return self._rank

    def read(self, name: str) -> NDArray[Any]:
        """Copy in id order: shape (n,) for one row, (n, rows) for more."""
        rows = abs(self.widths[name])
        out = new_array((self.count, rows), self.dtype(name))
        if self.count:
            kernel = to_id_order_f32 if self.widths[name] > 0 else to_id_order_i32
            kernel(self.count, rows, self._order(), self[name], out)
        return out[:, 0] if rows == 1 else out

    def write(self, name: str, values: NDArray[Any]) -> None:
        """Set from values in id order, shape (n,) or (n, rows)."""
        rows = abs(self.widths[name])
        given = np.ascontiguousarray(values, self.dtype(name)).reshape(self.count, rows)
        if self.count:
            kernel = from_id_order_f32 if self.widths[name] > 0 else from_id_order_i32
            kernel(self.count, rows, self._order(), given, self[name])

    def shape(self, name: str) -> tuple[int, ...]:
        """Shape that `read` gives and `write` takes."""
        rows = abs(self.widths[name])
        return (self.count,) if rows == 1 else (self.count, rows)

    def scatter(self, values: NDArray[np.float32], target: Any) -> None:
        """Values (n, rows) in id order into another array (rows, capacity) in storage order."""
        from_id_order_f32(self.count, values.shape[1], self._order(), np.ascontiguousarray(values), target)

    def state(self) -> dict[str, NDArray[Any]]:
        """Every array in storage order, shape (rows, n), and `issued` where ids have gaps: a checkpoint."""
        state = {name: self[name].to_numpy()[:, : self.count].copy() for name in self.widths}
        return state if self.issued == self.count else {**state, "issued": np.array([self.issued])}

    def restore(self, state: Mapping[str, NDArray[Any]]) -> None:
        """Take over what `state` gave, and its number of particles. SceneError where there is no room."""
        count = np.asarray(state["id"]).shape[1]
        if not self._least <= count <= self.room:
            raise SceneError(f"the saved state is of {count:,} particles; there is room for {self.room:,}")
        self.count = count
        self.issued = int(state["issued"][0]) if "issued" in state else count
        self.changes = 0
        self._rank = None
        for name in self.widths:
            self._now[name].from_numpy(self._padded(np.asarray(state[name], self.dtype(name))))

    def _padded(self, rows: NDArray[Any]) -> NDArray[Any]:
        out = np.zeros((rows.shape[0], self.capacity), rows.dtype)
        out[:, : self.count] = rows
        return out
