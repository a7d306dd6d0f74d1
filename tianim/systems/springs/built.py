"""Points and springs: what every piece is made into.

    E = 1/2 sum_s k_s (|d_s| - l_s)^2 + 1/2 x^T Q x

The first sum is over springs between two points, d their distance. The second is bending: with S the second
differences of a flat sheet or a straight rope and W their weights, Q = S^T W S is the energy
B/2 integral(curvature^2), exact for what bends without stretching (Bergou et al. 2006,
doi:10.2312/SGP/SGP06/227-230). The rows of Q sum to zero, so that bending acts as springs too, of rest length
0 and stiffness -Q_ij, some of them negative: one loop over neighbours does both.

Limits: ropes and sheets are straight and flat at rest; meshes as they are in their file (`curvature.py`).
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import scipy  # loads its parts when they are first used
from numpy.typing import NDArray

from tianim.spatial.mesh_files import Shown
from tianim.systems.springs.piece_params import Piece

Floats = NDArray[np.float64]
Ints = NDArray[np.int32]


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


def lengths(x: Floats, ends: Ints) -> Floats:
    """Distance of the two ends of each spring."""
    return np.asarray(np.linalg.norm(x[ends[:, 1]] - x[ends[:, 0]], axis=1))


def springs_at_rest(x: Floats, ends: Ints, stiffness: Floats, damping: float) -> Springs:
    """Springs at rest where they are, with dampers of `damping` x stiffness."""
    return Springs(ends.astype(np.int32), stiffness, lengths(x, ends), damping * stiffness)


def moving(piece: Piece, x: Floats, mass: Floats) -> Floats:
    """Velocity of each point, from the piece's own and its spin."""
    arm = x - mass @ x / mass.sum()
    return np.asarray(np.cross(np.array(piece.spin), arm) + piece.velocity)


def bending_energy(count: int, rows: list[tuple[Ints, Floats, Floats]]) -> Bending:
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
