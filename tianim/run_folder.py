"""The folder of a run: its record (run.json), who may write to it, and reading it back.

    out/<scene>/
      run.json       resolved scene, versions, machine, command, state: running | done | failed | stopped
      frames/        every frame as VTU, other formats beside it
      metrics.csv    a row a frame
      checkpoints/   the last two

A folder that holds a run is not overwritten unless asked.
"""

import contextlib
import fcntl
import json
import os
import signal
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from pydantic import ValidationError

from tianim import info
from tianim.errors import SceneError
from tianim.export import surfaces
from tianim.export.files import write_text
from tianim.export.formats import format_named
from tianim.export.record import RunFrames
from tianim.frame import Frame
from tianim.params import Params
from tianim.scene.errors import problems_of, scene_error
from tianim.scene.loading import Document
from tianim.scene.overrides import apply

if TYPE_CHECKING:
    from tianim.scene import Scene

P = TypeVar("P", bound=Params)

RECORD_VERSION = 1
# What every record has, beside what is only for people.
RECORD_KEYS = ("scene", "fps", "state", "frame_count", "frames_done", "seconds", "arch", "versions")
# What a run writes, and --overwrite removes.
OUTPUTS = (
    "run.json",
    "frames",
    "metrics.csv",
    "checkpoints",
    "preview.mp4",
    "preview.webp",
    "preview.png",
    "contact_sheet.png",
    "metrics.png",
)
# Parts of a scene that do not change its motion or its files: a run may be resumed with others.
NOT_MOTION = ("title", "description", "duration", "view", "checkpoint")


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
                raise SceneError(
                    f"{path}: record version {record['tianim_run']!r}; this reads {RECORD_VERSION}"
                )
            needed = {key: record[key] for key in RECORD_KEYS}
            if not (isinstance(needed["scene"], dict) and isinstance(needed["versions"], dict)):
                raise TypeError("scene and versions must be mappings")
        except (OSError, ValueError, KeyError, TypeError) as error:
            raise SceneError(f"{path}: not readable as the record of a run") from error
        return cls(folder, record)

    @property
    def frames_folder(self) -> Path:
        """Folder of the frames."""
        return self.folder / "frames"

    @property
    def checkpoints(self) -> Path:
        """Folder of the saved states."""
        return self.folder / "checkpoints"

    @property
    def metrics(self) -> Path:
        """The table of diagnostics."""
        return self.folder / "metrics.csv"

    @property
    def state(self) -> str:
        """`running`, `done`, `failed` or `stopped`; a run that was killed still says `running`."""
        return str(self.record["state"])

    @property
    def exit_code(self) -> int:
        """Exit code of a process that ends because the run is over: 130 after Ctrl-C, as shells have it."""
        return 128 + signal.Signals[self.record["stopped_by"]] if self.state == "stopped" else 0

    def frames(self) -> Sequence[Frame]:
        """The frames there are, each read when asked for. OutputError where there is none."""
        return RunFrames(self.folder)

    def save(self, **changes: Any) -> None:
        """Change the record and write it whole. OutputError where that fails."""
        self.record |= changes
        write_text(self.folder / "run.json", json.dumps(self.record, indent=1) + "\n")


def section(model: type[P], data: Mapping[str, Any], overrides: Sequence[str]) -> P:
    """A section of a recorded scene as its model, with `key=value` overrides. Raises SceneError."""
    changed, texts = apply(data, overrides, model)
    try:
        return model.model_validate(changed)
    except ValidationError as error:
        raise scene_error(problems_of(error, changed, model), Document(changed), texts) from None


def claim(folder: Path, scene: "Scene", options: RunOptions) -> None:
    """Refuse (SceneError) a folder that must not or cannot be written; touches nothing."""
    if options.resume and options.overwrite:
        raise SceneError("--resume goes on with a run and --overwrite replaces it: give one of them")
    must_be_writable(folder)
    for name in scene.output.formats:
        format_named(name).load()
    if scene.output.surfaces:
        surfaces.require()
    if options.overwrite:
        return
    there = [name for name in OUTPUTS if (folder / name).exists()]
    if not there:
        return
    if "run.json" not in there:
        raise SceneError(f"{folder}: holds {there[0]} but no run.json: choose another --out, or --overwrite")
    run = Run.open(folder)
    difference = _difference(_motion(run.record["scene"]), _motion(resolved(scene)))
    if difference:
        raise SceneError(
            f"{folder}: holds a run of another scene or with other settings ({difference}): "
            "choose another --out, or --overwrite"
        )
    if not options.resume:
        done = f"{run.record['frames_done']} of {run.record['frame_count']} frames"
        what = "a finished run" if run.state == "done" else f"an unfinished run ({run.state}, {done})"
        wish = "" if run.state == "done" else "--resume goes on, "
        raise SceneError(f"{folder}: holds {what} of this scene: {wish}--overwrite makes it anew")
    _must_go_on_alike(run, options)


@contextlib.contextmanager
def alone(folder: Path) -> Iterator[None]:
    """Hold the folder, so that no second run writes to it; the system lets go when the process ends."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        descriptor = os.open(folder, os.O_RDONLY)
    except OSError as error:
        raise SceneError(f"--out {folder}: cannot be made: {error.strerror or error}") from None
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


def must_be_writable(folder: Path) -> None:
    """SceneError where `folder` is not a folder or cannot be made or written; makes nothing."""
    try:
        existing = next(path for path in (folder, *folder.absolute().parents) if path.exists())
    except (OSError, ValueError) as error:  # too long, or not to be looked into
        raise SceneError(f"--out {str(folder)[:60]!r}: cannot be used: {error}") from None
    if not existing.is_dir():
        raise SceneError(f"--out {folder}: {existing} is a file, not a folder")
    if not os.access(existing, os.W_OK | os.X_OK):
        raise SceneError(f"--out {folder}: {existing} is not writable")


def _must_go_on_alike(run: Run, options: RunOptions) -> None:
    """SceneError where the run was made by another compiler or back end: its frames would differ."""
    was = (run.record["arch"], run.record["versions"]["compiler"].split()[0])
    now = (options.arch, info.versions()["compiler"].split()[0])
    if was != now:
        raise SceneError(f"{run.folder}: was run on {', '.join(was)}, and cannot go on on {', '.join(now)}")


def resolved(scene: "Scene") -> dict[str, Any]:
    """The scene with all defaults, as plain data."""
    return scene.model_dump(mode="json")


def _difference(before: Any, now: Any, key: str = "") -> str:
    """The first place where two scenes differ, in words; empty where they are the same."""
    if not (isinstance(before, Mapping) and isinstance(now, Mapping)):
        return "" if before == now else f"{key} was {str(before)[:40]}, is {str(now)[:40]}"
    found = (
        _difference(before.get(name), now.get(name), f"{key}.{name}".lstrip("."))
        for name in dict.fromkeys((*before, *now))
    )
    return next(filter(None, found), "")


def _motion(scene: Mapping[str, Any]) -> dict[str, Any]:
    return {key: value for key, value in scene.items() if key not in NOT_MOTION}
