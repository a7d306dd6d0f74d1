"""Strands that touch each other and themselves: tubes that keep their thickness and never pass through.

After the solver's step, from x to x', the ways of all points are changed until no two segments meet on them,
as surfaces are kept apart in `self_contact.py`:

 1. `strand_pairs.py` lists the pairs of segments that may meet on the way
 2. those that would come nearer than the thickness do not, and those that are make up a part of what lacks;
    friction holds them (`strand_kernels.py`)
 3. those whose axes would meet on the way (`closest.py`) become contacts too, until none would
 4. what is left after MOST_ROUNDS moves as a rigid body, or stays (`impact_zones.py`)

So no axis ever passes through another, and what is in contact keeps the thickness nearly. Nothing is carried
from step to step, and every push is one of a pair, so that momentum is kept.

Limits: segments of one strand that are nearer along it than half a turn of its tightest bend do not touch.
Pins and bodies move regardless: what they force through itself is reported. Strain limits are the solver's:
contacts after it keep the lengths that it found, as far as they have converged.
"""

from typing import Any

import numpy as np

from tianim.lang import ti
from tianim.systems.springs.apart import KeptApart
from tianim.systems.springs.arrays import constant, copy
from tianim.systems.springs.assembly import Assembly
from tianim.systems.springs.contact import Walls
from tianim.systems.springs.points import Points, entries_before
from tianim.systems.springs.self_gaps import NEAR
from tianim.systems.springs.self_kernels import farthest
from tianim.systems.springs.strand_kernels import (
    flag_meeting,
    flag_near,
    note_contacts,
    note_taut,
    note_walls,
    resolve,
    settle_moved,
)
from tianim.systems.springs.strand_pairs import PIECES, Ints, StrandPairs

# How far points may be pushed with one list, in thicknesses: it has what comes as near as NEAR of them, what
# would meet comes to a tenth, and each side may go half of the rest.
SLACK = 0.5
# Times that contacts and segments are gone through at most, fewer where there are so many that it would take
# more than AT_A_TIME of them in all, until none moves by ENOUGH of the thickness.
SWEEPS, FEWEST, AT_A_TIME, ENOUGH = 150, 15, 400_000, 2e-3
MOST_EXTRA, MOST_ROUNDS = 2, 10
FIRST_CONTACTS = 1024


class StrandContact(KeptApart):
    """What strands do to each other."""

    what = "strands"

    def __init__(
        self, whole: Assembly, points: Points, walls: Walls, thickness: float, friction: float
    ) -> None:
        super().__init__(whole, points, thickness, FIRST_CONTACTS)
        self._walls, self._friction = walls, friction
        chains, lengths = [], []
        for name, piece in whole.pieces.items():
            for chain in piece.chains:
                chains.append((chain + whole.first[name]).astype(np.int32))
                ways = np.diff(piece.position[chain], axis=0)
                lengths.append(float(np.linalg.norm(ways, axis=1).mean()))
        self._pairs = StrandPairs(chains, lengths, thickness)
        self._taut: Any = ti.ndarray(ti.i32, points.capacity)
        self._pull: Any = ti.ndarray(ti.f64, (points.capacity, 2))
        self._strands = len(chains)
        self._first = constant(np.array([*(chain[0] for chain in chains), whole.count]))
        self._back = constant(entries_before(points))

    def end(self, dt: float) -> None:
        """Change what the solver made of the step so that nothing meets."""
        points, pairs = self._points, self._pairs
        copy(points.count, points.x, self._solved)
        self._contacts = self.zones = 0
        self._busy.fill(0)
        if self._list():
            flag_near(
                pairs.room, self._h, self._start, points.x, pairs.pair, pairs.gap, pairs.count, pairs.flag
            )  # fmt: skip
            self._note(True, dt)
            self._resolve(1, dt)
            self._untangle(dt)
        self.pushed = self._contacts
        settle_moved(
            points.count, dt, points.inverse_mass, self._start, self._solved, points.x, points.v
        )  # fmt: skip

    def _untangle(self, dt: float) -> None:
        """Contacts of all that would meet, until nothing does."""
        for turn in range(MOST_ROUNDS):
            if not self._detect():
                return
            self._note(False, dt)
            self._resolve(min(1 + turn, MOST_EXTRA), dt)
        if self._detect():
            self._fail_safe()

    def _flagged(self) -> Ints:
        """The points (m, 4) of the pairs that `_detect` found."""
        pairs = self._pairs
        flag = pairs.flag.to_numpy().reshape(PIECES, pairs.room)
        used = np.arange(pairs.room) < pairs.count.to_numpy()[:PIECES, None]
        first = pairs.pair.to_numpy()[(used & (flag < 1.0)).ravel()]
        return np.stack([first[:, 0], first[:, 0] + 1, first[:, 1], first[:, 1] + 1], axis=1)

    def _list(self) -> int:
        """List the pairs for the step as it is now; how many."""
        points = self._points
        copy(points.count, points.x, self._listed)
        return self._pairs.find(self._start, points.x, NEAR * self._h)

    def _detect(self) -> int:
        """Flag the pairs that come too near on the way; how many. Lists them anew where points left it."""
        p, points = self._pairs, self._points
        if farthest(points.count, points.x, self._listed) > SLACK * self._h:
            self._list()
        met = flag_meeting(
            p.tasks, p.stride, p.room, self._h, self._start, points.x, p.pair, p.gap, p.count, p.flag
        )  # fmt: skip
        return int(met)

    def _note(self, near: bool, dt: float) -> None:
        """Make contacts of what is flagged, and of what that has with bodies."""
        p, points, walls = self._pairs, self._points, self._walls
        while True:
            found = note_contacts(
                near, self._contacts, self._corner.shape[0], p.room, self._h, self._friction, self._start,
                points.x, p.pair, p.gap, p.count, p.flag, self._corner, self._number, self._busy,
            )  # fmt: skip
            if not self._reserve(found):
                break
        more = found > self._contacts
        self._contacts = found
        if walls.any and more:
            self._reserve(found + min(points.count, 4 * found))
            self._contacts = note_walls(
                points.count, found, dt, walls.thickness, self._h, walls.bodies.table, walls.bodies.samples,
                walls.count, walls.bounds, walls.friction, self._solved, self._busy, self._corner,
                self._number,
            )  # fmt: skip

    def _resolve(self, times: int, dt: float) -> None:
        points = self._points
        segments = note_taut(
            self._strands, self._first, self._busy, self._solved, self._taut, self._pull
        )  # fmt: skip
        each = max(self._contacts + segments, 1)
        sweeps = times * min(SWEEPS, max(FEWEST, AT_A_TIME // each))
        resolve(
            sweeps, self._contacts, segments, dt, ENOUGH * self._h, self._corner, self._number, self._taut,
            self._pull, self._back, points.row, points.inverse_mass, points.x,
        )  # fmt: skip
