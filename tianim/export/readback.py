"""Readers of every format that is written, for comparing: what is in the files, a ReadBack a frame.

By another program's library where there is one: meshio, NumPy, h5py, USD. Only the VTU record
is read by our own reader here; the tests have meshio and VTK read it too.
"""

import xml.etree.ElementTree as ElementTree
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from tianim.export.formats import FORMATS, Format
from tianim.export.parts import cell_data_of, cells_of
from tianim.export.series import frame_name
from tianim.export.vtu import read_vtu
from tianim.frame import Array, Frame


@dataclass(frozen=True)
class ReadBack:
    """What a reader found in one frame's file; `cells` is None where the format names none."""

    position: Array
    cells: Array | None
    data: dict[str, Array] = field(default_factory=dict)
    cell_data: dict[str, Array] = field(default_factory=dict)


def _name(frames: Sequence[Frame]) -> str:
    """The one part that the frames have."""
    return frames[0].parts[0].name


def _files(folder: Path, format_: Format, frames: Sequence[Frame]) -> list[Path]:
    return [folder / frame_name(_name(frames), frame.index, format_.suffix) for frame in frames]


def _read_vtu(folder: Path, format_: Format, frames: Sequence[Frame]) -> list[ReadBack]:
    parts = [read_vtu(path) for path in _files(folder, format_, frames)]
    return [
        ReadBack(part.position, cells_of(part), dict(part.data), dict(cell_data_of(part))) for part in parts
    ]


def _read_meshio(folder: Path, format_: Format, frames: Sequence[Frame]) -> list[ReadBack]:
    from tianim.export.meshio_formats import EMPTY_FILES, read

    found = []
    for path, frame in zip(_files(folder, format_, frames), frames, strict=True):
        if path.suffix == ".msh" and path.read_text(errors="replace") == EMPTY_FILES[".msh"]:
            # Gmsh takes it; meshio's reader does not.
            found.append(ReadBack(np.zeros((0, 3)), None))
            continue
        mesh = read(path)
        has_cells = mesh.cells and cells_of(frame.parts[0]) is not None
        cells = mesh.cells[0].data if has_cells else None
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
            name.removeprefix(CELL_PREFIX): data.pop(name)
            for name in list(data)
            if name.startswith(CELL_PREFIX)
        }
        found.append(ReadBack(data.pop("position"), cells, data, cell_data))
    return found


def _read_gadget(folder: Path, format_: Format, frames: Sequence[Frame]) -> list[ReadBack]:
    import h5py

    from tianim.export.gadget import DATASETS, TYPES

    ours = {name: one for one, name in DATASETS.items()}
    found = []
    for path in _files(folder, format_, frames):
        with h5py.File(path) as file:
            groups = [file[f"PartType{kind}"] for kind in range(TYPES) if f"PartType{kind}" in file]
            data = {
                ours.get(name, name): np.concatenate([group[name] for group in groups]) for name in groups[0]
            }
        found.append(ReadBack(data.pop("position"), None, data))
    return found


def _read_xdmf_series(folder: Path, format_: Format, frames: Sequence[Frame]) -> list[ReadBack]:
    import h5py

    root = ElementTree.parse(folder / f"{_name(frames)}.xdmf").getroot()
    found = []
    with h5py.File(folder / f"{_name(frames)}.h5") as file:

        def values(element: Any) -> Array:
            return np.asarray(file[element.find("DataItem").text.partition(":")[2]])

        for grid in root.findall(".//Grid[@GridType='Uniform']"):
            topology = grid.find("Topology")
            attributes = [
                (one.get("Center"), one.get("Name"), values(one)) for one in grid.findall("Attribute")
            ]
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
    with h5py.File(folder / f"{_name(frames)}.vtkhdf") as file:
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
                    {
                        one: rows(f"PointData/{one}", f"PointDataOffsets/{one}", points)
                        for one in root["PointData"]
                    },
                    {
                        one: rows(f"CellData/{one}", f"CellDataOffsets/{one}", cells)
                        for one in root["CellData"]
                    },
                )
            )
    return found


def _read_usd(folder: Path, format_: Format, frames: Sequence[Frame]) -> list[ReadBack]:
    from pxr import Usd, UsdGeom

    from tianim.export.usd import FILE_NAME

    stage = Usd.Stage.Open(str(folder / FILE_NAME))
    prim = stage.GetPrimAtPath(f"/World/{_name(frames)}")
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
    position: Array = get("points").reshape(-1, 3)
    cells: Array | None = None
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


Reader = Callable[[Path, Format, Sequence[Frame]], list[ReadBack]]
READERS: Mapping[str, Reader] = {
    **{name: _read_meshio for name, one in FORMATS.items() if one.module == "meshio_formats"},
    "vtu": _read_vtu,
    "npz": _read_npz,
    "gadget": _read_gadget,
    "xdmf_series": _read_xdmf_series,
    "vtkhdf": _read_vtkhdf,
    "usd": _read_usd,
}
