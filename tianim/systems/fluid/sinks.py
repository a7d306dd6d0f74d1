"""Sinks: regions that take particles away at the start of each step."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tianim.lang import f32_2d, i32_1d, i32_2d, ti
from tianim.spatial.columns import Columns
from tianim.systems.fluid.params import FluidParams
from tianim.systems.fluid.source_params import BoxSink, PlaneSink, SinkParams, SphereSink

# A row of the table: what it is, the phase it takes, and two triples that depend on what it is.
BOX, OUTSIDE, SPHERE, PLANE, CLOSED = 0, 1, 2, 3, 4
KIND, PHASE, FIRST, SECOND = 0, 1, 2, 5
WIDTH = 8
EVERY = -1.0
FAR = 1e30  # [m], farther than any particle: z counts for nothing in two dimensions


@ti.kernel
def mark_kept(n: ti.i32, sinks: ti.i32, table: f32_2d, x: f32_2d, phase: i32_2d, keep: i32_1d) -> ti.i32:
    """keep[i]: 0 where a sink takes particle i, else 1; how many are taken."""
    taken = 0
    for i in range(n):
        gone = 0
        for s in range(sinks):
            kind = ti.cast(table[s, KIND], ti.i32)
            within, r2, along = 1, 0.0, 0.0
            for c in ti.static(range(3)):
                a, b = table[s, FIRST + c], table[s, SECOND + c]
                within &= ti.cast((x[c, i] >= a) & (x[c, i] <= b), ti.i32)
                r2 += (x[c, i] - a) ** 2
                along += (x[c, i] - a) * b
            hit = ti.select(kind == BOX, within, 0)
            hit = ti.select(kind == OUTSIDE, 1 - within, hit)
            hit = ti.select((kind == SPHERE) & (r2 < table[s, SECOND] ** 2), 1, hit)
            hit = ti.select((kind == PLANE) & (along < 0.0), 1, hit)
            mine = (table[s, PHASE] < 0.0) | (ti.cast(table[s, PHASE], ti.i32) == phase[0, i])
            gone |= ti.select(mine, hit, 0)
        keep[i] = 1 - gone
        taken += gone
    return taken


class Sinks:
    """All sinks of a fluid. `taken` counts the particles that they took."""

    def __init__(self, params: FluidParams, capacity: int) -> None:
        self.sinks = tuple(params.sinks.values())
        self.dimension = params.dimension
        self._phases = [
            EVERY if sink.phase is None else float(params.phase_number(sink.phase)) for sink in self.sinks
        ]
        self._keep: Any = ti.ndarray(ti.i32, capacity if self.sinks else 1)
        self.taken = 0

    def drain(self, columns: Columns, time: float) -> int:
        """Take away what is in a sink at `time` [s]; how many went."""
        if not self.sinks or columns.count == 0:
            return 0
        table = np.array(
            [
                self._row(sink.at(time), phase, time)
                for sink, phase in zip(self.sinks, self._phases, strict=True)
            ],
            np.float32,
        )
        count = columns.count
        gone = mark_kept(count, len(table), table, columns["position"], columns["phase"], self._keep)
        if gone:
            columns.remove(self._keep)
        self.taken += gone
        return int(gone)

    def diagnostics(self) -> dict[str, float]:
        """Particles taken so far."""
        return {"drained": float(self.taken)} if self.sinks else {}

    def state(self) -> dict[str, NDArray[Any]]:
        """What a checkpoint holds."""
        return {"sink_taken": np.array([self.taken])}

    def restore(self, state: Mapping[str, NDArray[Any]]) -> None:
        """Take over what `state` gave."""
        self.taken = int(state["sink_taken"][0])

    def _row(self, sink: SinkParams, phase: float, time: float) -> list[float]:
        """A row of the table, for the parameters of one moment."""
        if time < sink.start or (sink.end is not None and time > sink.end):
            return [CLOSED, EVERY, *[0.0] * 6]
        if isinstance(sink, SphereSink):
            return [SPHERE, phase, *self._flat(sink.centre, 0.0), sink.radius, 0.0, 0.0]
        if isinstance(sink, PlaneSink):
            return [PLANE, phase, *self._flat(sink.position, 0.0), *self._flat(sink.normal, 0.0)]
        kind = BOX if isinstance(sink, BoxSink) else OUTSIDE
        return [kind, phase, *self._flat(sink.lower, -FAR), *self._flat(sink.upper, FAR)]

    def _flat(self, vector: tuple[float, float, float], z: float) -> list[float]:
        """The vector, its z replaced in two dimensions."""
        return [*vector[:2], vector[2] if self.dimension == 3 else z]
