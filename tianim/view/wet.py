"""Fluids in pictures: which parts are fluid, and what that means for the rest of the picture.

Particles that fill a volume are drawn as balls that close up into a body; a tank round them is thin
edges, framed whole; torn water is white.
"""

from collections.abc import Iterable, Mapping

import numpy as np
from numpy.typing import NDArray

from tianim.frame import Part, Points
from tianim.view.look import Look

Float = NDArray[np.float32]

BALL_SPACING = 1.25  # diameter of a ball over the spacing at rest: they close up into a body
DISC_SPACING = 1.42  # and in a flat scene, which has nothing behind: four in a square close up
FOAM_SPACING = 0.3  # diameter of a disc of foam over the spacing of the fluid
FOAM_PIXELS = 2.6  # its automatic diameter where there are no particles [pixels of 720 rows]
FOAM_OPACITY = 0.45
EDGE_PIXELS = 1.5  # thickness of the edges of a tank [pixels of 720 rows]
EDGE_OPACITY = 0.75
EDGE_PIECES = 24  # pieces of a straight edge: each has the depth of its own place
# Relative density of particles that have a few neighbours left, and of those that have none: the share of
# a lone particle in its own density is 0.32 for a cubic spline over two spacings.
TORN = (0.62, 0.40)
UNKNOWN = 0.1  # a relative density below this was not worked out: a start before its first step
FLUID_BOUNDS = (0.5, 99.5)  # percentiles of all its particles that bound a fluid without a tank
FILL_TANK = 0.74  # share of the height that a tank fills
ELEVATION_TANK = 20.0  # height of the camera over a tank [degrees]: the water's surface must show
ELEVATION_SKY = 7.0  # and before a sky, whose horizon must show [degrees]


def is_fluid(part: Part) -> bool:
    """Whether a part is the particles of a fluid: they fill a volume."""
    return isinstance(part, Points) and (part.spacing > 0.0 or "pressure" in part.data)


def is_foam(part: Part) -> bool:
    """Whether a part is foam, spray and bubbles, as the pass over a finished run makes them."""
    return isinstance(part, Points) and {"kind", "age"} <= part.data.keys()


def is_wet(look: Look, parts: Mapping[str, Part]) -> bool:
    """Whether a film shows a fluid: particles, or a mesh of a material."""
    shown = [name for name in parts if look.parts.get(name) is None or look.parts[name].kind != "hidden"]
    liquid = any(style.material is not None for style in look.parts.values())
    return liquid or any(is_fluid(parts[name]) for name in shown)


def any_fluid(parts: Iterable[Part]) -> bool:
    """Whether there are particles of a fluid among `parts`."""
    return any(is_fluid(part) for part in parts)


def torn(part: Part) -> Float | None:
    """How far each particle has left the body, 0 to 1; None where the part does not tell."""
    if not is_fluid(part) or "density" not in part.data:
        return None
    density = np.asarray(part.data["density"], np.float32)
    if density.ndim != 1:
        return None
    share = np.clip((TORN[0] - density) / (TORN[0] - TORN[1]), 0.0, 1.0) * (density > UNKNOWN)
    return (share * share * (3.0 - 2.0 * share)).astype(np.float32)


def pieces(start: Float, end: Float) -> tuple[Float, Float]:
    """Straight edges (n, 3) cut into EDGE_PIECES each: starts and ends."""
    share = np.linspace(0.0, 1.0, EDGE_PIECES + 1, dtype=np.float32)[:, None, None]
    places = start + share * (end - start)
    return (
        np.ascontiguousarray(places[:-1].reshape(-1, 3), dtype=np.float32),
        np.ascontiguousarray(places[1:].reshape(-1, 3), dtype=np.float32),
    )
