"""The formats that meshio writes: VTK legacy, PLY, OBJ, STL, OFF, XDMF, Gmsh and MED.

This is the only module that imports meshio, so that a maintained fork (meshlane has the same
calls) can replace it in one line. What meshio would drop with a warning, or write wrongly, is
converted here, in a way that the table of formats states, or refused:

- An array with a number of components that the format cannot hold is split: `velocity` becomes
  vx, vy, vz, `color` red, green, blue, others name_x, name_y ... PLY has no vectors at all.
- PLY: integers of 64 bits become int32 where they fit and double where not; no data per cell;
  no lines (meshio writes faces with two corners, which other readers do not take for lines).
- OBJ, STL and OFF keep the geometry; STL only the corners of the triangles.
- VTK legacy is written in version 4.2, which holds an empty part too.
- Gmsh holds all data as double, and no points without cells.
- XDMF, Gmsh: an empty part is a small file of our own, as readers crash on meshio's.
"""

import contextlib
import io
import re
import warnings
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import meshio
import numpy as np

from tianim.errors import FormatError
from tianim.export.files import whole_folder
from tianim.export.formats import Stamp
from tianim.export.hdf import require_room
from tianim.export.parts import byte_count, cell_data_of, cells_of, kind_of, with_components
from tianim.frame import Array, Part

# Suffix to what `meshio.write` is told.
WRITERS: dict[str, dict[str, Any]] = {
    ".vtk": {"file_format": "vtk42"},
    ".ply": {"file_format": "ply"},
    ".obj": {"file_format": "obj"},
    ".stl": {"file_format": "stl", "binary": True},
    ".off": {"file_format": "off"},
    ".xdmf": {"file_format": "xdmf", "compression": None},
    ".msh": {"file_format": "gmsh"},
    ".med": {"file_format": "med"},
}
CELL_NAMES = {"points": "vertex", "lines": "line", "triangles": "triangle"}
GEOMETRY_ONLY = {".obj", ".stl", ".off"}
# Components that an array may have; VTK legacy would pad two to three, XDMF readers misread others.
COMPONENTS = {".ply": {1}, ".vtk": {1, 3, 4, 6, 9}, ".xdmf": {1, 3, 9}, ".msh": {1, 3, 9}}
EMPTY_FILES = {
    # Gmsh reads this; a reader of meshio's own empty file fails.
    ".msh": "$MeshFormat\n4.1 0 8\n$EndMeshFormat\n",
    # A point that no cell uses: VTK's reader crashes where there is none.
    ".xdmf": '<Xdmf Version="3.0"><Domain><Grid Name="Grid"><Geometry GeometryType="XYZ">'
    '<DataItem DataType="Float" Dimensions="1 3" Format="XML" Precision="4">0 0 0</DataItem></Geometry>'
    '<Topology TopologyType="Polyvertex" NumberOfElements="0" NodesPerElement="1">'
    '<DataItem DataType="Int" Dimensions="1 1" Format="XML" Precision="4">0</DataItem></Topology>'
    "</Grid></Domain></Xdmf>\n",
}
# The date that meshio puts into the first lines of PLY and OBJ.
DATE = re.compile(rb"Created by meshio v[^,\n]*, ([0-9T:.-]+)")


def write_part(path: Path, part: Part, stamp: Stamp) -> None:
    """Write one part of one frame; FormatError where the format cannot hold it."""
    suffix = path.suffix
    with whole_folder(path) as folder:
        file = folder / path.name
        if suffix in EMPTY_FILES and len(part.position) == 0:
            file.write_text(EMPTY_FILES[suffix], encoding="utf-8")
            return
        if suffix in (".xdmf", ".med"):
            require_room(file, byte_count(part))
        _write(file, _mesh(part, suffix))
        if suffix in (".ply", ".obj"):
            _blank_date(file)


def read(path: Path) -> meshio.Mesh:
    """What meshio reads in `path`; FormatError where it fails (by itself it would end the program)."""
    try:
        with _quiet():
            return meshio.read(path)
    except (Exception, SystemExit) as error:
        raise FormatError(f"{path}: meshio cannot read it ({error or type(error).__name__})") from error


def _write(file: Path, mesh: meshio.Mesh) -> None:
    try:
        with _quiet():
            mesh.write(file, **WRITERS[file.suffix])
    except OSError:
        raise
    except (Exception, SystemExit) as error:
        raise FormatError(f"{file.name}: meshio cannot write it ({error or type(error).__name__})") from error


@contextlib.contextmanager
def _quiet() -> Iterator[None]:
    """Without meshio's lines on the terminal: what they warn of is handled or stated here."""
    with (
        contextlib.redirect_stdout(io.StringIO()),
        contextlib.redirect_stderr(io.StringIO()),
        warnings.catch_warnings(),
    ):
        warnings.simplefilter("ignore")
        yield


def _mesh(part: Part, suffix: str) -> meshio.Mesh:
    """The part as meshio shall write it to a file with that suffix."""
    kind, cells = kind_of(part), cells_of(part)
    if cells is None:
        cells = np.arange(len(part.position), dtype=np.int32).reshape(-1, 1)
    if len(cells) == 0 and len(part.position) and suffix in (".msh", ".xdmf"):
        raise FormatError(
            f"format {suffix[1:]!r}: part {part.name!r} has points but no {kind}, which it cannot hold"
        )
    # A PLY's points are no faces: meshio would write them so, and Blender crashes on faces of one corner.
    has_cells = len(cells) > 0 and not (suffix == ".ply" and kind == "points")
    blocks = [(CELL_NAMES[kind], cells.astype(np.int32, copy=False))] if has_cells else []
    data: dict[str, Array] = {}
    cell_data: dict[str, list[Array]] = {}
    # MED cannot be read with arrays of length 0.
    if suffix not in GEOMETRY_ONLY and not (suffix == ".med" and len(part.position) == 0):
        data = _held(part.data, suffix)
    if suffix not in {*GEOMETRY_ONLY, ".ply"} and blocks:
        cell_data = {name: [values] for name, values in _held(cell_data_of(part), suffix).items()}
    if suffix == ".stl" and blocks:
        cell_data = {"facet_normals": [_normals(part.position, cells)]}
    return meshio.Mesh(part.position, blocks, point_data=data, cell_data=cell_data)


def _held(data: Mapping[str, Array], suffix: str) -> dict[str, Array]:
    """The arrays as the format holds them: types it knows, split where it lacks the components."""
    held: dict[str, Array] = {}
    for name, values in data.items():
        values = values.astype(_held_type(values, suffix), copy=False)
        held.update(with_components(name, values, COMPONENTS.get(suffix)))
    return held


def _held_type(values: Array, suffix: str) -> np.dtype:
    """The type to write: native byte order; no bool and no half, which meshio does not know."""
    dtype = values.dtype.newbyteorder("=")
    if dtype.kind == "b":
        return np.dtype(np.uint8)
    if dtype == np.float16:
        return np.dtype(np.float32)
    if suffix == ".ply" and dtype == np.int16:
        return np.dtype(np.int32)  # meshio writes "int16", which its reader does not know
    if suffix == ".ply" and dtype.kind in "iu" and dtype.itemsize == 8:
        fits = values.size == 0 or (values.min() >= -(2**31) and values.max() < 2**31)
        return np.dtype(np.int32 if fits else np.float64)
    return dtype


def _normals(position: Array, triangles: Array) -> Array:
    """Unit normals, shape (m, 3); zero where a triangle has no area (meshio would write NaN)."""
    a, b, c = (position[triangles[:, corner]].astype(np.float64) for corner in range(3))
    normals = np.cross(b - a, c - a)
    length = np.linalg.norm(normals, axis=1, keepdims=True)
    return np.divide(normals, length, out=np.zeros_like(normals), where=length > 0).astype(np.float32)


def _blank_date(file: Path) -> None:
    """Blank out the date in the header: the same frame shall give the same bytes."""
    with file.open("r+b") as opened:
        found = DATE.search(opened.read(200))
        if found:
            opened.seek(found.start(1))
            opened.write(b" " * len(found[1]))
