"""All pieces as one set of points and springs, and the rows of neighbours that kernels walk.

A row holds, for each neighbour j of point i, the stiffness k, the rest length l, the damping c and the
stiffness q of the bending, and gives the force

    f_i += [k (1 - l / |d|) + q] d + c (v_j - v_i) . d / |d|^2  d,     d = x_j - x_i

Each spring stands in two rows, with the same numbers, so that its two forces are equal and opposite.
"""

from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
import scipy  # loads its parts when they are first used
from numpy.typing import NDArray

from tianim.errors import SceneError
from tianim.lang import f32_2d, f64_1d, f64_2d, i32_1d, ti
from tianim.systems.springs.built import Built, Hinges, Springs
from tianim.systems.springs.hinges import hinge_gradients
from tianim.systems.springs.params import Pick, SpringsParams
from tianim.systems.springs.pieces import build_piece
from tianim.systems.springs.solids import Elements, elements_of, largest_omega2

Floats = NDArray[np.float64]
Ints = NDArray[np.int32]

# Columns of a row's coefficients.
STIFFNESS, REST, DAMPING, BENDING = 0, 1, 2, 3
# Bending up to this part of the springs' stiffness stands in the implicit matrix as an upper bound between
# next neighbours: its own pattern reaches two cells and doubles the factor.
WEAK = 0.05
# What each spring then gets, of the diagonal of Q at its ends: a second difference of weight w puts 6 w there
# and is at most 2 w (d^2 + d'^2) of the two first differences, each of which is in two of them.
BOUND = 4.0 / 6.0


@dataclass(frozen=True)
class Assembly:
    """Points and springs of all pieces.

    first    first point of each piece, by name
    pieces   each as it was built
    position, velocity (n, 3), mass (n,)
    springs  of all pieces, and the stitches
    bending  Q, sparse (n, n) [N/m], None where nothing resists bending
    hinges   of all networks
    elements of all solids, None without any
    """

    first: Mapping[str, int]
    pieces: Mapping[str, Built]
    position: Floats
    velocity: Floats
    mass: Floats
    springs: Springs
    bending: Any
    hinges: Hinges
    elements: Elements | None

    @property
    def count(self) -> int:
        """Points."""
        return len(self.mass)

    def chosen(self, place: str, pick: Pick) -> Ints:
        """The points that `pick` says. SceneError names `place` where there are none."""
        piece, first = self.pieces[pick.piece], self.first[pick.piece]
        count = len(piece.mass)
        if pick.lower is not None and pick.upper is not None:
            inside = ((piece.position >= pick.lower) & (piece.position <= pick.upper)).all(axis=1)
            if not inside.any():
                raise SceneError(
                    f"{place}: no point of {pick.piece} starts in the box {pick.lower} to {pick.upper}"
                )
            return (first + np.flatnonzero(inside)).astype(np.int32)
        if isinstance(pick.points, tuple):
            return (first + np.array(pick.points, np.int32)).astype(np.int32)
        groups = {**piece.groups, "all": np.arange(count, dtype=np.int32)}
        if pick.points not in groups:
            raise SceneError(
                f"{place}.points: {pick.piece} has no {pick.points!r}; it has {', '.join(groups)}"
            )
        return (first + groups[str(pick.points)]).astype(np.int32)

    def stiffest(self) -> Floats:
        """Upper bound of omega^2 about each point [1/s2], (n,): of the springs in any direction, and bending.

        In a spring's own direction both its ends move: twice the stiffness that one of them sees.
        """
        springs, x = self.springs, self.position
        a, b = springs.ends.T
        d = x[b] - x[a]
        length = np.linalg.norm(d, axis=1)
        n = np.divide(d, length[:, None], out=np.zeros_like(d), where=length[:, None] > 0.0)
        pull = springs.stiffness[:, None, None] * n[:, :, None] * n[:, None, :]
        # Springs that start without length may come to lie in any direction.
        pull[length == 0.0] = springs.stiffness[length == 0.0][:, None, None] * np.eye(3)
        total = np.zeros((self.count, 3, 3))
        for ends in (a, b):
            np.add.at(total, ends, pull)
        stiff = 2.0 * np.linalg.eigvalsh(total)[:, -1]
        for hinge, slopes in enumerate(hinge_gradients(x, self.hinges.points)):
            size = np.linalg.norm(slopes, axis=1)
            np.add.at(stiff, self.hinges.points[hinge], self.hinges.stiffness[hinge] * size * size.sum())
        if self.bending is not None:
            stiff += np.asarray(abs(self.bending).sum(axis=1)).ravel()
        omega2 = stiff / self.mass
        return omega2 if self.elements is None else omega2 + largest_omega2(self.elements, self.mass)


def assemble(params: SpringsParams) -> Assembly:
    """Build and join all pieces. SceneError where one cannot be built or a stitch does not fit."""
    pieces: dict[str, Built] = {}
    for name, piece in params.pieces.items():
        try:
            pieces[name] = build_piece(piece)
        except SceneError as error:
            raise SceneError(f"pieces.{name}: {error}") from None
    counts = [len(piece.mass) for piece in pieces.values()]
    first = dict(zip(pieces, np.cumsum([0, *counts[:-1]]).tolist(), strict=True))
    all_springs = [piece.springs for piece in pieces.values()]
    ends = [piece.springs.ends + first[name] for name, piece in pieces.items()]
    bending = None
    if any(piece.bending is not None for piece in pieces.values()):
        blocks = [
            scipy.sparse.csr_matrix((len(p.mass),) * 2) if p.bending is None else p.bending.matrix
            for p in pieces.values()
        ]
        bending = scipy.sparse.block_diag(blocks, format="csr")

    def joined(name: str) -> Any:
        return np.concatenate([getattr(piece, name) for piece in pieces.values()])

    springs = Springs(
        np.concatenate(ends), *(
            np.concatenate([getattr(one, name) for one in all_springs])
            for name in ("stiffness", "rest_length", "damping")
        ),
    )  # fmt: skip
    parts = [(first[name], piece.hinges) for name, piece in pieces.items()]
    hinges = Hinges(
        np.concatenate([own.points + start for start, own in parts]).astype(np.int32),
        np.concatenate([own.stiffness for _, own in parts]),
        np.concatenate([own.angle for _, own in parts]),
        np.concatenate([own.damping for _, own in parts]),
    )
    whole = Assembly(
        first,
        pieces,
        joined("position"),
        joined("velocity"),
        joined("mass"),
        springs,
        bending,
        hinges,
        _elements(pieces, first),
    )
    return _stitched(whole, params) if params.stitches else whole


def _elements(pieces: Mapping[str, Built], first: Mapping[str, int]) -> Elements | None:
    found = []
    for name, piece in pieces.items():
        if piece.solid is not None:
            own = elements_of(piece.position, piece.solid)
            found.append(replace(own, corners=own.corners + first[name]))
    if not found:
        return None
    return Elements(
        *(np.concatenate([getattr(own, field.name) for own in found]) for field in fields(Elements))
    )


def _stitched(whole: Assembly, params: SpringsParams) -> Assembly:
    springs = whole.springs
    ends, stiffness, damping = [springs.ends], [springs.stiffness], [springs.damping]
    rest = [springs.rest_length]
    for name, stitch in params.stitches.items():
        a = whole.chosen(f"stitches.{name}.first", stitch.first)
        b = whole.chosen(f"stitches.{name}.second", stitch.second)
        if len(a) != len(b):
            raise SceneError(f"stitches.{name}: joins {len(a)} points to {len(b)}; there must be as many")
        if (a == b).any():
            raise SceneError(f"stitches.{name}: joins a point to itself")
        ends.append(np.stack([a, b], axis=1).astype(np.int32))
        stiffness.append(np.full(len(a), stitch.stiffness))
        damping.append(np.full(len(a), stitch.damping))
        rest.append(np.zeros(len(a)))
    joined = Springs(
        np.concatenate(ends), np.concatenate(stiffness), np.concatenate(rest), np.concatenate(damping)
    )
    return Assembly(
        whole.first,
        whole.pieces,
        whole.position,
        whole.velocity,
        whole.mass,
        joined,
        whole.bending,
        whole.hinges,
        whole.elements,
    )


@dataclass(frozen=True)
class Rows:
    """Start of each row (n + 1,), neighbours (e,), coefficients (e, 4).

    entry, back_entry  (s,) where each spring stands in the row of its first and of its second point
    """

    start: Ints
    neighbour: Ints
    coefficient: NDArray[np.float32]
    entry: Ints
    back_entry: Ints


def rows_of(whole: Assembly) -> Rows:
    """The rows of all points."""
    n, springs = whole.count, whole.springs
    a, b = springs.ends.T.astype(np.int64)
    i, j = np.concatenate([a, b]), np.concatenate([b, a])
    values = np.stack([springs.stiffness, springs.rest_length, springs.damping, np.zeros(len(a))], axis=1)
    values = np.concatenate([values, values])
    code = i * n + j
    order = np.argsort(code, kind="stable")
    code, values = code[order], values[order]
    at_entry = np.argsort(order)
    if whole.bending is not None:
        Q = whole.bending.tocoo()
        off = (Q.row != Q.col) & (Q.data != 0.0)
        wanted, stiffness = Q.row[off].astype(np.int64) * n + Q.col[off], -Q.data[off]
        at = np.searchsorted(code, wanted)
        known = at < len(code)
        known[known] = code[at[known]] == wanted[known]
        values[at[known], BENDING] = stiffness[known]
        extra = np.zeros((int((~known).sum()), 4))
        extra[:, BENDING] = stiffness[~known]
        code, values = np.concatenate([code, wanted[~known]]), np.concatenate([values, extra])
        order = np.argsort(code, kind="stable")
        code, values = code[order], values[order]
        at_entry = np.argsort(order)[at_entry]
    start = np.searchsorted(code, np.arange(n + 1, dtype=np.int64) * n).astype(np.int32)
    entry, back_entry = np.split(at_entry.astype(np.int32), 2)
    return Rows(start, (code % n).astype(np.int32), values.astype(np.float32), entry, back_entry)


def implicit_matrix(whole: Assembly, held: NDArray[np.bool_], dt: float) -> Any:
    """M / dt^2 + sum of all stiffnesses, for one component; points that are `held` stand apart.

    It bounds the Hessian of the energy from above: springs count in all directions, as if at rest length.
    """
    n, springs = whole.count, whole.springs
    a, b = springs.ends.T
    stiffness = springs.stiffness + springs.damping / dt
    bending = whole.bending
    if bending is not None:
        Q = bending.tocoo()
        limit = WEAK * float(springs.stiffness.min())
        if abs(Q.diagonal()).max() <= limit:
            stiffness = stiffness + _bound(whole)
            bending = None
    L = scipy.sparse.coo_matrix((stiffness, (a, b)), shape=(n, n))
    L = (L + L.T).tocsr()
    A = scipy.sparse.diags(whole.mass / dt**2 + np.asarray(L.sum(axis=1)).ravel()) - L
    if bending is not None:
        A = A + bending
    free = scipy.sparse.diags((~held).astype(np.float64))
    A = (free @ A @ free + scipy.sparse.diags(held.astype(np.float64))).tocsc()
    A.eliminate_zeros()
    return A


def _bound(whole: Assembly) -> Floats:
    """Stiffness to be added to each spring [N/m] so that together they exceed the bending."""
    Q = whole.bending.tocsr()
    own = np.asarray(Q.diagonal())
    a, b = whole.springs.ends.T
    return np.asarray(BOUND * np.maximum(own[a], own[b]))


@ti.func
def pull_on(
    start: ti.template(), neighbour: ti.template(), row: ti.template(), x: ti.template(), v: ti.template(),
    i,
):  # fmt: skip
    """Force of all springs on point i [N]."""
    f = ti.Vector([0.0, 0.0, 0.0], ti.f64)
    for e in range(start[i], start[i + 1]):
        j = neighbour[e]
        dx = ti.cast(x[j, 0] - x[i, 0], ti.f32)
        dy = ti.cast(x[j, 1] - x[i, 1], ti.f32)
        dz = ti.cast(x[j, 2] - x[i, 2], ti.f32)
        inverse = 1.0 / ti.sqrt(ti.max(dx * dx + dy * dy + dz * dz, 1e-30))
        closing = (v[j, 0] - v[i, 0]) * dx + (v[j, 1] - v[i, 1]) * dy + (v[j, 2] - v[i, 2]) * dz
        s = row[e, 0] * (1.0 - row[e, 1] * inverse) + row[e, 3]
        s += row[e, 2] * ti.cast(closing, ti.f32) * inverse * inverse
        f += ti.Vector([s * dx, s * dy, s * dz])
    return f


@ti.kernel
def accelerate(
    n: ti.i32, start: i32_1d, neighbour: i32_1d, row: f32_2d, external: f64_2d, inverse_mass: f64_1d,
    x: f64_2d, v: f64_2d, a: f64_2d,
):  # fmt: skip
    """Acceleration of each point: springs, and what is `external` [m/s2]; 0 where it is held."""
    for i in range(n):
        f = pull_on(start, neighbour, row, x, v, i)
        for c in ti.static(range(3)):
            a[i, c] = inverse_mass[i] * f[c] + ti.select(inverse_mass[i] > 0.0, external[i, c], 0.0)
