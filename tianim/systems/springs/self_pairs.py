"""Which parts of surfaces may meet in a step: a tree of boxes over patches of triangles.

Patches hang together (`self_patches.py`). Every patch has the box that its points sweep in the step, with a
margin, and the cone of its normals on the way. The patches are the leaves of a complete binary tree; each
step only renews its boxes. Node k has the children 2 k and 2 k + 1, so that what follows a leaf in the order
of the tree is found without a stack: up while k is a right child, then to the right neighbour. Each leaf
walks what follows it, hence each pair of patches is seen once.

**What is nearly flat cannot meet itself**: a patch, or two that share a point, is left out while all its
normals lie within FLAT of an axis, for then it is a graph over a plane and folds nowhere, and half of all
distances are left, which is what it keeps anyway (Volino and Magnenat-Thalmann 1994,
doi:10.1111/1467-8659.1330155). Most of a calm cloth is not looked at.

A point and an edge belong to one of their triangles, so that each pair of point and triangle, edge and edge
is written down once too, if it is near or may come near. Those that share a point are none. Patches are cut
into PIECES, each with room of its own in the list: the order of pairs does not depend on the number of
threads.

A grid of cells would need a radius: here triangles may be of any size, and what moves 100 m/s, far.

Limits: at most 2^23 triangles. What is torn while it is nearly flat may pass through itself.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from tianim.lang import f32_1d, f32_2d, f64_1d, f64_2d, i32_1d, i32_2d, ti, workers
from tianim.systems.springs.arrays import constant, triple
from tianim.systems.springs.closest import EDGE_EDGE, POINT_TRIANGLE, between, closest, reach
from tianim.systems.springs.self_gaps import MARGIN, NEAR, kept_apart, least_gap, wanted
from tianim.systems.springs.self_patches import OWN_EDGE, OWN_POINT, beside_of, owners, patched

Floats = NDArray[np.float64]
Ints = NDArray[np.int32]

PIECES = 64
FIRST_ROOM = 256  # pairs of a piece at the start
TURN = PIECES  # place of the turn in the array of counts
FAR = 1e30
# Most angle [rad] between an axis and the normals of what is nearly flat.
FLAT = np.pi / 3.0
# Pairs of point and triangle, and of all, that two triangles have.
POINT_PAIRS, ALL_PAIRS = 6, 15
# Flags of a pair: near at the start of the step, or not; in between is the part of it after which it meets.
AT_START, NEVER = 0.0, 2.0


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


@ti.func
def normals(triangle: ti.template(), start: ti.template(), end: ti.template(), i):
    """Normals of triangle i on its way lie within these, as its corners move evenly: a quadratic in time.

    Tang, Curtis, Yoon, Manocha 2009, doi:10.1145/1618452.1618481. Zero where one vanishes.
    """
    a, b, c = triangle[i, 0], triangle[i, 1], triangle[i, 2]
    u0 = ti.cast(triple(start, b) - triple(start, a), ti.f32)
    v0 = ti.cast(triple(start, c) - triple(start, a), ti.f32)
    u1, v1 = (
        ti.cast(triple(end, b) - triple(end, a), ti.f32),
        ti.cast(triple(end, c) - triple(end, a), ti.f32),
    )
    first, last = u0.cross(v0), u1.cross(v1)
    mid = 0.5 * (u0.cross(v1) + u1.cross(v0))
    return _unit(first), _unit(mid), _unit(last)


@ti.func
def _unit(n):
    return n / ti.max(n.norm(), 1e-30)


@ti.kernel
def renew(
    leaves: ti.i32, used: ti.i32, first: i32_1d, triangle: i32_2d, start: f64_2d, end: f64_2d, box: f32_2d,
    swept: f32_2d, node: f32_2d, cone: f32_2d,
):  # fmt: skip
    """Boxes of triangles, patches and all nodes from those of the points; cones of the patches."""
    for p in range(used):
        low, high = ti.Vector([FAR, FAR, FAR]), ti.Vector([-FAR, -FAR, -FAR])
        axis = ti.Vector([0.0, 0.0, 0.0])
        for i in range(first[p], first[p + 1]):
            for c in ti.static(range(3)):
                a, b, d = triangle[i, 0], triangle[i, 1], triangle[i, 2]
                swept[i, c] = ti.min(box[a, c], box[b, c], box[d, c])
                swept[i, 3 + c] = ti.max(box[a, 3 + c], box[b, 3 + c], box[d, 3 + c])
                low[c], high[c] = ti.min(low[c], swept[i, c]), ti.max(high[c], swept[i, 3 + c])
            before, mid, last = normals(triangle, start, end, i)
            axis += before + mid + last
        axis = _unit(axis)
        cosine = 1.0
        for i in range(first[p], first[p + 1]):
            before, mid, last = normals(triangle, start, end, i)
            cosine = ti.min(cosine, before.dot(axis), mid.dot(axis), last.dot(axis))
        for c in ti.static(range(3)):
            node[leaves + p, c], node[leaves + p, 3 + c] = low[c], high[c]
            cone[p, c] = axis[c]
        cone[p, 3] = ti.acos(ti.max(cosine, -1.0))
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
def may_meet(cone: ti.template(), beside_start: ti.template(), beside: ti.template(), p, q):
    """Whether patches p and q, or p and itself, are not nearly flat together."""
    folded = cone[p, 3] > FLAT or cone[q, 3] > FLAT
    if p != q and not folded:
        folded = True
        for e in range(beside_start[p], beside_start[p + 1]):
            if beside[e] == q:
                cosine = cone[p, 0] * cone[q, 0] + cone[p, 1] * cone[q, 1] + cone[p, 2] * cone[q, 2]
                between_axes = ti.acos(ti.min(ti.max(cosine, -1.0), 1.0))
                folded = 0.5 * (between_axes + cone[p, 3] + cone[q, 3]) > FLAT
    return folded


@ti.func
def pair_of(triangle: ti.template(), own: ti.template(), same: ti.template(), box: ti.template(),
            swept: ti.template(), i, j, t):  # fmt: skip
    """Pair t of triangles i and j: whether there is one whose boxes meet, its kind, its points."""
    p, q = ti.select(t < 3, i, j), ti.select(t < 3, j, i)
    kind, there = POINT_TRIANGLE, False
    a, b, c, d = triangle[p, t % 3], triangle[q, 0], triangle[q, 1], triangle[q, 2]
    if t < POINT_PAIRS:
        there = own[p] >> (OWN_POINT + t % 3) & 1 == 1 and boxes_meet(box, a, swept, q)
        there = there and same[a] != same[b]
    else:
        e, f = (t - POINT_PAIRS) // 3, t % 3
        kind = EDGE_EDGE
        a, b = triangle[i, e], triangle[i, (e + 1) % 3]
        c, d = triangle[j, f], triangle[j, (f + 1) % 3]
        there = own[i] >> (OWN_EDGE + e) & 1 == 1 and own[j] >> (OWN_EDGE + f) & 1 == 1
        there = there and same[b] != same[c] and same[b] != same[d]
        there = there and edges_meet(box, a, b, c, d)
    there = there and same[a] != same[c] and same[a] != same[d]
    return there, kind, a, b, c, d


@ti.kernel
def find(
    tasks: ti.i32, stride: ti.i32, room: ti.i32, leaves: ti.i32, used: ti.i32, thickness: ti.f64,
    slack: ti.f64, first: i32_1d, triangle: i32_2d, own: i32_1d, same: i32_1d, group: i32_1d, rest: f64_2d,
    start: f64_2d, end: f64_2d, box: f32_2d, swept: f32_2d, node: f32_2d, cone: f32_2d, beside_start: i32_1d,
    beside: i32_1d, pair: i32_2d, count: i32_1d, gap: f64_1d, flag: f32_1d, met: i32_1d,
):  # fmt: skip
    """Pairs that are near, flagged and counted in `met`, or may come near while no point leaves `slack`.

    `gap` is their distance at the start. Counts go on where room ends.
    """
    count[TURN] = 0
    for block in range(tasks * stride):
        if block % stride == 0:
            piece = ti.atomic_add(count[TURN], 1)
            while piece < PIECES:
                found, flagged = 0, 0
                for p in range(first_of(piece, used), first_of(piece + 1, used)):
                    k = leaves + p
                    while k > 0:
                        if not boxes_meet(node, leaves + p, node, k):
                            k = after(k)
                        elif k < leaves:
                            k = 2 * k
                        else:
                            q = k - leaves
                            if may_meet(cone, beside_start, beside, p, q):
                                for i in range(first[p], first[p + 1]):
                                    if boxes_meet(swept, i, node, k):
                                        for j in range(ti.max(first[q], i + 1), first[q + 1]):
                                            if boxes_meet(swept, i, swept, j):
                                                for t in range(ALL_PAIRS):
                                                    there, kind, a, b, c, d = pair_of(
                                                        triangle, own, same, box, swept, i, j, t
                                                    )
                                                    if there:
                                                        listed, near, far = judged(
                                                            thickness, slack, group, rest, start, end, kind,
                                                            a, b, c, d,
                                                        )  # fmt: skip
                                                        if listed == 1:
                                                            if found < room:
                                                                at = piece * room + found
                                                                pair[at, 0], pair[at, 1] = kind, a
                                                                pair[at, 2], pair[at, 3] = b, c
                                                                pair[at, 4], gap[at] = d, far
                                                                flag[at] = ti.select(
                                                                    near == 1, AT_START, NEVER
                                                                )
                                                            found += 1
                                                            flagged += near
                            k = after(k)
                count[piece], met[piece] = found, flagged
                piece = ti.atomic_add(count[TURN], 1)


@ti.func
def judged(
    thickness, slack, group: ti.template(), rest: ti.template(), start: ti.template(), end: ti.template(),
    kind, a, b, c, d,
):  # fmt: skip
    """Whether a pair is to be listed, whether it is near, and its distance at the start."""
    xa, xb, xc, xd = triple(start, a), triple(start, b), triple(start, c), triple(start, d)
    w = closest(kind, xa, xb, xc, xd)
    n = between(w, xa, xb, xc, xd)
    far = n.norm()
    ya, yb, yc, yd = triple(end, a), triple(end, b), triple(end, c), triple(end, d)
    listed, near = 0, 0
    if far > 0.0:
        most = reach(kind, ya - xa, yb - xb, yc - xc, yd - xd) + 2.0 * slack
        if most > far - least_gap(far, thickness):
            listed = 1
        if far < NEAR * thickness:
            h = kept_apart(thickness, group, rest, kind, a, b, c, d)
            then = between(w, ya, yb, yc, yd).dot(n) / far
            if far < NEAR * h and then < wanted(far, h) + MARGIN * h:
                listed, near = 1, 1
    return listed, near, far


class Pairs:
    """The list: `pair` (PIECES * room, 5) with kind and four points, `count` (PIECES + 1,) by piece.

    points   how many points there are
    gap      distances at the start of the step, (PIECES * room,)
    flag     AT_START, NEVER or the part of the step after which they meet, (PIECES * room,)
    met      flagged ones by piece
    """

    def __init__(self, position: Floats, triangles: Ints, same: Ints, group: Ints, thickness: float) -> None:
        self.points, self._thickness = len(position), thickness
        order, first = patched(position[triangles].mean(axis=1), same[triangles])
        self.triangles = np.ascontiguousarray(triangles[order], np.int32)
        self.tasks, self.stride = workers()
        self._used = len(first) - 1
        self._leaves = 1 << (self._used - 1).bit_length()
        beside_start, beside = beside_of(first, same[self.triangles])
        self._first, self._beside_start, self._beside = (
            constant(first),
            constant(beside_start),
            constant(beside),
        )
        self._triangle, self._own = constant(self.triangles), constant(owners(self.triangles))
        self.same, self.group = constant(same), constant(group)
        self.rest: Any = ti.ndarray(ti.f64, position.shape)
        self.rest.from_numpy(np.ascontiguousarray(position, np.float64))
        self._box = ti.ndarray(ti.f32, (self.points, 6))
        self._swept = ti.ndarray(ti.f32, (len(self.triangles), 6))
        self._cone = ti.ndarray(ti.f32, (self._used, 4))
        self._node = ti.ndarray(ti.f32, (2 * self._leaves, 6))
        nothing = np.array([FAR] * 3 + [-FAR] * 3, np.float32)
        self._node.from_numpy(np.tile(nothing, (2 * self._leaves, 1)))
        self.count: Any = ti.ndarray(ti.i32, PIECES + 1)
        self.met: Any = ti.ndarray(ti.i32, PIECES)
        self.room = 0
        self._make_room(FIRST_ROOM)

    def _make_room(self, room: int) -> None:
        self.room = room
        self.pair: Any = ti.ndarray(ti.i32, (PIECES * room, 5))
        self.gap: Any = ti.ndarray(ti.f64, PIECES * room)
        self.flag: Any = ti.ndarray(ti.f32, PIECES * room)

    def find(self, start: Any, end: Any, slack: float) -> None:
        """List the pairs that are near or may come near while `end` moves by at most `slack`."""
        margin = 0.5 * NEAR * self._thickness + slack
        sweep(self.points, margin, start, end, self._box)
        renew(
            self._leaves, self._used, self._first, self._triangle, start, end, self._box, self._swept,
            self._node, self._cone,
        )  # fmt: skip
        while True:
            find(
                self.tasks, self.stride, self.room, self._leaves, self._used, self._thickness, slack,
                self._first, self._triangle, self._own, self.same, self.group, self.rest, start, end,
                self._box, self._swept, self._node, self._cone, self._beside_start, self._beside, self.pair,
                self.count, self.gap, self.flag, self.met,
            )  # fmt: skip
            counts = self.count.to_numpy()[:PIECES]
            if counts.max() <= self.room:
                return
            self._make_room(int(1.5 * counts.max()))
