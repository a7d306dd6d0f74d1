"""Survey: a quick look through a film before it is drawn, so that nothing has to jump later.

A few dozen frames tell where the action is, how large, how dense, how fast: camera, sizes and
colour ranges are then fixed for the whole film.
"""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from tianim.frame import Frame, Lines, Mesh, Part, Points
from tianim.view.values import values_of
from tianim.view.wet import any_fluid, is_foam

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
    fluid     there are particles of a fluid, which stay where they are as a whole
    spacing   distance between neighbours by part [m] (median segment length of lines)
    parts     one example of each part, from the frame in the middle where it can be
    frames    the frames looked at, every part thinned to a few points with their data
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
    fluid: bool = False

    @property
    def everything(self) -> Float:
        """The action of all frames together, (m, 3) [m]."""
        return np.concatenate(self.action) if self.action else np.zeros((0, 3), np.float32)


def survey(frames: Frames, unframed: Collection[str] = ()) -> Survey:
    """Look through `frames`; a film of no frames, or of nothing, gives an empty survey.

    The parts `unframed` are no action: the camera may leave them out.
    """
    indices = _chosen(frames)
    parts: dict[str, Part] = {}
    thinned: list[Frame] = []
    lowest = float("inf")
    for place, index in enumerate(indices):
        frame = frames[int(index)]
        thinned.append(Frame(frame.index, frame.time, tuple(_thin(part) for part in frame.parts)))
        for part in frame.parts:
            good = finite(part.position)
            if len(good) and part.name not in unframed:
                lowest = min(lowest, float(good[:, 1].min()))
            if part.name not in parts or (place <= len(indices) // 2 and len(part.position)):
                parts[part.name] = part
    fluid = any_fluid(parts.values())
    names = _action_names({name: part for name, part in parts.items() if name not in unframed}, fluid)
    action = [_joined([p.position for p in frame.parts if p.name in names]) for frame in thinned]
    return Survey(
        indices=indices,
        times=np.array([frame.time for frame in thinned]),
        action=action,
        flat=_flat_axis(_joined(action)),
        lowest=lowest if np.isfinite(lowest) else 0.0,
        loose=any(isinstance(parts[name], Points) for name in names),
        spacing={name: _spacing(part) for name, part in parts.items()},
        parts=parts,
        frames=thinned,
        fluid=fluid,
    )


def _chosen(frames: Frames) -> NDArray[np.int64]:
    """Indices of the frames to look at, the first and the last among them."""
    count = len(frames)
    if not count:
        return np.zeros(0, np.int64)
    points = sum(len(part.position) for part in frames[0].parts)
    most = MAX_FRAMES_LARGE if points > LARGE else MAX_FRAMES
    return np.unique(np.linspace(0, count - 1, min(count, most)).round().astype(np.int64))


def finite(position: Float) -> Float:
    """The rows of `position` that are finite."""
    good = np.isfinite(position).all(axis=1)
    return position if good.all() else position[good]


def _thin(part: Part) -> Points:
    """At most MAX_POINTS points of a part, evenly by order, so that it is the same ones in each frame."""
    every = slice(None, None, max(1, -(-len(part.position) // MAX_POINTS)))
    good = np.isfinite(part.position[every]).all(axis=1)
    arrays = dict(part.data)
    if isinstance(part, Lines):
        arrays |= {name: values_of(part, name) for name in part.cell_data}
    data = {name: np.asarray(values)[every][good] for name, values in arrays.items()}
    return Points(part.name, part.position[every][good].astype(np.float32), data, part.units)


def _action_names(parts: Mapping[str, Part], fluid: bool) -> list[str]:
    """Parts that the camera should frame: points and lines; meshes only where there is nothing else.

    A fluid is framed by its tank where it has one, and foam by the fluid.
    """
    tanks = [n for n, part in parts.items() if isinstance(part, Lines) and len(part.position)]
    if fluid and tanks:
        return tanks
    lively = [
        n
        for n, part in parts.items()
        if isinstance(part, Points | Lines) and len(part.position) and not is_foam(part)
    ]
    return lively or list(parts)


def _joined(positions: Sequence[Float]) -> Float:
    return np.concatenate(positions) if len(positions) else np.zeros((0, 3), np.float32)


def _flat_axis(everything: Float) -> int | None:
    """The one axis that the action does not use."""
    if len(everything) < 2:
        return None
    extent = np.ptp(everything, axis=0)
    flat = [axis for axis in (2, 1, 0) if extent[axis] <= FLAT * extent.max()]
    return flat[0] if len(flat) == 1 else None


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
