"""Lattices of particles: where a block's particles may stand, and which of these places are in a shape.

A block stands on a cubic lattice of its own: a box on one that begins half a spacing from its lower
faces, a ball on one about its centre, a mesh on one that is centred in the box about it.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tianim.math.rotations import from_euler, rotate
from tianim.spatial.distance_grid import inside
from tianim.spatial.mesh_files import TriangleData, read_mesh
from tianim.systems.fluid.block_params import ROUNDING, BoxBlock, MeshBlock, SphereBlock

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]
Filling = BoxBlock | SphereBlock | MeshBlock


class Lattice(NamedTuple):
    """Places `origin + spacing * (i, j, k)` with i < shape[0] and so on, k fastest; metres."""

    origin: Floats
    spacing: float
    shape: tuple[int, int, int]

    def points(self) -> Floats:
        """All places, (n, 3)."""
        steps = np.indices(self.shape).reshape(3, -1).T
        return self.origin + self.spacing * steps


def lattice_of(block: Filling, spacing: float, dimension: int) -> Lattice:
    """The lattice that a block stands on; in two dimensions its one layer is at z = 0."""
    if isinstance(block, BoxBlock):
        shape = block.shape(spacing, dimension)
        origin = np.array(block.lower) + 0.5 * spacing
    elif isinstance(block, SphereBlock):
        most = int(block.radius / spacing + ROUNDING)
        shape = (2 * most + 1,) * dimension
        origin = np.array(block.centre) - most * spacing
    else:
        vertices = mesh_of(block).vertices
        lower, upper = vertices.min(axis=0), vertices.max(axis=0)
        shape = tuple(max(int(n), 1) for n in np.floor((upper - lower)[:dimension] / spacing + ROUNDING))
        centre = 0.5 * (lower + upper)
        origin = centre.copy()
        origin[:dimension] -= 0.5 * spacing * (np.array(shape) - 1)
    if dimension == 2:
        shape, origin[2] = (*shape, 1), 0.0
    return Lattice(origin, spacing, (shape[0], shape[1], shape[2]))


def within(block: Filling, lattice: Lattice, dimension: int, margin: float = 0.0) -> Mask:
    """Which places of a lattice are in a block, (n,).

    `margin` [m] widens boxes and balls; a mesh is taken as it is.
    """
    if isinstance(block, MeshBlock):
        mesh = mesh_of(block)
        return inside(mesh, (mesh.vertices - lattice.origin) / lattice.spacing, lattice.shape)
    x = lattice.points()[:, :dimension]
    if isinstance(block, SphereBlock):
        return np.asarray(
            np.linalg.norm(x - np.array(block.centre)[:dimension], axis=1) < block.radius + margin
        )
    lower = np.array(block.lower)[:dimension]
    upper = lower + lattice.spacing * np.array(block.shape(lattice.spacing, dimension))
    return np.asarray(((x > lower - margin) & (x < upper + margin)).all(axis=1))


def mesh_of(block: MeshBlock) -> TriangleData:
    """The mesh where it stands [m]."""
    mesh = read_mesh(block.file)
    turned = rotate(from_euler(block.rotation), mesh.vertices * block.scale)
    return TriangleData(turned + np.array(block.position), mesh.triangles)
