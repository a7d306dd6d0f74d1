"""Placement as data: where particles start, and which way they head.

Shapes are filled evenly by volume (by area for surfaces). In two dimensions everything lies in
the plane z = 0: a ball becomes a disc, a shell and a torus become rings, a box a rectangle, and
normals and axes are along z whatever they say.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field, model_validator
from typing_extensions import Self

from tianim.errors import SceneError
from tianim.params import Direction, Fraction, NonNegative, Params, Positive, Positive3, ScenePath, Vector3
from tianim.spatial.point_files import PointData, read_points

Angle = Annotated[float, Field(ge=0, le=180)]

ORIGIN = (0.0, 0.0, 0.0)
UP = (0.0, 1.0, 0.0)


class Ball(Params):
    """Anywhere in a ball."""

    kind: Literal["ball"] = "ball"
    centre: Vector3 = Field(ORIGIN, description="centre [m]")
    radius: Positive = Field(1.0, description="radius [m]")


class Shell(Params):
    """Anywhere between two spheres, or on one."""

    kind: Literal["shell"] = "shell"
    centre: Vector3 = Field(ORIGIN, description="centre [m]")
    radius: Positive = Field(1.0, description="outer radius [m]")
    thickness: NonNegative = Field(0.0, description="outer less inner radius [m]")

    @model_validator(mode="after")
    def _fits(self) -> Self:
        if self.thickness > self.radius:
            raise ValueError(f"thickness {self.thickness:g} m: must not exceed the radius, {self.radius:g} m")
        return self


class BoxRegion(Params):
    """Anywhere in a box."""

    kind: Literal["box"] = "box"
    centre: Vector3 = Field(ORIGIN, description="centre [m]")
    size: Positive3 = Field((1.0, 1.0, 1.0), description="full lengths along x, y, z [m]")


class Disc(Params):
    """Anywhere on a flat disc, which may have a hole."""

    kind: Literal["disc"] = "disc"
    centre: Vector3 = Field(ORIGIN, description="centre [m]")
    radius: Positive = Field(1.0, description="radius [m]")
    hole: NonNegative = Field(0.0, description="radius of the hole [m]")
    normal: Direction = Field(UP, description="at right angles to the disc, any length but zero")

    @model_validator(mode="after")
    def _fits(self) -> Self:
        if self.hole >= self.radius:
            raise ValueError(f"hole {self.hole:g} m: must be less than the radius, {self.radius:g} m")
        return self


class Torus(Params):
    """Anywhere in a torus."""

    kind: Literal["torus"] = "torus"
    centre: Vector3 = Field(ORIGIN, description="centre [m]")
    ring_radius: Positive = Field(1.0, description="from the centre to the middle of the tube [m]")
    tube_radius: Positive = Field(0.25, description="radius of the tube [m]")
    axis: Direction = Field(UP, description="at right angles to the ring, any length but zero")

    @model_validator(mode="after")
    def _fits(self) -> Self:
        if self.tube_radius > self.ring_radius:
            raise ValueError(
                f"tube_radius {self.tube_radius:g} m: must not exceed ring_radius, {self.ring_radius:g} m"
            )
        return self


class Lattice(Params):
    """On a cubic (square) lattice about the centre, filled layer by layer from below."""

    kind: Literal["lattice"] = "lattice"
    centre: Vector3 = Field(ORIGIN, description="centre [m]")
    spacing: Positive = Field(1.0, description="between neighbours [m]")
    jitter: Fraction = Field(0.0, description="random displacement along each axis, part of the spacing")


class PointList(Params):
    """At the points given."""

    kind: Literal["points"] = "points"
    positions: tuple[Vector3, ...] = Field(description="one point a particle [m]")


def _checked(path: Path) -> PointData:
    try:
        return read_points(path)
    except SceneError as error:
        raise ValueError(str(error)) from error


class PointFile(Params):
    """Where a file says: NPZ (arrays position, velocity), PLY or VTU, as `tianim export` writes them."""

    kind: Literal["file"] = "file"
    path: ScenePath = Field(description="NPZ, PLY or VTU file")

    @model_validator(mode="after")
    def _is_readable(self) -> Self:
        _checked(self.path)
        return self


Placement = Annotated[
    Ball | Shell | BoxRegion | Disc | Torus | Lattice | PointList | PointFile, Field(discriminator="kind")
]


class RandomHeading(Params):
    """Every direction alike."""

    kind: Literal["random"] = "random"


class Along(Params):
    """About one direction."""

    kind: Literal["along"] = "along"
    direction: Direction = Field((1.0, 0.0, 0.0), description="middle of the cone, any length but zero")
    spread: Angle = Field(0.0, description="half angle of the cone that is filled evenly [deg]")


class Swirl(Params):
    """Round an axis, by the right-hand rule."""

    kind: Literal["swirl"] = "swirl"
    centre: Vector3 = Field(ORIGIN, description="a point of the axis [m]")
    axis: Direction = Field(UP, description="direction of the axis, any length but zero")
    inward: Annotated[float, Field(ge=-90, le=90)] = Field(
        0.0, description="turned towards the axis by [deg]"
    )


class FileHeading(Params):
    """The directions of the velocities in a file, one a particle."""

    kind: Literal["file"] = "file"
    path: ScenePath = Field(description="NPZ, PLY or VTU file with velocities")

    @model_validator(mode="after")
    def _has_velocities(self) -> Self:
        if _checked(self.path).velocity is None:
            raise ValueError(f"{self.path}: holds no array called velocity, (n, 3)")
        return self


Heading = Annotated[RandomHeading | Along | Swirl | FileHeading, Field(discriminator="kind")]
