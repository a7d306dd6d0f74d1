"""The longest explicit step of a scene, before it is built: for `tianim check`.

Neighbourhoods repeat in sheets and blocks: one of the same cells but few of them has all that a large one
has, at its corners, its sides and within, and so bears the same step. One strand is as the others.

Limits: meshes, ropes, networks and what is stitched are built as they are.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from tianim.systems.springs.piece_params import CellBox, Piece, Sheet, Strands

if TYPE_CHECKING:
    from tianim.systems.springs.params import SpringsParams

# Cells along each axis: bending reaches over two of them.
FEW = 8


def longest_first_step(params: SpringsParams) -> float:
    """Longest stable explicit step [s]; infinity without springs. SceneError as of `assemble`."""
    from tianim.systems.springs.assembly import assemble
    from tianim.systems.springs.explicit import longest_step

    if not params.stitches:
        pieces = {name: _few_cells(piece) for name, piece in params.pieces.items()}
        params = params.model_copy(update={"pieces": pieces})
    return longest_step(assemble(params))


def _few_cells(piece: Piece) -> Piece:
    """A piece of the same cells, FEW at most along each axis, or one strand."""
    if isinstance(piece, Sheet):
        u, v = piece.segments
        segments = min(u, FEW), min(v, FEW)
        size = piece.size[0] * segments[0] / u, piece.size[1] * segments[1] / v
        return piece.model_copy(update={"size": size, "segments": segments})
    if isinstance(piece, CellBox):
        sides = zip(piece.size, piece.cells(), strict=True)
        return piece.model_copy(update={"size": tuple(side * min(n, FEW) / n for side, n in sides)})
    if isinstance(piece, Strands):
        return piece.model_copy(update={"count": 1})
    return piece
