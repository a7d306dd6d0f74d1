"""Blocks and solids: a grid of cells, filled with springs or with tetrahedra.

    k = POISSON_FACTOR E V / l^2        of each spring of a cell of volume V: edges and face diagonals

Limits: Poisson's ratio of a block of springs is that of its lattice, about 1/4; a solid (`solids.py`) has
its own. Cells are boxes.
"""

from itertools import product

import numpy as np

from tianim.math.rotations import from_euler, rotate
from tianim.systems.springs.built import (
    Built,
    Ints,
    Springs,
    Tetrahedra,
    lengths,
    moving,
    springs_at_rest,
)
from tianim.systems.springs.piece_params import Block, Solid

POISSON_FACTOR = 0.4  # k / (E h) of the lattice of a block
# The tetrahedra of an even cell: the middle one, then those at the other four corners.
_FIVE = (
    ((0, 0, 0), (1, 1, 0), (1, 0, 1), (0, 1, 1)),
    ((1, 0, 0), (0, 0, 0), (1, 1, 0), (1, 0, 1)),
    ((0, 1, 0), (0, 0, 0), (1, 1, 0), (0, 1, 1)),
    ((0, 0, 1), (0, 0, 0), (1, 0, 1), (0, 1, 1)),
    ((1, 1, 1), (1, 1, 0), (1, 0, 1), (0, 1, 1)),
)
_CORNERS = tuple(product((0, 1), repeat=3))


def block(piece: Block) -> Built:
    """Cells of springs: edges and face diagonals."""
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
    length = lengths(x, ends)
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
        x, moving(piece, x, mass), mass, springs_at_rest(x, ends, stiffness, piece.damping),
        triangles=_skin(grid), groups=_faces(grid),
    )  # fmt: skip


def solid(piece: Solid) -> Built:
    """Cells of five tetrahedra."""
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
        x, moving(piece, x, np.asarray(mass)), np.asarray(mass), none, triangles=_skin(grid),
        groups=_faces(grid), solid=Tetrahedra(corners, piece.stiffness, piece.poisson, piece.damping),
    )  # fmt: skip


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
