"""`tianim run`: what it writes, what it refuses to overwrite, how it resumes, how it fails."""

import errno
import json
import os
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any, cast

import pytest
from command import FRAMES, Cli, Start, frame_bytes

from tianim import checkpoint, metrics
from tianim import run as run_module
from tianim.errors import SceneError
from tianim.run import simulate
from tianim.run_folder import Run, RunOptions
from tianim.scene import build, load_scene

QUICK = ("--no-preview",)


def record(folder: Path) -> dict[str, Any]:
    return cast(dict[str, Any], json.loads((folder / "run.json").read_text()))


def test_a_run_writes_frames_metrics_checkpoints_and_a_record(scene: Path, cli: Cli) -> None:
    result = cli("run", scene, *QUICK)
    assert result.exit_code == 0
    assert "out/dust/frames" in result.stdout
    assert "out/dust/metrics.csv" in result.stdout
    folder = Path("out/dust")
    assert sorted(path.name for path in folder.iterdir()) == [
        "checkpoints",
        "frames",
        "metrics.csv",
        "run.json",
    ]
    names = {f"dust_{index:04d}.vtu" for index in range(FRAMES)}
    assert frame_bytes(folder).keys() == names | {"dust.pvd", "dust.vtu.series"}
    assert [row["frame"] for row in metrics.read(folder / "metrics.csv")] == list(range(FRAMES))
    assert [path.name for path in sorted((folder / "checkpoints").iterdir())] == [
        "frame_0005.npz",
        "frame_0006.npz",
    ]
    assert [frame.index for frame in Run.open(folder).frames()] == list(range(FRAMES))


def test_the_record_says_what_was_run(scene: Path, cli: Cli) -> None:
    cli("run", scene, "dust.count=5", "--threads", 2, *QUICK)
    said = record(Path("out/dust"))
    expected = {
        "state": "done",
        "seed": 3,
        "fps": 24.0,
        "frame_count": FRAMES,
        "frames_done": FRAMES,
        "arch": "cpu",
        "threads": 2,
        "command": ["tianim", "run", str(scene), "dust.count=5", "--threads", "2", "--no-preview"],
    }
    assert {key: said[key] for key in expected} == expected
    assert said["scene"]["systems"]["dust"]["count"] == 5
    assert said["scene"]["systems"]["dust"]["noise"] == 1.0  # a default
    assert {"tianim", "python", "compiler", "numpy"} <= said["versions"].keys()
    assert {"processor", "cores"} <= said["machine"].keys()
    assert said["seconds"] > 0


def test_frames_and_out_and_quiet(scene: Path, cli: Cli) -> None:
    result = cli("run", scene, "--frames", 3, "--out", "elsewhere", "--quiet", *QUICK)
    assert (result.exit_code, result.output) == (0, "")
    assert len(Run.open(Path("elsewhere")).frames()) == 3
    assert not Path("out").exists()


def test_other_formats_go_beside(scene: Path, cli: Cli) -> None:
    assert cli("run", scene, "--format", "vtu,npz", *QUICK).exit_code == 0
    assert {f"dust_{index:04d}.npz" for index in range(FRAMES)} < frame_bytes(Path("out/dust")).keys()


def files(folder: Path) -> dict[str, tuple[int, bytes]]:
    return {
        str(path.relative_to(folder)): (path.stat().st_mtime_ns, path.read_bytes())
        for path in folder.rglob("*")
        if path.is_file()
    }


@pytest.mark.parametrize(
    ("arguments", "complaint"),
    [
        ((), "holds a finished run of this scene: --overwrite makes it anew"),
        (("dust.count=21",), "other settings (systems.dust.count was 20, is 21)"),
        (("seed=4", "--resume"), "other settings (seed was 3, is 4)"),
        (("--format", "npz", "--resume"), "output.formats"),
        (("--resume", "--overwrite"), "give one of them"),
        (("--overwrite", "dust.count=-1"), "dust.count"),
        (("--overwrite", "--format", "docx"), "docx"),
        (("--overwrite", "--format", "obj"), "format 'obj' holds triangles only; part 'dust' is points"),
        (("--overwrite", "output.parts=[smoke]"), "no part is called 'smoke'; there are dust"),
        (("--overwrite", "output.fields=[heat]"), "no part has 'heat'"),
        (("--overwrite", "--format", ","), "must name formats"),
        (("--overwrite", "--frames", "0"), "--frames"),
        (("--overwrite", "--threads", "0"), "--threads"),
        (("--overwrite", "--arch", "abacus"), "--arch"),
    ],
)
def test_a_run_is_not_overwritten_by_mistake(
    scene: Path, cli: Cli, arguments: tuple[str, ...], complaint: str
) -> None:
    cli("run", scene, *QUICK)
    before = files(Path("out/dust"))
    result = cli("run", scene, *arguments, *QUICK)
    assert result.exit_code == 2
    assert complaint in result.stderr
    assert result.stderr.count("\n") <= 2
    assert files(Path("out/dust")) == before


def test_overwrite_removes_what_the_run_before_made_and_nothing_else(scene: Path, cli: Cli) -> None:
    cli("run", scene, *QUICK)
    Path("out/dust/notes.txt").write_text("mine")
    assert cli("run", scene, "seed=4", "--frames", 2, "--overwrite", *QUICK).exit_code == 0
    assert len(Run.open(Path("out/dust")).frames()) == 2
    assert sorted(path.name for path in Path("out/dust/checkpoints").iterdir()) == ["frame_0001.npz"]
    assert "dust_0006.vtu" not in frame_bytes(Path("out/dust"))
    assert Path("out/dust/notes.txt").read_text() == "mine"


def test_a_folder_with_other_peoples_frames_is_refused(scene: Path, cli: Cli) -> None:
    Path("mine/frames").mkdir(parents=True)
    result = cli("run", scene, "--out", "mine", *QUICK)
    assert result.exit_code == 2
    assert "mine: holds frames but no run.json" in result.stderr
    assert not any(Path("mine/frames").iterdir())


@pytest.mark.parametrize("out", ["dust.yaml", "dust.yaml/run", "/proc/tianim", "a\0b", "x" * 5000])
def test_an_output_that_cannot_be_a_folder_is_refused(scene: Path, cli: Cli, out: str) -> None:
    before = scene.read_text()
    result = cli("run", scene, "--out", out, *QUICK)
    assert result.exit_code == 2
    assert "--out" in result.stderr
    assert result.stderr.count("\n") == 1
    assert scene.read_text() == before


@pytest.mark.parametrize("text", ["{", "[]", '{"tianim_run": 99}'])
def test_a_record_that_cannot_be_read_is_refused(scene: Path, cli: Cli, text: str) -> None:
    Path("out/dust").mkdir(parents=True)
    Path("out/dust/run.json").write_text(text)
    result = cli("run", scene, *QUICK)
    assert result.exit_code == 2
    assert "run.json" in result.stderr


@pytest.mark.parametrize("key", ["scene", "state", "frames_done", "frame_count", "versions", "arch"])
@pytest.mark.parametrize("arguments", [("run", "dust.yaml", "--resume"), ("render", "out/dust")])
def test_a_record_that_lacks_something_is_refused(
    scene: Path, cli: Cli, key: str, arguments: tuple[str, ...]
) -> None:
    Path("out/dust").mkdir(parents=True)
    whole: dict[str, Any] = {"tianim_run": 1, "fps": 24.0, "state": "done", "seconds": 1.0, "arch": "cpu"}
    whole |= {"frame_count": 3, "frames_done": 3, "scene": {}, "versions": {}}
    for wrong in ({name: value for name, value in whole.items() if name != key}, {**whole, "scene": 3}):
        Path("out/dust/run.json").write_text(json.dumps(wrong))
        result = cli(*arguments)
        assert result.exit_code == 2
        assert result.stderr == "tianim: out/dust/run.json: not readable as the record of a run\n"


class Killed(BaseException):
    """Stands for the end of the process."""


@pytest.mark.parametrize("name", ["checkpoints", "frames", "metrics.csv"])
def test_a_kill_while_the_folder_is_cleared_can_be_resumed(
    scene: Path, cli: Cli, monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    cli("run", scene, "--out", "straight", "seed=4", *QUICK)
    cli("run", scene, *QUICK)
    remove = run_module._remove

    def kill(path: Path) -> None:
        if path.name == name:
            raise Killed
        remove(path)

    with monkeypatch.context() as patched:
        patched.setattr(run_module, "_remove", kill)
        with pytest.raises(Killed):
            cli("run", scene, "seed=4", "--overwrite", *QUICK)
    resumed = cli("run", scene, "seed=4", "--resume", *QUICK)
    if name == "checkpoints":  # the earlier run is there still, whole
        assert "other settings (seed was 3, is 4)" in resumed.stderr
    else:
        assert resumed.exit_code == 0
        assert frame_bytes(Path("out/dust")) == frame_bytes(Path("straight"))


def test_resume_after_the_end_does_nothing_and_longer_goes_on(scene: Path, cli: Cli) -> None:
    cli("run", scene, "--out", "straight", *QUICK)
    cli("run", scene, "--frames", 4, *QUICK)
    before = frame_bytes(Path("out/dust"))
    assert cli("run", scene, "--frames", 4, "--resume", *QUICK).exit_code == 0
    assert frame_bytes(Path("out/dust")) == before
    assert cli("run", scene, "--resume", *QUICK).exit_code == 0
    assert frame_bytes(Path("out/dust")) == frame_bytes(Path("straight"))


@pytest.mark.parametrize("name", ["murmuration", "fish_school", "vicsek", "couzin"])
def test_the_scenes_of_the_project_resume_to_the_same_bytes(
    tmp_path: Path, cli: Cli, monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    monkeypatch.chdir(tmp_path)
    scene = load_scene(name)
    small = [f"{key}.count=300" for key in scene.systems]
    assert cli("run", name, *small, "--frames", 7, "--out", "straight", *QUICK).exit_code == 0
    assert cli("run", name, *small, "--frames", 4, "--out", "resumed", *QUICK).exit_code == 0
    assert cli("run", name, *small, "--frames", 7, "--out", "resumed", "--resume", *QUICK).exit_code == 0
    assert frame_bytes(Path("resumed")) == frame_bytes(Path("straight"))


def test_resume_takes_another_look_and_length(scene: Path, cli: Cli) -> None:
    cli("run", scene, "--frames", 3, *QUICK)
    result = cli("run", scene, "duration=0.5", "view.width=320", "checkpoint.every=9", "--resume", *QUICK)
    assert result.exit_code == 0
    run = Run.open(Path("out/dust"))
    assert (len(run.frames()), run.record["frame_count"], run.record["scene"]["view"]["width"]) == (
        13,
        13,
        320,
    )


def test_the_time_of_all_starts_is_added_up(scene: Path, cli: Cli) -> None:
    cli("run", scene, "--frames", 3, *QUICK)
    Run.open(Path("out/dust")).save(seconds=1000.0)
    cli("run", scene, "--resume", *QUICK)
    assert 1000.0 < record(Path("out/dust"))["seconds"] < 1100.0


class SignalAt:
    """Progress that sends this process Ctrl-C when a frame is made."""

    def __init__(self, index: int) -> None:
        self.index, self.told = index, 0

    def start(self, first: int, frame_count: int) -> None:
        pass

    def frame(self, index: int) -> None:
        if index == self.index:
            signal.raise_signal(signal.SIGINT)

    def stopping(self) -> None:
        self.told += 1


@pytest.mark.parametrize(("index", "state", "done"), [(2, "stopped", 3), (FRAMES - 1, "done", FRAMES)])
def test_a_signal_stops_a_run_that_is_not_over(scene: Path, index: int, state: str, done: int) -> None:
    loaded, progress = load_scene(scene), SignalAt(index)
    run = simulate(Path("out/dust"), loaded, build(loaded), RunOptions(), progress)
    assert (run.state, run.record["frames_done"], progress.told) == (state, done, 1)
    assert Run.open(Path("out/dust")).record == run.record
    assert (Path("out/dust/frames") / "dust.pvd").exists()


def test_from_python_a_run_is_not_overwritten_either(scene: Path, cli: Cli) -> None:
    cli("run", scene, *QUICK)
    before, loaded = files(Path("out/dust")), load_scene(scene)
    with pytest.raises(SceneError, match="holds a finished run of this scene"):
        simulate(Path("out/dust"), loaded, build(loaded), RunOptions(), SignalAt(-1))
    assert files(Path("out/dust")) == before


def test_a_checkpoint_comes_after_its_frames(scene: Path, cli: Cli, monkeypatch: pytest.MonkeyPatch) -> None:
    save = checkpoint.save
    late: list[int] = []

    def look(folder: Path, index: int, state: dict[str, Any]) -> Path:
        late.extend(k for k in range(index + 1) if not Path(f"out/dust/frames/dust_{k:04d}.vtu").exists())
        return save(folder, index, state)

    monkeypatch.setattr(checkpoint, "save", look)
    large = "dust.count=160000"  # written by the writer process
    assert cli("run", scene, large, "checkpoint.every=1", *QUICK).exit_code == 0
    assert late == []


def test_resume_removes_what_a_killed_run_left_half_written(scene: Path, cli: Cli) -> None:
    cli("run", scene, "--frames", 4, *QUICK)
    torn = [Path("out/dust", place, ".x.tmp") for place in ("", "frames", "checkpoints")]
    for path in torn:
        path.touch()
    assert cli("run", scene, "--resume", *QUICK).exit_code == 0
    assert not any(path.exists() for path in torn)


def test_resume_without_a_run_starts_one(scene: Path, cli: Cli) -> None:
    assert cli("run", scene, "--resume", *QUICK).exit_code == 0
    assert record(Path("out/dust"))["state"] == "done"


def test_resume_passes_a_torn_checkpoint_over(scene: Path, cli: Cli) -> None:
    cli("run", scene, "--out", "straight", *QUICK)
    cli("run", scene, "--frames", 4, *QUICK)
    newest = Path("out/dust/checkpoints/frame_0003.npz")
    newest.write_bytes(newest.read_bytes()[:-10])
    assert cli("run", scene, "--resume", *QUICK).exit_code == 0
    assert frame_bytes(Path("out/dust")) == frame_bytes(Path("straight"))


def test_resume_by_another_compiler_is_refused(scene: Path, cli: Cli) -> None:
    cli("run", scene, "--frames", 3, *QUICK)
    run = Run.open(Path("out/dust"))
    run.save(versions={**run.record["versions"], "compiler": "quadrants 1.0"})
    result = cli("run", scene, "--resume", *QUICK)
    assert result.exit_code == 2
    assert "quadrants" in result.stderr


def test_a_blow_up_stops_the_run_and_keeps_the_checkpoint(scene: Path, cli: Cli) -> None:
    result = cli("run", scene, f"dust.blow_up_at={4 / 24}", *QUICK)
    assert result.exit_code == 1
    assert result.stderr == "tianim: dust: particle 19 in frame 5: position is not finite\n"
    said = record(Path("out/dust"))
    assert (said["state"], said["message"]) == (
        "failed",
        "dust: particle 19 in frame 5: position is not finite",
    )
    saved = checkpoint.newest(Path("out/dust/checkpoints"))
    assert saved is not None
    assert saved[0] == 3
    assert len(Run.open(Path("out/dust")).frames()) == 5
    again = cli("run", scene, f"dust.blow_up_at={4 / 24}", *QUICK)
    assert "holds an unfinished run (failed, 4 of 7 frames) of this scene: --resume goes on" in again.stderr


def test_a_full_disk_stops_the_run_and_resume_goes_on(
    scene: Path, cli: Cli, monkeypatch: pytest.MonkeyPatch
) -> None:
    cli("run", scene, "--out", "straight", *QUICK)
    written = os.writev
    calls = iter(range(100))

    def writev(descriptor: int, chunks: object) -> int:
        if next(calls) >= 5:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        return written(descriptor, chunks)  # type: ignore[arg-type]

    with monkeypatch.context() as patched:
        patched.setattr(os, "writev", writev)
        result = cli("run", scene, *QUICK)
    assert result.exit_code == 1
    assert "dust_0005.vtu" in result.stderr
    assert "disk is full" in result.stderr
    assert result.stderr.count("\n") == 1
    assert record(Path("out/dust"))["state"] == "failed"
    assert "dust_0005.vtu" not in frame_bytes(Path("out/dust"))
    assert not list(Path("out/dust").rglob("*.tmp"))
    assert cli("run", scene, "--resume", *QUICK).exit_code == 0
    assert frame_bytes(Path("out/dust")) == frame_bytes(Path("straight"))


# A file system of 1 MB, made without being root where the kernel allows it.
SMALL_DISK = (
    "mount -t tmpfs -o size=1m none small && {command}; echo status $?; df --output=avail small; {after}"
)


def test_a_truly_full_disk(scene: Path) -> None:
    if subprocess.run(["unshare", "-rm", "true"], capture_output=True).returncode:
        pytest.skip("needs user namespaces")
    Path("small").mkdir()
    script = Path(sys.modules["drift"].__file__ or "")
    command = f"{sys.executable} {script} run {scene} dust.count=6000 --out small/dust --no-preview"
    after = "cat small/dust/run.json; ls -A small/dust/checkpoints small/dust/frames"
    done = subprocess.run(
        ["unshare", "-rm", "sh", "-c", SMALL_DISK.format(command=command, after=after)],
        capture_output=True,
        text=True,
        env={**os.environ, "PYTHONPATH": str(script.parents[1])},
    )
    assert "status 1\n" in done.stdout
    assert "disk is full" in done.stderr or "No space left" in done.stderr
    assert "Traceback" not in done.stderr
    assert '"state": "failed"' in done.stdout
    assert ".npz" in done.stdout
    assert ".tmp" not in done.stdout


SLOW = ("dust.seconds=0.01", "duration=1", "checkpoint.every=100")


def test_ctrl_c_finishes_the_frame_and_resume_goes_on(scene: Path, cli: Cli, start: Start) -> None:
    child = start("run", scene, *SLOW, *QUICK)
    wait_for(Path("out/dust/frames/dust_0004.vtu"), child)
    child.send_signal(signal.SIGINT)
    _, said = child.communicate()
    assert child.returncode == 130
    assert "stopped after frame" in said
    assert f"go on with: tianim run {scene} {' '.join((*SLOW, *QUICK))} --resume" in said
    run = Run.open(Path("out/dust"))
    assert (run.state, run.record["stopped_by"]) == ("stopped", "SIGINT")
    assert 5 <= run.record["frames_done"] == len(run.frames()) < 25
    assert "holds an unfinished run (stopped" in cli("run", scene, *SLOW, *QUICK).stderr
    assert cli("run", scene, *SLOW, "--resume", *QUICK).exit_code == 0
    assert cli("run", scene, *SLOW, "dust.seconds=0", "--out", "straight", *QUICK).exit_code == 0
    assert frame_bytes(Path("out/dust")) == frame_bytes(Path("straight"))


def test_a_run_that_is_terminated_saves_a_checkpoint(scene: Path, start: Start) -> None:
    child = start("run", scene, *SLOW, *QUICK)
    wait_for(Path("out/dust/frames/dust_0001.vtu"), child)
    child.terminate()
    child.communicate()
    assert child.returncode == 143
    run = Run.open(Path("out/dust"))
    saved = checkpoint.newest(run.checkpoints)
    assert saved is not None
    assert (run.record["stopped_by"], run.record["frames_done"]) == ("SIGTERM", saved[0] + 1)


def test_two_runs_do_not_write_to_one_folder(scene: Path, cli: Cli, start: Start) -> None:
    child = start("run", scene, *SLOW, *QUICK)
    wait_for(Path("out/dust/frames/dust_0001.vtu"), child)
    result = cli("run", scene, *SLOW, "--resume", *QUICK)
    assert result.exit_code == 2
    assert "another run is writing there" in result.stderr


def wait_for(path: Path, child: "subprocess.Popen[str]") -> None:
    while not path.exists():
        assert child.poll() is None, child.communicate()


PICTURES = {"preview.png", "preview.mp4", "contact_sheet.png", "metrics.png"}
SMALL = ("view.width=128", "view.height=72", "view.samples=1")


def test_pictures_and_film_are_made_and_named(scene: Path, cli: Cli) -> None:
    result = cli("run", scene, *SMALL)
    assert result.exit_code == 0
    folder = Path("out/dust")
    assert {path.name for path in folder.iterdir()} > PICTURES
    for name in PICTURES:
        assert f"out/dust/{name}" in result.stdout
    before = (folder / "preview.png").read_bytes()
    again = cli("render", folder, "background=night", "--out", "night", "--quiet")
    assert (again.exit_code, again.output) == (0, "")
    assert {path.name for path in Path("night").iterdir()} == PICTURES
    assert Path("night/preview.png").read_bytes() != before == (folder / "preview.png").read_bytes()
    wrong = cli("render", folder, "bakground=night")
    assert wrong.exit_code == 2
    assert "did you mean 'background'?" in wrong.stderr
