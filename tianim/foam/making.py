"""Foam, spray and bubbles as a pass over recorded frames.

Source: Ihmsen, Akinci, Akinci, Teschner, "Unified spray, foam and bubbles for particle-based fluids",
The Visual Computer 28 (2012). A particle of fluid makes foam by

    rate = I_speed (k_air I_air + k_crest I_crest)                [1/s]

    I_air    neighbours that close in on it:  sum |v_ij| (1 - cos(v_ij, x_ij)) W / S            [m/s]
    I_crest  a convex surface that moves outwards:  sum (1 - n_i . n_j) W / S over x_ji . n_i < 0
    I_speed  its kinetic energy, by thresholds of speed

each a ramp from 0 to 1 between two thresholds. New foam lies in the cylinder that its parent swept.
What has little fluid around it is spray and flies freely; with more it is foam, which goes with the
fluid and lasts for its lifetime; deep in the fluid it is a bubble, which rises.

Unlike there: sums are taken as shares of a full neighbourhood S, so that the thresholds are speeds and
do not depend on the spacing; bubbles have a speed of rising and a rate of drag in place of k_b and k_d;
walls and bodies keep foam out, and spray that lies on one dries like foam.

Between two frames the fluid follows cubic curves, in so many steps that nothing crosses a
neighbourhood in one. All random numbers are hashes of seed, parent and step: the same frames give the
same bytes.
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tianim.errors import SceneError
from tianim.foam import kernels
from tianim.foam.motion import Fluid, Motion, fluid_of
from tianim.foam.options import FoamOptions
from tianim.frame import Frame, Points
from tianim.lang import ti
from tianim.math.random import words_numpy
from tianim.params import Params, Vector3
from tianim.spatial.bodies import Bodies
from tianim.spatial.body_params import BodyParams
from tianim.spatial.columns import Columns
from tianim.spatial.grid import NeighborGrid
from tianim.spatial.sections import cut
from tianim.system import Bounds

Float = NDArray[np.float32]
Int = NDArray[np.int32]
Made = tuple[Points, dict[str, float]]

KINDS = {"spray": kernels.SPRAY, "foam": kernels.FOAM, "bubbles": kernels.BUBBLE}
UNITS = {"velocity": "m/s", "age": "s", "life": "s"}
# Room beyond the particles that there are, for a fluid that grows.
HEADROOM = 1.5
WIDTHS = {"position": 3, "velocity": 3}
# Sum of W = 1 - r/h over a ball of radius h, in shares of its content.
MEAN_KERNEL = {2: 1 / 3, 3: 1 / 4}
BALL = {2: math.pi, 3: 4 * math.pi / 3}
BOUNDED = {"open": 0, "contained": 1, "periodic": 2}


@dataclass(frozen=True)
class Surroundings:
    """What a fluid was in: its parts in the frames, how it was simulated, and what surrounds it.

    parts    of the frames that are the fluid
    gravity  [m/s2]: a `gravity` of parameters that may be keyframed, evaluated at each frame
    """

    parts: tuple[str, ...]
    dimension: int = 3
    seed: int = 1
    bounds: Bounds = field(default_factory=Bounds)
    bodies: Mapping[str, BodyParams] = field(default_factory=dict)
    gravity: Vector3 | Params = (0.0, -9.81, 0.0)

    def gravity_at(self, time: float) -> Vector3:
        """Gravity at `time` [m/s2]."""
        if not isinstance(self.gravity, Params):
            return self.gravity
        gravity: Vector3 = self.gravity.at(time).gravity  # type: ignore[attr-defined]
        return gravity


def make_foam(
    frames: Sequence[Frame], surroundings: Surroundings, options: FoamOptions, name: str
) -> Iterator[Made]:
    """The foam of each frame, as a part called `name`, with its numbers; none at the start.

    Each frame is read once, when its turn comes. The runtime must have been started. Raises
    SceneError where the fluid's parts have no spacing or no velocity.
    """
    first = frames[0]
    foam = Foam(surroundings, options, _spacing(first, surroundings.parts))
    before, last = fluid_of(first, surroundings.parts), first.time
    yield foam.points(name), foam.counts()
    for position in range(1, len(frames)):
        frame = frames[position]
        after = fluid_of(frame, surroundings.parts)
        foam.advance(before, after, last, frame.time)
        before, last = after, frame.time
        yield foam.points(name), foam.counts()


def _spacing(frame: Frame, parts: Sequence[str]) -> float:
    found = [part for part in frame.parts if part.name in parts and isinstance(part, Points)]
    for part in found:
        if not part.spacing:
            raise SceneError(f"part {part.name!r} does not tell the spacing of its particles")
    if not found:
        raise SceneError(f"no part of particles is called {' or '.join(map(repr, parts))}")
    return found[0].spacing


@dataclass
class _Cloud:
    """The particles of foam: place, motion, age and what is left of their life [s], in id order."""

    position: Float = field(default_factory=lambda: np.zeros((0, 3), np.float32))
    velocity: Float = field(default_factory=lambda: np.zeros((0, 3), np.float32))
    age: Float = field(default_factory=lambda: np.zeros(0, np.float32))
    life: Float = field(default_factory=lambda: np.zeros(0, np.float32))
    kind: Int = field(default_factory=lambda: np.zeros(0, np.int32))
    id: Int = field(default_factory=lambda: np.zeros(0, np.int32))

    def keep(self, which: NDArray[np.bool_]) -> None:
        """Drop the others."""
        for name, values in vars(self).items():
            setattr(self, name, np.ascontiguousarray(values[which]))

    def append(self, other: "_Cloud") -> None:
        """Put those of `other` behind."""
        for name, values in vars(other).items():
            setattr(self, name, np.concatenate([getattr(self, name), values]))


class Foam:
    """Foam as it goes from frame to frame."""

    def __init__(self, surroundings: Surroundings, options: FoamOptions, spacing: float) -> None:
        self.surroundings, self.options, self.spacing = surroundings, options, spacing
        self.support = options.support * spacing
        self.bodies = Bodies(surroundings.bodies)
        self.cloud = _Cloud()
        self.made = self.refused = 0
        self._steps = 0
        self._room = -1
        bounds = surroundings.bounds
        corners = np.zeros((2, 3), np.float32)
        if bounds.lower is not None and bounds.upper is not None:
            corners[:] = bounds.lower, bounds.upper
        self._corners = corners
        self._length = corners[1] - corners[0] if bounds.kind == "periodic" else np.zeros(3, np.float32)
        self._length[surroundings.dimension :] = 0.0

    def advance(self, before: Fluid, after: Fluid, start: float, end: float) -> None:
        """Go on from the fluid at `start` [s] to that at `end`."""
        motion = Motion(before, after, end - start, self._length)
        table = self._table(self.surroundings.gravity_at(start))
        wanted = math.ceil(motion.fastest * (end - start) / self.support)
        steps = min(max(wanted, 1), self.options.most_substeps)
        dt = (end - start) / steps
        for step in range(steps):
            self._steps += 1
            self.bodies.move(start + step * dt, dt)
            self._sort(motion.at((step + 0.5) / steps))
            self._move(table, dt)
            self._generate(table, dt)

    def points(self, name: str) -> Points:
        """The foam of now as a part."""
        cloud = self.cloud
        data = {
            "id": cloud.id.copy(),
            "kind": cloud.kind.copy(),
            "age": cloud.age.copy(),
            "life": cloud.life.copy(),
            "velocity": cloud.velocity.copy(),
        }
        return Points(name, cloud.position.copy(), data, UNITS)

    def counts(self) -> dict[str, float]:
        """How much of each kind there is, how much came about so far, how much `most` kept from it."""
        found = {name: int(np.count_nonzero(self.cloud.kind == kind)) for name, kind in KINDS.items()}
        return {**found, "made": self.made, "refused": self.refused}

    def _table(self, gravity: Vector3) -> Float:
        """The options as kernels read them."""
        o = self.options
        dimension = self.surroundings.dimension
        full = BALL[dimension] * o.support**dimension * MEAN_KERNEL[dimension]
        return np.array(
            [
                self.support, full, *o.trapped_air, *o.wave_crest, *o.speed, o.trapped_air_rate,
                o.wave_crest_rate, o.spray_below, o.bubble_above, o.rise, o.drag, self.spacing, *gravity,
            ],
            np.float32,
        )  # fmt: skip

    def _sort(self, fluid: Fluid) -> None:
        """Put the fluid into cells."""
        count = len(fluid.id)
        if count > self._room:
            self._room = max(int(count * HEADROOM), 1)
            self._columns = Columns(0, WIDTHS, self._room)
            self._grid = NeighborGrid(
                self._room, self.surroundings.dimension, self.surroundings.bounds, self.support
            )
            capacity = self._columns.capacity
            self._normal: Any = ti.ndarray(ti.f32, (3, capacity))
            self._rate: Any = ti.ndarray(ti.f32, (2, capacity))
        issued = np.array([int(fluid.id.max(initial=-1)) + 1])
        position = fluid.position.copy()
        periodic = self._length > 0.0
        # Between frames a particle may be out of the box, where a cell would be that of its border.
        turns = np.floor((position - self._corners[0])[:, periodic] / self._length[periodic])
        position[:, periodic] -= turns * self._length[periodic]
        columns = {"id": fluid.id[None], "position": position.T, "velocity": fluid.velocity.T}
        self._columns.restore({**columns, "issued": issued})
        self._grid.sort(self._columns)

    def _walk(self) -> tuple[Any, ...]:
        grid = self._grid
        return grid.shape, grid.geometry, self._length, grid.start, self._columns["position"]

    def _walls(self) -> tuple[Any, ...]:
        bodies = self.bodies
        table = bodies.table
        if self.surroundings.dimension == 2:
            table = table.to_numpy()
            for row in table:
                cut(row)
        return BOUNDED[self.surroundings.bounds.kind], self._corners, bodies.count, table, bodies.samples

    def _move(self, table: Float, dt: float) -> None:
        """Move the foam, let it age, and drop what is over."""
        cloud = self.cloud
        if not len(cloud.id):
            return
        kernels.move_foam(
            self.surroundings.dimension, dt, table, *self._walk(), self._columns["velocity"], *self._walls(),
            cloud.position, cloud.velocity, cloud.age, cloud.life, cloud.kind,
        )  # fmt: skip
        flown = (cloud.kind == kernels.SPRAY) & (cloud.age > self.options.oldest_spray)
        cloud.keep((cloud.life > 0.0) & ~flown & np.isfinite(cloud.position).all(axis=1))

    def _generate(self, table: Float, dt: float) -> None:
        """Let the fluid make foam, as it is in the middle of the step."""
        dimension, options = self.surroundings.dimension, self.options
        columns, count = self._columns, self._columns.count
        kernels.find_normals(dimension, count, table, *self._walk(), self._normal)
        kernels.find_rates(
            dimension, count, table, *self._walk(), columns["velocity"], self._normal, self._rate
        )
        rate, drive = self._rate.to_numpy()[:, :count]
        sources = np.flatnonzero(rate > 0.0)
        if not len(sources):
            return
        ids = columns["id"].to_numpy()[0, sources]
        # In the order of ids, which the order of cells is not.
        order = np.argsort(ids)
        sources, ids = sources[order], ids[order]
        chance = words_numpy(self.surroundings.seed, ids, self._steps, 0)[:, 0] / 2.0**32
        number = np.floor(rate[sources].astype(np.float64) * dt + chance).astype(np.int64)
        room = options.most - len(self.cloud.id)
        upto = np.minimum(np.cumsum(number), room)
        self.refused += int(number.sum() - upto[-1])
        number = np.diff(upto, prepend=0)
        state = np.concatenate([columns["position"].to_numpy(), columns["velocity"].to_numpy()])[:, sources]
        self._scatter(state.T, ids, drive[sources], number, dt)

    def _scatter(self, parents: Float, ids: Int, drive: Float, number: NDArray[np.int64], dt: float) -> None:
        """New foam: `number` of it around each of `parents` (n, 6), which had to by `drive` (0 to 1)."""
        count = int(number.sum())
        if not count:
            return
        which = np.repeat(np.arange(len(ids)), number)
        turn = np.arange(count) - np.repeat(np.cumsum(number) - number, number)
        new = _Cloud(
            np.empty((count, 3), np.float32),
            np.empty((count, 3), np.float32),
            np.zeros(count, np.float32),
            np.interp(drive[which], (0.0, 1.0), self.options.lifetime).astype(np.float32),
            np.full(count, kernels.FOAM, np.int32),
            np.arange(self.made, self.made + count, dtype=np.int32),
        )
        kernels.scatter_foam(
            self.surroundings.dimension, self.surroundings.seed, self._steps, dt, 0.5 * self.spacing,
            self.options.spread, self._length, *self._walls(), np.ascontiguousarray(parents[which]),
            ids[which], turn.astype(np.int32), new.position, new.velocity,
        )  # fmt: skip
        self.made += count
        self.cloud.append(new)
