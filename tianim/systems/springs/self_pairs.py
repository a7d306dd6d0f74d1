"""Which parts of surfaces may meet in a step: a tree of boxes over the triangles.

Every triangle has the box that its corners sweep in the step, with a margin. The boxes are the leaves of a
complete binary tree that is laid out once, from the places at the start, by halves along the longest side;
each step only renews its boxes. Node k has the children 2 k and 2 k + 1, so that what follows a leaf in the
order of the tree is found without a stack: up while k is a right child, then to the right neighbour. Each
leaf walks what follows it, hence each pair of triangles is seen once.

A point and an edge belong to one of their triangles, so that each pair of point and triangle, edge and edge
is written down once too. Those that share a point are none. Leaves are cut into PIECES, each with room of its
own in the list: the order of pairs does not depend on the number of threads.

A grid of cells would need a radius: here triangles may be of any size, and what moves 100 m/s, far.

Limits: at most 2^23 triangles.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from tianim.lang import f32_2d, f64_2d, i32_1d, i32_2d, ti, workers
from tianim.systems.springs.arrays import constant
from tianim.systems.springs.closest import EDGE_EDGE, POINT_TRIANGLE

Floats = NDArray[np.float64]
Ints = NDArray[np.int32]

PIECES = 64
FIRST_ROOM = 256  # pairs of a piece at the start
TURN = PIECES  # place of the turn in the array of counts
FAR = 1e30
# Bits of a triangle's own points and edges.
OWN_POINT, OWN_EDGE = 0, 3


@ti.func
def first_of(piece, n):
    """First of n items that belong to a piece; the items of all pieces are in order."""
    return ti.cast(ti.cast(piece, ti.i64) * n // PIECES, ti.i32)


@ti.kernel
def sweep(n: ti.i32, margin: ti.f32, start: f64_2d, end: f64_2d, box: f32_2d):
    """Box of each point's way with a margin: lower and upper corner."""
    for i in range(n):
        for c in ti.static(range(3)):
            a, b = ti.cast(start[i, c], ti.f32), ti.cast(end[i, c], ti.f32)
            m = margin + 1e-6 * ti.max(ti.abs(a), ti.abs(b))
            box[i, c] = ti.min(a, b) - m
            box[i, 3 + c] = ti.max(a, b) + m


@ti.kernel
def renew(m: ti.i32, leaves: ti.i32, triangle: i32_2d, box: f32_2d, node: f32_2d):
    """Boxes of all nodes from those of the points; leaves without a triangle have none."""
    for i in range(m):
        for c in ti.static(range(3)):
            a, b, d = triangle[i, 0], triangle[i, 1], triangle[i, 2]
            node[leaves + i, c] = ti.min(box[a, c], box[b, c], box[d, c])
            node[leaves + i, 3 + c] = ti.max(box[a, 3 + c], box[b, 3 + c], box[d, 3 + c])
    ti.loop_config(serialize=True)
    for back in range(leaves - 1):
        k = leaves - 1 - back
        for c in ti.static(range(3)):
            node[k, c] = ti.min(node[2 * k, c], node[2 * k + 1, c])
            node[k, 3 + c] = ti.max(node[2 * k, 3 + c], node[2 * k + 1, 3 + c])


@ti.func
def after(k):
    """The node that follows all of node k in the order of the tree; 0 at its end."""
    while k & 1 == 1:
        k = k >> 1
    return ti.select(k == 0, 0, k + 1)


@ti.func
def boxes_meet(a: ti.template(), i, b: ti.template(), j):
    """Whether box i of `a` meets box j of `b`."""
    return (
        (a[i, 0] <= b[j, 3]) & (b[j, 0] <= a[i, 3])
        & (a[i, 1] <= b[j, 4]) & (b[j, 1] <= a[i, 4])
        & (a[i, 2] <= b[j, 5]) & (b[j, 2] <= a[i, 5])
    )  # fmt: skip


@ti.func
def edges_meet(box: ti.template(), a, b, c, d):
    """Whether the box of edge a b meets that of c d."""
    hit = True
    for k in ti.static(range(3)):
        hit &= ti.min(box[a, k], box[b, k]) <= ti.max(box[c, 3 + k], box[d, 3 + k])
        hit &= ti.min(box[c, k], box[d, k]) <= ti.max(box[a, 3 + k], box[b, 3 + k])
    return hit


@ti.func
def note(pair: ti.template(), piece, room, count, kind, a, b, c, d):
    """Write a pair down where there is room; the next count."""
    if count < room:
        k = piece * room + count
        pair[k, 0], pair[k, 1], pair[k, 2], pair[k, 3], pair[k, 4] = kind, a, b, c, d
    return count + 1


@ti.kernel
def find(
    tasks: ti.i32, stride: ti.i32, room: ti.i32, m: ti.i32, leaves: ti.i32, triangle: i32_2d, own: i32_1d,
    same: i32_1d, box: f32_2d, node: f32_2d, pair: i32_2d, count: i32_1d,
):  # fmt: skip
    """All pairs whose boxes meet, piece by piece; counts go on where room ends."""
    count[TURN] = 0
    for block in range(tasks * stride):
        if block % stride == 0:
            piece = ti.atomic_add(count[TURN], 1)
            while piece < PIECES:
                found = 0
                for i in range(first_of(piece, m), first_of(piece + 1, m)):
                    k = after(leaves + i)
                    while k > 0:
                        if not boxes_meet(node, leaves + i, node, k):
                            k = after(k)
                        elif k < leaves:
                            k = 2 * k
                        else:
                            j = k - leaves
                            for swap in range(2):
                                p, q = ti.select(swap == 0, i, j), ti.select(swap == 0, j, i)
                                a, b, c = triangle[q, 0], triangle[q, 1], triangle[q, 2]
                                for corner in range(3):
                                    v = triangle[p, corner]
                                    if own[p] >> (OWN_POINT + corner) & 1 == 1 and boxes_meet(
                                        box, v, node, leaves + q
                                    ):
                                        s = same[v]
                                        if s != same[a] and s != same[b] and s != same[c]:
                                            found = note(pair, piece, room, found, POINT_TRIANGLE, v, a, b, c)
                            for e in range(3):
                                if own[i] >> (OWN_EDGE + e) & 1 == 1:
                                    a, b = triangle[i, e], triangle[i, (e + 1) % 3]
                                    for f in range(3):
                                        c, d = triangle[j, f], triangle[j, (f + 1) % 3]
                                        if own[j] >> (OWN_EDGE + f) & 1 == 1 and edges_meet(box, a, b, c, d):
                                            apart = same[a] != same[c] and same[a] != same[d]
                                            if apart and same[b] != same[c] and same[b] != same[d]:
                                                found = note(pair, piece, room, found, EDGE_EDGE, a, b, c, d)
                            k = after(k)
                count[piece] = found
                piece = ti.atomic_add(count[TURN], 1)


def halved(centre: Floats) -> tuple[NDArray[np.int64], int]:
    """Order of the leaves, by halves along the longest side, and how many there are: a power of two."""
    leaves = 1 << max(len(centre) - 1, 0).bit_length()
    order = np.full(leaves, -1)
    order[: len(centre)] = np.arange(len(centre))
    padded = np.vstack([centre, [[np.inf] * 3]])  # the last is that of leaves without a triangle
    size = leaves
    while size > 1:
        groups = order.reshape(-1, size)
        x = padded[groups]
        real = np.isfinite(x)
        extent = np.where(real, x, -np.inf).max(axis=1) - np.where(real, x, np.inf).min(axis=1)
        axis = np.where(np.isfinite(extent), extent, 0.0).argmax(axis=1)
        key = np.take_along_axis(x, axis[:, None, None], axis=2)[:, :, 0]
        order = np.take_along_axis(groups, np.argsort(key, axis=1, kind="stable"), axis=1).ravel()
        size //= 2
    return order, leaves


def owners(triangles: Ints) -> Ints:
    """Bits of the points and edges that each triangle owns: those that no triangle before it has."""
    own = np.zeros(len(triangles), np.int32)
    edges = np.sort(np.stack([triangles, np.roll(triangles, -1, axis=1)], axis=2), axis=2).astype(np.int64)
    codes = edges[:, :, 0] * (int(triangles.max()) + 1) + edges[:, :, 1]
    for first_bit, values in ((OWN_POINT, triangles), (OWN_EDGE, codes)):
        _, first = np.unique(values.ravel(), return_index=True)
        np.bitwise_or.at(own, first // 3, 1 << (first_bit + first % 3).astype(np.int32))
    return own


class Pairs:
    """The list: `pair` (PIECES * room, 5) with kind and four points, `count` (PIECES + 1,) by piece.

    points   how many points there are
    """

    def __init__(self, position: Floats, triangles: Ints, same: Ints) -> None:
        self.points = len(position)
        order, self.leaves = halved(position[triangles].mean(axis=1))
        self.triangles = np.ascontiguousarray(triangles[order[order >= 0]], np.int32)
        self.tasks, self.stride = workers()
        self._triangle = constant(self.triangles)
        self._own = constant(owners(self.triangles))
        self.same = constant(same)
        self._box = ti.ndarray(ti.f32, (self.points, 6))
        self._node = ti.ndarray(ti.f32, (2 * self.leaves, 6))
        self._node.from_numpy(np.tile(np.array([FAR] * 3 + [-FAR] * 3, np.float32), (2 * self.leaves, 1)))
        self.count: Any = ti.ndarray(ti.i32, PIECES + 1)
        self.room = 0
        self._make_room(FIRST_ROOM)

    def _make_room(self, room: int) -> None:
        self.room = room
        self.pair: Any = ti.ndarray(ti.i32, (PIECES * room, 5))
        self.gap: Any = ti.ndarray(ti.f64, PIECES * room)
        self.flag: Any = ti.ndarray(ti.f32, PIECES * room)

    def find(self, start: Any, end: Any, margin: float) -> int:
        """All pairs that come nearer than twice the margin on their way; how many."""
        sweep(self.points, margin, start, end, self._box)
        renew(len(self.triangles), self.leaves, self._triangle, self._box, self._node)
        while True:
            find(
                self.tasks, self.stride, self.room, len(self.triangles), self.leaves, self._triangle,
                self._own, self.same, self._box, self._node, self.pair, self.count,
            )  # fmt: skip
            counts = self.count.to_numpy()[:PIECES]
            if counts.max() <= self.room:
                return int(counts.sum())
            self._make_room(int(1.5 * counts.max()))
