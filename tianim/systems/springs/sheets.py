"""Sheets: a grid of points, springs along it and across its cells, bending by second differences.

    E = c - G^2 / c,  c = C11 = C22, C12 = G        Young's modulus of the lattice [N/m], with diagonals
    B/2 integral(x_uu^2 + 2 x_uv^2 + x_vv^2)        bending

Limits: cells that are far from square cannot have much shear; a sheet is flat at rest.
"""

from typing import Any

import numpy as np

from tianim.errors import SceneError
from tianim.systems.springs.built import Built, Floats, Ints, bending_energy, moving, springs_at_rest
from tianim.systems.springs.piece_params import Sheet


def sheet(piece: Sheet) -> Built:
    """A grid of points over u and v."""
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
    along, across, diagonal = _stiffness(piece, hu, hv)
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
    bending = _bending(piece, grid, hu, hv, share_u, share_v) if piece.bend > 0.0 else None
    a, b, c, d = grid[:-1, :-1], grid[1:, :-1], grid[1:, 1:], grid[:-1, 1:]
    triangles = np.concatenate([np.stack(t, axis=-1).reshape(-1, 3) for t in ((a, c, b), (a, d, c))])
    groups = {
        "left": grid[0], "right": grid[-1], "bottom": grid[:, 0], "top": grid[:, -1],
        "left_bottom": grid[:1, 0], "right_bottom": grid[-1:, 0], "left_top": grid[:1, -1],
        "right_top": grid[-1:, -1],
    }  # fmt: skip
    uv = np.stack([s.ravel(), t.ravel()], axis=1).astype(np.float32)
    return Built(
        x, moving(piece, x, mass), mass, springs_at_rest(x, ends, stiffness, piece.damping), bending,
        triangles=triangles.astype(np.int32), open_to_air=True, groups=groups, data={"uv": uv},
    )  # fmt: skip


def _stiffness(piece: Sheet, hu: float, hv: float) -> tuple[float, float, float]:
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


def _bending(piece: Sheet, grid: Ints, hu: float, hv: float, share_u: Floats, share_v: Floats) -> Any:
    """B/2 integral(x_uu^2 + 2 x_uv^2 + x_vv^2), by second differences."""
    cell = piece.bend * hu * hv
    second, twist = np.array([1.0, -2.0, 1.0]), np.array([1.0, -1.0, -1.0, 1.0])
    lines_u = np.stack([grid[:-2], grid[1:-1], grid[2:]], axis=-1).reshape(-1, 3)
    lines_v = np.stack([grid[:, :-2], grid[:, 1:-1], grid[:, 2:]], axis=-1).reshape(-1, 3)
    cells = np.stack([grid[:-1, :-1], grid[1:, :-1], grid[:-1, 1:], grid[1:, 1:]], axis=-1).reshape(-1, 4)
    weight_u = np.broadcast_to(cell / hu**4 * share_v, grid[1:-1].shape).ravel()
    weight_v = np.broadcast_to(cell / hv**4 * share_u[:, None], grid[:, 1:-1].shape).ravel()
    weight_uv = np.full(len(cells), 2.0 * cell / (hu * hv) ** 2)
    return bending_energy(
        grid.size, [(lines_u, second, weight_u), (lines_v, second, weight_v), (cells, twist, weight_uv)]
    )
