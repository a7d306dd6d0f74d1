"""What springs are made into, as data: sheets, meshes, ropes, blocks, and networks given point by point.

    pieces: {cloth: {kind: sheet, size: [1.5, 1.0], segments: [60, 40], stretch: 1000, bend: 1.0e-5}}

Stiffnesses are those of the material, not of single springs, so that a finer mesh behaves the same:

    stretch  of a sheet: force per width over strain [N/m]; of a rope: force over strain, EA [N]
    shear    of a sheet: force per width over the angle of shear [N/m]
    bend     of a sheet: moment per width over curvature [N m]; of a rope: moment over curvature, EI [N m2]
    damping  a time [s]: a spring of stiffness k has the axial damper damping x k, which leaves the motion of
             a rigid body alone
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator
from typing_extensions import Self

from tianim.errors import SceneError
from tianim.params import Direction, NonNegative, Params, Positive, Positive3, ScenePath, Vector3
from tianim.spatial.mesh_files import MESH_SUFFIXES, painted_values, read_mesh

Floats = NDArray[np.float64]

ORIGIN = (0.0, 0.0, 0.0)
GOLDEN_ANGLE = math.pi * (3.0 - math.sqrt(5.0))  # [rad]
MOST_SEGMENTS = 4096
# Directions count as at right angles within this cosine.
SQUARE = 1e-6

Segments = Annotated[int, Field(ge=1, le=MOST_SEGMENTS)]
Index = Annotated[int, Field(ge=0, le=100_000_000)]
Damping = Annotated[float, Field(ge=0, le=1e3)]


class Piece(Params):
    """What every piece has."""

    velocity: Vector3 = Field(ORIGIN, description="velocity of all its points at the start [m/s]")
    spin: Vector3 = Field(
        ORIGIN, description="angular velocity about its centre of mass at the start [rad/s]"
    )

    yield_strain: Positive | None = Field(
        None, description="beyond this strain a spring stays longer or shorter; left out: it never does"
    )
    tear_strain: Positive | None = Field(
        None, description="beyond this strain a spring tears; left out: it never does"
    )
    strain_limit: Positive | None = Field(
        None, description="no spring is stretched beyond this strain; left out: as its stiffness lets it"
    )

    def point_count(self) -> int:
        """Points that it will have."""
        raise NotImplementedError

    def spring_count(self) -> int:
        """Springs that it will have, estimated."""
        raise NotImplementedError


class Fabric(Piece):
    """What sheets and meshes have."""

    density: Positive = Field(0.2, description="mass per area [kg/m2]")
    stretch: Positive = Field(1000.0, description="force per width over strain [N/m]")
    bend: NonNegative = Field(0.0, description="bending stiffness [N m]; silk 1e-6, cotton 1e-5, denim 1e-4")
    damping: Damping = Field(1e-3, description="internal damping of its springs, as a time [s]")


class Sheet(Fabric):
    """A rectangular sheet of square or oblong cells."""

    kind: Literal["sheet"] = "sheet"
    size: tuple[Positive, Positive] = Field((1.0, 1.0), description="lengths along u and v [m]")
    segments: tuple[Segments, Segments] = Field((32, 32), description="cells along u and v")
    origin: Vector3 = Field(ORIGIN, description="corner u = v = 0 [m]")
    u: Direction = Field((1.0, 0.0, 0.0), description="direction of u, any length but zero")
    v: Direction = Field((0.0, 0.0, 1.0), description="direction of v, at right angles to u")
    shear: NonNegative = Field(100.0, description="force per width over the angle of shear [N/m]")
    diagonals: Literal[0, 1, 2] = Field(
        2, description="shear springs of a cell: both diagonals, or one, which makes the sheet lopsided"
    )
    skip: NonNegative = Field(
        0.0,
        description="stiffness [N/m] of springs over two cells, the lectures' bend springs: they resist "
        "folds, but not as a bending stiffness; 0: none",
    )

    @model_validator(mode="after")
    def _is_square(self) -> Self:
        u, v = (np.array(axis) / np.linalg.norm(axis) for axis in (self.u, self.v))
        if abs(float(u @ v)) > SQUARE:
            raise ValueError(f"u and v must be at right angles; their cosine is {float(u @ v):.3g}")
        return self

    def point_count(self) -> int:
        """Corners of all cells."""
        return (self.segments[0] + 1) * (self.segments[1] + 1)

    def spring_count(self) -> int:
        """Two and the diagonals a point."""
        return (2 + self.diagonals + 2 * (self.skip > 0.0)) * self.point_count()


class MeshPiece(Fabric):
    """A triangle mesh from a file: its edges are springs that give it the stiffness E = `stretch`.

    A spring has the stiffness E (area of its triangles) / (rest length)^2: exact for equilateral
    triangles, of which a sheet has Poisson's ratio 1/3 (Van Gelder 1998, doi:10.1080/10867651.1998.10487490).
    """

    kind: Literal["mesh"] = "mesh"
    file: ScenePath = Field(description=f"mesh file: {', '.join(MESH_SUFFIXES)}")
    scale: Positive = Field(1.0, description="factor on the file's coordinates")
    position: Vector3 = Field(ORIGIN, description="where the file's origin is put [m]")
    rotation: Vector3 = Field(ORIGIN, description="angles about its own x, then y, then z axis [deg]")
    maps: dict[Literal["density", "stretch", "bend", "pin"], Annotated[str, Field(max_length=64)]] = Field(
        {},
        description="numbers painted on the file's points (ply), by name: factors on density, stretch and "
        "bend; of pin, points above 1/2 are the group `painted`",
    )

    @model_validator(mode="after")
    def _is_a_sheet(self) -> Self:
        check_sheet(self.file)
        for name, field in self.maps.items():
            try:
                values = painted_values(self.file, field)
            except SceneError as error:
                raise ValueError(f"maps.{name}: {error}") from error
            if name != "pin" and not (values > 0.0).all():
                raise ValueError(f"maps.{name}: {field} must be positive; the least is {values.min():g}")
        return self

    def point_count(self) -> int:
        """Points of the file."""
        return len(read_mesh(self.file).vertices)

    def spring_count(self) -> int:
        """Edges of the mesh, about."""
        return 3 * self.point_count()


class Rope(Piece):
    """A chain of points from one end to the other: a rope, a cable, a strip seen from the side."""

    kind: Literal["rope"] = "rope"
    points: tuple[Vector3, ...] = Field(
        min_length=2, max_length=MOST_SEGMENTS, description="corners of its course [m]",
        examples=[[[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]]],
    )  # fmt: skip
    segments: Segments = Field(32, description="equal segments along its course")
    length: Positive | None = Field(
        None, description="its length at rest [m], where not that of its course: it starts slack or taut"
    )
    density: Positive = Field(0.1, description="mass per length [kg/m]")
    stretch: Positive = Field(1e4, description="force over strain, EA [N]")
    bend: NonNegative = Field(0.0, description="moment over curvature, EI [N m2]")
    damping: Damping = Field(1e-3, description="internal damping of its springs, as a time [s]")

    @property
    def course(self) -> float:
        """Length of the course [m]."""
        return float(np.linalg.norm(np.diff(np.array(self.points), axis=0), axis=1).sum())

    @model_validator(mode="after")
    def _has_length(self) -> Self:
        lengths = np.linalg.norm(np.diff(np.array(self.points), axis=0), axis=1)
        if not lengths.all():
            raise ValueError(f"points {int(lengths.argmin())} and the next are in one place")
        return self

    def point_count(self) -> int:
        """Ends of all segments."""
        return self.segments + 1

    def spring_count(self) -> int:
        """Segments."""
        return self.segments


class Strands(Piece):
    """Straight strands that stand on the cap of a sphere: hair, grass, fur.

    Their roots are spread evenly (Fibonacci's spiral). To hold them, pin the group `roots`, the first two
    points of each, to the body that they grow on.
    """

    kind: Literal["strands"] = "strands"
    count: Annotated[int, Field(ge=1, le=1_000_000)] = Field(2000, description="number of strands")
    segments: Annotated[int, Field(ge=2, le=MOST_SEGMENTS)] = Field(31, description="of each strand")
    length: Positive = Field(0.3, description="of each strand [m]")
    centre: Vector3 = Field(ORIGIN, description="centre of the sphere [m]")
    radius: Positive = Field(0.1, description="radius of the sphere [m]")
    axis: Direction = Field((0.0, 1.0, 0.0), description="to the middle of the cap, any length but zero")
    angle: Annotated[float, Field(gt=0, le=180)] = Field(
        100.0, description="from the axis to the border of the cap [deg]"
    )
    density: Positive = Field(1e-4, description="mass per length [kg/m]; one hair 1e-5")
    stretch: Positive = Field(10.0, description="force over strain, EA [N]")
    bend: NonNegative = Field(1e-8, description="moment over curvature, EI [N m2]")
    strain_limit: Positive | None = Field(0.01, description="no segment is longer or shorter by more")
    damping: Damping = Field(1e-3, description="internal damping of its springs, as a time [s]")

    def roots(self) -> tuple[Floats, Floats]:
        """Roots and the direction of each strand, (count, 3)."""
        k = np.arange(self.count) + 0.5
        height = 1.0 - (1.0 - math.cos(math.radians(self.angle))) * k / self.count
        turn = GOLDEN_ANGLE * k
        flat = np.sqrt(np.maximum(1.0 - height**2, 0.0))
        up = np.array(self.axis) / np.linalg.norm(self.axis)
        side = np.cross(up, np.eye(3)[int(np.abs(up).argmin())])
        side /= np.linalg.norm(side)
        other = np.cross(up, side)
        out = height[:, None] * up + flat[:, None] * (
            np.cos(turn)[:, None] * side + np.sin(turn)[:, None] * other
        )
        return np.array(self.centre) + self.radius * out, out

    def point_count(self) -> int:
        """Ends of all segments."""
        return self.count * (self.segments + 1)

    def spring_count(self) -> int:
        """Segments."""
        return self.count * self.segments


class CellBox(Piece):
    """A box of cubic cells."""

    size: Positive3 = Field((0.3, 0.3, 0.3), description="lengths along its x, y, z [m]")
    spacing: Positive = Field(0.05, description="side of a cell [m], about: a whole number of cells fits")
    position: Vector3 = Field(ORIGIN, description="its centre [m]")
    rotation: Vector3 = Field(ORIGIN, description="angles about its own x, then y, then z axis [deg]")
    density: Positive = Field(1000.0, description="mass per volume [kg/m3]")

    def cells(self) -> tuple[int, int, int]:
        """Cells along x, y, z."""
        x, y, z = (max(round(length / self.spacing), 1) for length in self.size)
        return x, y, z

    def point_count(self) -> int:
        """Corners of all cells."""
        return math.prod(cells + 1 for cells in self.cells())


class Block(CellBox):
    """A box of cubic cells with springs along edges and face diagonals: jelly.

    Equal springs k = 0.4 E h on edges and face diagonals of a lattice h make an isotropic solid of Young's
    modulus E and Poisson's ratio 1/4; a spring counts once for every cell that it belongs to.
    """

    kind: Literal["block"] = "block"
    stiffness: Positive = Field(2e4, description="Young's modulus [Pa]; jelly 1e4")
    damping: Damping = Field(5e-3, description="internal damping of its springs, as a time [s]")

    def spring_count(self) -> int:
        """Three edges and six diagonals a point."""
        return 9 * self.point_count()


class Solid(CellBox):
    """A box of tetrahedra, five in each cell: elastic with any Poisson's ratio (`solids.py`)."""

    kind: Literal["solid"] = "solid"
    stiffness: Positive = Field(2e4, description="Young's modulus [Pa]; jelly 1e4, rubber 1e6")
    poisson: Annotated[float, Field(ge=0, le=0.49)] = Field(0.3, description="Poisson's ratio")
    damping: Damping = Field(5e-3, description="internal damping, as a time [s]")

    def spring_count(self) -> int:
        """Five tetrahedra a cell, each of which takes as much as four springs."""
        return 20 * math.prod(self.cells())


class NetworkSpring(Params):
    """One spring between two points of a network."""

    between: tuple[Index, Index] = Field(description="numbers of its two points, from 0", examples=[[0, 1]])
    stiffness: Positive = Field(10.0, description="force over length [N/m]")
    rest_length: NonNegative | None = Field(
        None, description="[m]; left out: as far as its points are apart at the start; 0: it pulls always"
    )
    damping: NonNegative = Field(0.0, description="force over speed along the spring [N s/m]")


class NetworkHinge(Params):
    """An angular spring: two triangles of a network that share an edge keep their angle."""

    points: tuple[Index, Index, Index, Index] = Field(
        description="the two ends of the edge, then the corner on either side", examples=[[0, 1, 2, 3]]
    )
    stiffness: Positive = Field(1.0, description="torque over angle [N m]")
    angle: Annotated[float, Field(gt=-180, lt=180)] | None = Field(
        None, description="at rest [deg], 0: flat; left out: as at the start"
    )
    damping: NonNegative = Field(0.0, description="torque over its rate [N m s]")


class Network(Piece):
    """Masses and springs, one by one: what lectures draw."""

    kind: Literal["network"] = "network"
    points: tuple[Vector3, ...] = Field(
        min_length=1, max_length=MOST_SEGMENTS, description="places of the masses [m]",
        examples=[[[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.5, 1.0, 0.0], [0.5, -1.0, 0.0]]],
    )  # fmt: skip
    mass: Positive | Annotated[tuple[Positive, ...], Field(min_length=1)] = Field(
        1.0, description="of every point, or of each [kg]"
    )
    velocities: tuple[Vector3, ...] = Field((), description="of each point at the start [m/s]; left out: 0")
    springs: tuple[NetworkSpring, ...] = Field(
        (), max_length=100_000, description="between which points, and how stiff",
        examples=[[{"between": [0, 1]}]],
    )  # fmt: skip
    hinges: tuple[NetworkHinge, ...] = Field((), max_length=10_000, description="angular springs")

    @model_validator(mode="after")
    def _fits_together(self) -> Self:
        count = len(self.points)
        for name, given in (("mass", self.mass), ("velocities", self.velocities)):
            if isinstance(given, tuple) and given and len(given) != count:
                raise ValueError(f"{name}: {len(given)} values for {count} points")
        for k, hinge in enumerate(self.hinges):
            if max(hinge.points) >= count:
                raise ValueError(
                    f"hinges.{k}.points: no point {max(hinge.points)}; there are 0 to {count - 1}"
                )
            xa, xb, xc, xd = (np.array(self.points[i]) for i in hinge.points)
            if not (np.cross(xb - xa, xc - xa).any() and np.cross(xb - xa, xd - xa).any()):
                raise ValueError(f"hinges.{k}.points: three of them lie in a line, so there is no angle")
        for k, spring in enumerate(self.springs):
            a, b = spring.between
            if max(a, b) >= count:
                raise ValueError(f"springs.{k}.between: no point {max(a, b)}; there are 0 to {count - 1}")
            if a == b:
                raise ValueError(f"springs.{k}.between: joins point {a} to itself")
            if self.points[a] == self.points[b] and spring.rest_length != 0.0:
                raise ValueError(
                    f"springs.{k}: points {a} and {b} are in one place, so it has no direction: "
                    "move one, or give rest_length 0"
                )
        return self

    def point_count(self) -> int:
        """Masses."""
        return len(self.points)

    def spring_count(self) -> int:
        """Springs."""
        return len(self.springs)


PieceParams = Annotated[
    Sheet | MeshPiece | Rope | Strands | Block | Solid | Network, Field(discriminator="kind")
]


def check_sheet(path: Path) -> None:
    """ValueError where a mesh is no surface that springs can be made of."""
    try:
        mesh = read_mesh(path)
    except SceneError as error:
        raise ValueError(str(error)) from error
    corners = mesh.vertices[mesh.triangles]
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    if not area.all():
        k = int(np.flatnonzero(area == 0.0)[0])
        none = int((area == 0.0).sum())
        raise ValueError(f"{path}: triangle {k} has no area; {none} of {len(area)} have none")
    edges = np.sort(mesh.triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    pairs, uses = np.unique(edges, axis=0, return_counts=True)
    if uses.max() > 2:
        a, b = pairs[uses.argmax()]
        raise ValueError(
            f"{path}: {uses.max()} triangles share the edge between points {a} and {b}; at most 2 may"
        )
