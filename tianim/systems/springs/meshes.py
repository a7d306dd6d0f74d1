"""Meshes: surfaces read from a file, edges as springs, what is painted on them, bending across edges.

    k = Y A / l^2        of an edge of length l that A [m2] of its two triangles belong to, whole

Limits: triangles of one file are one fabric, stretched alike in all directions; points that belong to no
triangle are an error.
"""

from typing import Any

import numpy as np

from tianim.errors import SceneError
from tianim.math.rotations import from_euler, rotate
from tianim.spatial.mesh_files import painted_values, read_mesh, read_shown
from tianim.systems.springs.built import (
    Built,
    Curved,
    Floats,
    Ints,
    bending_energy,
    lengths,
    moving,
    springs_at_rest,
)
from tianim.systems.springs.piece_params import Fabric, MeshPiece

# Pairs of triangles bent by less than this angle [rad] are flat: file formats round.
FLAT = 1e-4


def mesh(piece: MeshPiece) -> Built:
    """The points of a file, and a spring along each edge."""
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
    stiffness = piece.stretch * wide / lengths(x, ends) ** 2
    shown = read_shown(piece.file)
    factor = {name: _painted(piece, name) for name in ("density", "stretch", "bend", "pin")}
    mass, stiffness = mass * factor["density"], stiffness * factor["stretch"][ends].mean(axis=1)
    bending, curved = None, None
    if piece.bend > 0.0:
        bending, curved = _bending(piece, x, triangles, area, edge, factor["bend"])
    border = np.unique(ends[np.bincount(edge, minlength=len(ends)) == 1]).astype(np.int32)
    groups = {"border": border}
    if "pin" in piece.maps:
        groups["painted"] = np.flatnonzero(factor["pin"] > 0.5).astype(np.int32)
    return Built(
        x, moving(piece, x, mass), mass, springs_at_rest(x, ends, stiffness, piece.damping), bending, curved,
        triangles=triangles, open_to_air=True, shown=shown, groups=groups,
    )  # fmt: skip


def _painted(piece: MeshPiece, name: str) -> Floats:
    """The map of the file that `maps` names for a quantity, a factor at each point; 1 without one."""
    if name not in piece.maps:
        return np.ones(len(read_mesh(piece.file).vertices))
    return painted_values(piece.file, piece.maps[name])


def _bending(
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
    return bending_energy(len(x), [(points, coefficients, weight)]), curved
