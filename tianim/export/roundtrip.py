"""What each format keeps, found by trying: write parts, read the files back, compare every array.

`formats_table` makes the table of `tianim export --formats` from it, and the tests hold it
against what the documents promise, so the two cannot drift apart. Reading is by another
program's library where there is one (meshio, NumPy, h5py, USD).
"""

import tempfile
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from tianim.errors import FormatError, MissingPartError
from tianim.export.exporters import Exporters, Plan
from tianim.export.formats import ALL, FORMATS, Format
from tianim.export.options import OutputOptions
from tianim.export.parts import KINDS, cell_data_of, cells_of, component_names, make_part
from tianim.export.readback import READERS, ReadBack
from tianim.frame import Array, Frame, Part

COUNTS = (0, 1, 1000)
FRAMES = 2
FPS = 30.0
PART = "sample"
GEOMETRY = ("position", "cells")


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
    return make_part(
        kind, PART, vectors(points, 3), cells, data, {} if kind == "points" else cell_data, units
    )


def round_trip(format_: Format, kind: str, count: int, folder: Path) -> Trip:
    """Write samples into the empty `folder` and compare what comes back.

    Raises MissingPartError where the format's package is not installed.
    """
    frames = [Frame(index, index / FPS, (sample(kind, count, seed=index),)) for index in range(FRAMES)]
    plan = Plan(folder, (format_.name,) if format_.name != "vtu" else (), OutputOptions(), FPS)
    format_.load()
    try:
        _write(plan, frames)
    except FormatError as error:
        return Trip(format_.name, kind, count, refused=str(error))
    found = READERS[format_.name](folder, format_, frames)
    fates: dict[str, str] = {}
    for frame, read in zip(frames, found, strict=True):
        for name, fate in _compare(frame.parts[0], read).items():
            # A fate counts once for all frames; where they differ, that is a defect.
            fates[name] = fate if fates.get(name, fate) == fate else "CHANGED"
    return Trip(format_.name, kind, count, fates)


def _write(plan: Plan, frames: list[Frame]) -> None:
    exporters = Exporters(plan)
    try:
        for frame in frames:
            exporters.write(plan.select(frame))
        exporters.finish()
    finally:
        exporters.release()


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
                fates[name] = (
                    _fate(values, found[name]) if name in found else _split_fate(name, values, found)
                )
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
    full, empty = (
        " and ".join([fate for fate in fates if fate != "exact"] or ["exact"])
        for fates in (words[False], words[True])
    )
    return full if empty in (full, "exact") else f"{full} (empty: {empty})"
