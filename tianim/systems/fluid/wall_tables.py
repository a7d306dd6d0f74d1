"""Shares: how much of a particle's surroundings is solid, by integrals of the kernel made beforehand.

The share of a half space at distance s is the integral of W beyond a plane. But particles do not fill
space evenly: none is nearer to another than about a spacing d. On the cubic lattice the layers that a wall
at d/2 from the first layer takes the place of weigh 0.150 (support 2 d), the half space 0.188: a fluid
before such a wall would stand 4 % too dense, and be driven off. So walls see the kernel with a smaller
support, `wall_support`, such that the half space weighs what the missing layers do (1.71 d instead of 2 d).
That one number sets right the slope too (0.497 for 0.510 per d), and the second layer, which misses nothing.

All lengths here are in that support. With curvature k = 1/R (k = 0 the plane), a sphere of radius r about
the particle is covered by a ball (solid cylinder, disc in two dimensions) at distance s from it by

    ball   (r - s)(2 + k (s - r)) / (4 r (1 + k s))
    rod    acos( (s (2 + k s) + k r^2) / (2 r (1 + k s)) ) / pi     of a circle about it, across the axis

A box is a product of slabs, each 1 less two half spaces: a product of shares, which is exact for a kernel
that is a product. The cubic spline is none; what is left over, E(s, t) = share of a quadrant - L(s) L(t),
is odd in s and in t and, to 1e-4, itself a product, E = -A(s) A(t). A is scaled such that the edge of a
lattice is right; its corner then is so as well (0.6063 for 0.6066).
"""

import math
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq

from tianim.lang import ti
from tianim.math.smoothing import cubic_scale, cubic_values, lattice_sum

Floats = NDArray[np.float64]

# Samples of a table on each side of s = 0, up to 1 support; linear between them (error 1e-4).
HALF = 96
COLUMNS = 2 * HALF + 1
# Curvatures (support over radius) 0, 1/4 ... 4: the last is a wire thinner than a spacing.
CURVATURE_STEP = 0.25
CURVATURES = 17
# Rows: for curvature k 4 k + these; slopes are per support.
BALL, BALL_SLOPE, ROD, ROD_SLOPE = 0, 1, 2, 3
CORNER = 4 * CURVATURES  # A
CORNER_SLOPE = CORNER + 1
ROWS = CORNER + 2
RADII = 800  # steps of the integrals over r


@lru_cache(maxsize=8)
def wall_support(support: float, dimension: int) -> float:
    """Support of the kernel that walls see, in spacings, where the particles' is `support` spacings."""
    missing = _lattice_share(support, dimension, 1)
    smallest, largest = 0.55, 2.0 * support
    return float(brentq(lambda h: _half_space(0.5 / h, dimension) - missing, smallest, largest, xtol=1e-6))


@lru_cache(maxsize=8)
def share_tables(support: float, dimension: int) -> NDArray[np.float32]:
    """The table that kernels look up, (ROWS, COLUMNS), for particles of `support` spacings."""
    s = np.linspace(-1.0, 1.0, COLUMNS)
    rows = np.zeros((ROWS, COLUMNS))
    for k in range(CURVATURES):
        curvature = CURVATURE_STEP * k
        rows[4 * k + ROD] = _share(s, curvature, dimension, "rod")
        rows[4 * k + BALL] = _share(s, curvature, dimension, "ball") if dimension == 3 else rows[4 * k + ROD]
    rows[BALL] = rows[ROD] = 0.5 * (rows[BALL] + 1.0 - rows[BALL, ::-1])  # a plane has no front
    rows[CORNER] = _corner_excess(s, rows[BALL], support, dimension)
    for row in (*range(BALL, CORNER, 4), *range(ROD, CORNER, 4), CORNER):
        rows[row + 1] = np.gradient(rows[row], s, edge_order=2)
    return rows.astype(np.float32)


@lru_cache(maxsize=2)
def _marginal_samples(dimension: int) -> tuple[Floats, Floats]:
    """The kernel of support 1 summed along one axis out of three; in two dimensions the kernel."""
    r = np.linspace(0.0, 1.0, RADII + 1)
    if dimension == 2:
        return r, np.asarray(cubic_scale(1.0, 2) * cubic_values(r))
    z = (np.arange(RADII // 2) + 0.5) / (RADII // 2)
    return r, np.asarray(2.0 * cubic_scale(1.0, 3) * cubic_values(np.hypot(r[:, None], z)).mean(axis=1))


def _marginal(r: Floats, dimension: int) -> Floats:
    return np.asarray(np.interp(r, *_marginal_samples(dimension)))


def _share(s: Floats, curvature: float, dimension: int, kind: str) -> Floats:
    """Share of a ball or rod at distances `s`, (n,)."""
    r = (np.arange(RADII) + 0.5) / RADII
    if kind == "ball":
        weight = 4.0 * math.pi * r**2 * cubic_scale(1.0, 3) * cubic_values(r)
    else:
        weight = 2.0 * math.pi * r * _marginal(r, dimension)
    weight /= weight.sum()
    at = s[:, None]
    from_centre = np.maximum(1.0 + curvature * at, 1e-9)  # over the radius; no farther in than the centre
    at = np.where(curvature > 0.0, (from_centre - 1.0) / max(curvature, 1e-9), at)
    if kind == "ball":
        covered = (r - at) * (2.0 + curvature * (at - r)) / (4.0 * r * from_centre)
        # Within the solid all of the sphere is covered, around it none.
        covered = np.where(
            r < -at, 1.0, np.where(curvature * (r - at) > 2.0, 0.0, np.clip(covered, 0.0, 1.0))
        )
    else:
        cosine = (at * (2.0 + curvature * at) + curvature * r**2) / (2.0 * r * from_centre)
        covered = np.arccos(np.clip(cosine, -1.0, 1.0)) / math.pi
    return np.asarray(covered @ weight)


def _half_space(s: float, dimension: int) -> float:
    return float(_share(np.array([s]), 0.0, dimension, "rod")[0])


def _lattice_share(support: float, dimension: int, axes: int) -> float:
    """What a lattice particle misses where all is gone that lies below it along each of `axes` axes."""
    reach = math.ceil(support)
    axis = np.arange(-reach, reach + 1)
    grid = np.stack(np.meshgrid(*[axis] * dimension, indexing="ij"), axis=-1).reshape(-1, dimension)
    gone = (grid[:, :axes] < 0).all(axis=1)
    weights = cubic_scale(support, dimension) * cubic_values(np.linalg.norm(grid, axis=1) / support)
    return float(weights[gone].sum() / lattice_sum(support, dimension))


def _corner_excess(s: Floats, flat: Floats, support: float, dimension: int) -> Floats:
    """A(s): shape from the kernel's quadrants with s = t, size from the lattice's edge."""
    cells = 2 * HALF
    centre = (np.arange(-cells, cells) + 0.5) / cells
    weight = _marginal(np.hypot(centre[:, None], centre), dimension)
    weight /= weight.sum()
    quadrant = np.zeros((2 * cells + 1, 2 * cells + 1))
    quadrant[:-1, :-1] = weight[::-1, ::-1].cumsum(axis=0).cumsum(axis=1)[::-1, ::-1]
    half_space = quadrant[:, 0]
    excess = np.maximum(half_space**2 - np.diag(quadrant), 0.0)[::2]
    edge = _lattice_share(support, dimension, 1) ** 2 - _lattice_share(support, dimension, 2)
    first = 0.5 / wall_support(support, dimension)
    size = math.sqrt(max(edge, 0.0) / np.interp(first, s, excess))
    return np.asarray(size * np.sign(s) * np.sqrt(excess))


@ti.func
def look_up(shares: ti.template(), row, s):
    """The table's row `row` at distance `s` [supports]."""
    at = (ti.max(ti.min(s, 1.0), -1.0) + 1.0) * HALF
    column = ti.min(ti.cast(at, ti.i32), COLUMNS - 2)
    f = at - column
    return shares[row, column] * (1.0 - f) + shares[row, column + 1] * f


@ti.func
def curved(shares: ti.template(), kind: ti.template(), s, curvature):
    """Share and slope of a ball or rod at distance `s` [supports], of `curvature` [1/support]."""
    at = ti.min(curvature / CURVATURE_STEP, CURVATURES - 1.0)
    k = ti.min(ti.cast(at, ti.i32), CURVATURES - 2)
    f = at - k
    row = 4 * k + kind
    share = look_up(shares, row, s) * (1.0 - f) + look_up(shares, row + 4, s) * f
    slope = look_up(shares, row + 1, s) * (1.0 - f) + look_up(shares, row + 5, s) * f
    return ti.Vector([share, slope])


@ti.func
def slab(shares: ti.template(), p, half):
    """Share of |q| < `half` as seen from `p` [supports]; its slope; A and its slope."""
    above, below = half - p, half + p
    return ti.Vector([
        1.0 - look_up(shares, BALL, above) - look_up(shares, BALL, below),
        look_up(shares, BALL_SLOPE, above) - look_up(shares, BALL_SLOPE, below),
        look_up(shares, CORNER, above) + look_up(shares, CORNER, below),
        look_up(shares, CORNER_SLOPE, below) - look_up(shares, CORNER_SLOPE, above),
    ])  # fmt: skip
