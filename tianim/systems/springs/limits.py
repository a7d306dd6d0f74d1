"""What springs do not bear: beyond a strain they stay longer, tear, or are held.

    yield   |e| > e_y:  l := |d| / (1 +- e_y), so that the strain is e_y again, with a new rest length
    tear    e > e_t:    the spring is gone
    limit   e > e_l:    its points move together, within e_l, each by its share of 1 / m (Provot 1995,
                        "Deformation constraints in a mass-spring model to describe rigid cloth behavior")

The first two are looked at after each step. They only ever weaken the springs, so that the implicit solver's
matrix stays above them and need not be factored again. The limit goes through all springs in order, until
it finds none beyond, SWEEPS times at most; velocities get what places got.

Bending across a tear ends with it (`bends.py`).

Limits: of a sheet, triangles with a torn edge are no longer shown. What a torn spring bore goes on at once,
as far as a step is long: by long steps more tears than one row.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from tianim.lang import f32_1d, f32_2d, f64_1d, f64_2d, i32_1d, i32_2d, ti
from tianim.systems.springs.arrays import constant
from tianim.systems.springs.assembly import Assembly
from tianim.systems.springs.bends import Bends
from tianim.systems.springs.built import Springs
from tianim.systems.springs.params import SpringsParams
from tianim.systems.springs.points import Points

SWEEPS = 300
# Springs beyond the limit are taken to this part of it, so that a sweep may find none and be the last.
INSIDE = 0.95
NEVER = 1e30


@ti.kernel
def give_way(
    n: ti.i32, start: i32_1d, neighbour: i32_1d, of_spring: i32_1d, yields: f32_1d, tears: f32_1d, x: f64_2d,
    row: f32_2d,
) -> ti.i32:  # fmt: skip
    """Yield and tear: each of the two rows of a spring for itself, from the same numbers. How many tear."""
    torn = 0
    for i in range(n):
        for e in range(start[i], start[i + 1]):
            s = of_spring[e]
            if s >= 0 and row[e, 0] > 0.0 and row[e, 1] > 0.0:
                j = neighbour[e]
                d = ti.Vector([x[j, 0] - x[i, 0], x[j, 1] - x[i, 1], x[j, 2] - x[i, 2]])
                length = ti.cast(d.norm(), ti.f32)
                strain = length / row[e, 1] - 1.0
                if strain > tears[s]:
                    row[e, 0], row[e, 2] = 0.0, 0.0
                    torn += 1
                elif ti.abs(strain) > yields[s]:
                    row[e, 1] = length / (1.0 + ti.select(strain > 0.0, yields[s], -yields[s]))
    return torn


@ti.kernel
def hold_together(
    count: ti.i32, dt: ti.f64, sweeps: ti.i32, inside: ti.f64, ends: i32_2d, entry: i32_1d, limit: f32_1d,
    row: f32_2d, inverse_mass: f64_1d, x: f64_2d, v: f64_2d,
) -> ti.i32:  # fmt: skip
    """Shorten what is beyond its limit, spring by spring; sweeps that it took."""
    used = 0
    ti.loop_config(serialize=True)
    for _ in range(1):
        moved = 1
        while moved > 0 and used < sweeps:
            moved = 0
            used += 1
            for s in range(count):
                a, b = ends[s, 0], ends[s, 1]
                rest = ti.cast(row[entry[s], 1], ti.f64)
                wa, wb = inverse_mass[a], inverse_mass[b]
                if row[entry[s], 0] > 0.0 and wa + wb > 0.0:
                    d = ti.Vector([x[b, 0] - x[a, 0], x[b, 1] - x[a, 1], x[b, 2] - x[a, 2]])
                    length = d.norm()
                    if length > rest * (1.0 + limit[s]):
                        moved = 1
                        move = (1.0 - rest * (1.0 + inside * limit[s]) / length) / (wa + wb) * d
                        for c in ti.static(range(3)):
                            x[a, c] = x[a, c] + wa * move[c]
                            v[a, c] = v[a, c] + wa * move[c] / dt
                            x[b, c] = x[b, c] - wb * move[c]
                            v[b, c] = v[b, c] - wb * move[c] / dt
    return used


class Limits:
    """Of all springs of a system."""

    def __init__(self, params: SpringsParams, whole: Assembly, points: Points, holds: bool) -> None:
        """`holds`: whether strain limits are kept here; strands keep theirs themselves."""
        self._whole, self._points = whole, points
        yields, tears, limits = (self._of_springs(params, name) for name in NAMES)
        self.weakens = bool((yields < NEVER).any() or (tears < NEVER).any())
        self._held = np.flatnonzero(limits < NEVER) if holds else np.zeros(0, np.int64)
        self._bends: Bends | None = None
        if whole.bending is not None and (tears < NEVER).any():
            self._bends = Bends(whole, points)
        entry, of_spring = points.entry, np.full(points.row.shape[0], -1, np.int32)
        if self.weakens:
            for ends in (entry, points.back_entry):
                of_spring[ends] = np.arange(len(ends))
            self._of_spring = constant(of_spring)
            self._yields, self._tears = constant(yields), constant(tears)
        if len(self._held):
            self._ends = constant(whole.springs.ends[self._held])
            self._entry = constant(entry[self._held])
            self._limits = constant(limits[self._held])

    def _of_springs(self, params: SpringsParams, name: str) -> NDArray[np.float64]:
        """A limit of each spring; stitches have none."""
        found = []
        for key, piece in self._whole.pieces.items():
            given = getattr(params.pieces[key], name)
            found.append(np.full(len(piece.springs.ends), NEVER if given is None else given))
        own = np.concatenate(found)
        return np.concatenate([own, np.full(len(self._whole.springs.ends) - len(own), NEVER)])

    def apply(self, dt: float) -> None:
        """After a step of dt [s]."""
        p = self._points
        if len(self._held):
            hold_together(
                len(self._held), dt, SWEEPS, INSIDE, self._ends, self._entry, self._limits, p.row,
                p.inverse_mass, p.x, p.v,
            )  # fmt: skip
        if self.weakens:
            torn = give_way(
                p.count, p.start, p.neighbour, self._of_spring, self._yields, self._tears, p.x, p.row
            )
            if torn and self._bends is not None:
                self._bends.part()

    def bending(self) -> Any:
        """The bending as it is now, Q (n, n) or None."""
        return self._whole.bending if self._bends is None else self._bends.matrix

    def springs(self) -> Springs:
        """The springs as they are now."""
        given = self._whole.springs
        if not self.weakens:
            return given
        row = self._points.row.to_numpy()[self._points.entry].astype(np.float64)
        return Springs(given.ends, row[:, 0], row[:, 1], row[:, 2])

    def state(self) -> dict[str, NDArray[Any]]:
        """The rows, where they may have changed."""
        return {"row": self._points.row.to_numpy()} if self.weakens else {}

    def restore(self, state: Any) -> None:
        """Take over what `state` gave."""
        if self.weakens:
            self._points.row.from_numpy(np.ascontiguousarray(state["row"], np.float32))
            if self._bends is not None:
                self._bends.part()


NAMES = ("yield_strain", "tear_strain", "strain_limit")
