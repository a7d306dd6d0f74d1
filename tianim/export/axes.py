"""Axes and units of the files: up axis and scale, applied on the way out and undone on the way in.

Inside, Y is up and lengths are in metres. With `up="z"` everything that points somewhere is
turned by 90 degrees about x: (x, y, z) becomes (x, -z, y), which is exact and so is its way
back. `scale` multiplies positions and data whose unit is a length, a speed or an acceleration
(other units stay SI); the way back is exact where the scale is a power of two and otherwise
rounds the last bit.
"""

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from tianim.frame import Array, Part, Points

UpAxis = Literal["y", "z"]
# Units that carry one power of a length.
LENGTH_UNITS = {"m", "m/s", "m/s^2", "m/s²"}
# The unit of an array that names none.
USUAL_UNITS = {"position": "m", "velocity": "m/s", "acceleration": "m/s^2", "radius": "m"}
# Arrays of three floats that do not point anywhere.
NOT_VECTORS = {"color", "colour", "rgb"}


@dataclass(frozen=True)
class Axes:
    """Which axis is up, and how many file units a metre has."""

    up: UpAxis = "y"
    scale: float = 1.0

    def apply(self, part: Part) -> Part:
        """A part in internal axes, as the file has it."""
        return part if self == INTERNAL else self._convert(part, undo=False)

    def undo(self, part: Part) -> Part:
        """A part read from the file, in internal axes."""
        return part if self == INTERNAL else self._convert(part, undo=True)

    def _convert(self, part: Part, undo: bool) -> Part:
        def convert(name: str, values: Array) -> Array:
            if self.up == "z" and (is_vector(name, values) or is_quaternion(name, values)):
                values = _turned(values, -1.0 if undo else 1.0)
            unit = part.units.get(name, USUAL_UNITS.get(name, ""))
            if self.scale != 1.0 and unit in LENGTH_UNITS and values.dtype.kind == "f":
                scale = values.dtype.type(self.scale)
                values = np.divide(values, scale) if undo else np.multiply(values, scale)
            return values

        changes: dict[str, object] = {
            "position": convert("position", part.position),
            "data": {name: convert(name, values) for name, values in part.data.items()},
        }
        if isinstance(part, Points):
            changes["spacing"] = part.spacing / self.scale if undo else part.spacing * self.scale
        else:
            changes["cell_data"] = {name: convert(name, values) for name, values in part.cell_data.items()}
        return replace(part, **changes)  # type: ignore[arg-type]


INTERNAL = Axes()


def is_quaternion(name: str, values: Array) -> bool:
    """Whether the array holds rotations (x, y, z, w)."""
    return name.endswith("orientation") and values.dtype.kind == "f" and values.shape[1:] == (4,)


def is_vector(name: str, values: Array) -> bool:
    """Whether the array holds directions or positions in space."""
    return name not in NOT_VECTORS and values.dtype.kind == "f" and values.shape[1:] == (3,)


def _turned(values: Array, angle: float) -> Array:
    """`values` (n, 3) or (n, 4) turned about x by `angle` = 1 or -1 right angles.

    An orientation turns with the model that it places (its vector part turns, w stays), as
    programs that read Y-up models into a Z-up world turn the models too.
    """
    turned = values.copy()
    np.multiply(values[:, 2], -angle, out=turned[:, 1])
    np.multiply(values[:, 1], angle, out=turned[:, 2])
    return turned
