"""The number that colours each item of a part, and the ranges of such numbers over a film."""

import numpy as np
from numpy.typing import NDArray

from tianim.errors import SceneError
from tianim.frame import Lines, Part

Float = NDArray[np.float32]

DERIVED = ("speed", "heading", "height")
CYCLIC = "heading"


def can_color_by(part: Part, by: str) -> bool:
    """Whether `part` has, or gives by its velocity, the values called `by`."""
    if by in part.data or by == "height" or (isinstance(part, Lines) and by in part.cell_data):
        return True
    return by in ("speed", "heading") and "velocity" in part.data


def values_of(part: Part, by: str, flat: int | None = None) -> Float:
    """One number per point of `part`: a data array (a vector's length), speed, height or heading.

    Data of the segments of lines is the mean over the segments at a point.

    `heading` is 0..1 round the compass: from z over x in the ground plane, or from x over y in a
    scene that is flat along z. `flat` is the axis along which the scene is flat.
    Raises SceneError naming what there is.
    """
    if not can_color_by(part, by):
        segments = part.cell_data if isinstance(part, Lines) else {}
        have = sorted({*part.data, *segments, *(name for name in DERIVED if can_color_by(part, name))})
        raise SceneError(f"view.parts.{part.name}.color.by {by!r}: the part has {', '.join(have)}")
    if isinstance(part, Lines) and by in part.cell_data:
        return _of_segments(part, by)
    if by in part.data:
        data = np.asarray(part.data[by], np.float32)
        return data if data.ndim == 1 else np.linalg.norm(data, axis=1)
    if by == "height":
        return np.ascontiguousarray(part.position[:, 1], dtype=np.float32)
    velocity = np.asarray(part.data["velocity"], np.float32)
    if by == "speed":
        return np.sqrt(np.einsum("ij,ij->i", velocity, velocity))
    across, along = (velocity[:, 0], velocity[:, 1]) if flat == 2 else (velocity[:, 2], velocity[:, 0])
    return (np.arctan2(along, across) / (2 * np.pi) % 1.0).astype(np.float32)


def _of_segments(part: Lines, by: str) -> Float:
    values = np.asarray(part.cell_data[by], np.float64)
    values = values if values.ndim == 1 else np.linalg.norm(values, axis=1)
    ends, count = part.segments.ravel(), len(part.position)
    total = np.bincount(ends, np.repeat(values, 2), count)
    return (total / np.maximum(np.bincount(ends, minlength=count), 1)).astype(np.float32)
