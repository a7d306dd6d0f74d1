"""The second differences that bending is made of, one by one, and which of them a tear ends.

    E = 1/2 sum_m w_m |S_m x|^2 = 1/2 x^T Q x

A difference across a torn spring is none any more: Q is put together anew of the others, and what rows hold
of it is replaced. It only ever weakens, so that the implicit solver's matrix stays above it.

Limits: where a piece is bent at rest (`curvature.py`), what bends it there stays across a tear.
"""

from typing import Any

import numpy as np
import scipy  # loads its parts when they are first used
from numpy.typing import NDArray

from tianim.systems.springs.assembly import BENDING, STIFFNESS, Assembly
from tianim.systems.springs.points import Points

Floats = NDArray[np.float64]
Ints = NDArray[np.int32]

CORNERS = 4  # points of a difference at most


def bends_of(whole: Assembly) -> tuple[Ints, Floats, Floats]:
    """Second differences of all pieces: points (m, 4), coefficients (m, 4), weight [N/m] and length (m, 2).

    Where there are three points, the last stands twice, with the coefficient 0.
    """
    corners, coefficients, strengths = [np.zeros((0, CORNERS), np.int32)], [np.zeros((0, CORNERS))], []
    strengths.append(np.zeros((0, 2)))
    for name, piece in whole.pieces.items():
        for points, S, weight in () if piece.bending is None else piece.bending.rows:
            spare = ((0, 0), (0, CORNERS - points.shape[1]))
            length = np.zeros(len(points))
            if piece.curved is not None:
                length = np.linalg.norm(np.einsum("mp,mpc->mc", S, piece.position[points]), axis=1)
            corners.append(np.pad(points + whole.first[name], spare, mode="edge").astype(np.int32))
            coefficients.append(np.pad(S, spare))
            strengths.append(np.stack([weight, length], axis=1))
    return np.concatenate(corners), np.concatenate(coefficients), np.concatenate(strengths)


def joining(corner: Ints, points: Points, count: int) -> Ints:
    """Where the springs between the points of each difference stand in the rows, (m, 6); -1 for none."""
    code = _codes(points, count)
    stiff = points.row.to_numpy()[: len(code), STIFFNESS] > 0.0
    found = []
    for a in range(CORNERS):
        for b in range(a):
            wanted = corner[:, a].astype(np.int64) * count + corner[:, b]
            entry = np.minimum(np.searchsorted(code, wanted), len(code) - 1)
            found.append(np.where((code[entry] == wanted) & stiff[entry], entry, -1))
    return np.stack(found, axis=1).astype(np.int32)


def _codes(points: Points, count: int) -> NDArray[np.int64]:
    """Row and neighbour of every entry as one number, in order."""
    start, neighbour = points.start.to_numpy(), points.neighbour.to_numpy()
    row = np.repeat(np.arange(count, dtype=np.int64), np.diff(start))
    return np.asarray(row * count + neighbour[: start[-1]])


class Bends:
    """Bending that tears.

    matrix   Q (n, n) of what is whole
    """

    def __init__(self, whole: Assembly, points: Points) -> None:
        self._points, self._count = points, whole.count
        self._corner, self._coefficient, strength = bends_of(whole)
        self._weight = strength[:, 0]
        self._joining = joining(self._corner, points, whole.count)
        self._codes = _codes(points, whole.count)
        self.matrix: Any = whole.bending

    def part(self) -> None:
        """Springs were torn: no bending across them."""
        row = self._points.row.to_numpy()
        torn = (self._joining >= 0) & (row[self._joining, STIFFNESS] == 0.0)
        weight = np.where(torn.any(axis=1), 0.0, self._weight)
        m = len(weight)
        at = (np.repeat(np.arange(m), CORNERS), self._corner.ravel())
        S = scipy.sparse.csr_matrix((self._coefficient.ravel(), at), shape=(m, self._count))
        self.matrix = (S.T @ scipy.sparse.diags(weight) @ S).tocsr()
        Q = self.matrix.tocoo()
        off = (Q.row != Q.col) & (Q.data != 0.0)
        wanted = Q.row[off].astype(np.int64) * self._count + Q.col[off]
        row[:, BENDING] = 0.0
        row[np.searchsorted(self._codes, wanted), BENDING] = -Q.data[off]
        self._points.row.from_numpy(row)
