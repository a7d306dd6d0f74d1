"""Frame and its parts: frozen NumPy values, the only thing that crosses from simulation to output.

Arrays are in id order. `units` names the unit of each data array ("m/s"); an array without
one has no unit. Positions are in metres, Y is up, unless a system says otherwise.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.generic]
Float = NDArray[np.float32]
Int = NDArray[np.int32]


@dataclass(frozen=True)
class Points:
    """A point cloud.

    position  [m], shape (n, 3)
    data      per point, shape (n,) or (n, k); "id" int32 is stable over a run
    spacing   of particles that fill a volume: [m] from one to the next at rest; 0 where they do not
    """

    name: str
    position: Float
    data: Mapping[str, Array] = field(default_factory=dict)
    units: Mapping[str, str] = field(default_factory=dict)
    spacing: float = 0.0


@dataclass(frozen=True)
class Mesh:
    """A triangle mesh.

    position [m], shape (n, 3); triangles, shape (m, 3), indices of points
    data per point, cell_data per triangle
    """

    name: str
    position: Float
    triangles: Int
    data: Mapping[str, Array] = field(default_factory=dict)
    cell_data: Mapping[str, Array] = field(default_factory=dict)
    units: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True)
class Lines:
    """Line segments: springs, ropes, hair, trails.

    position [m], shape (n, 3); segments, shape (m, 2), indices of points
    data per point, cell_data per segment
    """

    name: str
    position: Float
    segments: Int
    data: Mapping[str, Array] = field(default_factory=dict)
    cell_data: Mapping[str, Array] = field(default_factory=dict)
    units: Mapping[str, str] = field(default_factory=dict)


Part = Points | Mesh | Lines


@dataclass(frozen=True)
class Frame:
    """The state of a scene at one time: `index` 0 is the start, at `time` 0 s."""

    index: int
    time: float
    parts: tuple[Part, ...]
    diagnostics: Mapping[str, float] = field(default_factory=dict)

    def part(self, name: str) -> Part:
        """The part called `name`; KeyError names those there are."""
        for part in self.parts:
            if part.name == name:
                return part
        raise KeyError(f"no part {name!r}; there are {', '.join(p.name for p in self.parts)}")
