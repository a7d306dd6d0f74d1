"""Smoothing kernels of SPH: functions of q = r/h that vanish beyond the support radius h.

    W(r) = s w(q),   dW/dr = s w'(q) / h,   s such that W integrates to 1

In space the cubic B-spline (Monaghan 1992, doi:10.1146/annurev.aa.30.090192.002551), in the plane the quintic
(Morris et al. 1997, doi:10.1006/jcph.1997.5776), with the supports h that others call 2 h and 3 h. Kernels
take s as an argument, so that nothing is baked in.

Why two: fluid at rest is in order, a crystal of particles, and where it is sheared by e its density grows by
c e^2 while none of its volume goes. Under pressure that is a stiffness, and waves run too fast. In the plane,
over two spacings, the cubic spline has c = 0.11 (waves 4.5 % too fast, however many particles); the quintic
over 2.75 has 0.00 to 0.01, and squares of particles are as dense as hexagons, to 0.01 % for 0.4. Over more,
surfaces sink by half a spacing and walls reach to the third layer. In space it would be 87 neighbours for
32, and there c of the cubic spline is 0.06.
"""

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tianim.lang import ti

Floats = NDArray[np.float64]

# Support radius by dimension, in particle spacings.
SUPPORT = {2: 2.75, 3: 2.0}


def spline_scale(h: float, dimension: int) -> float:
    """The factor s [1/m^dimension] for support h [m]."""
    return 15309.0 / (478.0 * math.pi * h**2) if dimension == 2 else 8.0 / (math.pi * h**3)


def spline_values(q: ArrayLike, dimension: int) -> Floats:
    """w(q) in float64, for sums on the host and as an oracle."""
    q = np.asarray(q, np.float64)
    if dimension == 2:
        return _powers(q, 5)
    inner, outer = 6.0 * (q - 1.0) * q * q + 1.0, 2.0 * np.maximum(1.0 - q, 0.0) ** 3
    return np.where(q <= 0.5, inner, outer)


def spline_slopes(q: ArrayLike, dimension: int) -> Floats:
    """w'(q) in float64."""
    q = np.asarray(q, np.float64)
    if dimension == 2:
        return -5.0 * _powers(q, 4)
    return np.where(q <= 0.5, 6.0 * (3.0 * q - 2.0) * q, -6.0 * np.maximum(1.0 - q, 0.0) ** 2)


def _powers(q: Floats, power: int) -> Floats:
    """(1 - q)^n - 6 (2/3 - q)^n + 15 (1/3 - q)^n, each up to where it is zero."""
    parts = [np.maximum(end - q, 0.0) ** power for end in (1.0, 2.0 / 3.0, 1.0 / 3.0)]
    return parts[0] - 6.0 * parts[1] + 15.0 * parts[2]


@ti.func
def spline(dimension: ti.template(), q):
    """w(q): in space 2 (1 - q)^3 - 8 (1/2 - q)^3, in the plane a sum of fifth powers."""
    value = 0.0
    far = ti.max(1.0 - q, 0.0)
    if ti.static(dimension == 2):
        middle, near = ti.max(2.0 / 3.0 - q, 0.0), ti.max(1.0 / 3.0 - q, 0.0)
        far2, middle2, near2 = far * far, middle * middle, near * near
        value = far2 * far2 * far - 6.0 * middle2 * middle2 * middle + 15.0 * near2 * near2 * near
    else:
        near = ti.max(0.5 - q, 0.0)
        value = 2.0 * far * far * far - 8.0 * near * near * near
    return value


@ti.func
def spline_slope(dimension: ti.template(), q):
    """w'(q)."""
    value = 0.0
    far = ti.max(1.0 - q, 0.0)
    if ti.static(dimension == 2):
        middle, near = ti.max(2.0 / 3.0 - q, 0.0), ti.max(1.0 / 3.0 - q, 0.0)
        far2, middle2, near2 = far * far, middle * middle, near * near
        value = -5.0 * far2 * far2 + 30.0 * middle2 * middle2 - 75.0 * near2 * near2
    else:
        near = ti.max(0.5 - q, 0.0)
        value = 24.0 * near * near - 6.0 * far * far
    return value


def lattice_sum(support: float, dimension: int) -> float:
    """Sum of d^dimension W over a cubic (square) lattice of spacing d, for h = support d; near 1."""
    reach = math.ceil(support)
    axis = np.arange(-reach, reach + 1.0)
    grid = np.meshgrid(*[axis] * dimension, indexing="ij")
    r = np.sqrt(sum(g * g for g in grid))
    return float(spline_scale(support, dimension) * spline_values(r / support, dimension).sum())
