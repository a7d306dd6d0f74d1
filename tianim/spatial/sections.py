"""Bodies in two dimensions: what the plane z = 0 cuts out of them.

What lies along z reaches for ever along z, so that no surface but the section's is near the plane.
"""

import math

import numpy as np

from tianim.frame import Float
from tianim.lang import ti
from tianim.math.rotations import rotate, rotate_back
from tianim.spatial.bodies import CYLINDER, FAR, KIND, ROTATION, ROUNDED, ROUNDING, SHAPE

# A surface of whose normal less than this lies in the plane is hardly a wall there.
LEANING = 0.5


@ti.func
def in_plane(hit):
    """What `signed_distance` saw, along the plane: to where the surface, taken as flat, cuts it."""
    scale = 1.0 / ti.max(ti.sqrt(hit.x * hit.x + hit.y * hit.y), LEANING)
    return scale * ti.Vector([hit.x, hit.y, 0.0, hit.w])


def cut(row: Float) -> None:
    """Make a row of the bodies' table that of the section; planes and meshes stay as they are."""
    if row[KIND] not in (ROUNDED, CYLINDER):
        return
    rotation = row[ROTATION : ROTATION + 4]
    along_z = int(np.abs(rotate_back(rotation, (0.0, 0.0, 1.0))).argmax())
    if row[KIND] == CYLINDER and along_z != 1:
        # A rectangle, however it is turned about its axis.
        axis = rotate(rotation, (0.0, 1.0, 0.0))
        lean = 0.5 * math.atan2(-axis[0], axis[1])
        rotation[:] = 0.0, 0.0, math.sin(lean), math.cos(lean)
        row[KIND], along_z = ROUNDED, 2
    if row[ROUNDING] == 0.0:
        row[SHAPE + along_z] = FAR
    elif along_z == 1:
        row[SHAPE + 1] = 0.0  # of a capsule a disc
