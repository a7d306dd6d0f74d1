"""Nothing starts inside a body or beyond the bounds: contact would throw it out, or hold it there."""

import numpy as np
from numpy.typing import NDArray

from tianim.errors import SceneError
from tianim.spatial.bodies import Bodies
from tianim.system import Bounds
from tianim.systems.springs.assembly import Assembly

FARTHEST = 3  # decimals [m] that a message gives


def refuse_inside(
    whole: Assembly, held: NDArray[np.bool_], bodies: Bodies, bounds: Bounds, thickness: float
) -> None:
    """SceneError where points that are not `held` start in a body or out of bounds by over `thickness`."""
    for name, piece in whole.pieces.items():
        first = whole.first[name]
        free = ~held[first : first + len(piece.mass)]
        x = piece.position[free]
        if len(x) and bodies.count:
            distance = bodies.distance(x)[0]
            if (distance < -thickness).any():
                _refuse(name, x, -distance, thickness, "inside a body")
        if len(x) and bounds.kind == "contained":
            beyond = np.maximum(np.array(bounds.lower) - x, x - np.array(bounds.upper)).max(axis=1)
            if (beyond > thickness).any():
                _refuse(name, x, beyond, thickness, "out of bounds")


def _refuse(
    name: str, x: NDArray[np.float64], deep: NDArray[np.floating], thickness: float, where: str
) -> None:
    worst = int(deep.argmax())
    place = ", ".join(f"{value:.{FARTHEST}g}" for value in x[worst])
    raise SceneError(
        f"pieces.{name}: {int((deep > thickness).sum()):,} points start {where}, the deepest by "
        f"{deep[worst]:.{FARTHEST}g} m at ({place}): move the piece or the body, or pin them"
    )
