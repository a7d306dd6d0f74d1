"""The weight of viscosity between two particles, and what walls do in its place.

    w_ij = C (1 - q^2)^(3/2) / (r^2 + (d/4)^2),   q = r/h

With the slope of the cubic spline for (1 - q^2), as usual, eight neighbours in ten pull along the axes: the
viscosity of a lattice comes out 29 % too small for shear along its axes and 23 % too large for stretching.
This weight sees lattice, sliding layers and disorder alike, to 2 or 3 % (`pair_scale` sets the mean of the
first two to 1), and a fluid stirred by vortices to 2 %. One that falls off faster, (1 - q^2) / r^3, sees that
as 9 % too thick.

A wall that sticks acts like fluid beyond it whose velocity goes on linearly, from v at the particle's
distance s through the wall's u (Morris et al. 1997, doi:10.1006/jcph.1997.5776). Summed over the half space:

    a_i = - friction nu D(s/d) / d^2 (v - u)_tangential,   D a table
"""

import math
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import quad

from tianim.lang import ti
from tianim.spatial.neighbor_lists import nearest_image

Floats = NDArray[np.float64]

# The weight is finite for two particles in one place: softened by this length, in spacings.
SOFTENING = 0.25
FIRST = 0.5  # distance of the first layer from a wall [spacings]
# Samples of the table of walls over the support; nearer than NEAREST_DRAG spacings walls act as if there.
DRAG_SAMPLES = 128
NEAREST_DRAG = 0.1
# Phases of the layers that slide over one another, for the mean over them.
SLIDES = 16


def _weight(r: Floats, support: float) -> Floats:
    """W / C at distance r, both in spacings."""
    return np.asarray(np.maximum(1.0 - (r / support) ** 2, 0.0) ** 1.5 / (r * r + SOFTENING**2))


@lru_cache(maxsize=8)
def pair_scale(support: float, dimension: int) -> float:
    """C for spacing 1, such that the Laplacian of a shear flow is right in the mean.

    The mean is of the cubic lattice, along its axes, and of its layers slid over one another by all phases.
    """
    reach = math.ceil(support)
    across = np.arange(-reach - 1.0, reach + 2.0)

    def shear(phase: float) -> float:
        axes = (across + phase, np.arange(1.0, reach + 1.0), *[across] * (dimension - 2))
        x, y, *rest = np.meshgrid(*axes, indexing="ij")
        r = np.sqrt(x * x + y * y + sum(z * z for z in rest))
        return float((_weight(r, support) * x * x * y * y).sum())

    slid = float(np.mean([shear(k / SLIDES) for k in range(SLIDES)]))
    return 2.0 / (shear(0.0) + slid)


@lru_cache(maxsize=8)
def drag_table(support: float, dimension: int) -> NDArray[np.float32]:
    """D at distances k / DRAG_SAMPLES of the support from a wall, k = 0 to DRAG_SAMPLES.

    The integral of w z x^2 / s over the half space z > s, x along the wall, for spacing 1; times what makes
    it, for the first layer of a lattice, the sum over the layers that are missing there.
    """
    power, factor = (2.0, math.pi / 4.0) if dimension == 3 else (1.5, 2.0 / 3.0)
    distances = support * np.arange(DRAG_SAMPLES + 1) / DRAG_SAMPLES

    def value(s: float) -> float:
        def ring(r: float) -> float:
            lost = max(1.0 - (s / r) ** 2, 0.0) ** power
            return float(r ** (dimension + 2) * _weight(np.float64(r), support) * lost)

        return factor * quad(ring, s, support, limit=200)[0] / s

    scale = pair_scale(support, dimension) * _missing(support, dimension) / value(FIRST)
    return np.array([scale * value(max(s, NEAREST_DRAG)) for s in distances], np.float32)


def _missing(support: float, dimension: int) -> float:
    """Of w z x^2 / s over the lattice's layers beyond a wall at s = FIRST, without C."""
    axis = np.arange(-math.ceil(support), math.ceil(support) + 1.0)
    x = np.stack(np.meshgrid(*[axis] * dimension, indexing="ij"), axis=-1).reshape(-1, dimension)
    x = x[x[:, 1] > 0.0]
    return float((_weight(np.linalg.norm(x, axis=1), support) * x[:, 1] * x[:, 0] ** 2).sum() / FIRST)


@ti.func
def difference(periodic: ti.template(), d, length):
    """Difference `d` of two coordinates [m], of the nearest images where the box is `periodic`.

    Where it is not, the loop over the neighbours does without: some then fit into the registers.
    """
    if ti.static(periodic):
        d = nearest_image(d, length)
    return d


@ti.func
def pair_weight(r2, inverse_h, softening):
    """W / C for a squared distance r2 [m2]; 0 beyond the support."""
    left = ti.max(1.0 - r2 * inverse_h * inverse_h, 0.0)
    return left * ti.sqrt(left) / (r2 + softening)


@ti.func
def drag_at(s, drag: ti.template()):
    """D at distance s in supports, linear between the samples."""
    at = ti.min(ti.max(s, 0.0), 1.0) * DRAG_SAMPLES
    k = ti.min(ti.cast(at, ti.i32), DRAG_SAMPLES - 1)
    return drag[k] + (at - k) * (drag[k + 1] - drag[k])


@ti.func
def wall_rate(
    i,
    inverse_h,
    nu,
    distance: ti.template(),
    nearest: ti.template(),
    friction: ti.template(),
    drag: ti.template(),
):
    """How fast the nearest wall takes up the tangential velocity of particle i [1/s]; `nu` is nu / d^2."""
    rate = 0.0
    if nearest[i] >= 0 and distance[i] * inverse_h < 1.0:
        rate = friction[nearest[i]] * nu * drag_at(distance[i] * inverse_h, drag)
    return rate
