"""Which builder makes which kind of piece, and networks, whose points and springs are listed one by one."""

from collections.abc import Callable
from typing import Any

import numpy as np

from tianim.systems.springs.blocks import block, solid
from tianim.systems.springs.built import NO_HINGES, Built, Floats, Hinges, Springs, lengths, moving
from tianim.systems.springs.hinges import hinge_angles
from tianim.systems.springs.lines import rope, strands
from tianim.systems.springs.meshes import mesh
from tianim.systems.springs.piece_params import (
    Block,
    MeshPiece,
    Network,
    Piece,
    Rope,
    Sheet,
    Solid,
    Strands,
)
from tianim.systems.springs.sheets import sheet


def build_piece(piece: Piece) -> Built:
    """The points and springs of `piece`. SceneError where they cannot be made."""
    return _BUILDERS[type(piece)](piece)


def _network(piece: Network) -> Built:
    x = np.array(piece.points, np.float64)
    mass = np.broadcast_to(np.array(piece.mass, np.float64), len(x)).copy()
    ends = np.array([spring.between for spring in piece.springs], np.int32).reshape(-1, 2)
    rest = lengths(x, ends)
    given = [spring.rest_length for spring in piece.springs]
    rest = np.array([r if g is None else g for r, g in zip(rest, given, strict=True)], np.float64)
    stiffness = np.array([spring.stiffness for spring in piece.springs], np.float64)
    damping = np.array([spring.damping for spring in piece.springs], np.float64)
    velocity = moving(piece, x, mass)
    if piece.velocities:
        velocity = velocity + np.array(piece.velocities)
    return Built(x, velocity, mass, Springs(ends, stiffness, rest, damping), hinges=_hinges_of(piece, x))


def _hinges_of(piece: Network, x: Floats) -> Hinges:
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


_BUILDERS: dict[type[Piece], Callable[[Any], Built]] = {
    Sheet: sheet,
    MeshPiece: mesh,
    Rope: rope,
    Block: block,
    Network: _network,
    Solid: solid,
    Strands: strands,
}
