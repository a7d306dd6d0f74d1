"""VTU, the run's own record: VTK's XML unstructured grid with its arrays appended as raw bytes.

The fast path. A header of some lines says where each array lies, then come the arrays as they
are in memory, each behind its length in bytes (UInt64, little endian), written with one
`writev`: nothing is encoded, compressed or joined. ParaView, VTK and meshio read it (meshio
not where there is no cell); `read_vtu` reads it back, to export and to draw a finished run.

The file is in the axes of its options and says so in its field data (`up_axis` 1 or 2 for y or
z, `scale`), and `read_vtu` undoes them. Units stand beside each array as VTK keeps them
(UNITS_LABEL). Reference: VTK file formats, https://docs.vtk.org/en/latest/vtk_file_formats/vtkxml_file_format.html
"""

import xml.etree.ElementTree as ElementTree
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO
from xml.sax.saxutils import escape, quoteattr

import numpy as np
from numpy.typing import NDArray

from tianim.errors import OutputError
from tianim.export.axes import Axes, UpAxis
from tianim.export.files import Chunk, whole_file, write_chunks
from tianim.export.formats import Stamp
from tianim.export.parts import KINDS, cell_data_of, cells_of, kind_of, make_part
from tianim.frame import Array, Part, Points

CELL_TYPES = {"points": 1, "lines": 3, "triangles": 5}
VTK_NAMES = {
    "f4": "Float32", "f8": "Float64",
    "i1": "Int8", "i2": "Int16", "i4": "Int32", "i8": "Int64",
    "u1": "UInt8", "u2": "UInt16", "u4": "UInt32", "u8": "UInt64",
}  # fmt: skip
DTYPES = {name: np.dtype(f"<{code}") for code, name in VTK_NAMES.items()}
APPENDED = b'<AppendedData encoding="raw">_'
# meshio looks for the line break before the closing tag.
CLOSING = b"\n</AppendedData></VTKFile>\n"
LENGTH = np.dtype("<u8")
# Headers are some kilobytes; more than this is no header of ours.
LONGEST_HEADER = 1 << 20
INT32_LIMIT = 2**31 - 1


class _Topology:
    """Connectivity, offsets and types, which are the same for every frame: made once, grown, sliced."""

    def __init__(self) -> None:
        self._rising: dict[tuple[int, np.dtype], NDArray[np.integer]] = {}
        self._types: dict[int, NDArray[np.uint8]] = {}

    def rising(self, count: int, step: int, dtype: np.dtype) -> NDArray[np.integer]:
        """0, step, 2 step ... (count values)."""
        known = self._rising.get((step, dtype))
        if known is None or len(known) < count:
            known = np.arange(0, count * step, step, dtype=dtype)
            self._rising[step, dtype] = known
        return known[:count]

    def types(self, count: int, code: int) -> NDArray[np.uint8]:
        """`count` times `code`."""
        known = self._types.get(code)
        if known is None or len(known) < count:
            known = self._types[code] = np.full(count, code, dtype=np.uint8)
        return known[:count]


_topology = _Topology()


def _file_dtype(dtype: np.dtype) -> np.dtype:
    """The type in the file: little endian; VTK has no bool (as uint8) and no half (as float32)."""
    if dtype.kind == "b":
        return np.dtype("u1")
    return np.dtype("<f4") if dtype == np.float16 else dtype.newbyteorder("<")


@dataclass(frozen=True)
class _Column:
    """An array as the file has it, with its name and unit."""

    name: str
    values: Array
    unit: str = ""

    @property
    def size(self) -> int:
        """Bytes that it takes, with the length before it."""
        return LENGTH.itemsize + self.values.nbytes

    def element(self, offset: int) -> str:
        """The XML element that points at it."""
        # The number only where there is a second axis: meshio reads (n, 1) for a stated 1, and so do we.
        components = "" if self.values.ndim == 1 else f'NumberOfComponents="{self.values.shape[1]}" '
        text = (
            f'<DataArray type="{VTK_NAMES[self.values.dtype.str[1:]]}" Name={quoteattr(self.name)} '
            f'{components}format="appended" offset="{offset}"'
        )
        if not self.unit:
            return text + "/>\n"
        label = (
            f'<InformationKey name="UNITS_LABEL" location="vtkDataArray">{escape(self.unit)}</InformationKey>'
        )
        return f"{text}>{label}</DataArray>\n"


def _column(name: str, values: Array, unit: str = "") -> _Column:
    return _Column(name, np.ascontiguousarray(values, dtype=_file_dtype(values.dtype)), unit)


def write_part(path: Path, part: Part, stamp: Stamp) -> None:
    """Write `part`, which is in `stamp.axes`; OutputError where the disk refuses."""
    sections = _sections(part)
    columns = [column for section in sections.values() for column in section]
    chunks: list[Chunk] = [_header(part, stamp, sections).encode()]
    # The last array first: meshio finds arrays by their offsets, of which it changes those it
    # has read, and would take one for another if they came in the order of their elements.
    for column in reversed(columns):
        chunks.append(column.values.nbytes.to_bytes(LENGTH.itemsize, "little"))
        if column.values.nbytes:
            chunks.append(column.values.data.cast("B"))
    chunks.append(CLOSING)
    with whole_file(path) as temporary:
        write_chunks(temporary, chunks)


def _sections(part: Part) -> dict[str, list[_Column]]:
    """The arrays of the file, by section."""
    kind, cells = kind_of(part), cells_of(part)
    point_count = len(part.position)
    cell_count = point_count if cells is None else len(cells)
    nodes = KINDS[kind]
    dtype = np.dtype("<i4") if max(point_count, cell_count * nodes) < INT32_LIMIT else np.dtype("<i8")
    connectivity = (
        _topology.rising(point_count, 1, dtype) if cells is None else cells.astype(dtype, copy=False)
    )
    return {
        "Points": [_column("Points", part.position, "m")],
        "PointData": [_column(name, values, part.units.get(name, "")) for name, values in part.data.items()],
        "CellData": [
            _column(name, values, part.units.get(name, "")) for name, values in cell_data_of(part).items()
        ],
        "Cells": [
            _column("connectivity", connectivity.reshape(-1)),
            _column("offsets", _topology.rising(cell_count + 1, nodes, dtype)[1:]),
            _column("types", _topology.types(cell_count, CELL_TYPES[kind])),
        ],
    }


def _header(part: Part, stamp: Stamp, sections: dict[str, list[_Column]]) -> str:
    offset = sum(column.size for section in sections.values() for column in section)
    body = []
    for name, section in sections.items():
        body.append(f"<{name}>\n")
        for column in section:
            offset -= column.size
            body.append(column.element(offset))
        body.append(f"</{name}>\n")
    return (
        '<?xml version="1.0"?>\n'
        '<VTKFile type="UnstructuredGrid" version="1.0" byte_order="LittleEndian" header_type="UInt64">\n'
        f"<UnstructuredGrid>\n{_field_data(part, stamp)}"
        f'<Piece NumberOfPoints="{len(part.position)}" NumberOfCells="{len(sections["Cells"][-1].values)}">\n'
        f"{''.join(body)}</Piece>\n</UnstructuredGrid>\n{APPENDED.decode()}"
    )


def _field_data(part: Part, stamp: Stamp) -> str:
    values = {
        "TimeValue": ("Float64", repr(float(stamp.time))),
        "frame": ("Int64", str(stamp.index)),
        "cell_type": ("UInt8", str(CELL_TYPES[kind_of(part)])),
        "up_axis": ("UInt8", str("xyz".index(stamp.axes.up))),
        "scale": ("Float64", repr(stamp.axes.scale)),
    }
    if isinstance(part, Points) and part.spacing:
        values["spacing"] = ("Float64", repr(float(part.spacing)))
    lines = (
        f'<DataArray type="{type_}" Name="{name}" NumberOfTuples="1" format="ascii">{text}</DataArray>\n'
        for name, (type_, text) in values.items()
    )
    return f"<FieldData>\n{''.join(lines)}</FieldData>\n"


@dataclass(frozen=True)
class _Header:
    """The XML of a file that `write_part` wrote, and where its arrays begin."""

    root: ElementTree.Element
    start: int

    @property
    def kind(self) -> str:
        return {code: kind for kind, code in CELL_TYPES.items()}[int(self._field("cell_type"))]

    @property
    def stamp(self) -> Stamp:
        up: UpAxis = "z" if int(self._field("up_axis")) == 2 else "y"
        return Stamp(
            int(self._field("frame")), float(self._field("TimeValue")), Axes(up, float(self._field("scale")))
        )

    @property
    def spacing(self) -> float:
        """Of the particles; 0 where the file has none."""
        return float(self.root.findtext(".//FieldData/DataArray[@Name='spacing']") or 0.0)

    def _field(self, name: str) -> str:
        return self._find(f".//FieldData/DataArray[@Name='{name}']").text or ""

    def _find(self, path: str) -> ElementTree.Element:
        found = self.root.find(path)
        if found is None:
            raise ValueError(f"no {path}")
        return found

    def read(self, file: BinaryIO, section: str) -> dict[str, Array]:
        """The arrays of `PointData`, `Cells` ... by name; as they were given."""
        return {element.attrib["Name"]: self._array(file, element) for element in self._find(f".//{section}")}

    def _array(self, file: BinaryIO, element: ElementTree.Element) -> Array:
        dtype = DTYPES[element.attrib["type"]]
        file.seek(self.start + int(element.attrib["offset"]))
        size = int.from_bytes(file.read(LENGTH.itemsize), "little")
        values = np.fromfile(file, dtype, size // dtype.itemsize)
        if values.nbytes != size:
            raise ValueError("cut short")
        components = element.get("NumberOfComponents")
        return values if components is None else values.reshape(-1, int(components))

    def units(self) -> dict[str, str]:
        """The units of the data arrays that have one."""
        labels = (
            (element.attrib["Name"], element.findtext("InformationKey"))
            for section in ("PointData", "CellData")
            for element in self._find(f".//{section}")
        )
        return {name: unit for name, unit in labels if unit}


@contextmanager
def _opened(path: Path) -> Iterator[tuple[BinaryIO, _Header]]:
    """The open file and its header; OutputError where it is not there, not ours or damaged."""
    try:
        with path.open("rb", buffering=0) as file:
            yield file, _read_header(file)
    except OSError as error:
        raise OutputError(f"{path}: cannot read: {(error.strerror or str(error)).lower()}") from error
    except (ValueError, KeyError, ElementTree.ParseError) as error:
        raise OutputError(f"{path}: not a VTU file that tianim wrote, or a damaged one ({error})") from error


def _read_header(file: BinaryIO) -> _Header:
    head = b""
    while (end := head.find(APPENDED)) < 0:
        more = file.read(8192)
        if not more or len(head) > LONGEST_HEADER:
            raise ValueError("no appended data")
        head += more
    start = end + len(APPENDED)
    return _Header(ElementTree.fromstring(head[:start] + CLOSING), start)


def read_vtu(path: Path, name: str | None = None) -> Part:
    """The part in a file that `write_part` wrote, in internal axes; its name is `name` or the file's."""
    with _opened(path) as (file, header):
        kind = header.kind
        # The cells of a point cloud are its points: not read.
        cells = (
            None if kind == "points" else header.read(file, "Cells")["connectivity"].reshape(-1, KINDS[kind])
        )
        part = make_part(
            kind,
            name or path.stem.rpartition("_")[0] or path.stem,
            header.read(file, "Points")["Points"],
            cells,
            header.read(file, "PointData"),
            header.read(file, "CellData"),
            header.units(),
            header.spacing,
        )
        return header.stamp.axes.undo(part)


def read_stamp(path: Path) -> Stamp:
    """Frame index, time and axes of a file that `write_part` wrote, from its header alone."""
    with _opened(path) as (_, header):
        return header.stamp
