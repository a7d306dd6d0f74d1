"""Sizes that a look leaves out: from the spacing of the points, within what a picture can show."""

import numpy as np

from tianim.frame import Part, Points
from tianim.view.survey import Survey
from tianim.view.wet import BALL_SPACING, DISC_SPACING, EDGE_PIXELS, FOAM_PIXELS, FOAM_SPACING, is_fluid

DART_SPACING = 0.85  # length of a dart over the distance of neighbours
ARROW_SPACING = 1.15
SPHERE_SPACING = 0.9  # diameter
LINE_SPACING = 0.35  # thickness of a line over the length of its segments
DART_PIXELS = (5.5, 44.0)  # least and greatest automatic length [pixels of 720 rows]
ARROW_PIXELS = (9.0, 44.0)
SPHERE_PIXELS = (1.6, 60.0)
LINE_PIXELS = (1.6, 7.0)
CROWDED = 40_000  # points from which the least sizes shrink, so that they do not hide each other


def automatic_size(part: Part, kind: str, survey: Survey, pixel: float) -> float:
    """The size [m] of what stands for an item of `part`; `pixel` is what one of 720 rows covers [m]."""
    if kind == "edges":
        return EDGE_PIXELS * pixel
    if kind == "foam":
        found = [_spacing(other, survey) for other in survey.parts.values() if is_fluid(other)]
        return FOAM_SPACING * max(found) if found else FOAM_PIXELS * pixel
    if is_fluid(part) and kind in ("spheres", "glow"):
        share = BALL_SPACING if survey.flat is None else DISC_SPACING
        return max(share * _spacing(part, survey), SPHERE_PIXELS[0] * pixel)
    spacing = survey.spacing.get(part.name, 0.0)
    share, (least, most) = {
        "lines": (LINE_SPACING, LINE_PIXELS),
        "spheres": (SPHERE_SPACING, SPHERE_PIXELS),
        "glow": (SPHERE_SPACING, SPHERE_PIXELS),
        "arrows": (ARROW_SPACING, ARROW_PIXELS),
    }.get(kind, (DART_SPACING, DART_PIXELS))
    if kind != "lines":
        least *= min(1.0, max(0.3, (CROWDED / max(len(part.position), 1)) ** 0.5))
    wanted = spacing * share if spacing > 0.0 else 0.4 * most * pixel
    return float(np.clip(wanted, least * pixel, most * pixel))


def _spacing(part: Part, survey: Survey) -> float:
    """From one particle of a fluid to the next [m]: as the part tells, or as it was found."""
    told = part.spacing if isinstance(part, Points) else 0.0
    return told or survey.spacing.get(part.name, 0.0)
