"""A sparse matrix factored once, A = L D L^T, and solved with inside a kernel by all workers at once.

Points are put into the order of nested dissection (George 1973, doi:10.1137/0710032): a line of points parts
the others into two halves that do not know each other, and is eliminated after both; so on in each half.
SciPy's SuperLU factors. In the tree of eliminations each worker gets branches of its own; what is left at the
top, the first dividing lines, one worker does:

    forward   y_i = b_i - sum_j L_ij y_j          rows of L, each branch by itself, then the top
    backward  x_i = y_i / D_i - sum_j L_ji x_j    rows of L^T, the top, then each branch by itself

Rows are gathered, so that sums do not depend on the number of workers.

Limits: positive definite matrices; a factor of a sheet of n points takes some 8 n log2(sqrt n) entries.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy  # loads its parts when they are first used
from numpy.typing import NDArray

from tianim.errors import SceneError
from tianim.lang import ti, workers
from tianim.systems.springs.arrays import constant

Floats = NDArray[np.float64]
Ints = NDArray[np.int32]

# Parts of so few points are not divided further.
SMALLEST_PART = 24
# A worker's branches are balanced when the largest takes no more than this part of its share.
FINEST_SHARE = 0.25


def dissection(position: Floats, matrix: Any) -> NDArray[np.int64]:
    """The order of nested dissection: the numbers of the points, first to last to be eliminated.

    A part is cut across its longest side at the median of `position`; the points on one side of the cut that
    have neighbours on the other divide it.
    """
    indptr, indices = matrix.indptr, matrix.indices
    side = np.zeros(len(position), np.int8)  # 1 near side, 2 far side of the cut in work
    order: list[NDArray[np.int64]] = []

    def cut(part: NDArray[np.int64]) -> None:
        if len(part) > SMALLEST_PART:
            x = position[part]
            axis = int(np.ptp(x, axis=0).argmax())
            rank = np.argsort(x[:, axis], kind="stable")
            near, far = part[rank[: len(part) // 2]], part[rank[len(part) // 2 :]]
            side[near], side[far] = 1, 2
            begin, end = indptr[near], indptr[near + 1]
            starts = np.concatenate([[0], np.cumsum(end - begin)[:-1]])
            flat = np.repeat(begin - starts, end - begin) + np.arange((end - begin).sum())
            meets = np.add.reduceat(side[indices[flat]] == 2, starts) > 0
            side[part] = 0
            divides, rest = near[meets], near[~meets]
            if len(rest):
                cut(rest)
                cut(far)
                order.append(divides)
                return
        order.append(part)

    cut(np.arange(len(position)))
    return np.concatenate(order)


@dataclass(frozen=True)
class Factor:
    """L and D of A, and who does what.

    place      (n,) where point i stands in the order of elimination
    row_start, row, row_value           L by rows, without its diagonal
    column_start, column, column_value  L by columns
    inverse    (n,) 1 / D
    range_start (bins + 1,), ranges (r, 2)  first and last place of the branches of each worker
    top        first place of the top
    """

    place: Any
    row_start: Any
    row: Any
    row_value: Any
    column_start: Any
    column: Any
    column_value: Any
    inverse: Any
    range_start: Any
    ranges: Any
    tops: Any
    bins: int
    top_count: int
    entries: int


def factorise(matrix: Any, position: Floats) -> Factor:
    """Factor a symmetric positive definite sparse matrix (n, n) of points at `position` (n, 3).

    SceneError where it is not positive definite.
    """
    n = matrix.shape[0]
    order = dissection(position, matrix.tocsr())
    permuted = matrix.tocsr()[order][:, order].tocsc()
    try:
        lu = scipy.sparse.linalg.splu(
            permuted, permc_spec="NATURAL", diag_pivot_thresh=0.0, options={"SymmetricMode": True}
        )
    except RuntimeError as error:
        raise SceneError(f"the matrix of the solve cannot be factored ({error})") from None
    D = lu.U.diagonal()
    if not ((lu.perm_r == lu.perm_c).all() and (D > 0.0).all()):
        raise SceneError(
            "the matrix of the solve is not positive definite: is one stiffness far larger than the others?"
        )
    place = np.empty(n, np.int32)
    place[order] = lu.perm_r
    point = np.argsort(place).astype(np.int32)
    columns = scipy.sparse.tril(lu.L, -1, format="csc")
    columns.sort_indices()
    post = _postorder(_parents(columns))
    if (post[1:] < post[:-1]).any():
        columns, D, point = columns[post][:, post].tocsc(), D[post], point[post]
        columns.sort_indices()
        place[point] = np.arange(n, dtype=np.int32)
    rows = columns.tocsr()
    bins = workers()[0]
    ranges, starts, tops = _shares(columns, bins)
    return Factor(
        constant(place), constant(rows.indptr), constant(rows.indices), constant(rows.data),
        constant(columns.indptr), constant(columns.indices), constant(columns.data), constant(1.0 / D),
        constant(starts), constant(ranges), constant(tops), bins, len(tops), columns.nnz,
    )  # fmt: skip


def _parents(columns: Any) -> NDArray[np.int64]:
    """The tree of eliminations: which place follows each, -1 for roots."""
    start = columns.indptr
    parent = np.full(columns.shape[0], -1, np.int64)
    some = np.flatnonzero(np.diff(start))
    parent[some] = columns.indices[start[some]]
    return parent


def _postorder(parent: NDArray[np.int64]) -> NDArray[np.int64]:
    """An order in which each branch is in one run, as pieces that know nothing of each other are not."""
    children: dict[int, list[int]] = {}
    for j, up in enumerate(parent.tolist()):
        children.setdefault(up, []).append(j)
    order, waiting = [], list(children.get(-1, []))
    while waiting:
        order.append(waiting.pop())
        waiting += children.get(order[-1], [])
    return np.array(order[::-1], np.int64)


def _shares(columns: Any, bins: int) -> tuple[Ints, Ints, Ints]:
    """Branches of the tree of eliminations for each of `bins` workers, and the places of the top."""
    n = columns.shape[0]
    parent = _parents(columns)
    work = (np.diff(columns.indptr) + 1.0).tolist()
    first = list(range(n))
    for j, up in enumerate(parent.tolist()):
        if up >= 0:
            work[up] += work[j]
            first[up] = min(first[up], first[j])
    children: dict[int, list[int]] = {}
    for j, up in enumerate(parent.tolist()):
        children.setdefault(up, []).append(j)
    share = FINEST_SHARE * sum(work[root] for root in children.get(-1, [])) / bins
    branches, top, waiting = [], [], list(children.get(-1, []))
    while waiting:
        j = waiting.pop()
        if bins > 1 and work[j] > share and j in children:
            top.append(j)
            waiting += children[j]
        else:
            branches.append(j)
    given: list[list[tuple[int, int]]] = [[] for _ in range(bins)]
    loads = [0.0] * bins
    for j in sorted(branches, key=lambda j: (-work[j], j)):
        least = loads.index(min(loads))
        loads[least] += work[j]
        given[least].append((first[j], j + 1))
    ranges = [one for own in given for one in sorted(own)]
    starts = np.cumsum([0, *(len(own) for own in given)])
    return np.array(ranges, np.int32).reshape(-1, 2), starts.astype(np.int32), np.array(sorted(top), np.int32)


@ti.func
def forward_row(start: ti.template(), row: ti.template(), value: ti.template(), y: ti.template(), i):
    """y_i less what the places before it take."""
    sx, sy, sz = y[i, 0], y[i, 1], y[i, 2]
    for e in range(start[i], start[i + 1]):
        j, w = row[e], value[e]
        sx -= w * y[j, 0]
        sy -= w * y[j, 1]
        sz -= w * y[j, 2]
    y[i, 0], y[i, 1], y[i, 2] = sx, sy, sz


@ti.func
def backward_row(
    start: ti.template(), column: ti.template(), value: ti.template(), inverse: ti.template(),
    y: ti.template(), i,
):  # fmt: skip
    """y_i / D_i less what the places after it take."""
    sx, sy, sz = inverse[i] * y[i, 0], inverse[i] * y[i, 1], inverse[i] * y[i, 2]
    for e in range(start[i], start[i + 1]):
        j, w = column[e], value[e]
        sx -= w * y[j, 0]
        sy -= w * y[j, 1]
        sz -= w * y[j, 2]
    y[i, 0], y[i, 1], y[i, 2] = sx, sy, sz
