"""Emitters: fluid that comes in, layer after layer of the lattice.

A layer is a spacing thick and comes in when all of it has left the mouth, whatever the steps are: what
is due between two steps comes in at the next one, moved on by what it would have gone. So a running jet
comes out as a lattice, with the density of rest, and not in lumps of a step. A mouth that moves gives
each layer where it is at that moment, and adds its own velocity.

    way(t) = integral of the speed,    layer k is due when way = (k + 1) d, its particles d/2 before the mouth

Where there is no room for a layer it is refused: a warning once, and counted.
"""

import logging
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tianim.errors import SceneError
from tianim.math.random import words_numpy
from tianim.math.rotations import rotate
from tianim.params import Keyframes
from tianim.spatial.bodies import Bodies
from tianim.spatial.columns import Columns
from tianim.system import Bounds
from tianim.systems.fluid.clearance import as_text, nearest_body, room_in_bounds
from tianim.systems.fluid.mouths import Pose, Z, axes_of, layer_of, placed, pose_at
from tianim.systems.fluid.params import FluidParams

Floats = NDArray[np.float64]
State = Mapping[str, NDArray[Any]]

# Without a handler of the caller's, Python prints these as single lines on standard error.
LOG = logging.getLogger("tianim")
# Stream of random numbers that jitter takes.
JITTER = 7001
# The way is added up in steps: a layer that is due but for rounding is not left to the next step [d].
DUE = 1e-9
# Time over which the velocity of a mouth is measured [s].
PROBE = 1e-5


class Emitters:
    """All emitters of a fluid. `emit` is called at the start of each step.

    way      of each mouth's flow so far [m]
    speed    at which it flowed in the last step [m/s]
    layers   released or refused so far
    given    particles given so far
    refused  particles refused for lack of room, of all mouths
    """

    def __init__(self, name: str, params: FluidParams, bounds: Bounds, bodies: Bodies, seed: int) -> None:
        """SceneError where a mouth is in a wall when it begins to work."""
        self.name, self.seed = name, seed
        self.spacing, self.dimension, self._bounds = params.spacing, params.dimension, bounds
        self.emitters = tuple(params.emitters.values())
        self._phases = [params.phase_number(emitter.phase) for emitter in self.emitters]
        self._carriers = [bodies.params[one.on] if one.on is not None else None for one in self.emitters]
        self._axes = [axes_of(emitter, self.dimension) for emitter in self.emitters]
        self._mouths = [
            layer_of(emitter, self.spacing, self.dimension, axes)
            for emitter, axes in zip(self.emitters, self._axes, strict=True)
        ]
        self.way = np.zeros(len(self.emitters))
        self.speed = np.zeros(len(self.emitters))
        self.layers = np.zeros(len(self.emitters), np.int64)
        self.given = np.zeros(len(self.emitters), np.int64)
        self.refused = 0
        for k, key in enumerate(params.emitters):
            self._check_mouth(k, key, bounds, bodies)

    def emit(self, columns: Columns, time: float, dt: float) -> int:
        """Append what is due at `time` [s], and let the flow of the step from there go; how many came."""
        before = columns.count
        for k in range(len(self.emitters)):
            speed, open_for = self._speed(k, time), self._open(k, time, dt)
            self._release(k, columns, time)
            if open_for > 0.0:
                self.speed[k] = speed
                self.way[k] += speed * open_for
        return columns.count - before

    def diagnostics(self) -> dict[str, float]:
        """Particles given and refused so far."""
        if not self.emitters:
            return {}
        return {"emitted": float(self.given.sum()), "emitter_refused": float(self.refused)}

    def state(self) -> dict[str, NDArray[Any]]:
        """What a checkpoint holds."""
        return {
            "emitter_way": self.way.copy(),
            "emitter_speed": self.speed.copy(),
            "emitter_layers": self.layers.copy(),
            "emitter_given": self.given.copy(),
            "emitter_refused": np.array([self.refused]),
        }

    def restore(self, state: State) -> None:
        """Take over what `state` gave."""
        self.way[:] = state["emitter_way"]
        self.speed[:] = state["emitter_speed"]
        self.layers[:] = state["emitter_layers"]
        self.given[:] = state["emitter_given"]
        self.refused = int(state["emitter_refused"][0])

    def _speed(self, k: int, time: float) -> float:
        """Speed in the mouth [m/s]; a rate is shared out over the particles of a layer."""
        emitter = self.emitters[k]
        flow = emitter.at(time).flow()
        if emitter.rate is None:
            return flow
        return flow / (len(self._mouths[k]) * self.spacing ** (self.dimension - 1))

    def _open(self, k: int, time: float, dt: float) -> float:
        """Part of the step for which the emitter works [s]."""
        emitter = self.emitters[k]
        end = time + dt if emitter.end is None else min(emitter.end, time + dt)
        return max(end - max(emitter.start, time), 0.0)

    def _release(self, k: int, columns: Columns, time: float) -> None:
        """The layers of one mouth that are due."""
        emitter, d = self.emitters[k], self.spacing
        while self.way[k] - (self.layers[k] + 1) * d >= -DUE * d:
            self.layers[k] += 1
            ahead = max(self.way[k] - self.layers[k] * d, 0.0)
            wanted = len(self._mouths[k])
            if emitter.most is not None:
                wanted = min(wanted, emitter.most - int(self.given[k]))
            if wanted <= 0:
                return
            if wanted > columns.room - columns.count:
                self._refuse(wanted, columns.room)
                continue
            self._append(k, columns, time, ahead, wanted)
            self.given[k] += wanted

    def _append(self, k: int, columns: Columns, time: float, ahead: float, count: int) -> None:
        """A layer that was due in the last step and has gone `ahead` [m] since."""
        emitter, speed = self.emitters[k], self.speed[k]
        ago = ahead / speed
        left = time - ago
        pose = self._pose(k, left)
        points = self._mouths[k][:count] + 0.5 * self.spacing * Z
        points += self._jitter(emitter.jitter, columns.issued, count)
        velocity = speed * rotate(pose.rotation, Z) + self._drift(k, left, pose, points)
        position = self._brought_back(placed(pose, points) + ago * velocity)
        position[:, self.dimension :] = velocity[:, self.dimension :] = 0.0
        phase = np.full(count, self._phases[k], np.int32)
        columns.append(count, {"position": position, "velocity": velocity, "phase": phase})

    def _brought_back(self, x: Floats) -> Floats:
        """Places (n, 3) [m], in a periodic box the images in it: of others no neighbours are found."""
        bounds = self._bounds
        if bounds.kind != "periodic" or bounds.lower is None or bounds.upper is None:
            return x
        lower = np.array(bounds.lower)
        return np.asarray(lower + np.mod(x - lower, np.subtract(bounds.upper, lower)))

    def _pose(self, k: int, time: float) -> Pose:
        return pose_at(self.emitters[k], self._carriers[k], self._axes[k], time)

    def _drift(self, k: int, time: float, pose: Pose, points: Floats) -> Floats:
        """Velocity of the mouth itself at its points [m/s]."""
        if self._stands(k):
            return np.zeros((len(points), 3))
        return (placed(self._pose(k, time + PROBE), points) - placed(pose, points)) / PROBE

    def _stands(self, k: int) -> bool:
        """Whether the mouth never moves."""
        first, carrier = self.emitters[k], self._carriers[k]
        moved = carrier is not None and carrier.at(0.0) is not carrier
        return not moved and not any(isinstance(one, Keyframes) for one in (first.position, first.rotation))

    def _jitter(self, share: float, first: int, count: int) -> Floats:
        """Displacements of particles in the mouth's axes [m], from their ids."""
        if share == 0.0:
            return np.zeros((count, 3))
        words = words_numpy(self.seed, np.arange(first, first + count), 0, JITTER)[:, :3]
        shift = share * self.spacing * (2.0 * words.astype(np.float64) / 2.0**32 - 1.0)
        if self.dimension == 2:
            shift[:, 0] = 0.0
        return shift

    def _refuse(self, count: int, room: int) -> None:
        if self.refused == 0:
            LOG.warning(
                "%s: emitters are held up: there is room for %d particles (capacity); emitter_refused counts "
                "what did not come", self.name, room,
            )  # fmt: skip
        self.refused += count

    def _check_mouth(self, k: int, key: str, bounds: Bounds, bodies: Bodies) -> None:
        """SceneError where a mouth reaches into a wall or a body when it begins to work."""
        start = self.emitters[k].start
        points = placed(self._pose(k, start), self._mouths[k])
        outside = room_in_bounds(points, bounds, self.dimension) < 0.0
        bodies.move(start, 0.0)
        inside = bodies.distance(points)[0] < 0.0
        if self.emitters[k].on is not None:
            inside[:] = False  # it may well sit in its own body
        for bad, what in ((outside, "reaches out of the bounds"), (inside, "reaches into")):
            if bad.any():
                first = points[np.argmax(bad)]
                body = f" bodies.{nearest_body(bodies, first)}" if bad is inside else ""
                when = f" at its start, {start:g} s" if start > 0.0 else ""
                raise SceneError(f"emitters.{key}: its mouth {what}{body}, at {as_text(first)}{when}")
        bodies.move(0.0, 0.0)
