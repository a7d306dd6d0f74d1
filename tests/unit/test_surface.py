"""Surfaces of particles: right in area and volume, closed, the same bytes every way they are made."""

import importlib.util
import shutil
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
import pytest
from fluid_clouds import ball, lattice, water

from tianim.errors import FormatError, MissingPartError, OutputError
from tianim.export import (
    OutputOptions,
    RunFrames,
    SurfaceOptions,
    export_run,
    open_exporters,
    read_vtu,
    surface_run,
    surfaces,
)
from tianim.export.axes import Axes
from tianim.export.formats import Stamp
from tianim.export.surfaces import SurfaceTask, make_surface
from tianim.export.tables import Table
from tianim.export.vtu import write_part
from tianim.export.workers import SurfaceWorkers
from tianim.frame import Frame, Mesh, Points

FPS = 25.0
SPACING = 0.05
# A ball of 10 spacings: smoothing takes 3 % of its volume, the bumps that are left add to the area.
BALL_VOLUME, BALL_AREA = 0.04, 0.03
# A slab of 12 spacings loses 2 % at its edges and corners, which become round, and 5 % of its area.
SLAB_VOLUME, SLAB_AREA = 0.03, 0.07
# Before smoothing the volume is that of the particles.
ROUGH_VOLUME = 0.01


def made(part: Points, **options: object) -> surfaces.Surface:
    return make_surface(SurfaceTask("water_surface", SurfaceOptions(of=part.name, **options), (part,)))  # type: ignore[arg-type]


def edges(mesh: Mesh) -> np.ndarray:
    """The directed edges of all triangles, (3 m, 2)."""
    t = mesh.triangles
    return np.concatenate([t[:, [0, 1]], t[:, [1, 2]], t[:, [2, 0]]])


def is_watertight(mesh: Mesh) -> bool:
    """Whether each edge is there once in each direction: closed, and all triangles face alike."""
    there = edges(mesh)
    once = np.unique(there, axis=0)
    return len(once) == len(there) and set(map(tuple, once)) == set(map(tuple, once[:, ::-1]))


def test_a_ball_has_its_area_and_volume() -> None:
    surface = made(water(ball(0.5, SPACING), SPACING))
    assert surface.row["volume"] == pytest.approx(4 / 3 * np.pi * 0.5**3, rel=BALL_VOLUME)
    assert surface.row["area"] == pytest.approx(4 * np.pi * 0.5**2, rel=BALL_AREA)
    assert is_watertight(surface.mesh)
    outwards = surface.mesh.position / np.linalg.norm(surface.mesh.position, axis=1, keepdims=True)
    normal = surface.mesh.data["normal"].astype(np.float64)
    assert (outwards * normal).sum(axis=1).min() > 0.9
    np.testing.assert_allclose(np.linalg.norm(normal, axis=1), 1.0, atol=1e-5)


def test_a_slab_has_its_area_and_volume() -> None:
    part = water(lattice((0, 0, 0), (1, 0.3, 1), 0.025), 0.025)
    surface = made(part)
    assert surface.row["volume"] == pytest.approx(0.3, rel=SLAB_VOLUME)
    assert surface.row["area"] == pytest.approx(2 + 4 * 0.3, rel=SLAB_AREA)
    assert is_watertight(surface.mesh)
    assert made(part, smoothing=0).row["volume"] == pytest.approx(0.3, rel=ROUGH_VOLUME)
    assert surface.row["particle_volume"] == pytest.approx(len(part.position) * 0.025**3)
    # Far from the origin too: the sums are taken from the middle of the mesh.
    far = made(water(part.position + np.float32(64.0), 0.025))
    assert far.row["volume"] == pytest.approx(surface.row["volume"], rel=1e-3)


def test_two_parts_are_one_volume() -> None:
    left, right = lattice((0, 0, 0), (0.5, 0.3, 1), SPACING), lattice((0.5, 0, 0), (1, 0.3, 1), SPACING)
    parts = (water(left, SPACING), water(right, SPACING, name="water_oil"))
    task = SurfaceTask("all", SurfaceOptions(of=("water", "water_oil"), smoothing=0), parts)
    surface = make_surface(task)
    assert surface.row["volume"] == pytest.approx(0.3, rel=2 * ROUGH_VOLUME)
    assert surface.row["particles"] == len(left) + len(right)
    # One piece: the interface between the two is no surface.
    v, e = len(surface.mesh.position), len(edges(surface.mesh)) // 2
    assert v - e + len(surface.mesh.triangles) == 2


def test_attributes_are_carried_to_the_mesh() -> None:
    position = ball(0.5, SPACING)
    surface = made(water(position, SPACING, velocity=2.0 * position + 1.0), attributes=("velocity",))
    found = surface.mesh.data["velocity"].astype(np.float64)
    # Near the surface the mean of the particles around a place lies up to half a spacing inside.
    assert np.abs(found - (2.0 * surface.mesh.position + 1.0)).max() < 2.0 * SPACING
    assert surface.mesh.data["velocity"].dtype == np.float32
    assert surface.mesh.units == {"velocity": "m/s"}


@pytest.mark.parametrize("count", [0, 1, 2, 5])
def test_no_particles_or_a_handful(count: int) -> None:
    position = np.random.default_rng(1).uniform(0, 0.2, (count, 3)).astype(np.float32)
    surface = made(water(position, SPACING), attributes=("velocity",))
    mesh = surface.mesh
    assert (len(mesh.triangles) == 0) == (count == 0)
    assert mesh.triangles.dtype == np.int32
    assert mesh.data.keys() == {"normal", "velocity"}
    assert all(values.shape == mesh.position.shape for values in mesh.data.values())
    assert is_watertight(mesh)
    assert surface.row["volume"] >= 0.0


@pytest.mark.parametrize(
    ("place", "reason"), [(1e6, "too far apart for its grid: 1e+06 x"), (np.nan, "is not finite")]
)
def test_a_particle_that_is_lost_is_a_line(place: float, reason: str) -> None:
    position = np.array([[0, 0, 0], [place, 1e6, 1e6]], np.float32)
    with pytest.raises(OutputError, match="surface 'water_surface'") as caught:
        made(water(position, SPACING))
    assert reason in str(caught.value)
    assert "\n" not in str(caught.value)


def frames(count: int = 4) -> list[Frame]:
    """A ball that grows; the first frame has nothing."""
    made = []
    for index in range(count):
        position = ball(0.1 * index, SPACING) if index else np.zeros((0, 3), np.float32)
        part = water(position, SPACING, velocity=position * index)
        floor = Mesh("floor", np.eye(3, dtype=np.float32), np.array([[0, 1, 2]], np.int32))
        made.append(Frame(index, index / FPS, (part, floor)))
    return made


OPTIONS = OutputOptions(
    surfaces={"water_surface": SurfaceOptions(of="water", attributes=("velocity",), cube_size=1.0)}
)


def write(
    folder: Path, given: Sequence[Frame], options: OutputOptions = OPTIONS, first: int = 0, workers: int = 1
) -> Path:
    with open_exporters(folder / "frames", ("ply", "vtkhdf"), options, FPS, first, workers) as out:
        for frame in given[first:]:
            out.write(frame)
    return folder


def contents(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in (folder / "frames").iterdir()}


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run whose surfaces were made while it went on."""
    return write(tmp_path_factory.mktemp("run"), frames())


def test_a_run_has_its_surface_in_every_frame_and_format(run: Path) -> None:
    there = contents(run)
    for index in range(4):
        assert {f"water_surface_{index:04d}.vtu", f"water_surface_{index:04d}.ply"} <= there.keys()
    assert {"water_surface.pvd", "water_surface.vtkhdf", "water_surface.csv"} <= there.keys()
    read = RunFrames(run)
    mesh = read[3].part("water_surface")
    assert isinstance(mesh, Mesh)
    assert is_watertight(mesh)
    assert mesh.data.keys() == {"normal", "velocity"}
    assert len(read[0].part("water_surface").position) == 0
    lines = (run / "frames" / "water_surface.csv").read_text().splitlines()
    assert lines[0] == "frame,time,area,volume,particles,particle_volume"
    assert len(lines) == 5
    volumes = [float(line.split(",")[3]) for line in lines[1:]]
    assert volumes[0] == 0.0
    assert volumes == sorted(volumes)


def test_the_number_of_workers_does_not_change_a_byte(run: Path, tmp_path: Path) -> None:
    assert contents(write(tmp_path, frames(), workers=3)) == contents(run)


def test_the_simulation_does_not_wait_for_a_surface(tmp_path: Path) -> None:
    """A frame is handed over and the next one made: its files come later, and `wait` is told when."""
    part = water(ball(0.5, 0.03), 0.03)  # takes a fifth of a second
    with open_exporters(tmp_path, (), OPTIONS, FPS) as out:
        for index in range(2):
            out.write(Frame(index, index / FPS, (part,)))
        assert not (tmp_path / "water_surface_0001.vtu").exists()
        out.wait()
        assert (tmp_path / "water_surface_0001.vtu").exists()


def test_a_resumed_run_has_the_same_bytes(run: Path, tmp_path: Path) -> None:
    shutil.copytree(run, tmp_path, dirs_exist_ok=True)
    write(tmp_path, frames(), first=2)
    assert contents(tmp_path) == contents(run)


def test_the_pass_afterwards_makes_the_same_bytes(run: Path, tmp_path: Path) -> None:
    write(tmp_path, frames(), OutputOptions())
    assert "water_surface.pvd" not in contents(tmp_path)
    rows = surface_run(tmp_path, OPTIONS.surfaces, ("ply", "vtkhdf"), OutputOptions(), workers=2)
    assert contents(tmp_path) == contents(run)
    assert [row["frame"] for row in rows["water_surface"]] == [0, 1, 2, 3]
    # Again, and otherwise: what was there is replaced, and nothing else is touched.
    coarse = {"water_surface": SurfaceOptions(of="water", cube_size=2.0)}
    surface_run(tmp_path, coarse, (), OutputOptions())
    there = contents(tmp_path)
    assert "water_surface_0003.ply" not in there
    assert there["water_surface_0003.vtu"] != contents(run)["water_surface_0003.vtu"]
    assert {name: one for name, one in there.items() if not name.startswith("water_surface")} == {
        name: one for name, one in contents(run).items() if not name.startswith("water_surface")
    }


def test_a_run_with_a_surface_is_exported_as_any_other(run: Path, tmp_path: Path) -> None:
    export_run(run, ["stl", "npz"], OutputOptions(parts=("water_surface",)), tmp_path)
    assert {path.suffix for path in tmp_path.iterdir()} == {".stl", ".npz"}


def test_fields_do_not_take_from_a_surface_what_it_asks_for(tmp_path: Path) -> None:
    options = OPTIONS.model_copy(update={"fields": ("velocity",)})
    write(tmp_path, frames(2), options)
    read = RunFrames(tmp_path)[1]
    assert read.part("water").data.keys() == {"velocity"}
    assert read.part("water_surface").data.keys() == {"normal", "velocity"}


@pytest.mark.parametrize(
    ("options", "complaint"),
    [
        (SurfaceOptions(of="watr"), "surfaces.skin.of: no part is called 'watr'; there are floor, water"),
        (SurfaceOptions(of="floor"), "surfaces.skin.of: part 'floor' has no particles"),
        (SurfaceOptions(of="water", attributes=("speed",)), "has no 'speed'; there are id, velocity"),
        (SurfaceOptions(of="water", attributes=("id",)), "'id' has type int32"),
    ],
)
def test_what_cannot_be_made_is_refused_at_the_first_frame(
    tmp_path: Path, options: SurfaceOptions, complaint: str
) -> None:
    with (
        pytest.raises(FormatError, match=complaint) as caught,
        open_exporters(tmp_path, (), OutputOptions(surfaces={"skin": options}), FPS) as out,
    ):
        out.write(frames(1)[0])
    assert caught.value.exit_code == 2
    assert not list(tmp_path.glob("*.vtu"))


@pytest.mark.parametrize(
    ("options", "complaint"),
    [
        (OutputOptions(surfaces={"floor": SurfaceOptions(of="water")}), "two parts called 'floor'"),
        (OutputOptions(surfaces=OPTIONS.surfaces, formats=("gadget",)), "part 'water_surface' is triangles"),
        (OutputOptions(surfaces=OPTIONS.surfaces, parts=("skin",)), "there are floor, water, water_surface"),
    ],
)
def test_other_options_know_of_the_surfaces(tmp_path: Path, options: OutputOptions, complaint: str) -> None:
    only = Frame(
        0,
        0.0,
        frames(1)[0].parts if "two" in complaint or "skin" in options.parts else frames(1)[0].parts[:1],
    )
    with (
        pytest.raises(FormatError, match=complaint),
        open_exporters(tmp_path, (), options, FPS) as out,
    ):
        out.write(only)


def test_particles_without_a_spacing_need_a_radius(tmp_path: Path) -> None:
    part = Points("dust", ball(0.2, SPACING))
    frame = Frame(0, 0.0, (part,))
    with pytest.raises(FormatError, match=r"skin\.particle_radius: part 'dust' does not tell the spacing"):
        surfaces.check(frame, {"skin": SurfaceOptions(of="dust")})
    surfaces.check(frame, {"skin": SurfaceOptions(of="dust", particle_radius=SPACING / 2)})
    assert made(part, particle_radius=SPACING / 2).row["particle_volume"] == pytest.approx(
        len(part.position) * SPACING**3
    )


def test_without_the_package_nothing_begins(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    message = r"pip install 'tianim\[surface\]'"
    with (
        pytest.raises(MissingPartError, match=message),
        open_exporters(tmp_path / "new", (), OPTIONS, FPS),
    ):
        pass
    assert not (tmp_path / "new").exists()
    with open_exporters(tmp_path, (), OutputOptions(), FPS) as out:  # without surfaces it goes
        out.write(frames(1)[0])
    with pytest.raises(MissingPartError, match=message):
        surface_run(tmp_path, OPTIONS.surfaces, (), OutputOptions())


def test_a_worker_that_fails_ends_the_run_with_a_line(tmp_path: Path) -> None:
    lost = np.array([[0, 0, 0], [1e6, 1e6, 1e6]], np.float32)
    given = [*frames(3), Frame(3, 3 / FPS, (water(lost, SPACING),))]
    with pytest.raises(OutputError, match="'water_surface': the particles lie too far apart"):
        write(tmp_path, given)
    # What was made before it is there, whole.
    assert [frame.index for frame in RunFrames(tmp_path)] == [0, 1, 2]
    assert not list((tmp_path / "frames").glob(".*"))


@pytest.fixture
def workers() -> Iterator[SurfaceWorkers]:
    with SurfaceWorkers(2) as pool:
        yield pool


def test_a_worker_that_is_gone_is_a_line(workers: SurfaceWorkers) -> None:
    task = SurfaceTask("skin", SurfaceOptions(of="water"), (water(ball(0.2, SPACING), SPACING),))
    workers.give((task,))
    assert len(workers.take()) == 1
    process, _ = workers._idle[0]
    process.kill()
    process.wait()
    with pytest.raises(OutputError, match="makes surfaces ended"):
        next(workers.run([(task,)]))


def test_workers_give_back_in_order_and_have_one_thread(workers: SurfaceWorkers) -> None:
    tasks = [
        SurfaceTask(
            f"s{'x' * index}",
            SurfaceOptions(of="water"),
            (water(ball(0.3 - 0.04 * index, SPACING), SPACING),),
        )
        for index in range(6)
    ]  # the later, the quicker
    found = [made[0] for made in workers.run((task,) for task in tasks)]
    assert [one.mesh.name for one in found] == [task.name for task in tasks]
    for process, _ in workers._idle:
        environment = Path(f"/proc/{process.pid}/environ").read_bytes().split(b"\0")
        assert b"RAYON_NUM_THREADS=1" in environment
    again = make_surface(tasks[0])
    assert again.mesh.position.tobytes() == found[0].mesh.position.tobytes()


@pytest.mark.parametrize(("up", "scale"), [("y", 1.0), ("z", 1.0), ("y", 128.0)])
def test_the_record_keeps_the_spacing(tmp_path: Path, up: str, scale: float) -> None:
    path = tmp_path / "water_0000.vtu"
    axes = Axes(up, scale)  # type: ignore[arg-type]
    part = water(ball(0.1, SPACING), SPACING)
    write_part(path, axes.apply(part), Stamp(axes=axes))
    found = read_vtu(path)
    assert isinstance(found, Points)
    assert found.spacing == SPACING
    assert (
        f'Name="spacing" NumberOfTuples="1" format="ascii">{SPACING * scale!r}<'
        in path.read_bytes().decode("latin-1")
    )


def test_a_part_without_spacing_has_none_in_its_file(tmp_path: Path) -> None:
    path = tmp_path / "dust_0000.vtu"
    write_part(path, Points("dust", ball(0.1, SPACING)), Stamp())
    assert b"spacing" not in path.read_bytes()
    assert read_vtu(path).spacing == 0.0  # type: ignore[union-attr]


def test_a_damaged_table_is_a_line(tmp_path: Path) -> None:
    (tmp_path / "skin.csv").write_text("frame,time,area\n0,0.0\n1,zero,2\n")
    with pytest.raises(OutputError, match=r"skin\.csv: damaged"):
        Table(tmp_path, "skin").load(9)
