"""Pins: points that stay, follow a path, or go with a body, from a time on and until another.

A pin takes its points where they are when it starts to hold; on a body, they keep their place in its frame.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tianim.errors import SceneError
from tianim.math.rotations import from_euler, rotate, rotate_back
from tianim.spatial.bodies import Bodies
from tianim.systems.springs.assembly import Assembly
from tianim.systems.springs.params import SpringsParams
from tianim.systems.springs.points import Held, Points

Floats = NDArray[np.float64]


class Pins:
    """All pins of a system.

    held  (n,) which points are held now
    """

    def __init__(self, params: SpringsParams, whole: Assembly, bodies: Bodies) -> None:
        """Pins that hold from the start take their points; SceneError where two hold one point."""
        self._params, self._bodies = params.pins, bodies
        self._which = {name: whole.chosen(f"pins.{name}", pin) for name, pin in params.pins.items()}
        self._holds = dict.fromkeys(params.pins, False)
        self._anchor = {name: np.zeros((len(which), 3)) for name, which in self._which.items()}
        self.held = np.zeros(whole.count, np.bool_)
        self._active = Held()
        self._refuse_twice()

    def _refuse_twice(self) -> None:
        names = list(self._params)
        for k, name in enumerate(names):
            for other in names[:k]:
                both = np.intersect1d(self._which[name], self._which[other])
                a, b = self._params[name], self._params[other]
                apart = (a.end is not None and a.end <= b.start) or (b.end is not None and b.end <= a.start)
                if len(both) and not apart:
                    raise SceneError(
                        f"pins.{name}: holds point {both[0]}, and so does pins.{other} at the same time "
                        f"({len(both)} points in both): leave one out"
                    )

    def held_from_the_start(self) -> NDArray[np.bool_]:
        """Which points are held at time 0, (n,)."""
        found = np.zeros_like(self.held)
        for name, pin in self._params.items():
            found[self._which[name]] |= pin.holds(0.0)
        return found

    def update(self, time: float, dt: float, points: Points) -> bool:
        """Lead what is held to where it is to be at `time + dt`; whether other points are held now."""
        now = {name: pin.holds(time) for name, pin in self._params.items()}
        changed = now != self._holds
        if changed:
            x = points.read(points.x)
            for name, holds in now.items():
                if holds and not self._holds[name]:
                    self._take(name, time, x[self._which[name]])
            self._holds = now
            self._choose(points)
        if self._active.count:
            self._active.lead(points, self._target(time + dt), dt)
        return changed

    def settle(self, points: Points) -> None:
        """What is held, exactly in its place."""
        self._active.settle(points)

    def _choose(self, points: Points) -> None:
        self.held[:] = False
        for name, holds in self._holds.items():
            if holds:
                self.held[self._which[name]] = True
        which = [self._which[name] for name, holds in self._holds.items() if holds]
        self._active.choose(np.concatenate(which).astype(np.int32) if which else np.zeros(0, np.int32))
        points.hold(self.held)

    def _take(self, name: str, time: float, x: Floats) -> None:
        """Remember where the points of a pin are, in the frame of its body."""
        pin = self._params[name].at(time)
        x = x - np.array(pin.offset)
        if pin.body is not None:
            body = self._bodies.params[pin.body].at(time)
            x = rotate_back(from_euler(body.rotation), x - np.array(body.position))
        self._anchor[name] = x

    def _target(self, time: float) -> Floats:
        found = []
        for name, holds in self._holds.items():
            if holds:
                pin, x = self._params[name].at(time), self._anchor[name]
                if pin.body is not None:
                    body = self._bodies.params[pin.body].at(time)
                    x = rotate(from_euler(body.rotation), x) + np.array(body.position)
                found.append(x + np.array(pin.offset))
        return np.concatenate(found)

    def state(self) -> dict[str, NDArray[Any]]:
        """Which pins hold, and where they took their points."""
        held = {f"pin_{name}": anchor for name, anchor in self._anchor.items()}
        return {"pins": np.array(list(self._holds.values()), np.bool_), **held}

    def restore(self, state: Mapping[str, NDArray[Any]], points: Points) -> None:
        """Take over what `state` gave."""
        self._holds = dict(zip(self._params, np.asarray(state["pins"]).tolist(), strict=True))
        for name in self._anchor:
            self._anchor[name] = np.asarray(state[f"pin_{name}"], np.float64)
        self._choose(points)
