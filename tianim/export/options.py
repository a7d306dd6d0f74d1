"""The `output:` section of a scene: which files a run writes, and in which axes and units."""

from typing import Annotated, Literal

from pydantic import AfterValidator, Field

from tianim.errors import FormatError
from tianim.export.axes import Axes
from tianim.export.formats import format_named
from tianim.params import Count, Params, Positive


def _known(names: tuple[str, ...]) -> tuple[str, ...]:
    for name in names:
        try:
            format_named(name)
        except FormatError as error:
            raise ValueError(str(error)) from error
    return names


Names = tuple[Annotated[str, Field(min_length=1)], ...]


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
    first_number: Count = Field(0, description="number in the file name of frame 0 (1 gives name_0001)")

    @property
    def axes(self) -> Axes:
        """The axes and units of the files."""
        return Axes(self.up_axis, self.scale)
