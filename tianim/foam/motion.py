"""The fluid between two recorded frames: each particle on the cubic curve through both."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tianim.errors import SceneError
from tianim.frame import Array, Frame, Points

Float = NDArray[np.float32]
Int = NDArray[np.int32]


@dataclass(frozen=True)
class Fluid:
    """The particles of a fluid at one time: position [m] and velocity [m/s] (n, 3), id (n,), rising."""

    position: Float
    velocity: Float
    id: Int


def fluid_of(frame: Frame, parts: Sequence[str]) -> Fluid:
    """The particles of all `parts` of a frame. SceneError where one has no velocity.

    Ids are the recorded ones; of several parts they are made distinct.
    """
    found = [part for part in frame.parts if part.name in parts and isinstance(part, Points)]
    position: list[Array] = [np.zeros((0, 3), np.float32)]
    velocity: list[Array] = [np.zeros((0, 3), np.float32)]
    ids: list[Array] = [np.zeros(0, np.int64)]
    for number, part in enumerate(found):
        if "velocity" not in part.data:
            raise SceneError(f"part {part.name!r} has no velocity in the frames, which foam needs")
        own = part.data.get("id", np.arange(len(part.position)))
        position.append(part.position)
        velocity.append(part.data["velocity"])
        ids.append(own.astype(np.int64) * len(found) + number)
    every = np.concatenate(ids)
    order = np.argsort(every, kind="stable")
    return Fluid(
        np.concatenate(position).astype(np.float32)[order],
        np.concatenate(velocity).astype(np.float32)[order],
        every.astype(np.int32)[order],
    )


class Motion:
    """From one frame to the next, `interval` [s] later.

    Particles of the second frame are there; one that the first has not comes in straight. `length` is
    that of a periodic box on each axis [m], 0 where there is none.
    """

    def __init__(self, before: Fluid, after: Fluid, interval: float, length: Float) -> None:
        self.id = after.id
        self._interval = interval
        self._x1, self._v1 = after.position, after.velocity
        self._x0 = after.position - np.float32(interval) * after.velocity
        self._v0 = after.velocity.copy()
        _, first, second = np.intersect1d(before.id, after.id, assume_unique=True, return_indices=True)
        # From the image of the first place that is nearest to the second.
        step = after.position[second] - before.position[first]
        periodic = length > 0.0
        step[:, periodic] -= length[periodic] * np.round(step[:, periodic] / length[periodic])
        self._x0[second] = after.position[second] - step
        self._v0[second] = before.velocity[first]

    @property
    def fastest(self) -> float:
        """Largest speed at either end [m/s]."""
        ends = (self._v0, self._v1)
        return max((float(np.linalg.norm(v, axis=1).max()) for v in ends if len(v)), default=0.0)

    def at(self, share: float) -> Fluid:
        """The fluid when `share` (0 to 1) of the interval is over."""
        s, t = np.float32(share), np.float32(self._interval)
        x = self._x0 + (s * s * (3 - 2 * s)) * (self._x1 - self._x0)
        x += (t * s * (1 - s) ** 2) * self._v0 - (t * s * s * (1 - s)) * self._v1
        return Fluid(x.astype(np.float32), (self._v0 + s * (self._v1 - self._v0)).astype(np.float32), self.id)
