"""The pressure of a fluid at rest, from which a settled block starts.

    P(x) = integral of rho g from x up to the free surface above it

Particles are taken in columns one spacing wide along gravity. In a column the fluid is one stack as far
as there is no gap; its surface is half a spacing over its uppermost particle. Where a body lies on
the stack instead, the pressure there is that of the fluid beside it at the same height.
"""

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from tianim.spatial.bodies import Bodies

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

# Neighbours in a stack, or of one body of fluid, are nearer than this [spacings].
NEAR = 1.5
# Over a stack there is a body where a place one spacing up is nearer to one than this [spacings].
COVERED = 0.6


def rest_pressure(
    position: Floats, density: Floats, gravity: Floats, spacing: float, bodies: Bodies
) -> Floats:
    """P of each particle [Pa], (n,); `density` (n,) [kg/m3] of its phase at rest, `gravity` (3,) [m/s2]."""
    g = float(np.linalg.norm(gravity))
    if g == 0.0 or len(position) == 0:
        return np.zeros(len(position))
    up = -gravity / g
    height = position @ up
    order, stack, heads = _stacks(position, height, up, spacing)
    # In `order`: from the top of each stack downwards, half of each of two neighbours between them.
    weight = g * density[order]
    drop = -np.diff(height[order], prepend=0.0)
    step = 0.5 * drop * (weight + np.roll(weight, 1))
    step[heads] = 0.5 * spacing * weight[heads]
    total = np.cumsum(step)
    pressure = total - (total[heads] - step[heads])[stack]
    if bodies.count:
        above = position[order][heads] + spacing * up
        covered = bodies.distance(above)[0] < COVERED * spacing
        if covered.any() and not covered.all():
            pressure += _under_bodies(
                position[order], height[order], pressure, stack, heads, covered, spacing
            )
    result = np.empty(len(position))
    result[order] = pressure
    return result


def _stacks(position: Floats, height: Floats, up: Floats, spacing: float) -> tuple[Ints, Ints, Ints]:
    """Particles from top to bottom, stack by stack; the stack of each, and where each begins."""
    axes = np.linalg.svd(up[None])[2][1:]  # two directions at right angles to up
    flat = position @ axes.T
    cells = np.round((flat - flat.min(axis=0)) / spacing).astype(np.int64)
    column = cells[:, 0] * (cells[:, 1].max() + 1) + cells[:, 1]
    order = np.lexsort((-height, column))
    sorted_height, sorted_column = height[order], column[order]
    begins = np.ones(len(order), np.bool_)
    begins[1:] = (np.diff(sorted_column) != 0) | (-np.diff(sorted_height) > NEAR * spacing)
    return order, np.cumsum(begins) - 1, np.flatnonzero(begins)


def _under_bodies(
    position: Floats, height: Floats, pressure: Floats, stack: Ints, heads: Ints, covered: NDArray[np.bool_],
    spacing: float,
) -> Floats:  # fmt: skip
    """What is added [Pa] in stacks that end under a body: their tops take the pressure beside them."""
    pairs = cKDTree(position).query_pairs(NEAR * spacing, output_type="ndarray")
    graph = coo_array((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(len(position),) * 2)
    fluid = connected_components(graph, directed=False)[1]
    layer = np.round((height - height.min()) / spacing).astype(np.int64)
    place = fluid * (layer.max() + 1) + layer
    beside = np.zeros(place.max() + 1)
    np.maximum.at(beside, place, np.where(covered[stack], 0.0, pressure))
    missing = np.maximum(beside[place[heads]] - pressure[heads], 0.0)
    return np.asarray(np.where(covered, missing, 0.0)[stack])
