"""Survey: a quick look through a film before it is drawn, so that nothing has to jump later.

A few dozen frames tell where the action is, how large, how dense, how fast: camera, sizes and
colour ranges are then fixed for the whole film.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from tianim.frame import Frame, Lines, Mesh, Part, Points

Float = NDArray[np.float32]

MAX_FRAMES = 48  # frames looked at
LARGE = 300_000  # points from which MAX_FRAMES_LARGE are looked at
MAX_FRAMES_LARGE = 16
MAX_POINTS = 3000  # points kept of each frame
SPACING_POINTS = 1500  # points whose nearest neighbour is sought
FLAT = 1e-4  # a scene is flat along an axis that it fills less than this of its largest extent


class Frames(Protocol):
    """What is drawn: frames by index, read when asked for."""

    def __len__(self) -> int:
        """Number of frames."""

    def __getitem__(self, index: int, /) -> Frame:
        """The frame at `index`, from 0."""


@dataclass(frozen=True)
class Survey:
    """What was found.

    indices, times of the frames looked at; action: some of the points that matter in each, (m, 3) [m]
    flat      axis along which all points agree (0, 1, 2), or None
    lowest    height of the lowest thing [m]
    loose     the action is points, of which some may stray and need not be framed
    spacing   distance between neighbours by part [m] (median segment length of lines)
    parts     one example of each part, from the frame in the middle
    """

    indices: NDArray[np.int64]
    times: NDArray[np.float64]
    action: Sequence[Float]
    flat: int | None
    lowest: float
    loose: bool
    spacing: Mapping[str, float]
    parts: Mapping[str, Part]
    frames: Sequence[Frame] = field(repr=False)

    @property
    def everything(self) -> Float:
        """The action of all frames together, (m, 3) [m]."""
        return np.concatenate(self.action) if self.action else np.zeros((0, 3), np.float32)


def survey(frames: Frames) -> Survey:
    """Look through `frames`; a film of no frames, or of nothing, gives an empty survey."""
    count = len(frames)
    first = frames[0] if count else None
    points = sum(len(part.position) for part in first.parts) if first else 0
    most = MAX_FRAMES_LARGE if points > LARGE else MAX_FRAMES
    indices = (
        np.unique(np.linspace(0, count - 1, min(count, most)).round().astype(np.int64))
        if count
        else np.zeros(0, np.int64)
    )
    seen = [frames[int(index)] for index in indices]
    moving = _action_names(seen)
    action = [_sample([part for part in frame.parts if part.name in moving]) for frame in seen]
    middle = seen[len(seen) // 2] if seen else None
    parts = {part.name: part for frame in seen for part in frame.parts}
    if middle is not None:
        parts.update({part.name: part for part in middle.parts if len(part.position)})
    return Survey(
        indices=indices,
        times=np.array([frame.time for frame in seen]),
        action=action,
        flat=_flat_axis(action),
        lowest=_lowest(seen),
        loose=any(isinstance(part, Points) for frame in seen for part in frame.parts if part.name in moving),
        spacing={name: _spacing(part) for name, part in parts.items()},
        parts=parts,
        frames=seen,
    )


def finite(position: Float) -> Float:
    """The rows of `position` that are finite."""
    good = np.isfinite(position).all(axis=1)
    return position if good.all() else position[good]


def _action_names(seen: Sequence[Frame]) -> set[str]:
    """Parts that the camera should frame: points and lines; meshes only where there is nothing else."""
    names = {part.name for frame in seen for part in frame.parts if isinstance(part, Points | Lines)}
    names = {name for name in names if any(len(p.position) for f in seen for p in f.parts if p.name == name)}
    return names or {part.name for frame in seen for part in frame.parts}


def _sample(parts: Sequence[Part]) -> Float:
    """At most MAX_POINTS positions, evenly by order, so that it is the same particles in each frame."""
    whole = [finite(part.position) for part in parts]
    total = sum(map(len, whole))
    stride = max(1, -(-total // MAX_POINTS))
    picked = [position[::stride] for position in whole if len(position)]
    return np.concatenate(picked).astype(np.float32) if picked else np.zeros((0, 3), np.float32)


def _flat_axis(action: Sequence[Float]) -> int | None:
    """The axis that the action does not use; z before y, for a plan of few points."""
    everything = np.concatenate(action) if action else np.zeros((0, 3))
    if len(everything) < 2:
        return None
    extent = np.ptp(everything, axis=0)
    if extent.max() == 0.0:
        return None
    flat = [axis for axis in (2, 1, 0) if extent[axis] <= FLAT * extent.max()]
    return flat[0] if len(flat) == 1 else None


def _lowest(seen: Sequence[Frame]) -> float:
    heights = [
        finite(part.position)[:, 1].min() for f in seen for part in f.parts if len(finite(part.position))
    ]
    return float(min(heights)) if heights else 0.0


def _spacing(part: Part) -> float:
    """Median distance of neighbours [m]; 0 where there are none."""
    position = finite(part.position)
    if isinstance(part, Lines):
        if not len(part.segments) or len(position) != len(part.position):
            return 0.0
        ends = part.position[part.segments[:20000]]
        return float(np.median(np.linalg.norm(ends[:, 0] - ends[:, 1], axis=1)))
    if isinstance(part, Mesh) or len(position) < 2:
        return 0.0
    some = position[:: max(1, len(position) // SPACING_POINTS)]
    distance, _ = cKDTree(position).query(some, k=2)
    return float(np.median(distance[:, 1]))
