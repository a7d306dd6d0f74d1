"""What passes through what: edges that cut triangles, counted by brute force.

    sign V(a b c p) != sign V(a b c q),   V(p q a b), V(p q b c), V(p q c a) of one sign

Every edge p q is held against every triangle a b c whose boxes overlap, in float64 on the float32 places that
frames hold. It shares nothing with the search of the simulation (`self_pairs.py`, `closest.py`), which it
judges.

Limits: some edges times triangles comparisons, seconds from 10,000 points on; what merely touches is not
counted.
"""

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Ints = NDArray[np.int32]

CHUNK = 256  # edges at a time


def intersections(x: Floats, triangles: Ints, same: Ints | None = None) -> int:
    """How many pairs of an edge and a triangle that share no point pass through each other.

    same  (n,) a number for each point, the same for points that are stitched together; None: all differ
    """
    x = x.astype(np.float32).astype(np.float64)
    edges = np.unique(np.sort(triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1), axis=0)
    corners = x[triangles]
    same = np.arange(len(x), dtype=np.int32) if same is None else same
    low, high = corners.min(axis=1).T, corners.max(axis=1).T
    found = 0
    for first in range(0, len(edges), CHUNK):
        some = edges[first : first + CHUNK]
        ends = x[some]
        lower, upper = ends.min(axis=1).T[:, :, None], ends.max(axis=1).T[:, :, None]
        near = (lower[0] <= high[0]) & (upper[0] >= low[0])
        near &= (lower[1] <= high[1]) & (upper[1] >= low[1])
        near &= (lower[2] <= high[2]) & (upper[2] >= low[2])
        e, t = np.nonzero(near)
        found += int(_passes(x, some[e], triangles[t], same).sum())
    return found


def _passes(x: Floats, edge: Ints, triangle: Ints, same: Ints) -> NDArray[np.bool_]:
    """Whether each edge passes through the inside of its triangle."""
    shared = (same[edge][:, :, None] == same[triangle][:, None, :]).any(axis=(1, 2))
    p, q = x[edge[:, 0]], x[edge[:, 1]]
    a, b, c = x[triangle[:, 0]], x[triangle[:, 1]], x[triangle[:, 2]]

    def volume(i: Floats, j: Floats, k: Floats, m: Floats) -> Floats:
        return np.asarray(np.einsum("ij,ij->i", np.cross(j - i, k - i), m - i))

    sides = volume(a, b, c, p) * volume(a, b, c, q)
    u, v, w = volume(p, q, a, b), volume(p, q, b, c), volume(p, q, c, a)
    inside = ((u > 0.0) & (v > 0.0) & (w > 0.0)) | ((u < 0.0) & (v < 0.0) & (w < 0.0))
    return np.asarray((sides < 0.0) & inside & ~shared)
