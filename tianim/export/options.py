"""The `output:` section of a scene: what a run writes, in which axes and units, and the surfaces it makes."""

from typing import Annotated, Literal

from pydantic import AfterValidator, Field

from tianim.errors import FormatError
from tianim.export.axes import Axes
from tianim.export.formats import format_named
from tianim.params import Count, Name, Params, Positive


def _known(names: tuple[str, ...]) -> tuple[str, ...]:
    for name in names:
        try:
            format_named(name)
        except FormatError as error:
            raise ValueError(str(error)) from error
    return names


Names = tuple[Annotated[str, Field(min_length=1)], ...]


# Iterations of smoothing beyond which a surface of any size has become a blob.
MOST_SMOOTHING = 200


class SurfaceOptions(Params):
    """The surface of particles as a triangle mesh, a part of the frames like any other."""

    of: Annotated[str, Field(min_length=1)] | Annotated[Names, Field(min_length=1)] = Field(
        description="part of particles, or several that are one volume", examples=["water"]
    )
    particle_radius: Positive | None = Field(
        None, description="radius of a particle [m]; left out: half the spacing that the part tells"
    )
    smoothing_length: float = Field(
        2.0,
        ge=1,
        le=4,
        description="width of a particle's kernel, whose reach is twice that [particle radii]",
    )
    cube_size: float = Field(
        0.75, ge=0.2, le=4, description="side of the cubes that the mesh is cut from [particle radii]"
    )
    threshold: float = Field(
        0.6, gt=0, lt=1.5, description="value of the particles' summed kernels on the surface, 1 inside"
    )
    smoothing: int = Field(
        25, ge=0, le=MOST_SMOOTHING, description="iterations that smooth the mesh where particles are dense"
    )
    normal_smoothing: int = Field(
        10, ge=0, le=MOST_SMOOTHING, description="iterations that smooth the normals [of data array `normal`]"
    )
    attributes: Names = Field((), description="data arrays of the particles that the mesh is to have too")

    @property
    def parts(self) -> tuple[str, ...]:
        """Names of the parts that it is the surface of."""
        return (self.of,) if isinstance(self.of, str) else self.of


class OutputOptions(Params):
    """What a run writes. The run's own record is always VTU; other formats go beside it."""

    formats: Annotated[Names, AfterValidator(_known)] = Field(
        ("vtu",), description="file formats; vtu is always written [see `tianim export --formats`]"
    )
    up_axis: Literal["y", "z"] = Field("y", description="axis that points up in the files; y inside")
    scale: Positive = Field(
        1.0,
        description="length units of the files in a metre (100 for centimetres); fields in m, m/s, m/s^2 too",
    )
    fields: Names | Literal["all"] = Field("all", description="data arrays to write, besides the position")
    parts: Names | Literal["all"] = Field(
        "all",
        description="parts to write in the formats besides vtu, which has them all; there from the start",
    )
    surfaces: dict[Name, SurfaceOptions] = Field(
        {}, description="surface meshes made of particles while the run goes on, by the name of their part"
    )
    first_number: Count = Field(0, description="number in the file name of frame 0 (1 gives name_0001)")

    @property
    def axes(self) -> Axes:
        """The axes and units of the files."""
        return Axes(self.up_axis, self.scale)
