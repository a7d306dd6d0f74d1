"""What each format keeps, found by trying: write parts, read the files back, compare every array.

`formats_table` makes the table of `tianim export --formats` from it, and the tests hold it
against what the documents promise, so the two cannot drift apart. Reading is by another
program's library where there is one (meshio, NumPy, h5py, USD).
"""

import contextlib
import tempfile
import xml.etree.ElementTree as ElementTree
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from tianim.errors import FormatError, MissingPartError
from tianim.export.exporters import Exporters, Plan
from tianim.export.formats import ALL, FORMATS, Format
from tianim.export.options import OutputOptions
from tianim.export.parts import KINDS, cell_data_of, cells_of, component_names, make_part
from tianim.export.series import frame_name
from tianim.export.vtu import read_vtu
from tianim.frame import Array, Frame, Part

COUNTS = (0, 1, 1000)
FRAMES = 2
FPS = 30.0
PART = "sample"
GEOMETRY = ("position", "cells")


@dataclass(frozen=True)
class ReadBack:
    """What a reader found in one frame's file; `cells` is None where the format names none."""

    position: Array
    cells: Array | None
    data: dict[str, Array] = field(default_factory=dict)
    cell_data: dict[str, Array] = field(default_factory=dict)


@dataclass(frozen=True)
class Trip:
    """The outcome of writing `count` items of a kind in a format and reading them back.

    fates    per array: `exact`, `as <type>` (same values), `split` (by component), `corners`
             (same triangles, points renumbered), `dropped`, or `CHANGED`, which is a defect
    refused  the message, where the format does not take such a part
    """

    format: str
    kind: str
    count: int
    fates: dict[str, str] = field(default_factory=dict)
    refused: str = ""


def sample(kind: str, count: int, seed: int = 0) -> Part:
    """A part of `count` points, segments or triangles with data of many types."""
    random = np.random.default_rng(seed)
    points = count + KINDS[kind] - 1 if count else 0
    cells = None if kind == "points" else np.arange(count)[:, None] + np.arange(KINDS[kind])

    def vectors(rows: int, columns: int) -> Array:
        return random.standard_normal((rows, columns)).astype(np.float32)

    data: dict[str, Array] = {
        "velocity": vectors(points, 3),
        "orientation": vectors(points, 4),
        "density": random.random(points).astype(np.float32),
        "energy": random.random(points),
        "id": random.permutation(points).astype(np.int32),
        "serial": np.arange(points, dtype=np.int64) * 1000,
        "species": random.integers(0, 200, points).astype(np.uint8),
    }
    cell_data = {"tension": random.random(count).astype(np.float32)}
    units = {"velocity": "m/s", "density": "kg/m^3"}
    cells = None if cells is None else cells.astype(np.int32)
    return make_part(kind, PART, vectors(points, 3), cells, data, {} if kind == "points" else cell_data, units)


def round_trip(format_: Format, kind: str, count: int, folder: Path) -> Trip:
    """Write samples into the empty `folder` and compare what comes back; MissingPartError as the format says."""
    frames = [Frame(index, index / FPS, (sample(kind, count, seed=index),)) for index in range(FRAMES)]
    plan = Plan(folder, (format_.name,) if format_.name != "vtu" else (), OutputOptions(), FPS)
    format_.load()
    try:
        exporters = Exporters(plan)
        with contextlib.closing(_Releasing(exporters)):
            for frame in frames:
                exporters.write(plan.select(frame))
            exporters.finish()
    except FormatError as error:
        return Trip(format_.name, kind, count, refused=str(error))
    found = READERS[format_.name](folder, format_, frames)
    fates: dict[str, str] = {}
    for frame, read in zip(frames, found, strict=True):
        for name, fate in _compare(frame.parts[0], read).items():
            # A fate counts once for all frames; where they differ, that is a defect.
            fates[name] = fate if fates.get(name, fate) == fate else "CHANGED"
    return Trip(format_.name, kind, count, fates)


class _Releasing:
    def __init__(self, exporters: Exporters) -> None:
        self.close = exporters.release


def _compare(part: Part, read: ReadBack) -> dict[str, str]:
    position, cells = part.position, cells_of(part)
    fates = {"position": _fate(position, read.position)}
    if cells is not None and len(cells):
        fates["cells"] = "dropped" if read.cells is None else _same(np.array_equal(cells, read.cells))
        if read.cells is not None and fates["position"] == "CHANGED":
            corners = np.array_equal(position[cells], read.position.astype(position.dtype)[read.cells])
            fates["position"] = fates["cells"] = "corners" if corners else "CHANGED"
    for expected, found in ((part.data, read.data), (cell_data_of(part), read.cell_data)):
        for name, values in expected.items():
            if len(values):
                fates[name] = _fate(values, found[name]) if name in found else _split_fate(name, values, found)
    if len(position) == 0:
        count = len(read.position)
        fates["position"] = "exact" if count == 0 else f"{count} unused point"
    return fates


def _same(equal: bool) -> str:
    return "exact" if equal else "CHANGED"


def _fate(expected: Array, found: Array) -> str:
    if expected.shape != found.shape or not np.array_equal(expected, found):
        return "CHANGED"
    same_type = expected.dtype == found.dtype.newbyteorder("=")
    return "exact" if same_type else f"as {found.dtype.newbyteorder('=').name}"


def _split_fate(name: str, values: Array, found: dict[str, Array]) -> str:
    names = component_names(name, values.shape[1]) if values.ndim == 2 else ()
    if not names or any(one not in found for one in names):
        return "dropped"
    return "split" if np.array_equal(np.stack([found[one] for one in names], axis=1), values) else "CHANGED"


# Readers: what is in the folder, one ReadBack a frame.


def _files(folder: Path, format_: Format, frames: Sequence[Frame]) -> list[Path]:
    return [folder / frame_name(PART, frame.index, format_.suffix) for frame in frames]


def _read_vtu(folder: Path, format_: Format, frames: Sequence[Frame]) -> list[ReadBack]:
    parts = [read_vtu(path) for path in _files(folder, format_, frames)]
    return [ReadBack(part.position, cells_of(part), dict(part.data), dict(cell_data_of(part))) for part in parts]


def _read_meshio(folder: Path, format_: Format, frames: Sequence[Frame]) -> list[ReadBack]:
    from tianim.export.meshio_formats import EMPTY_FILES, read

    found = []
    for path, frame in zip(_files(folder, format_, frames), frames, strict=True):
        if path.suffix == ".msh" and path.read_text(errors="replace") == EMPTY_FILES[".msh"]:
            # Gmsh takes it; meshio's reader does not.
            found.append(ReadBack(np.zeros((0, 3)), None))
            continue
        mesh = read(path)
        kind = "points" if cells_of(frame.parts[0]) is None else None
        cells = None if kind or not mesh.cells else mesh.cells[0].data
        cell_data = {name: blocks[0] for name, blocks in mesh.cell_data.items() if blocks}
        position = mesh.points.reshape(-1, 3)
        found.append(ReadBack(position, cells, dict(mesh.point_data), cell_data))
    return found


def _read_npz(folder: Path, format_: Format, frames: Sequence[Frame]) -> list[ReadBack]:
    from tianim.export.npz import CELL_PREFIX

    found = []
    for path in _files(folder, format_, frames):
        with np.load(path) as archive:
            data = {name: archive[name] for name in archive.files}
        cells = data.pop("triangles", data.pop("segments", None))
        cell_data = {
            name.removeprefix(CELL_PREFIX): data.pop(name) for name in list(data) if name.startswith(CELL_PREFIX)
        }
        found.append(ReadBack(data.pop("position"), cells, data, cell_data))
    return found


def _read_xdmf_series(folder: Path, format_: Format, frames: Sequence[Frame]) -> list[ReadBack]:
    import h5py

    root = ElementTree.parse(folder / f"{PART}.xdmf").getroot()
    found = []
    with h5py.File(folder / f"{PART}.h5") as file:

        def values(element: Any) -> Array:
            return np.asarray(file[element.find("DataItem").text.partition(":")[2]])

        for grid in root.findall(".//Grid[@GridType='Uniform']"):
            topology = grid.find("Topology")
            attributes = [(one.get("Center"), one.get("Name"), values(one)) for one in grid.findall("Attribute")]
            found.append(
                ReadBack(
                    values(grid.find("Geometry")),
                    values(topology)[: int(topology.get("NumberOfElements"))],  # type: ignore[union-attr, arg-type]
                    {str(name): array for center, name, array in attributes if center == "Node"},
                    {str(name): array for center, name, array in attributes if center == "Cell"},
                )
            )
    return found


def _read_vtkhdf(folder: Path, format_: Format, frames: Sequence[Frame]) -> list[ReadBack]:
    import h5py

    found = []
    with h5py.File(folder / f"{PART}.vtkhdf") as file:
        root = file["VTKHDF"]
        steps = root["Steps"]
        for step in range(len(frames)):
            group = int(steps["PartOffsets"][step])
            points, cells = (int(root[name][group]) for name in ("NumberOfPoints", "NumberOfCells"))
            ids = int(root["NumberOfConnectivityIds"][group])

            def rows(name: str, offset: str, count: int, step: int = step) -> Array:
                begin = int(steps[offset][step])
                return np.asarray(root[name][begin : begin + count])

            connectivity = rows("Connectivity", "ConnectivityIdOffsets", ids)
            found.append(
                ReadBack(
                    rows("Points", "PointOffsets", points),
                    connectivity.reshape(cells, -1) if cells else None,
                    {one: rows(f"PointData/{one}", f"PointDataOffsets/{one}", points) for one in root["PointData"]},
                    {one: rows(f"CellData/{one}", f"CellDataOffsets/{one}", cells) for one in root["CellData"]},
                )
            )
    return found


def _read_usd(folder: Path, format_: Format, frames: Sequence[Frame]) -> list[ReadBack]:
    from pxr import Usd, UsdGeom

    from tianim.export.usd import FILE_NAME

    stage = Usd.Stage.Open(str(folder / FILE_NAME))
    prim = stage.GetPrimAtPath(f"/World/{PART}")
    return [_read_usd_frame(UsdGeom, prim, frame.index) for frame in frames]


def _read_usd_frame(geom: Any, prim: Any, code: int) -> ReadBack:
    def get(name: str) -> Array:
        return np.array(prim.GetAttribute(name).Get(code))

    data: dict[str, dict[str, Array]] = {"vertex": {}, "uniform": {}, "constant": {}}
    for primvar in geom.PrimvarsAPI(prim).GetPrimvars():
        values = np.array(primvar.Get(code))
        if primvar.GetElementSize() > 1:
            values = values.reshape(-1, primvar.GetElementSize())
        data[primvar.GetInterpolation()][primvar.GetPrimvarName()] = values
    for name, attribute in (("velocity", "velocities"), ("id", "ids")):
        if prim.GetAttribute(attribute).HasAuthoredValue():
            data["vertex"][name] = get(attribute)
    position, cells = get("points").reshape(-1, 3), None
    if prim.IsA(geom.Mesh):
        cells = get("faceVertexIndices").reshape(-1, 3)
    elif prim.IsA(geom.BasisCurves):
        # Back from curves to the part's points and segments.
        counts, index = get("curveVertexCounts"), data["vertex"].pop("point")
        ends = np.cumsum(counts)
        inner = np.setdiff1d(np.arange(len(index)), ends - 1)
        cells = np.stack([index[inner], index[inner + 1]], axis=1) if len(index) else None
        _, first = np.unique(index, return_index=True)
        position = position[first]
        data["vertex"] = {name: values[first] for name, values in data["vertex"].items()}
    return ReadBack(position, cells, data["vertex"], data["uniform"])


READERS: dict[str, Callable[[Path, Format, Sequence[Frame]], list[ReadBack]]] = {
    name: _read_meshio for name, one in FORMATS.items() if one.module == "meshio_formats"
} | {
    "vtu": _read_vtu,
    "npz": _read_npz,
    "xdmf_series": _read_xdmf_series,
    "vtkhdf": _read_vtkhdf,
    "usd": _read_usd,
}


@dataclass(frozen=True)
class FormatRow:
    """One line of the table of formats: what happens to each kind of part, and to its data."""

    name: str
    files: str
    about: str
    points: str
    lines: str
    triangles: str
    data: str


def formats_table() -> list[FormatRow]:
    """What each format keeps, by trying every kind with 0, 1 and 1,000 items. Takes some seconds."""
    return [_row(format_) for format_ in FORMATS.values()]


def _row(format_: Format) -> FormatRow:
    files = ("<run>" if format_.name == "usd" else "<part>") + ("" if format_.whole_run else "_0001")
    try:
        trips = []
        for kind in ALL:
            for count in COUNTS:
                with tempfile.TemporaryDirectory() as folder:
                    trips.append(round_trip(format_, kind, count, Path(folder)))
    except MissingPartError as error:
        return FormatRow(format_.name, "", format_.about, "", "", "", str(error))
    kinds = {kind: _geometry([trip for trip in trips if trip.kind == kind]) for kind in ALL}
    data: dict[str, list[str]] = {}
    for trip in trips:
        for name, fate in trip.fates.items():
            if name not in GEOMETRY:
                names = data.setdefault(fate, [])
                if name not in names:
                    names.append(name)
    text = "; ".join(f"{', '.join(names)} {fate}" for fate, names in data.items())
    only = next(iter(data)) if len(data) == 1 else ""
    return FormatRow(
        format_.name,
        files + "/".join(format_.suffixes),
        format_.about,
        **kinds,
        data={"exact": "all exact", "dropped": "none"}.get(only, text),
    )


def _geometry(trips: Iterable[Trip]) -> str:
    """Some words for a kind of part: `exact`, `refused`, or what differs, also where it is empty."""
    words: dict[bool, list[str]] = {True: [], False: []}
    for trip in trips:
        fates = ["refused"] if trip.refused else [trip.fates[name] for name in GEOMETRY if name in trip.fates]
        words[trip.count == 0] += [fate for fate in fates if fate not in words[trip.count == 0]]
    full, empty = (" and ".join([fate for fate in fates if fate != "exact"] or ["exact"]) for fates in (words[False], words[True]))
    return full if empty in (full, "exact") else f"{full} (empty: {empty})"
