"""The VTU record: every type and shape survives, other programs read it, damage is named."""

from pathlib import Path

import numpy as np
import pytest

from tianim.errors import FormatError, OutputError
from tianim.export import OutputOptions, Stamp, read_vtu
from tianim.export.axes import Axes, UpAxis
from tianim.export.parts import KINDS, cell_data_of, cells_of, check_frame, kind_of
from tianim.export.roundtrip import sample
from tianim.export.vtu import read_stamp, write_part
from tianim.frame import Array, Frame, Lines, Mesh, Part, Points

DTYPES = ("f4", "f8", "i1", "i2", "i4", "i8", "u1", "u2", "u4", "u8")
COMPONENTS = (1, 2, 3, 4, 6, 9)


def assert_same(part: Part, other: Part) -> None:
    """Same kind, same arrays bit for bit, same units."""
    assert kind_of(part) == kind_of(other)
    assert dict(part.units) == dict(other.units)
    pairs: list[tuple[Array | None, Array | None]] = [
        (part.position, other.position),
        (cells_of(part), cells_of(other)),
    ]
    for data, found in ((part.data, other.data), (cell_data_of(part), cell_data_of(other))):
        assert list(data) == list(found)
        pairs += [(data[name], found[name]) for name in data]
    for values, read in pairs:
        if values is None or read is None:
            assert values is read
        else:
            assert values.dtype == read.dtype
            assert values.shape == read.shape
            assert values.tobytes() == read.tobytes()


@pytest.mark.parametrize("count", [0, 1, 1000])
@pytest.mark.parametrize("kind", KINDS)
def test_every_kind_comes_back_bit_for_bit(tmp_path: Path, kind: str, count: int) -> None:
    part = sample(kind, count)
    write_part(tmp_path / "sample_0007.vtu", part, Stamp(7, 7 / 30))
    assert_same(part, read_vtu(tmp_path / "sample_0007.vtu"))
    assert read_vtu(tmp_path / "sample_0007.vtu").name == "sample"
    assert read_stamp(tmp_path / "sample_0007.vtu") == Stamp(7, 7 / 30)


@pytest.mark.parametrize("count", [0, 5])
def test_every_type_and_number_of_components_comes_back(tmp_path: Path, count: int) -> None:
    random = np.random.default_rng(1)
    data = {
        f"{dtype}x{k}": (random.random((count, k)) * 100)
        .astype(dtype)
        .reshape((count, k) if k > 1 else count)
        for dtype in DTYPES
        for k in COMPONENTS
    }
    part = Points("p", np.zeros((count, 3), np.float32), data, {"f4x3": "kg·m/s <&>"})
    write_part(tmp_path / "p_0000.vtu", part, Stamp())
    assert_same(part, read_vtu(tmp_path / "p_0000.vtu"))


def test_views_and_foreign_byte_order_are_written_by_value(tmp_path: Path) -> None:
    wide = np.arange(24, dtype=np.float32).reshape(4, 6)
    part = Points("p", wide[:, ::2], {"id": np.arange(4, dtype=">i4"), "flag": np.array([1, 0, 1, 1], bool)})
    write_part(tmp_path / "p_0000.vtu", part, Stamp())
    read = read_vtu(tmp_path / "p_0000.vtu")
    np.testing.assert_array_equal(read.position, wide[:, ::2])
    np.testing.assert_array_equal(read.data["id"], np.arange(4))
    assert read.data["flag"].dtype == np.uint8
    np.testing.assert_array_equal(read.data["flag"], [1, 0, 1, 1])


def test_counts_may_grow_and_shrink(tmp_path: Path) -> None:
    # The arrays of cells are kept between files and only sliced.
    meshio = pytest.importorskip("meshio")
    for number, count in enumerate((3, 10, 1, 10, 7)):
        path = tmp_path / f"p_{number:04d}.vtu"
        write_part(path, Points("p", np.ones((count, 3), np.float32)), Stamp())
        cells = meshio.read(path).cells
        assert [block.type for block in cells] == ["vertex"]
        np.testing.assert_array_equal(cells[0].data[:, 0], np.arange(count))


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("count", [1, 1000])
def test_meshio_reads_it(tmp_path: Path, kind: str, count: int) -> None:
    meshio = pytest.importorskip("meshio")
    part = sample(kind, count)
    write_part(tmp_path / "s_0000.vtu", part, Stamp(3, 0.1))
    mesh = meshio.read(tmp_path / "s_0000.vtu")
    np.testing.assert_array_equal(mesh.points, part.position)
    cells = cells_of(part)
    np.testing.assert_array_equal(mesh.cells[0].data, np.arange(count)[:, None] if cells is None else cells)
    assert mesh.point_data.keys() == part.data.keys()
    for name, values in part.data.items():
        np.testing.assert_array_equal(mesh.point_data[name], values)
        assert mesh.point_data[name].dtype == values.dtype
    for name, values in cell_data_of(part).items():
        np.testing.assert_array_equal(mesh.cell_data[name][0], values)
    assert mesh.field_data["TimeValue"] == pytest.approx(0.1)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("count", [0, 1, 1000])
def test_vtk_reads_it(tmp_path: Path, kind: str, count: int) -> None:
    vtk = pytest.importorskip("vtk")
    from vtk.util.numpy_support import vtk_to_numpy

    part = sample(kind, count)
    write_part(tmp_path / "s_0000.vtu", part, Stamp(3, 0.1))
    reader = vtk.vtkXMLUnstructuredGridReader()
    reader.SetFileName(str(tmp_path / "s_0000.vtu"))
    reader.Update()
    grid = reader.GetOutput()
    assert reader.GetErrorCode() == 0
    assert (grid.GetNumberOfPoints(), grid.GetNumberOfCells()) == (len(part.position), count)
    assert grid.GetFieldData().GetArray("TimeValue").GetValue(0) == 0.1
    for data, found in ((part.data, grid.GetPointData()), (cell_data_of(part), grid.GetCellData())):
        assert found.GetNumberOfArrays() == len(data)
        for name, values in data.items():
            np.testing.assert_array_equal(vtk_to_numpy(found.GetArray(name)), values)
    unit = grid.GetPointData().GetArray("velocity").GetInformation().Get(vtk.vtkDataArray.UNITS_LABEL())
    assert unit == "m/s"
    if count:
        np.testing.assert_array_equal(vtk_to_numpy(grid.GetPoints().GetData()), part.position)
        expected = np.arange(count) if cells_of(part) is None else cells_of(part).reshape(-1)  # type: ignore[union-attr]
        np.testing.assert_array_equal(vtk_to_numpy(grid.GetCells().GetConnectivityArray()), expected)
        assert {grid.GetCellType(cell) for cell in range(count)} == {
            {"points": 1, "lines": 3, "triangles": 5}[kind]
        }


@pytest.mark.parametrize("scale", [1.0, 4.0, 0.5])
@pytest.mark.parametrize("up", ["y", "z"])
@pytest.mark.parametrize("kind", KINDS)
def test_axes_of_the_file_are_undone_exactly(tmp_path: Path, kind: str, up: UpAxis, scale: float) -> None:
    # Turning by a right angle is exact, and so is a scale that is a power of two.
    part = sample(kind, 50)
    axes = OutputOptions(up_axis=up, scale=scale).axes
    write_part(tmp_path / "s_0000.vtu", axes.apply(part), Stamp(axes=axes))
    assert_same(part, read_vtu(tmp_path / "s_0000.vtu"))


def test_any_scale_is_undone_to_the_last_bit_but_one(tmp_path: Path) -> None:
    part, axes = sample("points", 1000), Axes("z", 100.0)
    write_part(tmp_path / "s_0000.vtu", axes.apply(part), Stamp(axes=axes))
    np.testing.assert_array_max_ulp(read_vtu(tmp_path / "s_0000.vtu").position, part.position, 1)


def test_up_axis_turns_what_points_somewhere() -> None:
    up = np.array([[0, 1, 0]], np.float32)
    # A turn of 60 degrees about Y, (x, y, z, w).
    orientation = np.array([[0, 0.5, 0, 0.75**0.5]], np.float32)
    part = Mesh(
        "m",
        up,
        np.zeros((1, 3), np.int32),
        {"velocity": up, "orientation": orientation, "color": up, "cell": np.array([[0, 1, 0]], np.int32)},
        {"normal": up},
        {"velocity": "m/s"},
    )
    turned = Axes("z", 10.0).apply(part)
    assert isinstance(turned, Mesh)
    np.testing.assert_array_equal(turned.position, [[0, 0, 10]])
    np.testing.assert_array_equal(turned.data["velocity"], [[0, 0, 10]])
    np.testing.assert_array_equal(turned.cell_data["normal"], [[0, 0, 1]])
    np.testing.assert_array_equal(turned.data["orientation"], [[0, 0, 0.5, np.float32(0.75**0.5)]])
    np.testing.assert_array_equal(turned.data["color"], up)
    np.testing.assert_array_equal(turned.data["cell"], [[0, 1, 0]])
    # Forward stays a right-handed frame: x keeps, z goes to -y.
    np.testing.assert_array_equal(
        Axes("z").apply(Points("p", np.array([[1, 0, 0], [0, 0, 1]], np.float32))).position,
        [[1, 0, 0], [0, -1, 0]],
    )


def test_turned_orientation_turns_turned_vectors() -> None:
    rotation = pytest.importorskip("scipy.spatial.transform").Rotation
    random = np.random.default_rng(2)
    # SciPy makes them unit quaternions.
    quaternion = rotation.from_quat(random.standard_normal((20, 4))).as_quat().astype(np.float32)
    body = random.standard_normal((20, 3)).astype(np.float32)
    world = rotation.from_quat(quaternion).apply(body).astype(np.float32)
    turn = Axes("z").apply
    turned = turn(Points("p", world, {"orientation": quaternion, "body": body}))
    again = rotation.from_quat(turned.data["orientation"]).apply(turned.data["body"])
    # float32 arithmetic on unit vectors
    np.testing.assert_allclose(again, turned.position, atol=1e-5)


def test_only_lengths_are_scaled() -> None:
    ones = np.ones(2, np.float32)
    data = dict.fromkeys(("radius", "speed", "density", "mass"), ones)
    units = {"radius": "m", "speed": "m/s", "density": "kg/m^3"}
    scaled = Axes("y", 100.0).apply(Points("p", np.ones((2, 3), np.float32), data, units))
    assert {name: float(values[0]) for name, values in scaled.data.items()} == {
        "radius": 100.0,
        "speed": 100.0,
        "density": 1.0,
        "mass": 1.0,
    }


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (None, "no such file"),
        (b"", "not a VTU file that tianim wrote"),
        (b"<html></html>", "not a VTU file that tianim wrote"),
        (b'<?xml version="1.0"?><VTKFile><AppendedData encoding="raw">_', "not a VTU file that tianim wrote"),
    ],
)
def test_what_is_no_record_is_named(tmp_path: Path, content: bytes | None, message: str) -> None:
    path = tmp_path / "p_0000.vtu"
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(OutputError, match=message) as caught:
        read_vtu(path)
    assert str(path) in str(caught.value)


def test_a_file_cut_short_is_named(tmp_path: Path) -> None:
    path = tmp_path / "s_0000.vtu"
    write_part(path, sample("points", 100), Stamp())
    whole = path.read_bytes()
    # Of the arrays of points none may be missing a byte; the closing tags may.
    for missing in (100, 1000, 4000):
        path.write_bytes(whole[:-missing])
        with pytest.raises(OutputError, match="damaged"):
            read_vtu(path)


@pytest.mark.parametrize(
    ("part", "message"),
    [
        (Points("a64", np.zeros((1, 3), np.float32)), "does not end in a digit"),
        (Points("", np.zeros((1, 3), np.float32)), "starts with a letter"),
        (Points("../x", np.zeros((1, 3), np.float32)), "starts with a letter"),
        (Points("p", np.zeros((1, 3), np.float32), {"a b": np.zeros(1)}), "array 'a b': a name starts"),
        (Points("p", np.zeros((4, 2), np.float32)), r"position has shape \(4, 2\)"),
        (Points("p", np.zeros((4, 3), np.float32), {"id": np.zeros(3)}), r"id has shape \(3,\)"),
        (Points("p", np.zeros((1, 3), np.float32), {"f": np.zeros((1, 3, 3))}), r"f has shape \(1, 3, 3\)"),
        (Points("p", np.zeros((1, 3), np.float32), {"c": np.zeros(1, complex)}), "no plain number"),
        (Lines("p", np.zeros((1, 3), np.float32), np.zeros((1, 3), np.int32)), r"expected \(m, 2\)"),
        (
            Mesh("p", np.zeros((3, 3), np.float32), np.zeros((1, 3), np.int32), {}, {"t": np.zeros(2)}),
            "for 1 cells",
        ),
    ],
)
def test_an_unsound_part_is_refused(part: Part, message: str) -> None:
    with pytest.raises(FormatError, match=message):
        check_frame(Frame(0, 0.0, (part,)))


def test_two_parts_with_one_name_are_refused() -> None:
    part = Points("p", np.zeros((1, 3), np.float32))
    with pytest.raises(FormatError, match="two parts called 'p'"):
        check_frame(Frame(0, 0.0, (part, part)))


def test_meshio_reads_any_sizes(tmp_path: Path) -> None:
    # meshio mixes up the arrays of small files unless they lie in the order that we write.
    meshio = pytest.importorskip("meshio")
    random = np.random.default_rng(3)
    for count in range(1, 40):
        data = {name: random.random(count).astype(np.float32) for name in "abcd"}
        write_part(tmp_path / "p_0000.vtu", Points("p", np.zeros((count, 3), np.float32), data), Stamp())
        mesh = meshio.read(tmp_path / "p_0000.vtu")
        for name, values in data.items():
            np.testing.assert_array_equal(mesh.point_data[name], values, err_msg=f"{count} points")
