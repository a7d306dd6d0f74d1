"""Points and springs: what every piece is made into.

    E = 1/2 sum_s k_s (|d_s| - l_s)^2 + 1/2 x^T Q x

The first sum is over springs between two points, d their distance. The second is bending: with S the second
differences of a flat sheet or a straight rope and W their weights, Q = S^T W S is the energy
B/2 integral(curvature^2), exact for what bends without stretching (Bergou et al. 2006,
doi:10.2312/SGP/SGP06/227-230). The rows of Q sum to zero, so that bending acts as springs too, of rest length
0 and stiffness -Q_ij, some of them negative: one loop over neighbours does both.

Limits: ropes and sheets are straight and flat at rest; meshes as they are in their file (`curvature.py`).
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from itertools import product
from typing import Any

import numpy as np
import scipy  # loads its parts when they are first used
from numpy.typing import NDArray

from tianim.errors import SceneError
from tianim.math.rotations import from_euler, rotate
from tianim.spatial.mesh_files import Shown, painted_values, read_mesh, read_shown
from tianim.systems.springs.piece_params import (
    Block,
    Fabric,
    MeshPiece,
    Network,
    Piece,
    Rope,
    Sheet,
    Solid,
    Strands,
)

Floats = NDArray[np.float64]
Ints = NDArray[np.int32]

# Pairs of triangles bent by less than this angle [rad] are flat: file formats round.
FLAT = 1e-4
POISSON_FACTOR = 0.4  # k / (E h) of the lattice of a block


@dataclass(frozen=True)
class Springs:
    """ends (s, 2), stiffness [N/m], rest_length [m], damping [N s/m], each (s,)."""

    ends: Ints
    stiffness: Floats
    rest_length: Floats
    damping: Floats


@dataclass(frozen=True)
class Bending:
    """Q, sparse (n, n) [N/m], and the differences that it is made of.

    rows  of each kind: points (m, p), coefficients (m, p), weights (m,) [N/m]
    """

    matrix: Any
    rows: tuple[tuple[Ints, Floats, Floats], ...]


@dataclass(frozen=True)
class Curved:
    """Differences S x that are not zero at rest.

    points (s, p), coefficient (s, p); weight [N/m] and length |S x| at rest [m], each (s,)
    """

    points: Ints
    coefficient: Floats
    weight: Floats
    length: Floats


@dataclass(frozen=True)
class Hinges:
    """points (h, 4), stiffness [N m], angle at rest [rad], damping [N m s], each (h,)."""

    points: Ints
    stiffness: Floats
    angle: Floats
    damping: Floats


@dataclass(frozen=True)
class Tetrahedra:
    """corners (t, 4), of positive volume; Young's modulus [Pa], Poisson's ratio, damping [s] of all."""

    corners: Ints
    stiffness: float
    poisson: float
    damping: float


NO_HINGES = Hinges(np.zeros((0, 4), np.int32), np.zeros(0), np.zeros(0), np.zeros(0))


@dataclass(frozen=True)
class Built:
    """A piece as points and springs.

    position   (n, 3) [m]
    velocity   (n, 3) [m/s]
    mass       (n,) [kg]
    bending    None where nothing resists it
    curved     what is bent at rest, of the differences that Q is made of
    triangles  (m, 3) of its surface, empty where it is lines
    open_to_air  whether its triangles are a sheet that the air meets on both sides
    shown      which points and triangles frames hold, where not the piece's own: those of its file
    chains     numbers of the points of each rope or strand, in order; empty for all else
    groups     numbers of points by a name that pins may use: "left", "first" ...
    data       per point, what frames show and never changes: "uv"
    """

    position: Floats
    velocity: Floats
    mass: Floats
    springs: Springs
    bending: Bending | None = None
    curved: Curved | None = None
    triangles: Ints = field(default_factory=lambda: np.zeros((0, 3), np.int32))
    open_to_air: bool = False
    hinges: Hinges = NO_HINGES
    solid: Tetrahedra | None = None
    chains: tuple[Ints, ...] = ()
    shown: Shown | None = None
    groups: Mapping[str, Ints] = field(default_factory=dict)
    data: Mapping[str, NDArray[np.float32]] = field(default_factory=dict)


def build_piece(piece: Piece) -> Built:
    """The points and springs of `piece`. SceneError where they cannot be made."""
    return _BUILDERS[type(piece)](piece)


def _lengths(x: Floats, ends: Ints) -> Floats:
    return np.asarray(np.linalg.norm(x[ends[:, 1]] - x[ends[:, 0]], axis=1))


def _springs(x: Floats, ends: Ints, stiffness: Floats, damping: float) -> Springs:
    """Springs at rest where they are, with dampers of `damping` x stiffness."""
    return Springs(ends.astype(np.int32), stiffness, _lengths(x, ends), damping * stiffness)


def _moving(piece: Piece, x: Floats, mass: Floats) -> Floats:
    arm = x - mass @ x / mass.sum()
    return np.asarray(np.cross(np.array(piece.spin), arm) + piece.velocity)


def _energy(count: int, rows: list[tuple[Ints, Floats, Floats]]) -> Bending:
    """Q = S^T W S of `rows`: points (m, p), coefficients (m, p) or (p,), weights (m,) [N/m] of each."""
    total: Any = scipy.sparse.csr_matrix((count, count))
    for points, coefficients, weight in rows:
        m, p = points.shape
        at = (np.repeat(np.arange(m), p), points.ravel())
        S = scipy.sparse.csr_matrix((np.broadcast_to(coefficients, (m, p)).ravel(), at), shape=(m, count))
        total = total + S.T @ scipy.sparse.diags(weight) @ S
    return Bending(
        total, tuple((points, np.broadcast_to(s, points.shape), weight) for points, s, weight in rows)
    )


def _sheet(piece: Sheet) -> Built:
    (nu, nv), (lu, lv) = piece.segments, piece.size
    hu, hv = lu / nu, lv / nv
    u, v = (np.array(axis) / np.linalg.norm(axis) for axis in (piece.u, piece.v))
    grid = np.arange((nu + 1) * (nv + 1), dtype=np.int32).reshape(nu + 1, nv + 1)
    s, t = np.meshgrid(np.linspace(0.0, 1.0, nu + 1), np.linspace(0.0, 1.0, nv + 1), indexing="ij")
    x = np.array(piece.origin) + s.reshape(-1, 1) * lu * u + t.reshape(-1, 1) * lv * v
    # Half a cell belongs to a line of points at the border.
    share_u, share_v = np.ones(nu + 1), np.ones(nv + 1)
    share_u[[0, -1]] = share_v[[0, -1]] = 0.5
    mass = piece.density * hu * hv * np.outer(share_u, share_v).ravel()
    along, across, diagonal = _sheet_stiffness(piece, hu, hv)
    parts = [
        (grid[:-1], grid[1:], np.broadcast_to(along * share_v, (nu, nv + 1))),
        (grid[:, :-1], grid[:, 1:], np.broadcast_to(across * share_u[:, None], (nu + 1, nv))),
    ]
    if piece.diagonals and diagonal > 0.0:
        parts.append((grid[:-1, :-1], grid[1:, 1:], np.full((nu, nv), diagonal)))
        if piece.diagonals == 2:
            parts.append((grid[1:, :-1], grid[:-1, 1:], np.full((nu, nv), diagonal)))
    if piece.skip > 0.0:
        parts += [
            (grid[:-2], grid[2:], np.full((max(nu - 1, 0), nv + 1), piece.skip)),
            (grid[:, :-2], grid[:, 2:], np.full((nu + 1, max(nv - 1, 0)), piece.skip)),
        ]
    ends = np.concatenate([np.stack([a.ravel(), b.ravel()], axis=1) for a, b, _ in parts])
    stiffness = np.concatenate([k.ravel() for _, _, k in parts])
    bending = _sheet_bending(piece, grid, hu, hv, share_u, share_v) if piece.bend > 0.0 else None
    a, b, c, d = grid[:-1, :-1], grid[1:, :-1], grid[1:, 1:], grid[:-1, 1:]
    triangles = np.concatenate([np.stack(t, axis=-1).reshape(-1, 3) for t in ((a, c, b), (a, d, c))])
    groups = {
        "left": grid[0], "right": grid[-1], "bottom": grid[:, 0], "top": grid[:, -1],
        "left_bottom": grid[:1, 0], "right_bottom": grid[-1:, 0], "left_top": grid[:1, -1],
        "right_top": grid[-1:, -1],
    }  # fmt: skip
    uv = np.stack([s.ravel(), t.ravel()], axis=1).astype(np.float32)
    return Built(
        x, _moving(piece, x, mass), mass, _springs(x, ends, stiffness, piece.damping), bending,
        triangles=triangles.astype(np.int32), open_to_air=True, groups=groups, data={"uv": uv},
    )  # fmt: skip


def _sheet_stiffness(piece: Sheet, hu: float, hv: float) -> tuple[float, float, float]:
    """Of one spring along u, along v and along a diagonal [N/m], for which the sheet has E and G.

    The diagonals of a cell resist stretch too: with c = C11 = C22 and C12 = G, E = c - G^2 / c.
    """
    E, G = piece.stretch, piece.shear if piece.diagonals else 0.0
    c = 0.5 * (E + np.hypot(E, 2.0 * G))
    ratio = hu / hv
    along, across = c - G * ratio**2, c - G / ratio**2
    if min(along, across) <= 0.0:
        raise SceneError(
            f"cells of {hu:.3g} x {hv:.3g} m are too oblong for shear {G:g} N/m beside stretch {E:g} N/m: "
            "choose segments that make them more square, or less shear"
        )
    diagonal = G * (hu**2 + hv**2) / (hu * hv) / max(piece.diagonals, 1)
    return float(along / ratio), float(across * ratio), float(diagonal)


def _sheet_bending(piece: Sheet, grid: Ints, hu: float, hv: float, share_u: Floats, share_v: Floats) -> Any:
    """B/2 integral(x_uu^2 + 2 x_uv^2 + x_vv^2), by second differences."""
    cell = piece.bend * hu * hv
    second, twist = np.array([1.0, -2.0, 1.0]), np.array([1.0, -1.0, -1.0, 1.0])
    lines_u = np.stack([grid[:-2], grid[1:-1], grid[2:]], axis=-1).reshape(-1, 3)
    lines_v = np.stack([grid[:, :-2], grid[:, 1:-1], grid[:, 2:]], axis=-1).reshape(-1, 3)
    cells = np.stack([grid[:-1, :-1], grid[1:, :-1], grid[:-1, 1:], grid[1:, 1:]], axis=-1).reshape(-1, 4)
    weight_u = np.broadcast_to(cell / hu**4 * share_v, grid[1:-1].shape).ravel()
    weight_v = np.broadcast_to(cell / hv**4 * share_u[:, None], grid[:, 1:-1].shape).ravel()
    weight_uv = np.full(len(cells), 2.0 * cell / (hu * hv) ** 2)
    return _energy(
        grid.size, [(lines_u, second, weight_u), (lines_v, second, weight_v), (cells, twist, weight_uv)]
    )


def _mesh(piece: MeshPiece) -> Built:
    data = read_mesh(piece.file)
    x = piece.scale * rotate(from_euler(piece.rotation), data.vertices) + piece.position
    triangles = data.triangles
    corners = x[triangles]
    area = 0.5 * np.linalg.norm(
        np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1
    )
    mass = np.asarray(np.bincount(triangles.ravel(), np.repeat(area, 3), len(x)) * piece.density / 3.0)
    if not mass.all():
        raise SceneError(f"{piece.file}: point {int((mass == 0.0).argmax())} belongs to no triangle")
    sides = triangles[:, [[1, 2], [2, 0], [0, 1]]]  # opposite to corner 0, 1, 2
    ends, which = np.unique(np.sort(sides.reshape(-1, 2), axis=1), axis=0, return_inverse=True)
    edge = which.reshape(-1).astype(np.int32)
    wide = np.bincount(edge, np.repeat(area, 3), len(ends))
    stiffness = piece.stretch * wide / _lengths(x, ends) ** 2
    shown = read_shown(piece.file)
    factor = {name: _painted(piece, name) for name in ("density", "stretch", "bend", "pin")}
    mass, stiffness = mass * factor["density"], stiffness * factor["stretch"][ends].mean(axis=1)
    bending, curved = None, None
    if piece.bend > 0.0:
        bending, curved = _mesh_bending(piece, x, triangles, area, edge, factor["bend"])
    border = np.unique(ends[np.bincount(edge, minlength=len(ends)) == 1]).astype(np.int32)
    groups = {"border": border}
    if "pin" in piece.maps:
        groups["painted"] = np.flatnonzero(factor["pin"] > 0.5).astype(np.int32)
    return Built(
        x, _moving(piece, x, mass), mass, _springs(x, ends, stiffness, piece.damping), bending, curved,
        triangles=triangles, open_to_air=True, shown=shown, groups=groups,
    )  # fmt: skip


def _painted(piece: MeshPiece, name: str) -> Floats:
    """The map of the file that `maps` names for a quantity, a factor at each point; 1 without one."""
    if name not in piece.maps:
        return np.ones(len(read_mesh(piece.file).vertices))
    return painted_values(piece.file, piece.maps[name])


def _mesh_bending(
    piece: Fabric, x: Floats, triangles: Ints, area: Floats, edge: Ints, factor: Floats
) -> tuple[Any, Curved | None]:
    """B/2 integral(curvature^2) by the Laplacians of pairs of triangles that share an edge.

    A pair sees what bends across its edge, (k_tt - 3 k_nn)^2, whose mean over the edges of equilateral
    triangles is 3 (k1^2 + k2^2) - 2 k1 k2. A third of Bergou's weight gives a cylinder B/2 k^2.
    """
    corner = x[triangles]
    order = np.argsort(edge, kind="stable")
    first = np.flatnonzero(np.diff(edge[order], prepend=-1))
    inner = first[np.diff(np.append(first, len(order))) == 2]
    one, two = order[inner], order[inner + 1]  # 3 t + number of the corner opposite to the edge

    def cotangents(k: Ints) -> tuple[Floats, Floats]:
        """At the two ends of the edge, in the triangle's own order."""
        t, c = k // 3, k % 3
        p, a, b = corner[t, c], corner[t, (c + 1) % 3], corner[t, (c + 2) % 3]
        twice = 2.0 * area[t]
        at_a = np.einsum("ij,ij->i", b - a, p - a) / twice
        at_b = np.einsum("ij,ij->i", a - b, p - b) / twice
        return at_a, at_b

    tri1, tri2 = one // 3, two // 3
    a = triangles[tri1, (one % 3 + 1) % 3]
    b = triangles[tri1, (one % 3 + 2) % 3]
    cot_a1, cot_b1 = cotangents(one)
    cot2 = cotangents(two)
    same = triangles[tri2, (two % 3 + 1) % 3] == a
    cot_a2, cot_b2 = np.where(same, cot2, cot2[::-1])
    points = np.stack([a, b, triangles[tri1, one % 3], triangles[tri2, two % 3]], axis=1)
    coefficients = np.stack([cot_b1 + cot_b2, cot_a1 + cot_a2, -cot_a1 - cot_b1, -cot_a2 - cot_b2], axis=1)
    weight = piece.bend * factor[points].mean(axis=1) / (area[tri1] + area[tri2])
    size = np.linalg.norm(np.einsum("sp,spc->sc", coefficients, x[points]), axis=1)
    bent = size > FLAT * np.sqrt(area[tri1] + area[tri2])
    curved = Curved(points[bent], coefficients[bent], weight[bent], size[bent]) if bent.any() else None
    return _energy(len(x), [(points, coefficients, weight)]), curved


def _rope(piece: Rope) -> Built:
    corners = np.array(piece.points)
    along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(corners, axis=0), axis=1))])
    at = np.linspace(0.0, along[-1], piece.segments + 1)
    x = np.stack([np.interp(at, along, axis) for axis in corners.T], axis=1)
    line = np.arange(piece.segments + 1, dtype=np.int32)
    rest = (piece.length or piece.course) / piece.segments
    mass = np.full(len(x), piece.density * rest)
    mass[[0, -1]] *= 0.5
    stiffness = np.full(piece.segments, piece.stretch / rest)
    ends = np.stack([line[:-1], line[1:]], axis=1)
    springs = Springs(ends, stiffness, np.full(piece.segments, rest), piece.damping * stiffness)
    bending = None
    if piece.bend > 0.0 and piece.segments > 1:
        triples = np.stack([line[:-2], line[1:-1], line[2:]], axis=1)
        weight = np.full(len(triples), piece.bend / rest**3)
        bending = _energy(len(x), [(triples, np.array([1.0, -2.0, 1.0]), weight)])
    groups = {"first": line[:1], "last": line[-1:], "ends": line[[0, -1]]}
    return Built(x, _moving(piece, x, mass), mass, springs, bending, chains=(line,), groups=groups)


def _strands(piece: Strands) -> Built:
    root, out = piece.roots()
    each = piece.segments + 1
    rest = piece.length / piece.segments
    x = (root[:, None] + rest * np.arange(each)[None, :, None] * out[:, None]).reshape(-1, 3)
    number = np.arange(len(x), dtype=np.int32).reshape(-1, each)
    ends = np.stack([number[:, :-1].ravel(), number[:, 1:].ravel()], axis=1)
    share = np.ones(each)
    share[[0, -1]] = 0.5
    mass = np.tile(piece.density * rest * share, piece.count)
    springs = _springs(x, ends, np.full(len(ends), piece.stretch / rest), piece.damping)
    bending = None
    if piece.bend > 0.0:
        triples = np.stack([number[:, :-2], number[:, 1:-1], number[:, 2:]], axis=-1).reshape(-1, 3)
        weight = np.full(len(triples), piece.bend / rest**3)
        bending = _energy(len(x), [(triples, np.array([1.0, -2.0, 1.0]), weight)])
    groups = {"roots": number[:, :2].ravel(), "tips": number[:, -1]}
    return Built(x, _moving(piece, x, mass), mass, springs, bending, chains=tuple(number), groups=groups)


def _block(piece: Block) -> Built:
    cells = piece.cells()
    h = np.array(piece.size) / cells
    shape = tuple(count + 1 for count in cells)
    grid = np.arange(np.prod(shape), dtype=np.int32).reshape(shape)
    place = np.stack(np.meshgrid(*(np.arange(n) for n in shape), indexing="ij"), axis=-1).reshape(-1, 3)
    x = rotate(from_euler(piece.rotation), (place - 0.5 * np.array(cells)) * h) + piece.position
    corner = {c: grid[tuple(slice(k, k + n) for k, n in zip(c, cells, strict=True))] for c in _CORNERS}
    pairs = [(a, b) for a, b in product(_CORNERS, _CORNERS) if a < b and _axes(a, b) < 3]
    ends = np.concatenate([np.stack([corner[a].ravel(), corner[b].ravel()], axis=1) for a, b in pairs])
    volume = float(np.prod(h))
    length = _lengths(x, ends)
    axes = np.repeat([_axes(a, b) for a, b in pairs], np.prod(cells))
    # An edge belongs to four cells, a face diagonal to two.
    stiffness = POISSON_FACTOR * piece.stiffness * volume / length**2 * np.where(axes == 1, 0.25, 1.0)
    ends, which = np.unique(np.sort(ends, axis=1), axis=0, return_inverse=True)
    stiffness = np.asarray(np.bincount(which.reshape(-1), stiffness, len(ends)), np.float64)
    cells_at = np.zeros(len(x))
    for c in _CORNERS:
        cells_at += np.bincount(corner[c].ravel(), minlength=len(x)).astype(np.float64)
    mass = cells_at * piece.density * volume / 8.0
    return Built(
        x, _moving(piece, x, mass), mass, _springs(x, ends, stiffness, piece.damping),
        triangles=_skin(grid), groups=_faces(grid),
    )  # fmt: skip


def _solid(piece: Solid) -> Built:
    cells = piece.cells()
    h = np.array(piece.size) / cells
    shape = tuple(count + 1 for count in cells)
    grid = np.arange(np.prod(shape), dtype=np.int32).reshape(shape)
    place = np.stack(np.meshgrid(*(np.arange(n) for n in shape), indexing="ij"), axis=-1).reshape(-1, 3)
    local = (place - 0.5 * np.array(cells)) * h
    x = rotate(from_euler(piece.rotation), local) + piece.position
    # Five in a cell; neighbours are mirrored, so that their faces are cut alike.
    found = []
    odd = np.indices(cells).sum(axis=0) % 2 == 1
    for mirrored in (False, True):
        for four in _FIVE:
            offsets = [(1 - a if mirrored else a, b, c) for a, b, c in four]
            corner = [grid[tuple(slice(k, k + n) for k, n in zip(c, cells, strict=True))] for c in offsets]
            found.append(np.stack([one[odd == mirrored] for one in corner], axis=-1))
    corners = np.concatenate(found)
    edges = local[corners[:, 1:]] - local[corners[:, :1]]
    volume = np.linalg.det(edges) / 6.0
    corners[volume < 0.0] = corners[volume < 0.0][:, [0, 2, 1, 3]]
    mass = np.bincount(corners.ravel(), np.repeat(np.abs(volume), 4), len(x)) * piece.density / 4.0
    none = Springs(np.zeros((0, 2), np.int32), np.zeros(0), np.zeros(0), np.zeros(0))
    return Built(
        x, _moving(piece, x, np.asarray(mass)), np.asarray(mass), none, triangles=_skin(grid),
        groups=_faces(grid), solid=Tetrahedra(corners, piece.stiffness, piece.poisson, piece.damping),
    )  # fmt: skip


# The tetrahedra of an even cell: the middle one, then those at the other four corners.
_FIVE = (
    ((0, 0, 0), (1, 1, 0), (1, 0, 1), (0, 1, 1)),
    ((1, 0, 0), (0, 0, 0), (1, 1, 0), (1, 0, 1)),
    ((0, 1, 0), (0, 0, 0), (1, 1, 0), (0, 1, 1)),
    ((0, 0, 1), (0, 0, 0), (1, 0, 1), (0, 1, 1)),
    ((1, 1, 1), (1, 1, 0), (1, 0, 1), (0, 1, 1)),
)
_CORNERS = tuple(product((0, 1), repeat=3))


def _axes(a: tuple[int, ...], b: tuple[int, ...]) -> int:
    """In how many axes two corners of a cell differ."""
    return sum(p != q for p, q in zip(a, b, strict=True))


def _faces(grid: Ints) -> dict[str, Ints]:
    """Points of each side of a block, by name."""
    names = (("left", "right"), ("bottom", "top"), ("back", "front"))
    return {
        name: np.take(grid, end, axis).ravel()
        for axis, pair in enumerate(names)
        for name, end in zip(pair, (0, -1), strict=True)
    }


def _skin(grid: Ints) -> Ints:
    """Triangles of the six sides of a block, seen from outside."""
    found = []
    for axis in range(3):
        for end in (0, -1):
            side = np.take(grid, end, axis)
            a, b, c, d = side[:-1, :-1], side[1:, :-1], side[1:, 1:], side[:-1, 1:]
            out = (end == -1) == (axis != 1)
            halves = ((a, b, c), (a, c, d)) if out else ((a, c, b), (a, d, c))
            found += [np.stack(half, axis=-1).reshape(-1, 3) for half in halves]
    return np.concatenate(found).astype(np.int32)


def _network(piece: Network) -> Built:
    x = np.array(piece.points, np.float64)
    mass = np.broadcast_to(np.array(piece.mass, np.float64), len(x)).copy()
    ends = np.array([spring.between for spring in piece.springs], np.int32).reshape(-1, 2)
    rest = _lengths(x, ends)
    given = [spring.rest_length for spring in piece.springs]
    rest = np.array([r if g is None else g for r, g in zip(rest, given, strict=True)], np.float64)
    stiffness = np.array([spring.stiffness for spring in piece.springs], np.float64)
    damping = np.array([spring.damping for spring in piece.springs], np.float64)
    velocity = _moving(piece, x, mass)
    if piece.velocities:
        velocity = velocity + np.array(piece.velocities)
    return Built(x, velocity, mass, Springs(ends, stiffness, rest, damping), hinges=_hinges(piece, x))


def _hinges(piece: Network, x: Floats) -> Hinges:
    if not piece.hinges:
        return NO_HINGES
    points = np.array([hinge.points for hinge in piece.hinges], np.int32)
    now = hinge_angles(x, points)
    angle = [
        a if one.angle is None else np.radians(one.angle) for a, one in zip(now, piece.hinges, strict=True)
    ]
    return Hinges(
        points, np.array([one.stiffness for one in piece.hinges], np.float64), np.array(angle),
        np.array([one.damping for one in piece.hinges], np.float64),
    )  # fmt: skip


def hinge_angles(x: Floats, points: Ints) -> Floats:
    """Angle of each hinge [rad], 0 where flat; `points` (h, 4): ends of the edge, corners beside it."""
    a, b, c, d = (x[points[:, k]] for k in range(4))
    n1, n2 = np.cross(b - a, c - a), np.cross(a - b, d - b)
    e = (b - a) / np.linalg.norm(b - a, axis=1)[:, None]
    sine = np.einsum("ij,ij->i", np.cross(n1, n2), e)
    return np.asarray(np.arctan2(sine, np.einsum("ij,ij->i", n1, n2)))


def hinge_gradients(x: Floats, points: Ints) -> Floats:
    """Slope of each angle by the places of its points, (h, 4, 3) [rad/m]."""
    a, b, c, d = (x[points[:, k]] for k in range(4))
    n1, n2 = np.cross(b - a, c - a), np.cross(a - b, d - b)
    u1 = n1 / np.einsum("ij,ij->i", n1, n1)[:, None]
    u2 = n2 / np.einsum("ij,ij->i", n2, n2)[:, None]
    length = np.linalg.norm(b - a, axis=1)[:, None]
    e = (b - a) / length

    def along(p: Floats) -> Floats:
        return np.asarray(np.einsum("ij,ij->i", p, e)[:, None])

    return np.stack(
        [
            -along(c - b) * u1 - along(d - b) * u2,
            -along(a - c) * u1 - along(a - d) * u2,
            -length * u1,
            -length * u2,
        ],
        axis=1,
    )


_BUILDERS: dict[type[Piece], Callable[[Any], Built]] = {
    Sheet: _sheet,
    MeshPiece: _mesh,
    Rope: _rope,
    Block: _block,
    Network: _network,
    Solid: _solid,
    Strands: _strands,
}
