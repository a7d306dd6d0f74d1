"""`tianim surface` and `foam`: parts that are made of a finished run and stand among its frames."""

import csv
import importlib.util
import shutil
from pathlib import Path

import numpy as np
import pytest
from command import FRAMES, SCENE, Cli, frame_bytes

from tianim.export import RunFrames
from tianim.run_folder import Run

SURFACES = "output: {surfaces: {dust_surface: {of: dust, particle_radius: 0.1, attributes: [velocity]}}}\n"
QUICK = ("--no-preview", "--quiet")
RADIUS = "particle_radius=0.1"
# A tank of water that is let go: a second of it has spray, foam and bubbles.
WATER = """\
tianim: 1
fps: 30
duration: 0.5
bounds: {kind: contained, lower: [0, 0, 0], upper: [1.0, 1.0, 0.3]}
systems:
  water:
    kind: fluid
    spacing: 0.05
    blocks: {column: {kind: box, lower: [0, 0, 0], upper: [0.4, 0.6, 0.3], velocity: [4, 0, 0]}}
"""


@pytest.fixture
def dust(scene: Path) -> Path:
    """The scene of drifting points, with a surface."""
    scene.write_text(SCENE + SURFACES)
    return scene


def rows(path: Path) -> list[dict[str, str]]:
    return list(csv.DictReader(path.read_text().splitlines()))


def test_a_run_makes_its_surface_and_the_pass_makes_the_same(dust: Path, cli: Cli) -> None:
    assert cli("run", dust, "--out", "whole", "--format", "npz", *QUICK).exit_code == 0
    whole = frame_bytes(Path("whole"))
    assert {f"dust_surface_{index:04d}.{one}" for index in range(FRAMES) for one in ("vtu", "npz")} < set(
        whole
    )

    assert cli("run", dust, "output.surfaces={}", "--out", "bare", "--format", "npz", *QUICK).exit_code == 0
    assert "dust_surface.csv" not in frame_bytes(Path("bare"))
    result = cli("surface", "bare", RADIUS, "attributes=[velocity]", "--of", "dust", "--jobs", 2)
    assert result.exit_code == 0
    assert frame_bytes(Path("bare")) == whole
    assert "bare/frames/dust_surface.csv" in result.stdout
    assert "particle_volume" in result.stdout
    table = rows(Path("bare/frames/dust_surface.csv"))
    assert [row["frame"] for row in table] == [str(index) for index in range(FRAMES)]
    assert all(float(row["volume"]) > 0.0 for row in table)

    # Without --of it is the scene's own, here coarser; --format says what else is written.
    result = cli("surface", "whole", "cube_size=2", "--format", "stl", "--quiet")
    assert (result.exit_code, result.output) == (0, "")
    after = frame_bytes(Path("whole"))
    assert "dust_surface_0003.stl" in after
    assert "dust_surface_0003.npz" not in after
    assert after["dust_surface_0003.vtu"] != whole["dust_surface_0003.vtu"]
    assert after["dust_0003.vtu"] == whole["dust_0003.vtu"]


def test_a_run_that_is_resumed_has_the_same_surfaces(dust: Path, cli: Cli) -> None:
    cli("run", dust, "--out", "whole", *QUICK)
    cli("run", dust, "--out", "cut", "--frames", 4, *QUICK)
    assert cli("run", dust, "--out", "cut", "--resume", *QUICK).exit_code == 0
    assert frame_bytes(Path("cut")) == frame_bytes(Path("whole"))


def test_the_view_may_style_a_surface_that_is_not_made_yet(dust: Path, cli: Cli) -> None:
    style = "view.parts={dust: {kind: hidden}, dust_surface: {kind: mesh}}"
    assert cli("run", dust, style, "--frames", 2, *QUICK).exit_code == 0
    wrong = cli("run", dust, "view.parts={dust_surfaces: {kind: mesh}}", "--out", "wrong", *QUICK)
    assert wrong.exit_code == 2
    assert "there are dust, dust_surface" in wrong.stderr


def test_without_the_package_a_run_does_not_begin(
    dust: Path, cli: Cli, monkeypatch: pytest.MonkeyPatch
) -> None:
    cli("run", dust, "output.surfaces={}", "--out", "bare", *QUICK)
    known = importlib.util.find_spec
    monkeypatch.setattr(
        importlib.util,
        "find_spec",
        lambda name, *more: None if name == "pysplashsurf" else known(name, *more),
    )
    for arguments in (("run", dust, *QUICK), ("surface", "bare", RADIUS, "--of", "dust")):
        result = cli(*arguments)
        assert result.exit_code == 2
        assert result.stderr == (
            "tianim: surfaces of particles need a package that is not installed: "
            "pip install 'tianim[surface]'\n"
        )
    assert not Path("out").exists()


def test_what_cannot_be_made_is_a_line(dust: Path, cli: Cli) -> None:
    assert cli("run", dust, "output.surfaces={}", "--out", "bare", *QUICK).exit_code == 0
    before = frame_bytes(Path("bare"))
    for arguments, complaint in [
        (("surface", "bare"), "no part tells the spacing of its particles: choose one with --of"),
        (("surface", "bare", "--of", "dust"), "give their radius [m]"),
        (("surface", "bare", "--of", "dast", RADIUS), "no part is called 'dast'; there are dust"),
        (("surface", "bare", "--of", "dust", "cube_sise=1"), "did you mean 'cube_size'?"),
        (("surface", "bare", "--of", " , "), "must name parts"),
        (("surface", "nowhere"), "nowhere: not the folder of a run"),
        (("foam", "bare"), "no part tells the spacing"),
        (("foam", "bare", "--of", "dust"), "part 'dust' does not tell the spacing"),
        (("foam", "bare", "--of", "dust", "speed=[2,1]"), "the first must not exceed the second"),
        (("foam", "nowhere"), "nowhere: not the folder of a run"),
        (("run", dust, "output.surfaces.dust_surface.of=dast"), "no part is called 'dast'; there are dust"),
    ]:
        result = cli(*arguments)
        assert result.exit_code == 2, arguments
        assert complaint in result.stderr
        assert result.stderr.count("\n") == 1
    assert frame_bytes(Path("bare")) == before


def test_a_part_of_the_scene_is_not_replaced(dust: Path, cli: Cli) -> None:
    dust.write_text(SCENE + "bodies: {dust_surface: {kind: plane}, dust_foam: {kind: plane}}\n")
    assert cli("run", dust, *QUICK).exit_code == 0
    for command in (("surface", "out/dust", RADIUS), ("foam", "out/dust")):
        result = cli(*command, "--of", "dust")
        assert result.exit_code == 2
        assert "which is not replaced" in result.stderr


def test_a_phase_or_a_surface_of_the_scene_is_not_replaced(
    tmp_path: Path, cli: Cli, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Liquids called foam and surface, and a surface called foam, are what the passes would write over."""
    monkeypatch.chdir(tmp_path)
    phases = "    phases: {foam: {density: 900}, surface: {density: 800}}\n"
    Path("water.yaml").write_text(WATER + phases + "output: {surfaces: {water_surface_foam: {of: water}}}\n")
    assert cli("run", "water.yaml", "--frames", "2", *QUICK).exit_code == 0
    before = frame_bytes(Path("out/water"))
    for command, part in (("surface", "water"), ("foam", "water"), ("foam", "water_surface")):
        result = cli(command, "out/water", "--of", part)
        assert result.exit_code == 2
        assert f"the scene has a '{part}_{command}' already, which is not replaced" in result.stderr
    assert frame_bytes(Path("out/water")) == before


@pytest.fixture
def water(tmp_path: Path, cli: Cli, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A run of a fluid."""
    monkeypatch.chdir(tmp_path)
    Path("water.yaml").write_text(WATER)
    assert cli("run", "water.yaml", "--format", "npz", *QUICK).exit_code == 0
    return Path("out/water")


def test_foam_and_surface_of_a_fluid(water: Path, cli: Cli) -> None:
    before = frame_bytes(water)
    more = ("speed=[0.5,2]", "trapped_air=[0.1,0.5]")
    result = cli("foam", water, *more)
    assert result.exit_code == 0
    assert "out/water/frames/water_foam.csv" in result.stdout
    table = rows(water / "frames" / "water_foam.csv")
    made = [int(row["made"]) for row in table]
    assert made[0] == 0
    assert made[-1] > 0
    assert cli("surface", water, "--quiet").exit_code == 0  # knows the spacing
    frames = Run.open(water).frames()
    assert isinstance(frames, RunFrames)
    assert frames.parts == ("water", "water_foam", "water_surface")
    last = frames[len(frames) - 1]
    foam = last.part("water_foam")
    assert len(foam.position) == sum(int(table[-1][kind]) for kind in ("spray", "foam", "bubbles"))
    # The tank keeps it in.
    assert (foam.position >= 0.0).all()
    assert (foam.position <= np.array([1.0, 1.0, 0.3], np.float32)).all()
    after = frame_bytes(water)
    assert {name: after[name] for name in before} == before
    assert {"water_foam_0015.npz", "water_surface_0015.npz", "water_foam.pvd"} <= after.keys()

    # What is refused costs nothing that was there.
    for wrong, complaint in [
        (("foam", water, "--format", "stl"), "format 'stl' holds triangles only"),
        (("foam", water, "--of", "water,oil"), "no part is called 'oil'; there are water"),
        (("foam", water, "--of", "oil"), "no part is called 'oil'; there are water"),
    ]:
        result = cli(*wrong)
        assert (result.exit_code, result.stderr.count("\n")) == (2, 1), wrong
        assert complaint in result.stderr
    assert frame_bytes(water) == after

    copied = shutil.copytree(water, "copy")
    assert cli("foam", copied, *more, "--quiet").exit_code == 0
    assert frame_bytes(Path(copied)) == after
    assert cli("export", copied, "--format", "ply", "--quiet").exit_code == 0
    assert "water_foam_0015.ply" in frame_bytes(Path(copied))
