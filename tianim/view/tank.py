"""The tank of a fluid: the edges of contained bounds, which pictures show and frames do not have."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tianim.frame import Frame, Lines
from tianim.view.survey import Frames
from tianim.view.wet import is_fluid

Float = NDArray[np.float32]

TANK = "tank"  # name of the part
# A surface made of particles is round where it meets a wall: what is nearer to it than FLAT spacings is laid
# on the wall, and what is nearer than BENT moves with it.
FLAT, BENT = 0.6, 2.0


class Tanked:
    """The frames of a fluid in a box, with the edges of the box as a part of each."""

    def __init__(self, frames: Frames, edges: Lines) -> None:
        self._frames, self._edges = frames, edges

    def __len__(self) -> int:
        return len(self._frames)

    def __getitem__(self, index: int) -> Frame:
        return add_edges(self._frames[index], self._edges)


def add_edges(frame: Frame, edges: Lines | None) -> Frame:
    """The frame with `edges` as its last part, where there are any."""
    if edges is None:
        return frame
    return Frame(frame.index, frame.time, (*frame.parts, edges), frame.diagnostics)


def tank_of(frame: Frame, bounds: Mapping[str, Any]) -> Lines | None:
    """Edges of the contained `bounds` of a scene, a rectangle where it is flat; None but for a fluid.

    `bounds` is that section of the scene: kind, lower, upper.
    """
    fluids = [part for part in frame.parts if is_fluid(part)]
    if bounds.get("kind") != "contained" or not fluids or any(part.name == TANK for part in frame.parts):
        return None
    lower, upper = (np.array(bounds[name], np.float32) for name in ("lower", "upper"))
    depth = np.concatenate([part.position[:, 2] for part in fluids])
    if len(depth) > 1 and np.ptp(depth) == 0.0:
        lower[2] = upper[2] = depth[0]
    corners = np.array([[i, j, k] for i in (0, 1) for j in (0, 1) for k in (0, 1)], np.float32)
    pairs = [(i, i | bit) for i in range(8) for bit in (1, 2, 4) if not i & bit]
    if lower[2] == upper[2]:
        pairs = [(i, j) for i, j in pairs if not (i | j) & 1]
    return Lines(TANK, lower + corners * (upper - lower), np.array(pairs, np.int32))


def with_tank(frames: Frames, bounds: Mapping[str, Any]) -> Frames:
    """`frames` with the tank of a fluid in them, as `tank_of` finds it in the first."""
    edges = tank_of(frames[0], bounds) if len(frames) else None
    return frames if edges is None else Tanked(frames, edges)


def laid_on_walls(position: Float, frame: Frame) -> Float:
    """Vertices (n, 3) [m] of a fluid's surface in `frame`, laid on the walls of its tank where it has one."""
    spacing = max((part.spacing for part in frame.parts if is_fluid(part)), default=0.0)  # type: ignore[union-attr]
    tank = next((part for part in frame.parts if part.name == TANK), None)
    if tank is None or spacing == 0.0:
        return position
    out = position.copy()
    flat, bent = FLAT * spacing, BENT * spacing
    for axis in range(3):
        low, high = float(tank.position[:, axis].min()), float(tank.position[:, axis].max())
        if high - low < 2 * bent:
            continue
        for wall, inward in ((low, 1.0), (high, -1.0)):
            away = (out[:, axis] - wall) * inward
            near = away < bent
            moved = np.maximum(away[near] - flat, 0.0) * (bent / (bent - flat))
            out[near, axis] = wall + inward * moved
    return out
