"""What contact of surfaces and of strands share: room for contacts, and the fail-safe.

A contact is a row of `corner`, four points, and one of `number` (`self_kernels.py`).
"""

import logging
from abc import ABC, abstractmethod
from collections.abc import Mapping
from typing import Any

import numpy as np

from tianim.lang import ti
from tianim.systems.springs.arrays import copy
from tianim.systems.springs.assembly import Assembly
from tianim.systems.springs.impact_zones import Floats, Ints, keep_apart
from tianim.systems.springs.points import Points
from tianim.systems.springs.self_kernels import NUMBERS

LOG = logging.getLogger("tianim")


class KeptApart(ABC):
    """Pieces that change where the solver put their points, so that nothing meets on the way.

    what      they are, for messages
    pushed    contacts in the last step
    zones     points of it that the fail-safe moved
    """

    what: str

    def __init__(self, whole: Assembly, points: Points, thickness: float, room: int) -> None:
        """`room` for so many contacts at first."""
        self._points, self._mass, self._h = points, whole.mass, thickness
        places = (points.capacity, 3)
        self._start, self._solved, self._listed = (ti.ndarray(ti.f64, places) for _ in range(3))
        self._busy: Any = ti.ndarray(ti.i32, points.capacity)
        self._contacts = 0
        self._make_room(room)
        self._warned = False
        self.pushed = self.zones = 0

    def begin(self) -> None:
        """Remember where the step begins."""
        copy(self._points.count, self._points.x, self._start)

    @abstractmethod
    def end(self, dt: float) -> None:
        """Change what the solver made of the step so that nothing meets."""

    @abstractmethod
    def _detect(self) -> int:
        """Flag the pairs that come too near on the way; how many."""

    @abstractmethod
    def _flagged(self) -> Ints:
        """The points (m, 4) of the pairs that `_detect` found."""

    def _fail_safe(self) -> None:
        points = self._points
        held = points.inverse_mass.to_numpy()[: points.count] == 0.0
        start, wanted = points.read(self._start), points.read(points.x)
        self.zones, apart = keep_apart(start, wanted, self._mass, held, self._meets)
        if not apart and not self._warned:
            LOG.warning("self-contact: pins or bodies force %s through each other", self.what)
            self._warned = True

    def _meets(self, x: Floats) -> Ints:
        """The points (m, 4) of the pairs that come too near on the way to `x`."""
        self._points.write(self._points.x, x)
        return self._flagged() if self._detect() else np.zeros((0, 4), np.int32)

    def _reserve(self, contacts: int) -> bool:
        """Room for so many contacts; those that there are stay. Whether there was too little."""
        if contacts <= self._corner.shape[0]:
            return False
        old = self._corner.to_numpy(), self._number.to_numpy()
        self._make_room(2 * contacts)
        for array, values in zip((self._corner, self._number), old, strict=True):
            grown = np.zeros(array.shape, values.dtype)
            grown[: len(values)] = values
            array.from_numpy(grown)
        return True

    def _make_room(self, contacts: int) -> None:
        self._corner: Any = ti.ndarray(ti.i32, (contacts, 4))
        self._number: Any = ti.ndarray(ti.f64, (contacts, NUMBERS))

    def diagnostics(self) -> Mapping[str, float]:
        """Contacts in the last step, those with bodies too, and points in the fail-safe."""
        return {"self_contacts": float(self.pushed), "self_failsafe": float(self.zones)}
