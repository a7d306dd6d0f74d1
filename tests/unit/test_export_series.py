"""A run's folder: names, indexes with physical times, reading it back, resuming, re-exporting."""

import json
import xml.etree.ElementTree as ElementTree
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tianim.errors import FormatError, OutputError
from tianim.export import FORMATS, OutputOptions, RunFrames, export_run, open_exporters, read_vtu
from tianim.export.roundtrip import sample
from tianim.frame import Frame, Mesh, Points

FPS = 24.0


def frame_at(index: int) -> Frame:
    """A cloud that grows from nothing, and a mesh that comes at frame 2."""
    cloud = replace(sample("points", index * 3, seed=index), name="boids")
    mesh = replace(sample("triangles", 4, seed=index), name="shark")
    return Frame(index, index / FPS, (cloud, mesh) if index >= 2 else (cloud,))


def write_run(
    folder: Path,
    indices: Iterable[int],
    formats: tuple[str, ...] = (),
    options: OutputOptions | None = None,
    resume_from: int = 0,
) -> None:
    with open_exporters(folder, formats, options or OutputOptions(), FPS, resume_from) as writer:
        for index in indices:
            writer.write(frame_at(index))


def contents(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in sorted(folder.iterdir())}


def test_files_are_named_and_indexed(tmp_path: Path) -> None:
    write_run(tmp_path, range(4))
    assert sorted(contents(tmp_path)) == [
        "boids.pvd",
        "boids.vtu.series",
        *(f"boids_{index:04d}.vtu" for index in range(4)),
        "shark.pvd",
        "shark.vtu.series",
        "shark_0002.vtu",
        "shark_0003.vtu",
    ]
    series = json.loads((tmp_path / "boids.vtu.series").read_text())
    assert series["files"] == [{"name": f"boids_{index:04d}.vtu", "time": index / FPS} for index in range(4)]
    sets = ElementTree.parse(tmp_path / "shark.pvd").getroot().findall("./Collection/DataSet")
    assert [(float(one.attrib["timestep"]), one.attrib["file"]) for one in sets] == [
        (2 / FPS, "shark_0002.vtu"),
        (3 / FPS, "shark_0003.vtu"),
    ]


def test_indexes_are_right_after_every_frame(tmp_path: Path) -> None:
    with open_exporters(tmp_path, (), OutputOptions(), FPS) as writer:
        for index in range(3):
            writer.write(frame_at(index))
            writer.wait()
            assert len(json.loads((tmp_path / "boids.vtu.series").read_text())["files"]) == index + 1
            assert len(RunFrames(tmp_path)) == index + 1


def test_paraview_readers_find_the_times(tmp_path: Path) -> None:
    pyvista = pytest.importorskip("pyvista")
    write_run(tmp_path, range(4))
    for name in ("boids.pvd", "boids.vtu.series"):
        reader = pyvista.get_reader(str(tmp_path / name))
        assert list(reader.time_values) == [index / FPS for index in range(4)]
        reader.set_active_time_point(3)
        mesh = reader.read()
        mesh = mesh[0] if isinstance(mesh, pyvista.MultiBlock) else mesh
        np.testing.assert_array_equal(mesh.points, frame_at(3).part("boids").position)


@pytest.mark.parametrize("options", [OutputOptions(), OutputOptions(up_axis="z", scale=4.0, first_number=7)])
def test_a_run_is_read_back_as_it_was(tmp_path: Path, options: OutputOptions) -> None:
    write_run(tmp_path / "frames", range(4), options=options)
    frames = RunFrames(tmp_path)
    assert len(frames) == 4
    assert frames.parts == ("boids", "shark")
    assert frames.times == tuple(index / FPS for index in range(4))
    assert frames.fps == FPS
    for expected, frame in zip(map(frame_at, range(4)), frames, strict=True):
        assert (frame.index, frame.time) == (expected.index, expected.time)
        assert [part.name for part in frame.parts] == [part.name for part in expected.parts]
        for part, other in zip(frame.parts, expected.parts, strict=True):
            assert type(part) is type(other)
            assert part.position.tobytes() == other.position.tobytes()
            assert {name: values.tobytes() for name, values in part.data.items()} == {
                name: values.tobytes() for name, values in other.data.items()
            }
    assert frames[-1].index == 3
    assert [frame.index for frame in frames[1:3]] == [1, 2]
    with pytest.raises(IndexError):
        frames[4]


def test_numbers_start_where_asked(tmp_path: Path) -> None:
    write_run(tmp_path, range(2), options=OutputOptions(first_number=1001))
    assert {path.name for path in tmp_path.glob("*.vtu")} == {"boids_1001.vtu", "boids_1002.vtu"}


def test_more_than_9999_frames_stay_in_order(tmp_path: Path) -> None:
    write_run(tmp_path, range(3), options=OutputOptions(first_number=9998))
    assert sorted(path.name for path in tmp_path.glob("*.vtu")) == [
        "boids_10000.vtu",
        "boids_9998.vtu",
        "boids_9999.vtu",
        "shark_10000.vtu",
    ]
    assert [frame.index for frame in RunFrames(tmp_path)] == [0, 1, 2]


@pytest.mark.parametrize("resume_from", [0, 1, 3, 5])
def test_a_resumed_run_makes_the_same_bytes(tmp_path: Path, resume_from: int) -> None:
    formats = ("npz", "vtk", "xdmf", "vtkhdf", "xdmf_series")
    write_run(tmp_path / "once", range(5), formats)
    # The run that was stopped went further, left a half file and an index that is not whole.
    write_run(tmp_path / "twice", range(5), formats)
    (tmp_path / "twice" / ".boids_0003.vtu.tmp").write_bytes(b"half")
    (tmp_path / "twice" / "boids.vtu.series").write_text("{")
    write_run(tmp_path / "twice", range(resume_from, 5), formats, resume_from=resume_from)
    assert contents(tmp_path / "twice") == contents(tmp_path / "once")


def test_resuming_drops_the_frames_from_there_on(tmp_path: Path) -> None:
    write_run(tmp_path, range(5), ("npz",))
    (tmp_path / "photo_0004.vtu").write_text("someone else's")
    with open_exporters(tmp_path, ("npz",), OutputOptions(), FPS, resume_from=2):
        names = set(contents(tmp_path))
    assert names == {
        "boids.pvd",
        "boids.vtu.series",
        "boids_0000.npz",
        "boids_0000.vtu",
        "boids_0001.npz",
        "boids_0001.vtu",
        "photo_0004.vtu",
    }
    assert len(RunFrames(tmp_path)) == 2


def test_two_runs_cannot_write_into_one_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("tianim.export.files.LOCK_PATIENCE", 0.1)
    with (
        open_exporters(tmp_path, (), OutputOptions(), FPS),
        pytest.raises(OutputError, match="another run is writing there"),
        open_exporters(tmp_path, (), OutputOptions(), FPS),
    ):
        pass
    with open_exporters(tmp_path, (), OutputOptions(), FPS):
        pass


def test_fields_and_parts_choose(tmp_path: Path) -> None:
    options = OutputOptions(fields=("velocity", "id"), parts=("shark",), formats=("npz",))
    write_run(tmp_path, range(2, 4), options=options)
    assert list(read_vtu(tmp_path / "boids_0003.vtu").data) == ["velocity", "id"]
    shark = read_vtu(tmp_path / "shark_0003.vtu")
    assert isinstance(shark, Mesh)
    assert shark.cell_data == {}
    assert {path.name for path in tmp_path.glob("*.npz")} == {"shark_0002.npz", "shark_0003.npz"}


def test_a_field_that_is_nowhere_is_named(tmp_path: Path) -> None:
    options = OutputOptions(fields=("velocty",))
    with pytest.raises(
        FormatError, match=r"output\.fields: no part has 'velocty'; there are density, energy"
    ):
        write_run(tmp_path, [1], options=options)


def test_a_part_that_is_nowhere_is_named(tmp_path: Path) -> None:
    options = OutputOptions(parts=("sharc",))
    message = r"output\.parts: no part is called 'sharc'; there are boids, shark"
    with pytest.raises(FormatError, match=message):
        write_run(tmp_path, [2], options=options)
    write_run(tmp_path / "frames", range(2, 4))
    with pytest.raises(FormatError, match=message):
        export_run(tmp_path, ("npz",), options)


def test_a_refused_part_stops_before_anything_is_written(tmp_path: Path) -> None:
    with pytest.raises(FormatError, match="'obj' holds triangles only; part 'boids' is points"):
        write_run(tmp_path, range(2), ("obj",))
    assert contents(tmp_path) == {}


@pytest.mark.parametrize("name", [name for name in FORMATS if name not in ("vtu", "usd")])
def test_exporting_a_run_gives_what_the_run_would_have(tmp_path: Path, name: str) -> None:
    part = "shark" if "triangles" in FORMATS[name].kinds else "boids"
    options = OutputOptions(up_axis="z", parts=(part,))
    write_run(tmp_path / "first" / "frames", range(2, 6), (name,), options)
    write_run(tmp_path / "second" / "frames", range(2, 6))
    seen: list[tuple[int, int]] = []
    folder = export_run(
        tmp_path / "second", (name,), options, progress=lambda done, total: seen.append((done, total))
    )
    assert folder == tmp_path / "second" / "frames"

    def made(run: str) -> dict[str, bytes]:
        found = contents(tmp_path / run / "frames")
        return {key: value for key, value in found.items() if not key.endswith((".vtu", ".pvd", ".series"))}

    assert made("first") == made("second")
    assert made("first")
    assert seen == [(index + 1, 4) for index in range(4)]


def test_a_record_can_be_copied_in_other_axes(tmp_path: Path) -> None:
    write_run(tmp_path / "run" / "frames", range(3))
    export_run(tmp_path / "run", ("vtu",), OutputOptions(up_axis="z"), folder=tmp_path / "copy")
    up = pytest.importorskip("meshio").read(tmp_path / "copy" / "boids_0002.vtu").points
    position = frame_at(2).part("boids").position
    np.testing.assert_array_equal(up[:, 2], position[:, 1])
    np.testing.assert_array_equal(RunFrames(tmp_path / "copy")[2].part("boids").position, position)


def test_the_record_is_not_written_over(tmp_path: Path) -> None:
    write_run(tmp_path / "frames", range(2))
    before = contents(tmp_path / "frames")
    with pytest.raises(FormatError, match="own record is vtu already"):
        export_run(tmp_path, ("vtu",), OutputOptions(up_axis="z"))
    assert contents(tmp_path / "frames") == before


@pytest.mark.parametrize("target", ["other", "other/frames"])
def test_the_record_of_another_run_is_not_written_over(tmp_path: Path, target: str) -> None:
    for name in ("run", "other"):
        write_run(tmp_path / name / "frames", range(3))
        (tmp_path / name / "run.json").write_text("{}")
    before = contents(tmp_path / "other" / "frames")
    with pytest.raises(FormatError, match="own record is vtu already"):
        export_run(tmp_path / "run", ("vtu",), OutputOptions(up_axis="z"), folder=tmp_path / target)
    export_run(tmp_path / "run", ("vtu",), OutputOptions(up_axis="z"), folder=tmp_path / "other" / "copy")
    assert contents(tmp_path / "other" / "frames") == before


@pytest.mark.parametrize(
    "content",
    [
        None,
        "{",
        '{"files": [{"name": 1}]}',
        '{"files": [{"name": "boids.vtu", "time": 0}]}',
        '{"files": [{"name": "boids_x.vtu", "time": 0}]}',
    ],
)
def test_a_folder_without_a_record_is_named(tmp_path: Path, content: str | None) -> None:
    if content:
        (tmp_path / "boids.vtu.series").write_text(content)
    with pytest.raises(OutputError, match=str(tmp_path)):
        RunFrames(tmp_path)
    with pytest.raises(OutputError, match="no such folder"):
        RunFrames(tmp_path / "nowhere")


def test_an_output_folder_that_is_a_file_is_named(tmp_path: Path) -> None:
    (tmp_path / "frames").write_text("a file")
    with pytest.raises(OutputError, match="frames: cannot write: file exists"):
        write_run(tmp_path / "frames", [0])


def test_options_know_their_formats() -> None:
    assert OutputOptions(formats=["ply", "usd"]).formats == ("ply", "usd")  # type: ignore[arg-type]
    for wrong in ({"formats": ["pyl"]}, {"up_axis": "x"}, {"scale": 0}, {"scale": -1.0}, {"fields": "some"}):
        with pytest.raises(ValueError, match=r"formats|up_axis|scale|fields"):
            OutputOptions(**wrong)


def test_usd_moves_in_blender_terms(tmp_path: Path) -> None:
    usd = pytest.importorskip("pxr.Usd")
    geom = pytest.importorskip("pxr.UsdGeom")
    options = OutputOptions(up_axis="z", scale=100.0, first_number=1, formats=("usd",))
    write_run(tmp_path, range(5), options=options)
    stage = usd.Stage.Open(str(tmp_path / "scene.usdc"))
    assert (stage.GetStartTimeCode(), stage.GetEndTimeCode(), stage.GetTimeCodesPerSecond()) == (1, 5, FPS)
    assert geom.GetStageUpAxis(stage) == "Z"
    assert geom.GetStageMetersPerUnit(stage) == 0.01
    assert stage.GetDefaultPrim().GetPath() == "/World"
    cloud, shark = (stage.GetPrimAtPath(f"/World/{name}") for name in ("boids", "shark"))
    assert (cloud.GetTypeName(), shark.GetTypeName()) == ("Points", "Mesh")
    # The shark comes at frame 2, which has number 3.
    assert [geom.Imageable(shark).ComputeVisibility(code) for code in (1, 2, 3, 5)] == [
        "invisible",
        "invisible",
        "inherited",
        "inherited",
    ]
    for index in range(5):
        part = options.axes.apply(frame_at(index).part("boids"))
        points = geom.Points(cloud)
        np.testing.assert_array_equal(
            np.array(points.GetPointsAttr().Get(index + 1)).reshape(-1, 3), part.position
        )
        np.testing.assert_array_equal(
            np.array(points.GetVelocitiesAttr().Get(index + 1)).reshape(-1, 3), part.data["velocity"]
        )
        np.testing.assert_array_equal(np.array(points.GetIdsAttr().Get(index + 1)), part.data["id"])
    # The same triangles in all frames are stored once, and are no cage of a subdivision surface.
    mesh = geom.Mesh(shark)
    assert mesh.GetFaceVertexIndicesAttr().GetNumTimeSamples() == 0
    assert mesh.GetSubdivisionSchemeAttr().Get() == "none"
    assert cloud.GetAttribute("primvars:density").GetCustomDataByKey("unit") == "kg/m^3"


def test_usd_is_written_piece_by_piece(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    # Long runs do not fit in memory: the stage is saved as it grows.
    usd_format = pytest.importorskip("tianim.export.usd")
    geom = pytest.importorskip("pxr.UsdGeom")
    saves: list[Path] = []
    save = usd_format._save
    monkeypatch.setattr(usd_format, "HELD_BYTES", 100)

    def count(stage: object, path: Path) -> None:
        saves.append(path)
        save(stage, path)

    monkeypatch.setattr(usd_format, "_save", count)
    write_run(tmp_path, range(6), ("usd",))
    assert len(saves) >= 5
    stage = pytest.importorskip("pxr.Usd").Stage.Open(str(tmp_path / "scene.usdc"))
    for index in range(6):
        points = geom.Points(stage.GetPrimAtPath("/World/boids")).GetPointsAttr().Get(index)
        np.testing.assert_array_equal(np.array(points).reshape(-1, 3), frame_at(index).part("boids").position)


def test_strands_become_curves() -> None:
    curves_of = pytest.importorskip("tianim.export.usd").curves_of
    segments = np.array([[0, 1], [1, 2], [5, 4], [4, 3], [7, 8], [8, 7]], np.int32)
    counts, index = curves_of(segments, joined=True)
    assert counts.tolist() == [3, 3, 3]
    assert index.tolist() == [0, 1, 2, 5, 4, 3, 7, 8, 7]
    counts, index = curves_of(segments, joined=False)
    assert counts.tolist() == [2] * 6
    assert index.reshape(-1, 2).tolist() == segments.tolist()


def test_points_keep_their_order_in_every_part(tmp_path: Path) -> None:
    ids = np.arange(9, dtype=np.int32)[::-1].copy()
    part = Points("p", np.arange(27, dtype=np.float32).reshape(9, 3), {"id": ids})
    with open_exporters(tmp_path, (), OutputOptions(), FPS) as writer:
        writer.write(Frame(0, 0.0, (part,)))
    np.testing.assert_array_equal(RunFrames(tmp_path)[0].part("p").data["id"], ids)
