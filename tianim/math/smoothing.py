"""Smoothing kernels of SPH: functions of q = r/h that vanish beyond the support radius h.

    W(r) = s w(q),   dW/dr = s w'(q) / h,   s such that W integrates to 1

`cubic` is the cubic B-spline (Monaghan, 1992, doi:10.1146/annurev.aa.30.090192.002551), with the support
h that others call 2 h. Kernels take s as an argument, so that nothing is baked in.
"""

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tianim.lang import ti

Floats = NDArray[np.float64]


def cubic_scale(h: float, dimension: int) -> float:
    """S of the cubic spline [1/m^dimension] for support h [m]."""
    return 40.0 / (7.0 * math.pi * h**2) if dimension == 2 else 8.0 / (math.pi * h**3)


def cubic_values(q: ArrayLike) -> Floats:
    """w(q) in float64, for sums on the host and as an oracle."""
    q = np.asarray(q, np.float64)
    inner, outer = 6.0 * (q - 1.0) * q * q + 1.0, 2.0 * np.maximum(1.0 - q, 0.0) ** 3
    return np.where(q <= 0.5, inner, outer)


def cubic_slopes(q: ArrayLike) -> Floats:
    """w'(q) in float64."""
    q = np.asarray(q, np.float64)
    return np.where(q <= 0.5, 6.0 * (3.0 * q - 2.0) * q, -6.0 * np.maximum(1.0 - q, 0.0) ** 2)


@ti.func
def cubic(q):
    """w(q): 6 (q^3 - q^2) + 1 up to a half, 2 (1 - q)^3 up to one."""
    far = ti.max(1.0 - q, 0.0)
    near = ti.max(0.5 - q, 0.0)
    # The two pieces as one: 2 (1 - q)^3 - 8 (1/2 - q)^3.
    return 2.0 * far * far * far - 8.0 * near * near * near


@ti.func
def cubic_slope(q):
    """w'(q)."""
    far = ti.max(1.0 - q, 0.0)
    near = ti.max(0.5 - q, 0.0)
    return 24.0 * near * near - 6.0 * far * far


def lattice_sum(support: float, dimension: int) -> float:
    """Sum of d^dimension W over a cubic (square) lattice of spacing d, for h = support d; near 1."""
    reach = math.ceil(support)
    axis = np.arange(-reach, reach + 1.0)
    grid = np.meshgrid(*[axis] * dimension, indexing="ij")
    r = np.sqrt(sum(g * g for g in grid))
    return float(cubic_scale(support, dimension) * cubic_values(r / support).sum())
