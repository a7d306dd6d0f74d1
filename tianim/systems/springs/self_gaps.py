"""How near two parts of surfaces may come: rules that the search and the contacts share.

A pair is four points, of a point and a triangle or of two edges (`closest.py`).
"""

from tianim.lang import ti
from tianim.systems.springs.arrays import triple
from tianim.systems.springs.closest import between, closest

# Pairs nearer than this many thicknesses at the start of a step are kept apart by it, if the solver brings
# them within MARGIN thicknesses of what they are to keep.
NEAR, MARGIN = 1.25, 0.2
# Part of what lacks to the thickness that is made up in a step.
RECOVERED = 0.1
# Pairs of one surface keep at most this part of the distance that they had at rest.
OF_REST = 0.5
# No pair comes nearer than this part of the thickness, or of its distance at the start of the step.
LEAST, LEAST_OF_GAP = 0.1, 0.8


@ti.func
def least_gap(gap, thickness):
    """How near a pair may come that starts at `gap`."""
    return ti.min(LEAST * thickness, LEAST_OF_GAP * gap)


@ti.func
def kept_apart(thickness, group: ti.template(), rest: ti.template(), kind, a, b, c, d):
    """Distance that a pair keeps: less where its parts are nearer at rest, as in a fine mesh."""
    h = ti.cast(thickness, ti.f64)
    if group[a] == group[d]:
        xa, xb, xc, xd = triple(rest, a), triple(rest, b), triple(rest, c), triple(rest, d)
        h = ti.min(h, OF_REST * between(closest(kind, xa, xb, xc, xd), xa, xb, xc, xd).norm())
    return h


@ti.func
def wanted(far, h):
    """What a pair that is to keep h and starts at `far` has at the end."""
    return ti.min(h, far + RECOVERED * ti.max(h - far, 0.0))
