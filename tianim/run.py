"""A run: a simulation whose frames, metrics and checkpoints go to a folder, and can be resumed.

    out/<scene>/
      run.json       resolved scene, versions, machine, command, state: running | done | failed | stopped
      frames/        every frame as VTU, other formats beside it
      metrics.csv    a row a frame
      checkpoints/   the last two

A frame counts once a checkpoint at or after it stands; a resumed run makes the later ones again,
byte for byte. A folder that holds a run is not overwritten unless asked.
"""

import contextlib
import fcntl
import json
import os
import shutil
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from datetime import datetime, timezone
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

from tianim import checkpoint, info
from tianim.errors import OutputError, SceneError, TianimError
from tianim.export import open_exporters
from tianim.interrupts import Interrupts
from tianim.metrics import Metrics

if TYPE_CHECKING:
    from tianim.scene import Scene
    from tianim.simulation import Simulation

RECORD_VERSION = 1
# What a run writes, and --overwrite removes.
OUTPUTS = (
    "run.json", "frames", "metrics.csv", "checkpoints", "preview.mp4", "preview.png", "contact_sheet.png", "metrics.png",
)  # fmt: skip
# Parts of a scene that do not change its motion or its files: a run may be resumed with others.
NOT_MOTION = ("title", "description", "duration", "view", "checkpoint")


class Progress(Protocol):
    """What is told while a run goes on."""

    def start(self, first: int, frame_count: int) -> None:
        """Frames `first` to `frame_count` - 1 will be made."""

    def frame(self, index: int) -> None:
        """Frame `index` is made."""

    def stopping(self) -> None:
        """Asked to stop: the frame in hand is being finished."""


@dataclass(frozen=True)
class RunOptions:
    """How a scene is run; nothing here changes the motion.

    frame_count  frames to make, the start included; None: the scene's
    resume       go on from the last checkpoint, where there is one
    overwrite    replace a run that the folder holds
    arch, threads, command, scene_file   for the record
    """

    frame_count: int | None = None
    resume: bool = False
    overwrite: bool = False
    arch: str = "cpu"
    threads: int = 1
    command: tuple[str, ...] = ()
    scene_file: str = ""


@dataclass
class Run:
    """A run folder and its record (run.json)."""

    folder: Path
    record: dict[str, Any] = field(default_factory=dict)

    @classmethod
    def open(cls, folder: Path) -> "Run":
        """The run that `folder` holds. SceneError where it holds none."""
        path = folder / "run.json"
        if not path.is_file():
            raise SceneError(f"{folder}: not the folder of a run (it has no run.json)")
        try:
            record = json.loads(path.read_text(encoding="utf-8"))
            if record["tianim_run"] != RECORD_VERSION:
                raise SceneError(f"{path}: record version {record['tianim_run']!r}; this reads {RECORD_VERSION}")
        except (OSError, ValueError, KeyError, TypeError) as error:
            raise SceneError(f"{path}: not readable as the record of a run") from error
        return cls(folder, record)

    @property
    def frames_folder(self) -> Path:
        return self.folder / "frames"

    @property
    def checkpoints(self) -> Path:
        return self.folder / "checkpoints"

    @property
    def metrics(self) -> Path:
        return self.folder / "metrics.csv"

    @property
    def state(self) -> str:
        return str(self.record["state"])

    def save(self, **changes: Any) -> None:
        """Change the record and write it whole. OutputError where that fails."""
        self.record |= changes
        path, beside = self.folder / "run.json", self.folder / ".run.json.tmp"
        try:
            beside.write_text(json.dumps(self.record, indent=1) + "\n", encoding="utf-8")
            os.replace(beside, path)
        except OSError as error:
            with contextlib.suppress(OSError):
                beside.unlink(missing_ok=True)
            raise OutputError(f"cannot write {path}: {error.strerror or error}") from error


def claim(folder: Path, scene: "Scene", options: RunOptions) -> None:
    """Refuse (SceneError) a folder that must not or cannot be written; touches nothing."""
    _must_be_writable(folder)
    if options.overwrite:
        return
    there = [name for name in OUTPUTS if (folder / name).exists()]
    if not there:
        return
    if "run.json" not in there:
        raise SceneError(f"{folder}: holds {there[0]}, not made by a run: choose another --out, or --overwrite")
    run = Run.open(folder)
    if _motion(run.record["scene"]) != _motion(_resolved(scene)):
        was = run.record.get("scene_file") or "another scene"
        raise SceneError(
            f"{folder}: holds a run of {was} with other settings ({_first_difference(run, scene)}): "
            "choose another --out, or --overwrite"
        )
    if not options.resume:
        done = f"{run.record['frames_done']} of {run.record['frame_count']} frames"
        what = "a finished run" if run.state == "done" else f"an unfinished run ({run.state}, {done})"
        wish = "--overwrite makes it again" if run.state == "done" else "--resume goes on, --overwrite starts anew"
        raise SceneError(f"{folder}: holds {what} of this scene: {wish}")
    _must_go_on_alike(run, options)


def simulate(folder: Path, scene: "Scene", simulation: "Simulation", options: RunOptions, progress: Progress) -> Run:
    """Run `simulation`, built from `scene`, into `folder`; give the run, `done` or `stopped`.

    Raises BlowupError, OutputError and SceneError; the record then says `failed` and why, and
    the last checkpoints stay for --resume.
    """
    claim(folder, scene, options)
    with _alone(folder):
        run = _begin(folder, scene, simulation, options)
        with _recorded(run):
            _make_frames(run, scene, simulation, progress)
    return run


def _begin(folder: Path, scene: "Scene", simulation: "Simulation", options: RunOptions) -> Run:
    """Restore the last checkpoint of a run to be resumed, or clear the folder; then say `running`."""
    if options.frame_count is not None:
        simulation.frame_count = options.frame_count
    before = Run.open(folder) if options.resume and (folder / "run.json").is_file() else None
    last = checkpoint.newest(before.checkpoints) if before is not None else None
    if before is not None and last is not None:
        simulation.restore(last[1])
        run = before
    else:
        run = Run(folder)
        # In this order, so that a kill in between leaves nothing that a later --resume would believe.
        shutil.rmtree(run.checkpoints, ignore_errors=True)
        run.save(**_first_record(scene))
        for name in OUTPUTS[1:]:
            _remove(folder / name)
    run.save(
        state="running",
        message="",
        frame_count=simulation.frame_count,
        frames_done=simulation.index + 1 if last is not None else 0,
        started=_now(),
        command=list(options.command),
        scene_file=options.scene_file,
        arch=options.arch,
        threads=options.threads,
        versions=info.versions(),
        machine=info.machine(),
    )
    return run


def _make_frames(run: Run, scene: "Scene", simulation: "Simulation", progress: Progress) -> None:
    kept = int(run.record["frames_done"]) - 1
    with (
        Interrupts(progress.stopping) as interrupts,
        open_exporters(run.frames_folder, scene.output.formats, scene.output, scene.fps) as exporters,
        Metrics(run.metrics, kept) as metrics,
    ):
        progress.start(kept + 1, simulation.frame_count)
        for frame in simulation.frames():
            exporters.write(frame)
            metrics.write(frame, simulation.step_seconds)
            progress.frame(frame.index)
            last = frame.index + 1 == simulation.frame_count
            if last or interrupts.pending or (frame.index + 1) % scene.checkpoint.every == 0:
                exporters.wait()
                metrics.sync()
                checkpoint.save(run.checkpoints, frame.index, simulation.state())
                run.save(frames_done=frame.index + 1)
            if interrupts.pending and not last:
                run.save(state="stopped", message=f"stopped by {interrupts.pending.name}")
                return
    run.save(state="done")


@contextlib.contextmanager
def _recorded(run: Run) -> Iterator[None]:
    """Keep the time taken; record why the run ended where it failed."""
    started, before = time.perf_counter(), float(run.record["seconds"])
    try:
        yield
    except BaseException as error:
        seconds = before + time.perf_counter() - started
        stopped = isinstance(error, KeyboardInterrupt)
        message = str(error) if isinstance(error, TianimError) else f"{type(error).__name__} {error}".strip()
        _save_on_a_full_disk(run, state="stopped" if stopped else "failed", message=message, seconds=seconds)
        raise
    run.save(seconds=before + time.perf_counter() - started, ended=_now())


def _save_on_a_full_disk(run: Run, **changes: Any) -> None:
    """Save the record, making room with the older checkpoint; the error at hand matters more than this one."""
    try:
        run.save(**changes)
    except OutputError:
        checkpoint.drop_oldest(run.checkpoints)
        with contextlib.suppress(OutputError):
            run.save(**changes)


@contextlib.contextmanager
def _alone(folder: Path) -> Iterator[None]:
    """Hold the folder, so that no second run writes to it; the system lets go when the process ends."""
    folder.mkdir(parents=True, exist_ok=True)
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise SceneError(f"{folder}: another run is writing there now") from None
        except OSError:
            pass  # a file system without locks
        yield
    finally:
        os.close(descriptor)


def _must_be_writable(folder: Path) -> None:
    """SceneError where `folder` is not a folder or cannot be made or written; makes nothing."""
    existing = next(path for path in (folder, *folder.absolute().parents) if path.exists())
    if not existing.is_dir():
        raise SceneError(f"--out {folder}: {existing} is a file, not a folder")
    if not os.access(existing, os.W_OK | os.X_OK):
        raise SceneError(f"--out {folder}: {existing} is not writable")


def _must_go_on_alike(run: Run, options: RunOptions) -> None:
    """SceneError where the run was made by another compiler or back end: its frames would differ."""
    was = (run.record["arch"], run.record["versions"]["compiler"].split()[0])
    now = (options.arch, info.versions()["compiler"].split()[0])
    if was != now:
        raise SceneError(
            f"{run.folder}: was run with {' on '.join(reversed(was))}, and cannot go on with {' on '.join(reversed(now))}"
        )


def _first_record(scene: "Scene") -> dict[str, Any]:
    return {
        "tianim_run": RECORD_VERSION,
        "scene": _resolved(scene),
        "seed": scene.seed,
        "fps": scene.fps,
        "frame_count": 0,
        "frames_done": 0,
        "state": "running",
        "seconds": 0.0,
    }


def _resolved(scene: "Scene") -> dict[str, Any]:
    """The scene with all defaults, as plain data."""
    return scene.model_dump(mode="json")


def _motion(scene: Mapping[str, Any]) -> dict[str, Any]:
    return {key: value for key, value in scene.items() if key not in NOT_MOTION}


def _now() -> str:
    return datetime.now(timezone.utc).isoformat(timespec="seconds")


def _remove(path: Path) -> None:
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path)
    else:
        path.unlink(missing_ok=True)
