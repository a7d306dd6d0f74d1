"""Self-contact: surfaces keep their distance from each other and from themselves, and never pass through.

After the solver's step, from x to x', the ways of all points are changed until no two parts meet on them
(after Bridson, Fedkiw, Anderson 2002, doi:10.1145/566570.566623):

 1. `self_pairs.py` lists the pairs of point and triangle, edge and edge, whose boxes meet on the way
 2. those nearer than the thickness at x come no nearer, and make up a part of what lacks to it; friction
    holds them (`self_kernels.py`)
 3. those that would meet on the way (`closest.py`) become contacts too, until none would
 4. what is left after MOST_ROUNDS moves as a rigid body, or stays (`impact_zones.py`)

As x has no intersections, nor has x': every pair keeps at least a part of its distance, which is more than
rounding of places to float32 takes. Points that touch a body are not pushed into it.

Contacts begin with what they pushed in the step before, and the implicit solver knows it: after each of its
iterations they push apart what it brought together, and its inertial places y go along by `GAIN` times as
much, so that the forces stay and springs settle against contacts instead of being stretched by them. As with
bodies (`contact_forces.py`) the gain is what a point's neighbours add to its mass.

Limits: what intersects at the start stays so. Pins and bodies move regardless: what they force through
itself is reported. What is wrung tight needs more iterations than what lies in folds, or its springs stretch.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np
import scipy  # loads its parts when they are first used
from numpy.typing import NDArray

from tianim.lang import ti
from tianim.systems.springs.apart import KeptApart
from tianim.systems.springs.arrays import copy
from tianim.systems.springs.assembly import Assembly
from tianim.systems.springs.contact import Walls
from tianim.systems.springs.points import Points
from tianim.systems.springs.self_kernels import (
    apply,
    detect,
    draw,
    farthest,
    keep,
    note_contacts,
    note_walls,
    recall,
    remember,
    resolve,
    scan,
    settle_moved,
)
from tianim.systems.springs.self_pairs import PIECES, Ints, Pairs

# How far points may be pushed with one list, in thicknesses.
SLACK = 0.4
# Times that all contacts are gone through at most, until none moves by this part of the thickness.
SWEEPS, ENOUGH = 12, 4e-3
# The same within each of the solver's iterations.
SWEEPS_INSIDE = 3
MOST_EXTRA, MOST_ROUNDS = 2, 10
FIRST_CONTACTS = 4096


class SelfContact(KeptApart):
    """What surfaces do to each other."""

    what = "surfaces"

    def __init__(
        self, whole: Assembly, points: Points, walls: Walls, thickness: float, friction: float, solver: Any
    ) -> None:
        super().__init__(whole, points, thickness, FIRST_CONTACTS)
        self._walls, self._friction = walls, friction
        triangles = [piece.triangles + whole.first[name] for name, piece in whole.pieces.items()]
        same, group = joined(whole)
        self._pairs = Pairs(
            whole.position, np.concatenate(triangles).astype(np.int32), same, group, thickness
        )
        self._offset: Any = ti.ndarray(ti.i32, PIECES)
        self._wall: Any = ti.ndarray(ti.f32, (points.capacity, 5))
        self._implicit = hasattr(solver, "touched")
        self._gain: Any = ti.ndarray(ti.f64, points.capacity)
        self._gain.fill(1.0)
        self._head: Any = ti.ndarray(ti.i32, points.capacity)
        self._y: Any = None
        self._foreseen = False
        if self._implicit:
            solver.between = self
        self._touched: Any = solver.touched if self._implicit else ti.ndarray(ti.i32, points.capacity)
        self._room_before, self._b = 0, 1.0
        self.forget()

    def foresee(self, b: float, y: Any) -> int:
        """Contacts between pairs that will be near, as far as the solver's first guess says; how many."""
        points = self._points
        self._y, self._foreseen = y, True
        self._note_near()
        if self._contacts:
            draw(
                points.count, b, points.start, points.neighbour, points.row, points.inverse_mass, self._busy,
                self._gain,
            )  # fmt: skip
            self._recall(b)
            apply(self._contacts, self._corner, self._number, points.inverse_mass, y)
            self.push_apart()
        self._b = b
        return self._contacts

    def push_apart(self) -> None:
        """What an iteration of the solver brought together is pushed apart, and is to stay so."""
        self._resolve(SWEEPS_INSIDE, inside=True)

    def end(self, dt: float) -> None:
        """Change what the solver made of the step so that nothing meets."""
        points = self._points
        copy(points.count, points.x, self._solved)
        if not self._foreseen:
            self._note_near()
            self._recall(dt)
            apply(self._contacts, self._corner, self._number, points.inverse_mass, points.x)
            self._b = dt
        if self._contacts:
            self._note_walls(dt)
            self._resolve(SWEEPS)
        self._untangle(dt)
        self._foreseen = False
        self.pushed = self._contacts
        settle_moved(
            points.count, dt, int(self._walls.any), int(self._implicit), points.inverse_mass, self._start,
            self._solved, points.x, points.v, self._touched, self._busy,
        )  # fmt: skip
        self._keep()

    def _recall(self, b: float) -> None:
        """Contacts begin with the forces of the step before, which are as the square of its length."""
        recall(
            self._contacts, (b / self._b) ** 2, self._corner, self._number, self._head, self._after,
            self._corner_before, self._force_before, self._gain,
        )  # fmt: skip

    def _keep(self) -> None:
        """Corners and forces of the contacts, for the next step."""
        self._reserve_before(self._contacts)
        self._before = self._contacts
        keep(self._before, self._corner, self._number, self._corner_before, self._force_before)
        remember(self._before, self._corner_before, self._head, self._after)

    def _reserve_before(self, contacts: int) -> None:
        if contacts > self._room_before:
            self._room_before = max(2 * contacts, FIRST_CONTACTS)
            self._corner_before: Any = ti.ndarray(ti.i32, (self._room_before, 4))
            self._force_before: Any = ti.ndarray(ti.f64, (self._room_before, 3))
            self._after: Any = ti.ndarray(ti.i32, self._room_before)

    def _note_near(self) -> None:
        """Contacts of what is near at the start of the step."""
        self._contacts = 0
        self._busy.fill(0)
        self._list()
        if self._flags():
            self._note(True)

    def _untangle(self, dt: float) -> None:
        """Contacts of all that would meet, until nothing does."""
        self.zones = 0
        for turn in range(MOST_ROUNDS):
            if not self._detect():
                return
            walls = self._contacts == 0
            self._note(False)
            if walls:
                self._note_walls(dt)
            self._resolve(SWEEPS * min(1 + turn, MOST_EXTRA))
        if self._detect():
            self._fail_safe()

    def _flagged(self) -> Ints:
        """The points (m, 4) of the pairs that `_detect` found."""
        pairs = self._pairs
        flag = pairs.flag.to_numpy().reshape(PIECES, pairs.room)
        used = np.arange(pairs.room) < pairs.count.to_numpy()[:PIECES, None]
        return np.asarray(pairs.pair.to_numpy()[(used & (flag < 1.0)).ravel(), 1:])

    def _list(self) -> None:
        """List the pairs for the step as it is now, and flag those that are near."""
        points = self._points
        copy(points.count, points.x, self._listed)
        self._pairs.find(self._start, points.x, SLACK * self._h)

    def _flags(self) -> int:
        """How many pairs are flagged."""
        return int(scan(self._contacts, self._pairs.met, self._offset)) - self._contacts

    def _detect(self) -> int:
        """Flag the pairs that come too near on the way; how many. Lists them anew where points left it."""
        p, points = self._pairs, self._points
        if farthest(points.count, points.x, self._listed) > SLACK * self._h:
            self._list()
        detect(
            p.tasks, p.stride, p.room, self._h, self._start, points.x, p.pair, p.count, p.gap, p.flag, p.met
        )
        return self._flags()

    def _note(self, near: bool) -> None:
        """Make contacts of what is flagged."""
        p = self._pairs
        total = int(scan(self._contacts, self._pairs.met, self._offset))
        self._reserve(total)
        note_contacts(
            near, p.tasks, p.stride, p.room, self._h, self._friction, p.group, p.rest, self._start,
            self._points.x, p.pair, p.count, p.gap, p.flag, self._offset, self._corner, self._number,
            self._busy,
        )  # fmt: skip
        self._contacts = total

    def _note_walls(self, dt: float) -> None:
        walls, points = self._walls, self._points
        if walls.any:
            self._reserve(self._contacts + min(points.count, 4 * self._contacts))
            self._contacts = note_walls(
                points.count, self._contacts, dt, walls.thickness, self._h, walls.bodies.table,
                walls.bodies.samples, walls.count, walls.bounds, walls.friction, self._solved, self._busy,
                self._wall, self._corner, self._number,
            )  # fmt: skip

    def _resolve(self, sweeps: int, inside: bool = False) -> None:
        points = self._points
        resolve(
            inside, sweeps, self._contacts, ENOUGH * self._h, self._corner, self._number, points.inverse_mass,
            points.x, self._y if inside else points.x,
        )  # fmt: skip

    def state(self) -> dict[str, NDArray[Any]]:
        """What pushed in the last step."""
        some = slice(0, self._before)
        return {
            "self_corner": self._corner_before.to_numpy()[some],
            "self_force": self._force_before.to_numpy()[some],
            "self_step": np.array([self._b]),
        }

    def restore(self, state: Mapping[str, NDArray[Any]]) -> None:
        """Take over what `state` gave."""
        self.forget()
        self._before = len(state["self_corner"])
        self._reserve_before(self._before)
        for name, array in (("self_corner", self._corner_before), ("self_force", self._force_before)):
            values = np.zeros(array.shape, np.int32 if name == "self_corner" else np.float64)
            values[: self._before] = state[name]
            array.from_numpy(values)
        self._b = float(state["self_step"][0])
        remember(self._before, self._corner_before, self._head, self._after)

    def forget(self) -> None:
        """Nothing pushed: places or velocities were set."""
        self._before, self._b = 0, 1.0
        self._reserve_before(1)
        self._head.fill(-1)


def joined(whole: Assembly) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
    """A number for points that are stitched together, and one for those that any springs connect, (n,)."""
    found = []
    for chosen in (whole.springs.rest_length == 0.0, np.ones(len(whole.springs.ends), np.bool_)):
        a, b = whole.springs.ends[chosen].T
        graph = scipy.sparse.coo_matrix((np.ones(len(a), np.int8), (a, b)), shape=(whole.count, whole.count))
        found.append(scipy.sparse.csgraph.connected_components(graph, directed=False)[1].astype(np.int32))
    return found[0], found[1]
