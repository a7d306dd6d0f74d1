"""Frames to files and back: the VTU record of a run, the other formats, and the table of them.

    with open_exporters(folder, ["ply"], OutputOptions(), fps=30.0) as writer:
        for frame in simulation.frames():
            writer.write(frame)

Importing this loads neither the compiler nor any format's package.
"""

from typing import TYPE_CHECKING

from tianim.export.exporters import export_run
from tianim.export.formats import FORMATS, Format, Stamp, format_named
from tianim.export.options import OutputOptions, SurfaceOptions
from tianim.export.passes import add_parts, surface_run
from tianim.export.record import RunFrames
from tianim.export.vtu import read_vtu
from tianim.export.writer import FrameWriter, open_exporters

if TYPE_CHECKING:
    from tianim.export.roundtrip import FormatRow

__all__ = [
    "FORMATS",
    "Format",
    "FrameWriter",
    "OutputOptions",
    "RunFrames",
    "Stamp",
    "SurfaceOptions",
    "add_parts",
    "export_run",
    "format_named",
    "formats_table",
    "open_exporters",
    "read_vtu",
    "surface_run",
]


def formats_table() -> "list[FormatRow]":
    """What each format keeps, by trying every kind of part with 0, 1 and 1,000 items; some seconds."""
    from tianim.export import roundtrip

    return roundtrip.formats_table()
