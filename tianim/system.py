"""The System protocol: what the engine asks of boids, gravity, fluids and the rest.

A system holds its state, steps it, and shows it. It knows no scene, no file and no viewer.
"""

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from tianim.frame import Part
from tianim.params import Params

if TYPE_CHECKING:
    from tianim.spatial.bodies import Bodies


class SystemParams(Params):
    """Base of each system's parameters; a subclass fixes `kind: Literal["..."]`.

    The estimates serve `tianim check`, before anything is allocated.
    """

    kind: str

    def particle_count(self) -> int:
        """Particles that the system will hold."""
        raise NotImplementedError

    def memory_bytes(self) -> int:
        """Bytes of state and work arrays, estimated."""
        raise NotImplementedError

    def seconds_per_step(self) -> float:
        """Seconds a step on two ordinary cores, estimated."""
        raise NotImplementedError

    def largest_step(self) -> float:
        """Largest dt [s] at the start, for estimating the number of substeps."""
        raise NotImplementedError

    def check_scene(
        self, bounds: "Bounds", body_names: Collection[str], system_names: Collection[str]
    ) -> None:
        """Raise ValueError where the rest of the scene does not fit: bounds, or names that are not there."""

    def check_substeps(self, frame: float) -> None:
        """Raise ValueError where a frame of so many seconds needs more substeps than the system allows."""


@dataclass(frozen=True)
class Bounds:
    """The domain: `periodic`, `contained` (walls) or `open`; corners [m], None where open."""

    kind: str = "open"
    lower: tuple[float, float, float] | None = None
    upper: tuple[float, float, float] | None = None


@dataclass(frozen=True)
class World:
    """What surrounds the systems of a scene and is shared by them.

    A system is built as `Kind(name, params, world)`. `seed` belongs to this system alone. `fields`
    names the data arrays that frames are to hold, None for all: what nobody wants is not computed.
    """

    bounds: Bounds
    bodies: "Bodies"
    seed: int
    fields: frozenset[str] | None = None

    def wants(self, field: str) -> bool:
        """Whether frames are to hold the data array `field`."""
        return self.fields is None or field in self.fields


class System(Protocol):
    """What the Simulation asks of a system.

    `arrays` lists what a script may read and set by name, as NumPy in id order.
    """

    name: str

    def max_step(self) -> float:
        """Largest dt [s] that the system is stable or accurate for now."""

    def step(self, time: float, dt: float) -> None:
        """Advance from `time` [s] by `dt` [s]; channels are evaluated at `time`."""

    def snapshot(self) -> tuple[Part, ...]:
        """What the system shows in a frame: copies, in id order."""

    def diagnostics(self) -> dict[str, float]:
        """Numbers of this moment for metrics.csv, keys without the system's name."""

    def check(self) -> None:
        """Raise BlowupError when a particle is not finite or beyond its stated bound."""

    def state(self) -> dict[str, NDArray[np.generic]]:
        """All that is needed to go on as if never stopped, in storage order."""

    def restore(self, state: Mapping[str, NDArray[np.generic]]) -> None:
        """Take over what `state` gave."""

    def arrays(self) -> tuple[str, ...]:
        """Names that `read` and `write` take."""

    def read(self, name: str) -> NDArray[np.generic]:
        """The array `name` as NumPy, (n,) or (n, 3), in id order."""

    def write(self, name: str, values: NDArray[np.generic]) -> None:
        """Set the array `name` from NumPy, (n,) or (n, 3), in id order."""


@runtime_checkable
class Limited(Protocol):
    """A system that does not bear any number of substeps a frame."""

    def check_substeps(self, substeps: int) -> None:
        """Raise SceneError where a frame that needs so many, by the last `max_step`, is not to be made."""
