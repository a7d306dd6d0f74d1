"""The fluid at the start, as data: boxes, spheres, meshes and points that are filled with particles.

    blocks: {column: {kind: box, lower: [0, 0, 0], upper: [1, 2, 1]},
             drop: {kind: sphere, centre: [0, 3, 0], radius: 0.3, velocity: [0, -2, 0]}}

Particles stand on a cubic lattice of the fluid's spacing. In two dimensions z counts for nothing:
a box is a rectangle, a sphere a disc, a mesh what the plane z = 0 cuts out of it.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from pydantic import Field, model_validator
from typing_extensions import Self

from tianim.errors import SceneError
from tianim.params import MAX_COUNT, Name, Params, Positive, ScenePath, Vector3
from tianim.spatial.mesh_files import MESH_SUFFIXES, read_mesh
from tianim.spatial.point_files import read_points

ORIGIN = (0.0, 0.0, 0.0)
# A block whose side is a whole number of spacings must not lose a layer to rounding [spacings].
ROUNDING = 1e-3


def layers(length: float, spacing: float) -> int:
    """Layers of particles that fit into `length` [m]."""
    return max(math.floor(length / spacing + ROUNDING), 0)


class Block(Params):
    """What every block has."""

    velocity: Vector3 = Field(ORIGIN, description="velocity of all its particles at the start [m/s]")
    phase: Name | None = Field(
        None, description="which of `phases` it is made of; the fluid's own where left out"
    )
    settled: bool = Field(
        False, description="starts with the pressure of rest below its surface, so that it does not bounce"
    )
    carve: bool = Field(
        False, description="leaves out what lies in bodies or earlier blocks, instead of refusing it"
    )

    @model_validator(mode="after")
    def _settled_is_at_rest(self) -> Self:
        if self.settled and any(self.velocity):
            raise ValueError("settled and velocity: what is settled is at rest; leave one of the two out")
        return self

    def particle_count(self, spacing: float, dimension: int) -> int:
        """Particles that it will be filled with, estimated."""
        raise NotImplementedError


class BoxBlock(Block):
    """A box: as many whole layers as fit, the first half a spacing from the lower faces."""

    kind: Literal["box"] = "box"
    lower: Vector3 = Field(description="corner with the smallest coordinates [m]", examples=[[0.0, 0.0, 0.0]])
    upper: Vector3 = Field(description="corner with the largest coordinates [m]", examples=[[1.0, 1.0, 1.0]])

    @model_validator(mode="after")
    def _lower_is_below_upper(self) -> Self:
        check_corners(self.lower, self.upper)
        return self

    def shape(self, spacing: float, dimension: int) -> tuple[int, ...]:
        """Layers along each axis."""
        sides = zip(self.lower[:dimension], self.upper[:dimension], strict=True)
        return tuple(layers(high - low, spacing) for low, high in sides)

    def particle_count(self, spacing: float, dimension: int) -> int:
        """Particles that it will be filled with, exact."""
        return math.prod(self.shape(spacing, dimension))


class SphereBlock(Block):
    """A ball (in two dimensions a disc): the lattice about its centre, points within the radius."""

    kind: Literal["sphere"] = "sphere"
    centre: Vector3 = Field(ORIGIN, description="centre [m]")
    radius: Positive = Field(1.0, description="radius [m]")

    def particle_count(self, spacing: float, dimension: int) -> int:
        """By volume."""
        across = self.radius / spacing
        volume = 4.0 / 3.0 * math.pi * across**3 if dimension == 3 else math.pi * across**2
        return math.ceil(volume)


class MeshBlock(Block):
    """The inside of a closed triangle mesh: the points of the lattice that lie within."""

    kind: Literal["mesh"] = "mesh"
    file: ScenePath = Field(description=f"mesh file: {', '.join(MESH_SUFFIXES)}")
    scale: Positive = Field(1.0, description="factor on the file's coordinates")
    position: Vector3 = Field(ORIGIN, description="where the file's origin is put [m]")
    rotation: Vector3 = Field(ORIGIN, description="angles about its own x, then y, then z axis [deg]")

    @model_validator(mode="after")
    def _is_closed(self) -> Self:
        check_closed(self.file)
        return self

    def particle_count(self, spacing: float, dimension: int) -> int:
        """By volume; in two dimensions by the box about the mesh."""
        mesh = read_mesh(self.file)
        across = self.scale / spacing
        if dimension == 2:
            return math.ceil(float(np.prod(np.sort(mesh.extent)[1:])) * across**2)
        corners = mesh.vertices[mesh.triangles] - mesh.lower
        volume = np.einsum("ij,ij->", np.cross(corners[:, 0], corners[:, 1]), corners[:, 2]) / 6.0
        return math.ceil(abs(float(volume)) * across**3)


class PointsBlock(Block):
    """Particles at points given one by one or by a file, which must be about a spacing apart."""

    kind: Literal["points"] = "points"
    positions: tuple[Vector3, ...] = Field(
        (), max_length=100_000, description="one point a particle [m]", examples=[[[0.0, 0.0, 0.0]]]
    )
    file: ScenePath | None = Field(
        None, description="NPZ (array position, perhaps velocity), PLY or VTU file, instead of positions"
    )

    @model_validator(mode="after")
    def _has_points(self) -> Self:
        if bool(self.positions) == (self.file is not None):
            raise ValueError("positions, file: a block of points needs one of the two")
        if self.file is not None:
            try:
                read_points(self.file)
            except SceneError as error:
                raise ValueError(str(error)) from error
        return self

    def particle_count(self, spacing: float, dimension: int) -> int:
        """The number of points."""
        return len(self.positions) if self.file is None else len(read_points(self.file).position)


BlockParams = Annotated[BoxBlock | SphereBlock | MeshBlock | PointsBlock, Field(discriminator="kind")]
Many = Annotated[int, Field(ge=1, le=MAX_COUNT)]


def check_corners(lower: Vector3, upper: Vector3) -> None:
    """ValueError where a box has no inside."""
    for axis, low, high in zip("xyz", lower, upper, strict=True):
        if not low < high:
            raise ValueError(
                f"lower must be less than upper in every axis; in {axis}, {low:g} is not below {high:g}"
            )


def check_closed(path: Path) -> None:
    """ValueError where a mesh cannot be read or has no inside to be filled."""
    try:
        mesh = read_mesh(path)
    except SceneError as error:
        raise ValueError(str(error)) from error
    if mesh.open_edges:
        raise ValueError(
            f"{path} is not watertight ({mesh.open_edges} open edges), so it has no inside to be filled: "
            "close it"
        )
    if not mesh.extent.all():
        raise ValueError(f"{path} is flat, so it has no inside to be filled")
