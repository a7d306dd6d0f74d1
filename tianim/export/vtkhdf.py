"""VTKHDF: one HDF5 file a part for the whole run, an unstructured grid with time steps.

VTK's own format for ParaView 5.12 and later. Every array is one dataset to which each frame
appends its rows; `Steps` says where the rows of a frame begin. Cells that stay the same are
stored once: a VTKHDF "part" is a set of cells here, which several steps may share.
Reference: VTK file formats, VTKHDF 2.x,
https://docs.vtk.org/en/latest/vtk_file_formats/vtkhdf_file_format/index.html
"""

from collections.abc import Sequence
from contextlib import ExitStack
from pathlib import Path

import h5py
import numpy as np

from tianim.errors import FormatError
from tianim.export.files import os_errors, whole_file
from tianim.export.formats import RunInfo
from tianim.export.hdf import new_hdf5, require_room
from tianim.export.parts import KINDS, byte_count, cell_data_of, cells_of, kind_of
from tianim.export.vtu import CELL_TYPES
from tianim.frame import Array, Frame, Part

VERSION = (2, 2)
# Rows of a chunk, least and most: large enough to write fast, small enough for a small part.
CHUNK_ROWS = (1024, 65536)


def assemble(folder: Path, frames: Sequence[Frame], run: RunInfo) -> None:
    """Write `<part>.vtkhdf` for every part of the frames."""
    with ExitStack() as stack:
        files: dict[str, _PartFile] = {}
        for frame in frames:
            for part in frame.parts:
                path = folder / f"{part.name}.vtkhdf"
                if part.name not in files:
                    temporary = stack.enter_context(whole_file(path))
                    files[part.name] = _PartFile(stack.enter_context(new_hdf5(temporary)))
                with os_errors(path):
                    require_room(path, byte_count(part))
                    files[part.name].add(frame, part)
        for file in files.values():
            file.finish()


class _PartFile:
    """The file of one part while it grows."""

    def __init__(self, file: h5py.File) -> None:
        self._root = file.create_group("VTKHDF")
        self._root.attrs["Version"] = VERSION
        self._root.attrs.create("Type", b"UnstructuredGrid", dtype=h5py.string_dtype("ascii", 16))
        for name in ("PointData", "CellData"):
            self._root.create_group(name)
        # What `Steps` says of each frame: its time, and where its rows begin in each dataset.
        self._steps: dict[str, list[float]] = {}
        self._cells: Array | None = None
        self._points = 0
        self._cells_begin: dict[str, float] = {}

    def add(self, frame: Frame, part: Part) -> None:
        step: dict[str, float] = {"Values": frame.time, "PointOffsets": self._append("Points", part.position)}
        step |= self._place_cells(part)
        for group, data in (("PointData", part.data), ("CellData", cell_data_of(part))):
            for name, values in data.items():
                step[f"{group}Offsets/{name}"] = self._append(f"{group}/{name}", values)
        if self._steps and self._steps.keys() != step.keys():
            names = sorted(key.rpartition("/")[2] for key in self._steps.keys() ^ step.keys())
            raise FormatError(
                f"format 'vtkhdf': part {part.name!r} must have the same arrays in every frame; "
                f"frame {frame.index} differs in {', '.join(names)}"
            )
        for key, value in step.items():
            self._steps.setdefault(key, []).append(value)

    def _place_cells(self, part: Part) -> dict[str, float]:
        """Where the cells of the part are; they are stored where they differ from those before."""
        cells = cells_of(part)
        if cells is None:
            cells = np.arange(len(part.position)).reshape(-1, 1)
        points = len(part.position)
        if self._cells is None or points != self._points or not np.array_equal(cells, self._cells):
            self._cells, self._points, nodes = cells, points, KINDS[kind_of(part)]
            self._cells_begin = {
                "PartOffsets": self._append("NumberOfCells", np.array([len(cells)])),
                "CellOffsets": self._append(
                    "Types", np.full(len(cells), CELL_TYPES[kind_of(part)], np.uint8)
                ),
                "ConnectivityIdOffsets": self._append("Connectivity", cells.reshape(-1).astype(np.int64)),
            }
            self._append("Offsets", np.arange(len(cells) + 1) * nodes)
            self._append("NumberOfPoints", np.array([points]))
            self._append("NumberOfConnectivityIds", np.array([cells.size]))
        return self._cells_begin

    def _append(self, name: str, values: Array) -> int:
        """Append rows to a dataset; gives the row they begin at."""
        if values.dtype.kind == "b":
            values = values.astype(np.uint8)
        if name not in self._root:
            shape = values.shape[1:]
            rows = min(max(len(values), CHUNK_ROWS[0]), CHUNK_ROWS[1])
            self._root.create_dataset(
                name, (0, *shape), values.dtype, maxshape=(None, *shape), chunks=(rows, *shape)
            )
        dataset = self._root[name]
        begin = len(dataset)
        if len(values):
            dataset.resize(begin + len(values), axis=0)
            dataset[begin:] = values
        return begin

    def finish(self) -> None:
        """Write what `Steps` says."""
        steps = self._root.create_group("Steps")
        count = len(self._steps["Values"])
        steps.attrs["NSteps"] = count
        steps["NumberOfParts"] = np.ones(count, np.int64)
        for key, values in self._steps.items():
            steps[key] = np.array(values, np.float64 if key == "Values" else np.int64)
