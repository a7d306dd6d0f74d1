"""`tianim sweep`: every combination, each on its own, failures shown, one table."""

import csv
import subprocess
from pathlib import Path

import pytest
from command import Cli

from tianim.errors import SceneError
from tianim.run_folder import Run, alone
from tianim.sweep import Result, Sweep

BOIDS = """\
tianim: 1
fps: 30
duration: 0.1
systems:
  boids: {kind: boids, count: 30}
"""


def sweep(*values: str, folder: Path = Path("out")) -> Sweep:
    return Sweep("scene.yaml", values, folder, threads=1)


def test_combinations_are_all_of_them() -> None:
    assert sweep("a=1,2", "b=x,y").combinations() == [
        {"a": "1", "b": "x"},
        {"a": "1", "b": "y"},
        {"a": "2", "b": "x"},
        {"a": "2", "b": "y"},
    ]


def test_a_comma_in_brackets_is_part_of_a_value() -> None:
    assert [one["a"] for one in sweep("a=[[1,2],[3,4]],{b: 1, c: 2},5").combinations()] == [
        "[[1,2],[3,4]]",
        "{b: 1, c: 2}",
        "5",
    ]


def test_too_many_are_refused() -> None:
    hundred = ",".join(map(str, range(100)))
    with pytest.raises(SceneError, match="more than 10,000 combinations"):
        sweep(f"a={hundred}", f"b={hundred}", "c=1,2").combinations()


def test_a_value_twice_is_refused() -> None:
    with pytest.raises(SceneError, match="sweep 'a=1,2,1': a value is given twice"):
        sweep("a=1,2,1").combinations()


def test_a_folder_that_will_not_do_is_a_line(scene: Path, cli: Cli) -> None:
    result = cli("sweep", scene, "seed=1,2", "--out", "/proc/tianim")
    assert result.exit_code == 2
    assert result.stderr == "tianim: --out /proc/tianim: cannot be made: No such file or directory\n"
    with alone(Path("sweeps")):
        result = cli("sweep", scene, "seed=1,2", "--out", "sweeps")
    assert (result.exit_code, result.stderr) == (2, "tianim: sweeps: another run is writing there now\n")


def test_folders_are_readable_and_apart(tmp_path: Path) -> None:
    names = [Sweep.folder_of(one) for one in sweep("boids.count=1,2", "seed=3").combinations()]
    assert names == ["count=1_seed=3", "count=2_seed=3"]
    assert Sweep.folder_of({"a.x": "1", "b.x": "2"}) == "a.x=1_b.x=2"
    slashes, dashes = (Sweep.folder_of({"file": value}) for value in ("a/b", "a-b"))
    assert slashes != dashes
    assert "/" not in slashes
    assert len(Sweep.folder_of({"a": "x" * 500})) < 100


def test_a_result_is_a_row() -> None:
    good = Result({"a": "1"}, Path("a=1"), 0, "", {"frame": 3.0, "boids.speed": 2.5})
    bad = Result({"a": "2"}, Path("a=2"), 2, "a: must be 1")
    assert good.row() == {"a": "1", "outcome": "done", "frame": 3.0, "boids.speed": 2.5}
    assert (bad.row(), bad.line()) == (
        {"a": "2", "outcome": "failed: a: must be 1"},
        "a=2: failed: a: must be 1",
    )


def test_a_sweep_runs_all_and_shows_what_failed(
    tmp_path: Path, cli: Cli, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("flock.yaml").write_text(BOIDS)
    arguments = ("sweep", "flock.yaml", "boids.count=20,-1,30", "--jobs", 3)
    result = cli(*arguments)
    assert result.exit_code == 1
    folder = Path("out/flock_sweep")
    with (folder / "sweep.csv").open() as file:
        table = list(csv.DictReader(file))
    assert [row["boids.count"] for row in table] == ["20", "-1", "30"]
    assert [row["outcome"][:6] for row in table] == ["done", "failed", "done"]
    assert [row["frame"] for row in table] == ["3", "", "3"]
    assert "must be greater than or equal to 0" in table[1]["outcome"]
    assert "boids.count=-1: failed: " in result.stderr
    assert "out/flock_sweep/sweep.csv" in result.stdout
    # Alike to a run by itself, whatever runs beside it.
    cli("run", "flock.yaml", "--no-preview")
    alone = Run.open(Path("out/flock")).frames()[3].part("boids").position
    beside = Run.open(folder / "count=30").frames()[3].part("boids").position
    assert alone.tobytes() == beside.tobytes()


def test_a_child_that_dies_is_a_failed_row(tmp_path: Path, cli: Cli, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    Path("flock.yaml").write_text(BOIDS)
    monkeypatch.setattr(
        subprocess, "run", lambda command, **_: subprocess.CompletedProcess(command, -9, stdout="", stderr="")
    )
    result = cli("sweep", "flock.yaml", "seed=1,2")
    assert result.exit_code == 1
    assert "seed=2: failed: the process ended with status -9" in result.stderr
