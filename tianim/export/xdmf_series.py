"""One XDMF a part for the whole run, its numbers in one HDF5 file beside it; points may move.

meshio's own time series holds a single geometry, so the XML is written here: a temporal
collection of grids, each pointing at the datasets `<frame>/position`, `<frame>/cells` and
`<frame>/point.<name>`, `<frame>/cell.<name>` of the HDF5 file. Cells that stay the same are
stored once. A frame without points is one point that no cell uses, as VTK's reader crashes
on an empty grid. Reference: the XDMF model and format, https://www.xdmf.org
"""

from collections.abc import Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Any
from xml.sax.saxutils import quoteattr

import h5py
import numpy as np

from tianim.export.files import os_errors, whole_folder
from tianim.export.formats import RunInfo
from tianim.export.hdf import new_hdf5, require_room
from tianim.export.parts import KINDS, byte_count, cell_data_of, cells_of, kind_of, with_components
from tianim.frame import Array, Frame, Part

TOPOLOGIES = {"points": "Polyvertex", "lines": "Polyline", "triangles": "Triangle"}
# Components to XDMF's name; arrays with others are split, as VTK's reader misreads them.
SHAPES = {1: "Scalar", 3: "Vector", 9: "Tensor"}


def assemble(folder: Path, frames: Sequence[Frame], run: RunInfo) -> None:
    """Write `<part>.xdmf` and `<part>.h5` for every part of the frames."""
    with ExitStack() as stack:
        files: dict[str, _PartFile] = {}
        for frame in frames:
            for part in frame.parts:
                path = folder / f"{part.name}.xdmf"
                if part.name not in files:
                    temporary = stack.enter_context(whole_folder(path)) / path.name
                    h5 = stack.enter_context(new_hdf5(temporary.with_suffix(".h5")))
                    files[part.name] = _PartFile(temporary, h5)
                with os_errors(path):
                    require_room(path, byte_count(part))
                    files[part.name].add(frame, part)
        for file in files.values():
            file.finish()


class _PartFile:
    """The two files of one part while they grow."""

    def __init__(self, path: Path, file: h5py.File) -> None:
        self._path, self._h5 = path, file
        self._grids: list[str] = []
        self._cells: Array | None = None
        self._topology = ""

    def add(self, frame: Frame, part: Part) -> None:
        group = self._h5.create_group(f"{frame.index:04d}")
        group.attrs["time"] = frame.time
        empty = len(part.position) == 0
        position = np.zeros((1, 3), np.float32) if empty else part.position
        geometry = f'<Geometry GeometryType="XYZ">{self._item(group, "position", position)}</Geometry>'
        attributes = [
            self._attribute(group, f"{center}.{one}", one, values, "Node" if center == "point" else "Cell")
            for center, data in (("point", part.data), ("cell", cell_data_of(part)))
            for name, array in data.items()
            for one, values in with_components(name, array, SHAPES).items()
            if len(values)
        ]
        self._grids.append(
            f'<Grid Name={quoteattr(part.name)} GridType="Uniform"><Time Value="{frame.time!r}"/>\n'
            f"{self._topology_of(group, part)}\n{geometry}\n{''.join(attributes)}</Grid>\n"
        )

    def _topology_of(self, group: Any, part: Part) -> str:
        kind = kind_of(part)
        cells = cells_of(part)
        if cells is None:
            cells = np.arange(len(part.position), dtype=np.int32).reshape(-1, 1)
        if self._cells is None or not np.array_equal(cells, self._cells):
            self._cells = cells
            stored = cells if len(cells) else np.zeros((1, KINDS[kind]), np.int32)
            self._topology = (
                f'<Topology TopologyType="{TOPOLOGIES[kind]}" NumberOfElements="{len(cells)}" '
                f'NodesPerElement="{KINDS[kind]}">{self._item(group, "cells", stored)}</Topology>'
            )
        return self._topology

    def _attribute(self, group: Any, key: str, name: str, values: Array, center: str) -> str:
        shape = SHAPES[1 if values.ndim == 1 else values.shape[1]]
        item = self._item(group, key, values)
        opening = f'<Attribute Name={quoteattr(name)} AttributeType="{shape}" Center="{center}">'
        return f"{opening}{item}</Attribute>\n"

    def _item(self, group: Any, key: str, values: Array) -> str:
        """Store `values`; gives the DataItem that points at them."""
        if values.dtype.kind == "b":
            values = values.astype(np.uint8)
        group.create_dataset(key, data=values)
        size = values.dtype.itemsize
        kind = {"f": "Float", "i": "Int", "u": "UInt"}[values.dtype.kind]
        if size == 1:
            kind = {"Int": "Char", "UInt": "UChar"}[kind]
        dimensions = " ".join(map(str, values.shape))
        return (
            f'<DataItem NumberType="{kind}" Precision="{size}" Dimensions="{dimensions}" '
            f'Format="HDF">{self._path.stem}.h5:{group.name}/{key}</DataItem>'
        )

    def finish(self) -> None:
        """Write the XML."""
        self._path.write_text(
            '<?xml version="1.0"?>\n<Xdmf Version="3.0"><Domain>\n'
            '<Grid Name="run" GridType="Collection" CollectionType="Temporal">\n'
            f"{''.join(self._grids)}</Grid>\n</Domain></Xdmf>\n",
            encoding="utf-8",
        )
