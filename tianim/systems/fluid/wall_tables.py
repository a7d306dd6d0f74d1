"""Shares: how much of a particle's surroundings a wall takes, as tables over the distance.

At the first layer, half a spacing d from a wall, two numbers are given:

    lambda = c    what the lattice of the fluid misses there: its layers on the wall's side, 0.150 for a
                  support of 2 d. Then every layer of a lattice before a plane has density 1. (The integral of
                  the kernel over the half space is 0.188: particles do not fill space evenly, none is nearer
                  than about d. A fluid before such a wall would stand 4 % too dense, and be driven off.)
    lambda' = -1/d  A particle of the first layer has d^2 of the wall and bears P d^2 for all the fluid behind
                  it. The wall's force on it is V P grad lambda, the transpose of what makes it (pressure.py).

The share falls off as a square, which has both and ends smoothly at d/2 + 2 c d, 0.8 d, before the second
layer, which misses nothing:

    law(z) = c ((d/2 + 2 c d - z) / (2 c d))^2        at most 1/2; beyond the surface 1 - law(-z)

With a support of more than 2 d the second layer misses something too (0.002 of 2.75 d in the plane). For it
there is a tail, a square that ends where nothing is missing any more; the steep part then is for what is left
of c and, so that the slopes of both layers together are -1/d, of the slope.

A wall that is curved, of radius R, has the same law times a part: the integral of the kernel over it seen
from the first layer, over that for a plane. A sphere of radius r about a particle at distance s is covered
by a ball (solid cylinder, disc in two dimensions), with k = 1/R, to the parts

    ball   (r - s)(2 + k (s - r)) / (4 r (1 + k s))
    rod    acos( (s (2 + k s) + k r^2) / (2 r (1 + k s)) ) / pi     of a circle about it, across the axis

The kernel of these integrals has a smaller support (1.71 d for 2 d), such that a half space weighs c.

A box is a product of slabs, each 1 less two half spaces. The lattice is no product: an edge takes 0.0191 of
it, not c^2 = 0.0224. What is left over, E(s, t) = share of a quadrant - L(s) L(t), is odd in s and in t;
for the kernel it is itself a product, -A(s) A(t), to 1e-4. So here, with A = law sqrt(c^2 - edge) / c; a
corner of the lattice then comes out as well (0.6063 for 0.6066).
"""

import math
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq

from tianim.lang import ti
from tianim.math.smoothing import lattice_sum, spline_scale, spline_values

Floats = NDArray[np.float64]

# Samples of a table on each side of s = 0, up to 1 reach; linear between them (error 1e-4).
HALF = 96
COLUMNS = 2 * HALF + 1
# Curvatures (reach over radius) 0, 1/4 ... 4: the last is a wire thinner than half a spacing.
CURVATURE_STEP = 0.25
CURVATURES = 17
# Rows: for curvature k 4 k + these; slopes are per reach.
BALL, BALL_SLOPE, ROD, ROD_SLOPE = 0, 1, 2, 3
CORNER = 4 * CURVATURES  # A
CORNER_SLOPE = CORNER + 1
ROWS = CORNER + 2
FIRST, SECOND = 0.5, 1.5  # distances of the first layers [spacings]
# Nearer to a wall than so many spacings the share is 1/2. Contacts keep particles out of there; the slope
# that they feel at it stays for those a little nearer, and ends where the edges of solids are looked up.
CLOSEST, SLOPES_END = 0.25, 0.1
RADII = 800  # steps of the integrals over r


def reach(support: float, dimension: int) -> float:
    """Where shares end [spacings], for particles whose kernel has a support of `support` spacings."""
    return max(FIRST + _steep(support, dimension)[1], _tail(support, dimension)[1])


def _tail(support: float, dimension: int) -> tuple[float, float]:
    """What the second layer misses, and where the tail of the law ends [spacings]."""
    second = _lattice_share(support, dimension, 1, 2)
    return second, support - FIRST if second > 0.0 else FIRST


def _tail_law(z: Floats, support: float, dimension: int) -> tuple[Floats, Floats]:
    """The tail at distances z [spacings], and its slope."""
    second, end = _tail(support, dimension)
    if second == 0.0:
        return 0.0 * z, 0.0 * z
    width = end - SECOND
    left = np.maximum(end - z, 0.0) / width
    return second * left**2, -2.0 * second * left / width


def _steep(support: float, dimension: int) -> tuple[float, float]:
    """What the steep part of the law is at the first layer, and how much farther it goes [spacings]."""
    tail, slope = _tail_law(np.array([FIRST, SECOND]), support, dimension)
    part = _lattice_share(support, dimension, 1) - float(tail[0])
    return part, 2.0 * part / (1.0 + float(slope.sum()))


@lru_cache(maxsize=8)
def share_tables(support: float, dimension: int) -> NDArray[np.float32]:
    """The table that kernels look up, (ROWS, COLUMNS), over distances in reaches."""
    s = np.linspace(-1.0, 1.0, COLUMNS)
    missing, unit = _lattice_share(support, dimension, 1), reach(support, dimension)
    law, slope = share_law(np.abs(s) * unit, support, dimension)
    rows = np.zeros((ROWS, COLUMNS))
    for k in range(CURVATURES):
        for kind, row in (("ball", 4 * k + BALL), ("rod", 4 * k + ROD)):
            curvature = CURVATURE_STEP * k / unit
            solid, container = _parts(curvature, support, dimension, kind if dimension == 3 else "rod")
            rows[row] = np.where(s >= 0.0, solid * law, 1.0 - container * law)
            rows[row + 1] = np.where(s >= 0.0, solid, container) * slope * unit
    edge = math.sqrt(max(missing**2 - _lattice_share(support, dimension, 2), 0.0)) / missing
    rows[CORNER], rows[CORNER_SLOPE] = np.sign(s) * edge * law, edge * slope * unit
    return rows.astype(np.float32)


def share_law(z: Floats, support: float, dimension: int) -> tuple[Floats, Floats]:
    """Share of a plane at distances `z` >= 0 [spacings], and its slope per spacing."""
    part, width = _steep(support, dimension)
    z, kept = np.maximum(z, CLOSEST), np.clip(2.0 * (z - SLOPES_END) / (CLOSEST - SLOPES_END), 0.0, 1.0)
    left = np.maximum(FIRST + width - z, 0.0) / width
    tail, slope = _tail_law(z, support, dimension)
    return np.minimum(part * left**2 + tail, 0.5), (slope - 2.0 * part * left / width) * kept


def _parts(curvature: float, support: float, dimension: int, kind: str) -> tuple[float, float]:
    """Of a plane's share, that of a solid of `curvature` [1/spacing], and of a container."""
    unit = _wall_support(support, dimension)
    at = np.array([FIRST, -FIRST]) / unit
    before, behind = _share(at, curvature * unit, dimension, kind)
    plane = _share(at[:1], 0.0, dimension, kind)[0]
    return before / plane, (1.0 - behind) / plane


@lru_cache(maxsize=8)
def _wall_support(support: float, dimension: int) -> float:
    """Support [spacings] of a kernel of which a half space takes what the lattice's first layer misses."""
    missing = _lattice_share(support, dimension, 1)

    def excess(unit: float) -> float:
        return float(_share(np.array([FIRST / unit]), 0.0, dimension, "rod")[0]) - missing

    return float(brentq(excess, 1.1 * FIRST, 2.0 * support, xtol=1e-6))


@lru_cache(maxsize=2)
def _marginal_samples(dimension: int) -> tuple[Floats, Floats]:
    """The kernel of support 1 summed along one axis out of three; in two dimensions the kernel."""
    r = np.linspace(0.0, 1.0, RADII + 1)
    if dimension == 2:
        return r, np.asarray(spline_scale(1.0, 2) * spline_values(r, 2))
    z = (np.arange(RADII // 2) + 0.5) / (RADII // 2)
    return r, np.asarray(2.0 * spline_scale(1.0, 3) * spline_values(np.hypot(r[:, None], z), 3).mean(axis=1))


def _marginal(r: Floats, dimension: int) -> Floats:
    return np.asarray(np.interp(r, *_marginal_samples(dimension)))


def _share(s: Floats, curvature: float, dimension: int, kind: str) -> Floats:
    """Share of a ball or rod at distances `s`, (n,)."""
    r = (np.arange(RADII) + 0.5) / RADII
    if kind == "ball":
        weight = 4.0 * math.pi * r**2 * spline_scale(1.0, 3) * spline_values(r, 3)
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


@lru_cache(maxsize=32)
def _lattice_share(support: float, dimension: int, axes: int, layer: int = 1) -> float:
    """What a lattice particle misses where all from a layer below it on is gone, along `axes` axes."""
    axis = np.arange(-math.ceil(support), math.ceil(support) + 1)
    grid = np.stack(np.meshgrid(*[axis] * dimension, indexing="ij"), axis=-1).reshape(-1, dimension)
    gone = (grid[:, :axes] <= -layer).all(axis=1)
    r = np.linalg.norm(grid, axis=1) / support
    weights = spline_scale(support, dimension) * spline_values(r, dimension)
    return float(weights[gone].sum() / lattice_sum(support, dimension))


@ti.func
def look_up(shares: ti.template(), row, s):
    """The table's row `row` at distance `s` [reaches]."""
    at = (ti.max(ti.min(s, 1.0), -1.0) + 1.0) * HALF
    column = ti.min(ti.cast(at, ti.i32), COLUMNS - 2)
    f = at - column
    return shares[row, column] * (1.0 - f) + shares[row, column + 1] * f


@ti.func
def curved(shares: ti.template(), kind: ti.template(), s, curvature):
    """Share and slope of a ball or rod at distance `s` [reaches], of `curvature` [1/reach]."""
    at = ti.min(curvature / CURVATURE_STEP, CURVATURES - 1.0)
    k = ti.min(ti.cast(at, ti.i32), CURVATURES - 2)
    f = at - k
    row = 4 * k + kind
    share = look_up(shares, row, s) * (1.0 - f) + look_up(shares, row + 4, s) * f
    slope = look_up(shares, row + 1, s) * (1.0 - f) + look_up(shares, row + 5, s) * f
    return ti.Vector([share, slope])


@ti.func
def slab(shares: ti.template(), p, half):
    """Share of |q| < `half` as seen from `p` [reaches]; its slope; A and its slope."""
    above, below = half - p, half + p
    found = ti.Vector([1.0, 0.0, 0.0, 0.0])
    if ti.min(above, below) < 1.0:  # most particles are near one pair of faces of a tank at the most
        found = ti.Vector([
            1.0 - look_up(shares, BALL, above) - look_up(shares, BALL, below),
            look_up(shares, BALL_SLOPE, above) - look_up(shares, BALL_SLOPE, below),
            look_up(shares, CORNER, above) + look_up(shares, CORNER, below),
            look_up(shares, CORNER_SLOPE, below) - look_up(shares, CORNER_SLOPE, above),
        ])  # fmt: skip
    return found
