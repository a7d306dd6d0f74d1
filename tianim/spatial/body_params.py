"""Bodies as data: the shapes that a scene may hold as colliders, predators, targets.

A body is a shape with a pose over time. Rotations are three angles [deg] about the body's own
axes, x first, then the turned y, then the turned z (intrinsic XYZ). Lengths in metres.
A solid keeps particles out; a container (`inside: true`) keeps them in.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, BeforeValidator, Field, ValidationInfo, model_validator
from typing_extensions import Self

from tianim.errors import SceneError
from tianim.params import Animated, Direction, NonNegative, Params, Positive, Positive3, ScenePath, Vector3
from tianim.spatial.mesh_files import MESH_SUFFIXES, read_mesh

Resolution = Annotated[int, Field(ge=8, le=256)]
Speed = Annotated[float, Field(gt=0, le=1000)]


class Posed(Params):
    """What every body has: where it is."""

    position: Animated[Vector3] = Field((0.0, 0.0, 0.0), description="origin of the body [m]")
    rotation: Animated[Vector3] = Field(
        (0.0, 0.0, 0.0), description="angles about its own x, then y, then z axis [deg]"
    )


class Plane(Posed):
    """The half space behind a plane: free space is where the normal points."""

    kind: Literal["plane"] = "plane"
    normal: Direction = Field((0.0, 1.0, 0.0), description="direction of free space, any length but zero")
    drawn_size: Positive = Field(20.0, description="side of the square that pictures and exports show [m]")


class Box(Posed):
    """A box about its origin."""

    kind: Literal["box"] = "box"
    size: Positive3 = Field((1.0, 1.0, 1.0), description="full lengths along x, y, z [m]")
    inside: bool = Field(False, description="true: a container, free space is inside")


class Sphere(Posed):
    """A sphere about its origin."""

    kind: Literal["sphere"] = "sphere"
    radius: Positive = Field(1.0, description="radius [m]")
    inside: bool = Field(False, description="true: a container, free space is inside")


class Capsule(Posed):
    """A cylinder along the body's y axis with round ends."""

    kind: Literal["capsule"] = "capsule"
    radius: Positive = Field(0.5, description="radius [m]")
    length: Positive = Field(1.0, description="between the centres of the two round ends [m]")


class Cylinder(Posed):
    """A cylinder about its origin along the body's y axis, with flat ends."""

    kind: Literal["cylinder"] = "cylinder"
    radius: Positive = Field(0.5, description="radius [m]")
    length: Positive = Field(1.0, description="from end to end [m]")
    inside: bool = Field(False, description="true: a container, free space is inside")


class TriangleMesh(Posed):
    """A closed triangle mesh, or an open one as a shell of some thickness."""

    kind: Literal["mesh"] = "mesh"
    file: ScenePath = Field(description=f"mesh file: {', '.join(MESH_SUFFIXES)}")
    scale: Positive = Field(1.0, description="factor on the file's coordinates")
    resolution: Resolution = Field(64, description="cells of the distance grid along the longest side")
    thickness: NonNegative = Field(
        0.0, description="0: the solid inside; else a shell that reaches this far from the surface [m]"
    )
    inside: bool = Field(False, description="true: a container, free space is inside the closed mesh")

    @model_validator(mode="after")
    def _is_a_mesh(self) -> Self:
        if self.inside and self.thickness > 0.0:
            raise ValueError("inside: true needs a closed mesh without thickness: a shell has no inside")
        _refuse_bad_mesh(self.file, self)
        return self


def _refuse_bad_mesh(path: Path, body: TriangleMesh | MeshSequence) -> None:
    """Raise what pydantic adds the place in the scene to."""
    try:
        check_surface(path, body)
    except SceneError as error:
        raise ValueError(str(error)) from error


def _resolve(value: Any, info: ValidationInfo) -> Any:
    """Take a folder or pattern as relative to the scene file."""
    folder = (info.context or {}).get("folder")
    return value if not isinstance(value, str | Path) or folder is None else Path(folder) / value


def _at_least_two(files: Path) -> Path:
    try:
        count = len(sequence_files(files))
    except OSError as error:
        raise ValueError(f"{files}: cannot be read ({error.strerror})") from error
    if count < 2:
        raise ValueError(f"{files}: a sequence needs two or more meshes ({', '.join(MESH_SUFFIXES)})")
    return files


class MeshSequence(Posed):
    """A closed mesh that changes shape: one file a key, all with the same triangles.

    `loop` goes from the last key straight back to the first, as keyframes do.
    """

    kind: Literal["mesh_sequence"] = "mesh_sequence"
    files: Annotated[Path, Field(strict=False), BeforeValidator(_resolve), AfterValidator(_at_least_two)] = (
        Field(description="folder of numbered meshes, or a pattern such as fish/swim_*.obj")
    )
    fps: Speed = Field(30.0, description="meshes a second [1/s]")
    repeat: Literal["none", "loop", "pingpong"] = Field("none", description="what follows the last mesh")
    scale: Positive = Field(1.0, description="factor on the files' coordinates")
    resolution: Resolution = Field(64, description="cells of the distance grid along the longest side")
    thickness: NonNegative = Field(
        0.0, description="0: the solid inside; else a shell that reaches this far from the surface [m]"
    )

    @model_validator(mode="after")
    def _first_is_a_mesh(self) -> Self:
        _refuse_bad_mesh(sequence_files(self.files)[0], self)
        return self


BodyParams = Annotated[
    Plane | Box | Sphere | Capsule | Cylinder | TriangleMesh | MeshSequence, Field(discriminator="kind")
]


def sequence_files(files: Path) -> tuple[Path, ...]:
    """The mesh files of a folder or pattern, in the order of the last number in their names."""
    found = files.iterdir() if files.is_dir() else files.parent.glob(files.name)
    meshes = [path for path in found if path.suffix.lower() in MESH_SUFFIXES and path.is_file()]
    return tuple(sorted(meshes, key=lambda path: (_number(path.stem), path.name)))


def _number(stem: str) -> int:
    digits = re.findall(r"\d+", stem)
    return int(digits[-1]) if digits else -1


def check_surface(path: Path, body: TriangleMesh | MeshSequence) -> None:
    """SceneError where the mesh has no inside and no thickness, or too little for its grid."""
    mesh = read_mesh(path)
    if body.thickness == 0.0 and mesh.open_edges:
        raise SceneError(
            f"{path} is not watertight ({mesh.open_edges} open edges), so it has no inside: "
            "close it, or give a thickness [m] to make it a shell"
        )
    cell = float(mesh.extent.max()) * body.scale / body.resolution
    if 0.0 < body.thickness < cell:
        raise SceneError(
            f"thickness {body.thickness:g} m: must be at least a cell of the distance grid, {cell:.3g} m"
        )
