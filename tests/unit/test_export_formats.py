"""What each format keeps: the table that the tool prints, tried out and held against what we promise."""

import shutil
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tianim.errors import FormatError, MissingPartError, OutputError
from tianim.export import FORMATS, OutputOptions, Stamp, format_named, formats_table
from tianim.export.exporters import Exporters, Plan, plan_output
from tianim.export.formats import ALL
from tianim.export.parts import byte_count, cell_data_of, cells_of
from tianim.export.readback import READERS
from tianim.export.roundtrip import COUNTS, round_trip, sample
from tianim.frame import Array, Frame, Lines, Mesh, Part, Points

GEOMETRY = ("position", "cells")
ARRAYS = ("velocity", "orientation", "density", "energy", "id", "serial", "species", "tension")
NONE = dict.fromkeys(ARRAYS, "dropped")
# The promise: per format the kinds that it holds, what becomes of positions and cells, and of
# those arrays that do not come back exactly.
PROMISED: dict[str, tuple[tuple[str, ...], str, dict[str, str]]] = {
    "vtu": (ALL, "exact", {}),
    "vtk": (ALL, "exact", {}),
    "ply": (
        ("points", "triangles"),
        "exact",
        {"velocity": "split", "orientation": "split", "serial": "as int32", "tension": "dropped"},
    ),
    "obj": (("triangles",), "as float64", NONE),
    "stl": (("triangles",), "exact", NONE),
    "off": (("triangles",), "as float64", NONE),
    "xdmf": (ALL, "exact", {"orientation": "split"}),
    "msh": (
        ALL,
        "as float64",
        {"orientation": "split"}
        | dict.fromkeys(("velocity", "density", "id", "serial", "species", "tension"), "as float64"),
    ),
    "med": (ALL, "exact", {}),
    "npz": (ALL, "exact", {}),
    "gadget": (("points",), "exact", {}),
    "xdmf_series": (ALL, "exact", {"orientation": "split"}),
    "vtkhdf": (ALL, "exact", {}),
    "usd": (ALL, "exact", {"species": "as int32"}),
}


def test_every_format_is_promised() -> None:
    assert PROMISED.keys() == FORMATS.keys()


@pytest.mark.parametrize("count", COUNTS)
@pytest.mark.parametrize("kind", ALL)
@pytest.mark.parametrize("name", FORMATS)
def test_a_format_keeps_what_it_promises(tmp_path: Path, name: str, kind: str, count: int) -> None:
    try:
        trip = round_trip(format_named(name), kind, count, tmp_path)
    except MissingPartError as error:
        pytest.skip(str(error))
    kinds, geometry, others = PROMISED[name]
    if kind not in kinds:
        assert f"part 'sample' is {kind}" in trip.refused
        assert list(tmp_path.iterdir()) == []
        return
    assert trip.refused == ""
    if count == 0:
        # XDMF's readers crash on an empty grid: it has a point that no cell uses.
        expected = {"position": "1 unused point" if name.startswith("xdmf") else "exact"}
        assert trip.fates == expected
        return
    if name == "usd" and kind == "points":
        others = others | {"id": "as int64"}
    arrays = ARRAYS if kind != "points" else ARRAYS[:-1]
    assert {key: fate for key, fate in trip.fates.items() if key not in GEOMETRY} == {
        array: others.get(array, "exact") for array in arrays
    }
    assert trip.fates["position"] == geometry
    assert trip.fates.get("cells", "exact") == "exact"


def test_the_round_trip_sees_a_changed_array(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from tianim.export import npz

    write = npz.write_part

    def write_wrongly(path: Path, part: Part, stamp: Stamp) -> None:
        data = dict(part.data)
        data["density"] = data["density"] + np.float32(1e-6)
        del data["energy"]
        write(path, Points(part.name, part.position, data), stamp)

    monkeypatch.setattr(npz, "write_part", write_wrongly)
    fates = round_trip(format_named("npz"), "points", 10, tmp_path).fates
    assert (fates["density"], fates["energy"], fates["velocity"]) == ("CHANGED", "dropped", "exact")


def test_the_table_has_a_row_for_every_format_and_no_defect() -> None:
    rows = {row.name: row for row in formats_table()}
    assert rows.keys() == FORMATS.keys()
    assert "CHANGED" not in repr(rows)
    assert (rows["vtu"].points, rows["vtu"].lines, rows["vtu"].data) == ("exact", "exact", "all exact")
    assert (rows["obj"].points, rows["obj"].data) == ("refused", "none")
    assert "serial as int32" in rows["ply"].data
    assert rows["xdmf"].points == "exact (empty: 1 unused point)"


def write_frames(folder: Path, name: str, parts: list[Part]) -> list[Frame]:
    """The parts as frames of a run, written in one format."""
    frames = [Frame(index, index / 25, (part,)) for index, part in enumerate(parts)]
    plan = Plan(folder, (name,), OutputOptions(), 25.0)
    exporters = Exporters(plan)
    for frame in frames:
        exporters.write(plan.select(frame))
    exporters.finish()
    exporters.release()
    return frames


def assert_vtk_has(grid: Any, part: Part) -> None:
    """VTK's grid has the part's points, cells and arrays (three and four components not split)."""
    from vtk.util.numpy_support import vtk_to_numpy

    count = len(part.position)
    assert grid.GetNumberOfPoints() == count
    if count:
        np.testing.assert_array_equal(vtk_to_numpy(grid.GetPoints().GetData()), part.position)
    cells = np.arange(count)[:, None] if cells_of(part) is None else cells_of(part)
    assert cells is not None
    assert grid.GetNumberOfCells() == len(cells)
    if len(cells):
        connectivity = vtk_to_numpy(grid.GetCells().GetConnectivityArray())
        np.testing.assert_array_equal(connectivity.reshape(cells.shape), cells)
    data = [(part.data, grid.GetPointData())]
    data += [(cell_data_of(part), grid.GetCellData())] if len(cells) else []
    for expected, found in data:
        for array, values in expected.items():
            np.testing.assert_array_equal(vtk_to_numpy(found.GetArray(array)), values, err_msg=array)


@pytest.mark.parametrize("kind", ALL)
def test_vtk_reads_legacy_files(tmp_path: Path, kind: str) -> None:
    vtk = pytest.importorskip("vtk")
    frames = write_frames(tmp_path, "vtk", [sample(kind, count) for count in COUNTS])
    for frame in frames:
        reader = vtk.vtkUnstructuredGridReader()
        reader.SetFileName(str(tmp_path / f"sample_{frame.index:04d}.vtk"))
        reader.ReadAllScalarsOn()
        reader.Update()
        assert_vtk_has(reader.GetOutput(), frame.parts[0])


@pytest.mark.parametrize("kind", ALL)
@pytest.mark.parametrize("counts", [(5, 5, 0, 7), (0, 3, 3, 1), (2,)])
def test_vtk_reads_vtkhdf_with_times(tmp_path: Path, kind: str, counts: tuple[int, ...]) -> None:
    vtk = pytest.importorskip("vtk")
    parts = [sample(kind, count, seed) for seed, count in enumerate(counts)]
    frames = write_frames(tmp_path, "vtkhdf", parts)
    reader = vtk.vtkHDFReader()
    reader.SetFileName(str(tmp_path / "sample.vtkhdf"))
    reader.UpdateInformation()
    assert reader.GetNumberOfSteps() == len(frames)
    for frame in frames:
        reader.SetStep(frame.index)
        reader.Update()
        assert reader.GetTimeValue() == frame.time
        assert_vtk_has(reader.GetOutputDataObject(0), frame.parts[0])


# VTK's XDMF reader ends the process on files that it does not like: it gets one of its own.
READ_XDMF = """
import sys, vtk
from vtk.util.numpy_support import vtk_to_numpy
for name in sys.argv[1:]:
    reader = vtk.vtkXdmfReader()
    reader.SetFileName(name)
    reader.UpdateInformation()
    times = reader.GetOutputInformation(0).Get(vtk.vtkStreamingDemandDrivenPipeline.TIME_STEPS())
    for time in times or [0.0]:
        reader.UpdateTimeStep(time) if times else reader.Update()
        grid = reader.GetOutputDataObject(0)
        velocity = grid.GetPointData().GetArray("velocity")
        total = 0.0 if velocity is None else float(vtk_to_numpy(velocity).astype(float).sum())
        print(time, grid.GetNumberOfPoints(), grid.GetNumberOfCells(), total)
"""


@pytest.mark.parametrize("kind", ALL)
def test_vtk_reads_xdmf(tmp_path: Path, kind: str) -> None:
    pytest.importorskip("vtk")
    counts = (5, 5, 0, 7)
    parts = [sample(kind, count, seed) for seed, count in enumerate(counts)]
    frames = write_frames(tmp_path, "xdmf_series", parts)
    write_frames(tmp_path, "xdmf", parts)
    files = [tmp_path / "sample.xdmf", *(tmp_path / f"sample_{frame.index:04d}.xdmf" for frame in frames)]
    run = subprocess.run(
        [sys.executable, "-c", READ_XDMF, *files], capture_output=True, text=True, check=True
    )
    lines = [[float(word) for word in line.split()] for line in run.stdout.splitlines()]
    expected = [
        [time, max(len(part.position), 1), count, part.data["velocity"].astype(float).sum()]
        for times in ([frame.time for frame in frames], [0.0] * len(frames))
        for time, part, count in zip(times, parts, counts, strict=True)
    ]
    # sums of float32 in float64, printed in full
    np.testing.assert_allclose(lines, expected, atol=1e-9)


@pytest.mark.parametrize("count", COUNTS)
@pytest.mark.parametrize("name", ["ply", "obj", "stl"])
def test_vtk_reads_surfaces(tmp_path: Path, name: str, count: int) -> None:
    vtk = pytest.importorskip("vtk")
    from vtk.util.numpy_support import vtk_to_numpy

    part = write_frames(tmp_path, name, [sample("triangles", count)])[0].parts[0]
    reader = {"ply": vtk.vtkPLYReader, "obj": vtk.vtkOBJReader, "stl": vtk.vtkSTLReader}[name]()
    reader.SetFileName(str(tmp_path / f"sample_0000.{name}"))
    reader.Update()
    surface = reader.GetOutput()
    assert surface.GetNumberOfPolys() == count
    if count:
        corners = vtk_to_numpy(surface.GetPoints().GetData())[
            vtk_to_numpy(surface.GetPolys().GetConnectivityArray()).reshape(-1, 3)
        ]
        assert isinstance(part, Mesh)
        np.testing.assert_array_equal(corners, part.position[part.triangles])


def test_a_ply_has_the_names_that_programs_look_for(tmp_path: Path) -> None:
    data: dict[str, Array] = {
        "velocity": np.ones((1, 3), np.float32),
        "color": np.array([[255, 128, 0]], np.uint8),
        "id": np.array([7], np.int64),
    }
    write_frames(tmp_path, "ply", [Points("p", np.zeros((1, 3), np.float32), data)])
    header = (tmp_path / "p_0000.ply").read_bytes().split(b"end_header")[0].decode().splitlines()
    assert [line for line in header if line.startswith(("element", "property"))] == [
        "element vertex 1",
        *(f"property float {axis}" for axis in "xyz"),
        *(f"property float v{axis}" for axis in "xyz"),
        *(f"property uint8 {name}" for name in ("red", "green", "blue")),
        "property int32 id",
    ]


def test_a_ply_keeps_ids_beyond_32_bits_as_double(tmp_path: Path) -> None:
    meshio = pytest.importorskip("meshio")
    ids = np.array([5_000_000_000, 1], np.int64)
    write_frames(tmp_path, "ply", [Points("p", np.zeros((2, 3), np.float32), {"id": ids})])
    read = meshio.read(tmp_path / "p_0000.ply").point_data["id"]
    assert read.dtype == np.float64
    np.testing.assert_array_equal(read, ids)


@pytest.mark.parametrize("dtype", ["f2", "f4", "f8", "i1", "i2", "i4", "i8", "u1", "u2", "u4", "u8", "b1"])
@pytest.mark.parametrize("name", [name for name, row in PROMISED.items() if row[2] is not NONE])
def test_every_number_type_keeps_its_values(tmp_path: Path, name: str, dtype: str) -> None:
    values = (np.arange(24) % 2).astype(dtype)
    data = {f"k{k}": (values[: 4 * k].reshape(4, k) if k > 1 else values[:4]) for k in (1, 2, 3, 4, 6)}
    part: Part = Mesh("sample", np.eye(4, 3, dtype=np.float32), np.array([[0, 1, 2]], np.int32), data)
    if "triangles" not in PROMISED[name][0]:
        part = Points("sample", part.position, data)
    try:
        frames = write_frames(tmp_path, name, [part])
    except MissingPartError as error:
        pytest.skip(str(error))
    read = READERS[name](tmp_path, format_named(name), frames)[0]
    for array, expected in data.items():
        found = read.data.get(array)
        if found is None:
            found = np.stack(
                [read.data[f"{array}_{i}"] for i in "xyzw012345" if f"{array}_{i}" in read.data], axis=1
            )
        np.testing.assert_array_equal(found, expected.astype(float), err_msg=array)


def test_stl_of_a_triangle_without_area_has_no_nan(tmp_path: Path) -> None:
    part = Mesh("m", np.zeros((3, 3), np.float32), np.array([[0, 1, 2]], np.int32))
    write_frames(tmp_path, "stl", [part])
    record = np.frombuffer((tmp_path / "m_0000.stl").read_bytes()[84:], "<f4,<f4,<f4,(3,3)<f4,<u2", count=1)
    assert not any(np.isnan(record[0][axis]) for axis in range(3))


@pytest.mark.parametrize("name", ["vtkhdf", "xdmf_series"])
def test_points_may_come_while_the_cells_stay(tmp_path: Path, name: str) -> None:
    parts: list[Part] = [
        Mesh("m", np.full((count, 3), count, np.float32), np.array([[0, 1, 2]], np.int32))
        for count in (3, 5, 4)
    ]
    frames = write_frames(tmp_path, name, parts)
    for part, read in zip(parts, READERS[name](tmp_path, format_named(name), frames), strict=True):
        np.testing.assert_array_equal(read.position, part.position)


def test_usd_has_the_diameter_of_a_radius_as_width(tmp_path: Path) -> None:
    usd = pytest.importorskip("pxr.Usd")
    radius = np.array([0.5, 2.0], np.float32)
    write_frames(tmp_path, "usd", [Points("p", np.zeros((2, 3), np.float32), {"radius": radius})])
    stage = usd.Stage.Open(str(tmp_path / "scene.usdc"))
    np.testing.assert_array_equal(stage.GetPrimAtPath("/World/p").GetAttribute("widths").Get(0), [1, 4])


@pytest.mark.parametrize("name", ["xdmf", "med", "xdmf_series", "vtkhdf"])
def test_hdf5_is_not_begun_where_the_room_is_short(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    part = sample("points", 1000)
    usage = shutil.disk_usage(tmp_path)._replace(free=2 * byte_count(part) + (4 << 20) - 1)
    monkeypatch.setattr("shutil.disk_usage", lambda path: usage)
    with pytest.raises(OutputError, match="the disk is full"):
        write_frames(tmp_path, name, [part])
    assert {path.suffix for path in tmp_path.iterdir()} <= {".vtu", ".pvd", ".series"}


@pytest.mark.parametrize("name", ["xdmf", "msh"])
def test_points_without_cells_are_refused_where_no_reader_takes_them(tmp_path: Path, name: str) -> None:
    part = Lines("hair", np.zeros((3, 3), np.float32), np.zeros((0, 2), np.int32))
    with pytest.raises(FormatError, match="'hair' has points but no lines"):
        write_frames(tmp_path, name, [part])


def test_the_same_frames_give_the_same_bytes(tmp_path: Path) -> None:
    folders = [tmp_path / "first", tmp_path / "second"]
    for folder in folders:
        # Some formats would put the date into their files, HDF5 in seconds.
        time.sleep(1.1 if folder == folders[1] else 0.0)
        for name in FORMATS:
            if name != "usd":
                (folder / name).mkdir(parents=True)
                kind = PROMISED[name][0][-1]
                write_frames(folder / name, name, [sample(kind, 10, seed) for seed in range(2)])
    first, second = (
        {path.relative_to(folder): path.read_bytes() for path in folder.rglob("*.*")} for folder in folders
    )
    assert first == second
    assert len(first) > 2 * len(FORMATS)


@pytest.mark.parametrize(
    ("name", "near"),
    [
        ("vtuu", "vtu"),
        ("pyl", "ply"),
        ("h5", "xdmf"),
        ("usdc", "usd"),
        ("xdmf-serie", "xdmf_series"),
        ("", None),
    ],
)
def test_an_unknown_format_names_the_nearest(name: str, near: str | None) -> None:
    with pytest.raises(FormatError, match="must be one of vtu, vtk, ply") as caught:
        format_named(name)
    assert (f"did you mean '{near}'?" in str(caught.value)) == (near is not None)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("name", ["ply", ".ply", " PLY ", "xdmf-series"])
def test_a_format_may_be_written_as_users_do(name: str) -> None:
    assert format_named(name).name in ("ply", "xdmf_series")


def test_a_format_named_twice_is_written_once_and_the_record_is_not_named(tmp_path: Path) -> None:
    plan = plan_output(tmp_path, ("ply", "vtu", ".PLY"), OutputOptions(), 25.0)
    assert plan.formats == ("ply",)


def test_a_missing_package_is_one_line(monkeypatch: pytest.MonkeyPatch) -> None:
    import importlib.util

    find = importlib.util.find_spec
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None if name == "pxr" else find(name))
    with pytest.raises(MissingPartError, match=r"^format 'usd' .* pip install 'tianim\[usd\]'$"):
        format_named("usd").load()


def test_meshio_may_not_end_the_program(tmp_path: Path) -> None:
    from tianim.export.meshio_formats import read

    path = tmp_path / "bad.vtk"
    path.write_text("nonsense")
    with pytest.raises(FormatError, match=r"bad\.vtk: meshio cannot read it"):
        read(path)
