"""Particles that start from a file: NPZ, PLY, VTU; and files that are not such."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import meshio
import numpy as np
import pytest
from pydantic import TypeAdapter, ValidationError

from tianim.errors import SceneError
from tianim.export import OutputOptions, open_exporters
from tianim.frame import Frame, Points
from tianim.spatial.placement import FileHeading, Placement, PointFile, directions, own_count, place
from tianim.spatial.point_files import read_points

RNG = np.random.default_rng(11)
POSITION = RNG.normal(size=(50, 3)).astype(np.float32)
VELOCITY = RNG.normal(size=(50, 3)).astype(np.float32)


def save_npz(path: Path, **arrays: Any) -> Path:
    np.savez(path, **arrays)
    return path


def save_vtu(path: Path, binary: bool = True) -> Path:
    cells = [("vertex", np.arange(len(POSITION))[:, None])]
    meshio.Mesh(POSITION, cells, point_data={"velocity": VELOCITY}).write(path, binary=binary)
    return path


def save_raw_vtu(path: Path) -> Path:
    """A VTU with appended raw arrays, as the project writes its frames."""
    count = len(POSITION)
    arrays: list[tuple[str, str, int, str, np.ndarray]] = [
        ("Points", "Points", 3, "Float32", POSITION),
        ("PointData", "velocity", 3, "Float32", VELOCITY),
        ("Cells", "connectivity", 1, "Int32", np.arange(count, dtype=np.int32)),
        ("Cells", "offsets", 1, "Int32", np.arange(1, count + 1, dtype=np.int32)),
        ("Cells", "types", 1, "UInt8", np.ones(count, dtype=np.uint8)),
    ]
    text, data = {"Points": "", "PointData": "", "Cells": ""}, b""
    for section, name, width, kind, values in arrays:
        text[section] += (
            f'<DataArray type="{kind}" Name="{name}" NumberOfComponents="{width}" '
            f'format="appended" offset="{len(data)}"/>\n'
        )
        data += np.uint64(values.nbytes).tobytes() + values.tobytes()
    body = "".join(f"<{section}>\n{inner}</{section}>\n" for section, inner in text.items())
    path.write_bytes(
        b'<?xml version="1.0"?>\n<VTKFile type="UnstructuredGrid" version="1.0" byte_order="LittleEndian" '
        b'header_type="UInt64">\n<UnstructuredGrid>\n'
        + f'<Piece NumberOfPoints="{count}" NumberOfCells="{count}">\n{body}</Piece>\n'.encode()
        + b'</UnstructuredGrid>\n<AppendedData encoding="raw">\n_'
        + data
        + b"\n</AppendedData>\n</VTKFile>\n"
    )
    return path


def save_ply(path: Path, names: tuple[str, ...]) -> Path:
    columns = dict(zip(names, VELOCITY.T, strict=True))
    meshio.Mesh(POSITION, [], point_data=columns).write(path)
    return path


WRITERS: dict[str, Callable[[Path], Path]] = {
    "a.npz": lambda path: save_npz(path, position=POSITION, velocity=VELOCITY),
    "a.vtu": save_vtu,
    "ascii.vtu": lambda path: save_vtu(path, binary=False),
    "raw.vtu": save_raw_vtu,
    "short.ply": lambda path: save_ply(path, ("vx", "vy", "vz")),
    "long.ply": lambda path: save_ply(path, ("velocity_x", "velocity_y", "velocity_z")),
}


@pytest.mark.parametrize("name", WRITERS)
def test_positions_and_velocities_come_back(tmp_path: Path, name: str) -> None:
    placement = PointFile(path=WRITERS[name](tmp_path / name))
    assert own_count(placement) == 50
    placed = place(placement, None, np.random.default_rng(0))
    exact = 1e-6 if name == "ascii.vtu" else 0.0  # text has 11 digits
    np.testing.assert_allclose(placed.position, POSITION, atol=exact)
    assert placed.velocity is not None
    np.testing.assert_allclose(placed.velocity, VELOCITY, atol=exact)
    assert placed.velocity.dtype == np.float32
    heading = directions(FileHeading(path=placement.path), placed.position, np.random.default_rng(0))
    np.testing.assert_allclose(heading, VELOCITY / np.linalg.norm(VELOCITY, axis=1, keepdims=True), atol=1e-6)


def test_exported_frames_can_be_started_from(tmp_path: Path) -> None:
    points = Points("boids", POSITION, {"id": np.arange(50, dtype=np.int32), "velocity": VELOCITY})
    with open_exporters(tmp_path, ["npz", "ply"], OutputOptions(), fps=30.0) as writer:
        writer.write(Frame(0, 0.0, (points,)))
    for suffix in (".npz", ".ply", ".vtu"):
        (path,) = tmp_path.glob(f"*{suffix}")
        data = read_points(path)
        np.testing.assert_array_equal(data.position, POSITION)
        np.testing.assert_array_equal(data.velocity, VELOCITY)


def test_two_dimensions_take_x_and_y(tmp_path: Path) -> None:
    placed = place(PointFile(path=WRITERS["a.npz"](tmp_path / "a.npz")), 50, np.random.default_rng(0), 2)
    np.testing.assert_array_equal(placed.position, POSITION * [1, 1, 0])
    assert placed.velocity is not None
    np.testing.assert_array_equal(placed.velocity, VELOCITY * [1, 1, 0])
    flat = save_npz(tmp_path / "flat.npz", position=POSITION[:, :2])
    np.testing.assert_array_equal(
        place(PointFile(path=flat), None, np.random.default_rng(0), 2).position, POSITION * [1, 1, 0]
    )


def test_a_file_without_velocities(tmp_path: Path) -> None:
    path = save_npz(tmp_path / "a.npz", position=POSITION)
    assert place(PointFile(path=path), None, np.random.default_rng(0)).velocity is None
    with pytest.raises(ValidationError, match="holds no array called velocity"):
        FileHeading(path=path)


def test_an_empty_file_of_points(tmp_path: Path) -> None:
    placed = place(
        PointFile(path=save_npz(tmp_path / "a.npz", position=np.zeros((0, 3)))),
        None,
        np.random.default_rng(0),
    )
    assert placed.position.shape == (0, 3)


def test_counts_must_agree(tmp_path: Path) -> None:
    path = save_npz(tmp_path / "a.npz", position=POSITION, velocity=VELOCITY)
    with pytest.raises(SceneError, match="count 49: the file placement has 50 points"):
        place(PointFile(path=path), 49, np.random.default_rng(0))
    with pytest.raises(SceneError, match="has 50 velocities, needed are 3"):
        directions(FileHeading(path=path), np.zeros((3, 3)), np.random.default_rng(0))


def test_what_is_read_cannot_be_changed(tmp_path: Path) -> None:
    data = read_points(save_npz(tmp_path / "a.npz", position=POSITION))
    with pytest.raises(ValueError, match="read-only"):
        data.position[0] = 1.0


def pickled(path: Path) -> Path:
    return save_npz(path, position=np.array([{"a": 1}, None], dtype=object))


BAD_FILES: dict[str, tuple[Callable[[Path], object], str]] = {
    "text.npz": (lambda path: path.write_text("hello"), "not a readable .npz file"),
    "text.ply": (lambda path: path.write_text("hello"), "not a readable .ply file"),
    "text.vtu": (lambda path: path.write_text("hello"), "not a readable .vtu file"),
    "empty.npz": (lambda path: path.write_bytes(b""), "not a readable .npz file"),
    "empty.ply": (lambda path: path.write_bytes(b""), "not a readable .ply file"),
    "empty.vtu": (lambda path: path.write_bytes(b""), "not a readable .vtu file"),
    "other.vtu": (lambda path: path.write_text("<VTKFile type='ImageData'/>"), "not a readable .vtu file"),
    "pickle.npz": (pickled, "not a readable .npz file"),
    "names.npz": (lambda path: save_npz(path, x=POSITION), "holds no array called position"),
    "flat.npz": (lambda path: save_npz(path, position=POSITION.reshape(-1)), r"position has shape \(150,\)"),
    "words.npz": (
        lambda path: save_npz(path, position=np.array([["a", "b", "c"]])),
        "must be .n, 3. numbers",
    ),
    "nan.npz": (lambda path: save_npz(path, position=POSITION * np.nan), "not finite"),
    "huge.npz": (lambda path: save_npz(path, position=POSITION.astype(float) * 1e30), "beyond 1e.18"),
    "pair.npz": (
        lambda path: save_npz(path, position=POSITION, velocity=VELOCITY[1:]),
        "50 positions but 49 velocities",
    ),
    "a.csv": (lambda path: path.write_text("1,2,3"), r"must be one of \.npz, \.ply, \.vtu"),
}


@pytest.mark.parametrize("name", BAD_FILES)
def test_a_bad_file_gives_one_line(tmp_path: Path, name: str) -> None:
    write, message = BAD_FILES[name]
    path = tmp_path / name
    write(path)
    with pytest.raises(SceneError, match=message) as caught:
        read_points(path)
    assert "\n" not in str(caught.value)
    assert name in str(caught.value)
    with pytest.raises(ValidationError, match=message):
        PointFile(path=path)


def test_a_missing_file_gives_one_line(tmp_path: Path) -> None:
    with pytest.raises(SceneError, match="cannot be read"):
        read_points(tmp_path / "none.npz")
    with pytest.raises(ValidationError, match="no such file"):
        PointFile(path=tmp_path / "none.npz")


def test_a_file_is_found_beside_the_scene(tmp_path: Path) -> None:
    save_npz(tmp_path / "start.npz", position=POSITION)
    placement = TypeAdapter(Placement).validate_python(
        {"kind": "file", "path": "start.npz"}, context={"folder": tmp_path}
    )
    assert own_count(placement) == 50
