"""What the flocks share: agents with a place and a velocity, read and set in id order, measured, checked."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tianim.buffers import new_array
from tianim.errors import BlowupError, SceneError
from tianim.frame import Points
from tianim.lang import ti, workers
from tianim.spatial.columns import Columns
from tianim.system import World
from tianim.systems.boids.motion import PIECES, SUMS, first_fault, orientation, sums

# Farther than this from the origin [m] a float32 position is coarser than a metre.
ESCAPE = 1e7
ESCAPE_BITS = int(np.float32(ESCAPE).view(np.int32))
SETTABLE = ("position", "velocity", "lean")


class Swarm:
    """Columns position (n, 3) [m], velocity (n, 3) [m/s], lean (n,) (tangent of the bank), and more.

    `parts` gives the first id and the count of each part that a snapshot shows.
    """

    def __init__(self, name: str, count: int, dimension: int, world: World, more: Mapping[str, int]) -> None:
        self.name, self.count, self.dimension, self.world = name, count, dimension, world
        self.columns = Columns(count, {"position": 3, "velocity": 3, "lean": 1, **more})
        self.parts: dict[str, tuple[int, int]] = {name: (0, count)}
        self._ids = new_array((count,), np.int32)
        self._ids[:] = np.arange(count)
        self._fault = ti.ndarray(ti.i32, 2)
        self._sums = np.zeros((PIECES, SUMS))
        self._measured = False  # whether the sums are of now: a step says no

    def inside(self, position: NDArray[np.float32]) -> NDArray[np.float32]:
        """Positions brought into the bounds: wrapped where periodic, clamped where contained."""
        bounds, axes = self.world.bounds, slice(self.dimension)
        if bounds.lower is None or bounds.upper is None:
            return position
        lower, upper = np.array([bounds.lower, bounds.upper], np.float32)[:, axes]
        inside = position.copy()
        if bounds.kind == "periodic":
            given = position[:, axes]
            wrapped = lower + np.mod(given - lower, upper - lower)
            wrapped = np.where(wrapped < upper, wrapped, lower)
            # What is inside stays to the bit, so that setting what was read changes nothing.
            inside[:, axes] = np.where((given >= lower) & (given < upper), given, wrapped)
        else:
            inside[:, axes] = np.clip(position[:, axes], lower, upper)
        return inside

    def snapshot(self) -> tuple[Points, ...]:
        """Each part with velocity, orientation (quaternion, +Z ahead, +Y up) and id, as the world wants."""
        position = self.columns.read("position")
        data: dict[str, NDArray[Any]] = {}
        if self.world.wants("velocity"):
            data["velocity"] = self.columns.read("velocity")
        if self.world.wants("orientation"):
            data["orientation"] = self._orientation()
        if self.world.wants("id"):
            data["id"] = self._ids
        parts = []
        for name, (first, count) in self.parts.items():
            own = slice(first, first + count)
            units = {"velocity": "m/s"} if "velocity" in data else {}
            parts.append(
                Points(name, position[own], {key: values[own] for key, values in data.items()}, units)
            )
        return tuple(parts)

    def _orientation(self) -> NDArray[np.float32]:
        turn = new_array((self.count, 4), np.float32)
        if self.count:
            orientation(self.count, self.columns["id"], self.columns["velocity"], self.columns["lean"], turn)
        return turn

    def diagnostics(self) -> dict[str, float]:
        """Polarisation |mean v/|v||, mean and largest speed [m/s], centre [m], of all species."""
        names = ("polarisation", "mean_speed", "max_speed", "centre_x", "centre_y", "centre_z")
        if self.count == 0:
            return dict.fromkeys(names, 0.0)
        self._measure()
        total = self._sums.sum(axis=0) / self.count
        polarisation = float(np.linalg.norm(total[:3]))
        fastest = float(self._sums[:, 4].max())
        return dict(
            zip(names, (polarisation, float(total[3]), fastest, *map(float, total[5:8])), strict=True)
        )

    def _measure(self) -> None:
        if not self._measured:
            sums(self.count, workers()[1], self.columns["position"], self.columns["velocity"], self._sums)
            self._measured = True

    def check(self) -> None:
        """BlowupError for the lowest id that is not finite or farther than ESCAPE."""
        if self.count == 0:
            return
        self._measure()
        if self._sums[:, 8].max() <= ESCAPE_BITS:
            return
        columns = self.columns
        first_fault(self.count, ESCAPE, columns["id"], columns["position"], columns["velocity"], self._fault)
        not_finite, escaped = (int(value) for value in self._fault.to_numpy())
        if not_finite < self.count:
            raise BlowupError(self.name, not_finite, "position or velocity is not finite")
        if escaped < self.count:
            raise BlowupError(
                self.name,
                escaped,
                f"farther than {ESCAPE:g} m from the origin, or faster than {ESCAPE:g} m/s",
            )

    def state(self) -> dict[str, NDArray[Any]]:
        """The columns in storage order."""
        return self.columns.state()

    def restore(self, state: Mapping[str, NDArray[Any]]) -> None:
        """Take over what `state` gave."""
        self._measured = False
        self.columns.restore(state)

    def arrays(self) -> tuple[str, ...]:
        """position, velocity, lean; id and what else there is can only be read."""
        return tuple(self.columns.widths)

    def read(self, name: str) -> NDArray[Any]:
        """An array in id order."""
        return self.columns.read(self._known(name))

    def write(self, name: str, values: NDArray[Any]) -> None:
        """Set position, velocity or lean, in id order; SceneError for what cannot be set.

        Positions are brought into the bounds; in two dimensions z becomes zero.
        """
        if self._known(name) not in SETTABLE:
            raise SceneError(f"{self.name}.{name}: cannot be set; {', '.join(SETTABLE)} can")
        values = np.asarray(values, np.float32)
        wanted = self.columns.shape(name)
        if values.shape != wanted:
            raise SceneError(f"{self.name}.{name}: has shape {values.shape}, must be {wanted}")
        if self.dimension == 2 and values.ndim == 2:
            values = values * np.array([1, 1, 0], np.float32)
        self._measured = False
        self.columns.write(name, self.inside(values) if name == "position" else values)

    def _known(self, name: str) -> str:
        if name not in self.arrays():
            raise SceneError(f"{self.name}: no array {name!r}; there are {', '.join(self.arrays())}")
        return name
