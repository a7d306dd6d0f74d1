"""Ropes and strands: points in a row, springs between next neighbours, bending by second differences.

    k = EA / l,   B/2 integral(x_ss^2)        of a segment of length l

Limits: straight at rest, without twist.
"""

import numpy as np

from tianim.systems.springs.built import Built, Springs, bending_energy, moving, springs_at_rest
from tianim.systems.springs.piece_params import Rope, Strands


def rope(piece: Rope) -> Built:
    """One row of points along a course of straight parts."""
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
        bending = bending_energy(len(x), [(triples, np.array([1.0, -2.0, 1.0]), weight)])
    groups = {"first": line[:1], "last": line[-1:], "ends": line[[0, -1]]}
    return Built(x, moving(piece, x, mass), mass, springs, bending, chains=(line,), groups=groups)


def strands(piece: Strands) -> Built:
    """Rows of points, each straight out from its root."""
    root, out = piece.roots()
    each = piece.segments + 1
    rest = piece.length / piece.segments
    x = (root[:, None] + rest * np.arange(each)[None, :, None] * out[:, None]).reshape(-1, 3)
    number = np.arange(len(x), dtype=np.int32).reshape(-1, each)
    ends = np.stack([number[:, :-1].ravel(), number[:, 1:].ravel()], axis=1)
    share = np.ones(each)
    share[[0, -1]] = 0.5
    mass = np.tile(piece.density * rest * share, piece.count)
    springs = springs_at_rest(x, ends, np.full(len(ends), piece.stretch / rest), piece.damping)
    bending = None
    if piece.bend > 0.0:
        triples = np.stack([number[:, :-2], number[:, 1:-1], number[:, 2:]], axis=-1).reshape(-1, 3)
        weight = np.full(len(triples), piece.bend / rest**3)
        bending = bending_energy(len(x), [(triples, np.array([1.0, -2.0, 1.0]), weight)])
    groups = {"roots": number[:, :2].ravel(), "tips": number[:, -1]}
    return Built(x, moving(piece, x, mass), mass, springs, bending, chains=tuple(number), groups=groups)
