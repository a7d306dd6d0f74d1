"""A run: a simulation whose frames, metrics and checkpoints go to a folder, and can be resumed.

A frame counts once a checkpoint at or after it stands; a resumed run makes the later ones again,
byte for byte.
"""

import contextlib
import shutil
import time
from collections.abc import Iterator
from datetime import datetime, timezone
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

from tianim import checkpoint, info
from tianim.errors import OutputError, TianimError
from tianim.export import open_exporters
from tianim.export.exporters import Plan
from tianim.interrupts import Interrupts
from tianim.metrics import Metrics
from tianim.run_folder import OUTPUTS, RECORD_VERSION, Run, RunOptions, alone, claim, resolved

if TYPE_CHECKING:
    from tianim.scene import Scene
    from tianim.simulation import Simulation

# Threads of the simulation for each process that makes surfaces, each with one thread: so many that they
# keep up with it, so few that it keeps most of the cores.
THREADS_A_WORKER = 4


class Progress(Protocol):
    """What is told while a run goes on."""

    def start(self, first: int, frame_count: int) -> None:
        """Frames `first` to `frame_count` - 1 will be made."""

    def frame(self, index: int) -> None:
        """Frame `index` is made."""

    def stopping(self) -> None:
        """Asked to stop: the frame in hand is being finished."""


def simulate(
    folder: Path, scene: "Scene", simulation: "Simulation", options: RunOptions, progress: Progress
) -> Run:
    """Run `simulation`, built from `scene`, into `folder`; give the run, `done` or `stopped`.

    Raises BlowupError, OutputError and SceneError; the record then says `failed` and why, and
    the last checkpoints stay for --resume.
    """
    # Before anything of an earlier run goes: is there what is to be written, and can the formats hold it?
    plan = Plan(folder, scene.output.formats, scene.output, scene.fps)
    plan.check_start(simulation.frame())
    with alone(folder):
        claim(folder, scene, options)
        run = _begin(folder, scene, simulation, options)
        with _recorded(run):
            _make_frames(run, scene, simulation, surface_workers(options.threads), progress)
    return run


def _begin(folder: Path, scene: "Scene", simulation: "Simulation", options: RunOptions) -> Run:
    """Restore the last checkpoint of a run to be resumed, or clear the folder; then say `running`."""
    if options.frame_count is not None:
        simulation.frame_count = options.frame_count
    before = Run.open(folder) if options.resume and (folder / "run.json").is_file() else None
    last = checkpoint.newest(before.checkpoints) if before is not None else None
    if before is not None and last is not None:
        simulation.restore(last[1])
        for torn in (
            path
            for place in (folder, before.checkpoints, before.frames_folder)
            for path in place.glob(".*.tmp")
        ):
            _remove(torn)
        before.save(
            scene=resolved(scene),
            frames_done=simulation.index + 1,
            **_start(simulation.frame_count, options),
        )
        return before
    run = Run(folder)
    # In this order, so that a kill in between leaves nothing that a later --resume would believe.
    _remove(run.checkpoints)
    run.save(**_first_record(scene), **_start(simulation.frame_count, options))
    for name in OUTPUTS[1:]:
        _remove(folder / name)
    return run


def surface_workers(threads: int) -> int:
    """Processes for surfaces beside a simulation that has so many threads."""
    return max(1, threads // THREADS_A_WORKER)


def _make_frames(
    run: Run, scene: "Scene", simulation: "Simulation", workers: int, progress: Progress
) -> None:
    kept = int(run.record["frames_done"]) - 1
    with (
        Interrupts(progress.stopping) as interrupts,
        open_exporters(run.frames_folder, (), scene.output, scene.fps, kept + 1, workers) as exporters,
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
                exporters.abandon()  # a resumed run assembles the one-file formats
                run.save(state="stopped", stopped_by=interrupts.pending.name)
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
        _save_on_a_full_disk(run, seconds=seconds, ended=_now(), **_why(error))
        raise
    run.save(seconds=before + time.perf_counter() - started, ended=_now())


def _why(error: BaseException) -> dict[str, str]:
    if isinstance(error, KeyboardInterrupt):
        return {"state": "stopped", "stopped_by": "SIGINT"}
    message = str(error) if isinstance(error, TianimError) else f"{type(error).__name__} {error}".strip()
    return {"state": "failed", "message": message}


def _save_on_a_full_disk(run: Run, **changes: Any) -> None:
    """Save the record, if need be in the room of the older checkpoint; the error at hand matters more."""
    try:
        run.save(**changes)
    except OutputError:
        checkpoint.drop_oldest(run.checkpoints)
        with contextlib.suppress(OutputError):
            run.save(**changes)


def _first_record(scene: "Scene") -> dict[str, Any]:
    return {
        "tianim_run": RECORD_VERSION,
        "scene": resolved(scene),
        "seed": scene.seed,
        "fps": scene.fps,
        "frames_done": 0,
        "seconds": 0.0,
    }


def _start(frame_count: int, options: RunOptions) -> dict[str, Any]:
    """What the record says anew each time the run is started or goes on."""
    return {
        "state": "running",
        "message": "",
        "frame_count": frame_count,
        "started": _now(),
        "command": list(options.command),
        "scene_file": options.scene_file,
        "stopped_by": "",
        "ended": "",
        "arch": options.arch,
        "threads": options.threads,
        "versions": info.versions(),
        "machine": info.machine(),
    }


def _now() -> str:
    return datetime.now(timezone.utc).isoformat(timespec="seconds")


def _remove(path: Path) -> None:
    try:
        if path.is_dir() and not path.is_symlink():
            shutil.rmtree(path)
        else:
            path.unlink(missing_ok=True)
    except OSError as error:
        raise OutputError(f"cannot remove {path}: {error.strerror or error}") from error
