"""The table of formats: one line each. Adding a format means a module and a line here.

A format writes either one file a part and frame, through its module's

    write_part(path: Path, part: Part, stamp: Stamp) -> None

or one file for the whole run when that has ended, from the run's own record, through

    assemble(folder: Path, frames: Sequence[Frame], run: RunInfo) -> None

Parts arrive sound (`parts.check_frame`), of a kind that the format holds, and already in the
axes and units of the files. Modules are imported when their format is used: h5py, meshio and
USD cost a second that a plain run should not pay.
"""

import difflib
import importlib
import importlib.util
from dataclasses import dataclass
from types import ModuleType

from tianim.errors import FormatError, MissingPartError
from tianim.export.axes import INTERNAL, Axes
from tianim.export.parts import kind_of
from tianim.frame import Part

ALL = ("points", "lines", "triangles")


@dataclass(frozen=True)
class Stamp:
    """When a part is, and in which axes: index and time [s] of its frame."""

    index: int = 0
    time: float = 0.0
    axes: Axes = INTERNAL


@dataclass(frozen=True)
class RunInfo:
    """What a file of a whole run says of itself: frames a second, axes, number of frame 0."""

    fps: float
    axes: Axes = INTERNAL
    first_number: int = 0


@dataclass(frozen=True)
class Format:
    """One line of the table.

    about     who reads it
    suffixes  of its files; the first is the one to open
    kinds     of part that it holds; others are refused
    package   what to install where its module needs more than the core: (import name, extra)
    is_text   slow to write: 100 times the time of a binary format for the same bytes
    """

    name: str
    about: str
    module: str
    suffixes: tuple[str, ...]
    kinds: tuple[str, ...] = ALL
    whole_run: bool = False
    is_text: bool = False
    package: tuple[str, str] | None = None

    @property
    def suffix(self) -> str:
        """Suffix of the file to open."""
        return self.suffixes[0]

    def load(self) -> ModuleType:
        """The module that writes it; MissingPartError where a package is not installed."""
        if self.package and importlib.util.find_spec(self.package[0]) is None:
            raise MissingPartError(
                f"format {self.name!r} needs a package that is not installed: "
                f"pip install 'tianim[{self.package[1]}]'"
            )
        return importlib.import_module(f"tianim.export.{self.module}")

    def refuse_others(self, part: Part) -> None:
        """FormatError where the format cannot hold such a part."""
        kind = kind_of(part)
        if kind not in self.kinds:
            able = ", ".join(name for name, other in FORMATS.items() if kind in other.kinds)
            raise FormatError(
                f"format {self.name!r} holds {' and '.join(self.kinds)} only; part {part.name!r} is {kind} "
                f"(these hold it: {able}; or name the parts to write in output.parts)"
            )


_TABLE = (
    Format("vtu", "ParaView, VTK, Blender's sequence loader; the run's own record", "vtu", (".vtu",)),
    Format("vtk", "VTK legacy 4.2, every VTK program", "meshio_formats", (".vtk",)),
    Format("ply", "Blender, Houdini, MeshLab, Open3D", "meshio_formats", (".ply",), ("points", "triangles")),
    Format("obj", "every 3D program", "meshio_formats", (".obj",), ("triangles",), is_text=True),
    Format("stl", "3D printing, CAD", "meshio_formats", (".stl",), ("triangles",)),
    Format("off", "geometry tools", "meshio_formats", (".off",), ("triangles",), is_text=True),
    Format("xdmf", "ParaView, VisIt; one pair of files a frame", "meshio_formats", (".xdmf", ".h5")),
    Format("msh", "Gmsh 4.1", "meshio_formats", (".msh",)),
    Format("med", "Salome", "meshio_formats", (".med",)),
    Format("npz", "NumPy", "npz", (".npz",)),
    Format("gadget", "yt, pynbody, GADGET: snapshots of stars", "gadget", (".hdf5",), ("points",)),
    Format(
        "xdmf_series", "ParaView, VisIt; one pair a part", "xdmf_series", (".xdmf", ".h5"), whole_run=True
    ),
    Format("vtkhdf", "ParaView 5.12 and later; one file a part", "vtkhdf", (".vtkhdf",), whole_run=True),
    Format(
        "usd",
        "Blender, Houdini, Maya, Omniverse; one stage a run",
        "usd",
        (".usdc",),
        whole_run=True,
        package=("pxr", "usd"),
    ),
)
FORMATS: dict[str, Format] = {format_.name: format_ for format_ in _TABLE}


def format_named(name: str) -> Format:
    """The format called `name` (".PLY" is "ply"); FormatError names those there are and the nearest."""
    key = name.strip().lower().removeprefix(".").replace("-", "_")
    if key in FORMATS:
        return FORMATS[key]
    by_suffix = {suffix[1:]: one.name for one in reversed(_TABLE) for suffix in one.suffixes}
    near = by_suffix.get(key) or next(iter(difflib.get_close_matches(key, FORMATS, 1)), None)
    hint = f"; did you mean {near!r}?" if near else ""
    raise FormatError(f"unknown format {name!r}: must be one of {', '.join(FORMATS)}{hint}")
