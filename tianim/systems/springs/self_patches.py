"""Patches of triangles for the search of pairs: laid out once, from the places at the start.

One of PATCH triangles of what hangs together is a seed, evenly in space; a patch is the triangles nearest to
its seed along the surface.
"""

import numpy as np
import scipy  # loads its parts when they are first used
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Ints = NDArray[np.int32]

PATCH = 32  # triangles of a patch, about
# Bits of a triangle's own points and edges.
OWN_POINT, OWN_EDGE = 0, 3


def halved(centre: Floats) -> NDArray[np.int64]:
    """Order of the triangles: by halves along the longest side, down to single ones."""
    size = 1 << max(len(centre) - 1, 0).bit_length()
    order = np.full(size, -1)
    order[: len(centre)] = np.arange(len(centre))
    padded = np.vstack([centre, [[np.inf] * 3]])  # the last is that of places without a triangle
    while size > 1:
        groups = order.reshape(-1, size)
        x = padded[groups]
        real = np.isfinite(x)
        extent = np.where(real, x, -np.inf).max(axis=1) - np.where(real, x, np.inf).min(axis=1)
        axis = np.where(np.isfinite(extent), extent, 0.0).argmax(axis=1)
        key = np.take_along_axis(x, axis[:, None, None], axis=2)[:, :, 0]
        order = np.take_along_axis(groups, np.argsort(key, axis=1, kind="stable"), axis=1).ravel()
        size //= 2
    return order[order >= 0]


def joints(corner: Ints) -> tuple[Ints, Ints, Ints]:
    """Triangles on both sides of the edges at which two meet that turn the same way round, and their ends."""
    count = int(corner.max()) + 1
    a, b = corner.ravel().astype(np.int64), np.roll(corner, -1, axis=1).ravel().astype(np.int64)
    codes, place, times = np.unique(a * count + b, return_index=True, return_counts=True)
    codes, place = codes[times == 1], place[times == 1]
    back = codes % count * count + codes // count
    at = np.minimum(np.searchsorted(codes, back), len(codes) - 1)
    both = (codes[at] == back) & (codes < back)
    ends = np.stack([codes[both] // count, codes[both] % count], axis=1)
    return place[both] // 3, place[at[both]] // 3, ends


def patched(centre: Floats, corner: Ints) -> tuple[NDArray[np.int64], Ints]:
    """Order of the triangles by patches that hang together, and the first of each patch."""
    m = len(corner)
    a, b, _ = joints(corner)
    far = np.linalg.norm(centre[a] - centre[b], axis=1) + 1e-12  # zeros would be no edges
    graph = scipy.sparse.csr_matrix((far, (a, b)), shape=(m, m))
    _, part = scipy.sparse.csgraph.connected_components(graph, directed=False)
    order = halved(centre)
    rank = np.empty(m, np.int64)
    rank[order] = np.arange(m)
    by_part = order[np.argsort(part[order], kind="stable")]
    size = np.bincount(part)
    place = np.arange(m) - np.repeat(np.cumsum(size) - size, size)
    middle = np.minimum(PATCH // 2, size - 1)[part[by_part]]
    seeds = by_part[place % PATCH == middle]
    seeds = seeds[np.argsort(rank[seeds])]
    _, _, source = scipy.sparse.csgraph.dijkstra(
        graph, directed=False, indices=seeds, return_predecessors=True, min_only=True
    )
    patch = np.searchsorted(rank[seeds], rank[source])
    first = np.concatenate([[0], np.cumsum(np.bincount(patch, minlength=len(seeds)))]).astype(np.int32)
    return np.lexsort((rank, patch)), first


def beside_of(first: Ints, corner: Ints) -> tuple[Ints, Ints]:
    """The patches that share a point with each, about which triangles go round edge by edge: start, lists.

    Where two fans meet in a point, or two sides of a surface, they may meet elsewhere however flat they are.
    """
    patches, points = len(first) - 1, int(corner.max()) + 1
    patch = np.repeat(np.arange(patches, dtype=np.int64), np.diff(first))
    around = np.bincount(corner.ravel(), minlength=points)
    one_fan = around - np.bincount(joints(corner)[2].ravel(), minlength=points) <= 1
    known = one_fan[corner.ravel()]
    touches = scipy.sparse.csr_matrix(
        (np.ones(int(known.sum()), np.int32), (np.repeat(patch, 3)[known], corner.ravel()[known])),
        shape=(patches, points),
    )
    shared = (touches @ touches.T).tocoo()
    codes = np.unique(shared.row.astype(np.int64) * patches + shared.col)
    start = np.searchsorted(codes, np.arange(patches + 1) * np.int64(patches)).astype(np.int32)
    return start, (codes % patches).astype(np.int32)


def owners(triangles: Ints) -> Ints:
    """Bits of the points and edges that each triangle owns: those that no triangle before it has."""
    own = np.zeros(len(triangles), np.int32)
    edges = np.sort(np.stack([triangles, np.roll(triangles, -1, axis=1)], axis=2), axis=2).astype(np.int64)
    codes = edges[:, :, 0] * (int(triangles.max()) + 1) + edges[:, :, 1]
    for first_bit, values in ((OWN_POINT, triangles), (OWN_EDGE, codes)):
        _, first = np.unique(values.ravel(), return_index=True)
        np.bitwise_or.at(own, first // 3, 1 << (first_bit + first % 3).astype(np.int32))
    return own
