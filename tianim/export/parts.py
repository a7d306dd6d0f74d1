"""What exporters need to know of a part: its kind, its cells, its arrays, and that they are sound."""

import re
from collections.abc import Callable, Container, Mapping
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from tianim.errors import FormatError
from tianim.frame import Array, Frame, Lines, Mesh, Part, Points

# The kinds of part, with the number of points a cell has. A point of a cloud is its own cell.
KINDS = {"points": 1, "lines": 2, "triangles": 3}
# A name that ends in a digit would run into the frame number: "a64_0001" is fine, "a64" is not.
PART_NAME = re.compile(r"[A-Za-z]([A-Za-z0-9_]*[A-Za-z_])?")
# What every format takes for the name of an array.
DATA_NAME = re.compile(r"[A-Za-z_][A-Za-z0-9_]*")
# Names that programs look for; components of other vectors become name_x, name_y, name_z.
USUAL_COMPONENTS = {
    "velocity": ("vx", "vy", "vz"),
    "normal": ("nx", "ny", "nz"),
    "color": ("red", "green", "blue", "alpha"),
}


def kind_of(part: Part) -> str:
    """`points`, `lines` or `triangles`."""
    if isinstance(part, Mesh):
        return "triangles"
    return "lines" if isinstance(part, Lines) else "points"


def cells_of(part: Part) -> NDArray[np.integer] | None:
    """Indices of points, shape (m, 2) or (m, 3); None for a point cloud."""
    if isinstance(part, Mesh):
        return part.triangles
    return part.segments if isinstance(part, Lines) else None


def cell_data_of(part: Part) -> Mapping[str, Array]:
    """Data per cell; a point cloud has none."""
    return {} if isinstance(part, Points) else part.cell_data


def make_part(
    kind: str,
    name: str,
    position: Array,
    cells: Array | None,
    data: Mapping[str, Array],
    cell_data: Mapping[str, Array],
    units: Mapping[str, str],
    spacing: float = 0.0,
) -> Part:
    """The part of that kind with these arrays; only a point cloud has a spacing."""
    if kind == "points":
        return Points(name, position, data, units, spacing)  # type: ignore[arg-type]
    maker = Mesh if kind == "triangles" else Lines
    return maker(name, position, cells, data, cell_data, units)  # type: ignore[arg-type]


def map_arrays(part: Part, function: Callable[[Array], Array]) -> Part:
    """The part with `function` applied to each of its arrays."""
    changes: dict[str, object] = {
        "position": function(part.position),
        "data": {name: function(values) for name, values in part.data.items()},
    }
    if isinstance(part, Mesh):
        changes["triangles"] = function(part.triangles)
    if isinstance(part, Lines):
        changes["segments"] = function(part.segments)
    if not isinstance(part, Points):
        changes["cell_data"] = {name: function(values) for name, values in part.cell_data.items()}
    return replace(part, **changes)  # type: ignore[arg-type]


def component_names(name: str, count: int) -> tuple[str, ...]:
    """Names of the components of an array that is split."""
    usual = USUAL_COMPONENTS.get(name, ())
    if len(usual) >= count > 1:
        return usual[:count]
    return tuple(f"{name}_{'xyzw'[i] if count <= 4 else i}" for i in range(count))


def with_components(name: str, values: Array, allowed: Container[int] | None) -> dict[str, Array]:
    """The array as it is, or split by component where `allowed` has not their number."""
    count = 1 if values.ndim == 1 else values.shape[1]
    if count == 1:
        return {name: values.reshape(-1)}
    if allowed is None or count in allowed:
        return {name: values}
    return {one: np.ascontiguousarray(values[:, i]) for i, one in enumerate(component_names(name, count))}


def byte_count(part: Part) -> int:
    """Bytes of all arrays of the part."""
    total = 0

    def add(values: Array) -> Array:
        nonlocal total
        total += values.nbytes
        return values

    map_arrays(part, add)
    return total


def check_frame(frame: Frame) -> None:
    """FormatError where no exporter could write the frame: names, shapes or types are wrong."""
    names = [part.name for part in frame.parts]
    for part in frame.parts:
        if not PART_NAME.fullmatch(part.name):
            raise FormatError(
                f"part {part.name!r}: a name starts with a letter, has only letters, digits and _, "
                "and does not end in a digit"
            )
        if names.count(part.name) > 1:
            raise FormatError(f"frame {frame.index} has two parts called {part.name!r}")
        _check_part(part)


def _check_part(part: Part) -> None:
    cells = cells_of(part)
    if part.position.ndim != 2 or part.position.shape[1] != 3:
        raise FormatError(f"part {part.name!r}: position has shape {part.position.shape}, expected (n, 3)")
    if cells is not None and (cells.ndim != 2 or cells.shape[1] != KINDS[kind_of(part)]):
        raise FormatError(
            f"part {part.name!r}: cells have shape {cells.shape}, expected (m, {KINDS[kind_of(part)]})"
        )
    _check_data(part.name, part.data, len(part.position), "points")
    _check_data(part.name, cell_data_of(part), 0 if cells is None else len(cells), "cells")


def _check_data(part_name: str, data: Mapping[str, Array], count: int, what: str) -> None:
    for name, values in data.items():
        if not DATA_NAME.fullmatch(name):
            raise FormatError(
                f"part {part_name!r}: array {name!r}: a name starts with a letter or _ and has only letters, "
                "digits and _"
            )
        if values.ndim not in (1, 2) or len(values) != count:
            raise FormatError(
                f"part {part_name!r}: {name} has shape {values.shape}, expected ({count},) or ({count}, k) "
                f"for {count} {what}"
            )
        if values.dtype.kind not in "fiub" or values.dtype.itemsize > 8:
            raise FormatError(f"part {part_name!r}: {name} has type {values.dtype}, which is no plain number")
