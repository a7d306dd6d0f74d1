"""The only place that starts the compiler: one start a process, arrays live until it ends.

Taichi allows one `init` a process (a second makes every array of the first invalid), so
`start` refuses a second call with other settings and ignores one with the same.
"""

import contextlib
import io
import os
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from tianim.errors import MissingPartError, SceneError
from tianim.lang import COMPILER, ti

Arch = Literal["cpu", "cuda", "vulkan"]
ARCHES: tuple[Arch, ...] = ("cpu", "cuda", "vulkan")


@dataclass(frozen=True)
class Runtime:
    """What was started: back end, worker threads, compiler."""

    arch: Arch
    threads: int
    compiler: str


_started: Runtime | None = None


def available_cores() -> int:
    """Cores that this process may use (containers often allow fewer than the machine has)."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def current() -> Runtime:
    """The runtime that was started; starts one with the defaults when none was."""
    return _started or start()


def start(arch: Arch = "cpu", threads: int | None = None) -> Runtime:
    """Start the compiler on `arch` with `threads` workers (default: every core this process may use).

    Raises SceneError for an unknown back end, a bad thread count or a second, different start,
    MissingPartError where the back end is not there.
    """
    global _started
    if arch not in ARCHES:
        raise SceneError(f"--arch {arch!r}: must be one of {', '.join(ARCHES)}")
    if threads is not None and not 1 <= threads <= 1024:
        raise SceneError(f"--threads {threads}: must be between 1 and 1024")
    wanted = Runtime(arch, threads or available_cores(), COMPILER)
    if _started is not None:
        if (threads is None and arch == _started.arch) or wanted == _started:
            return _started
        raise SceneError(f"the runtime was started with {_started}; one process cannot start another")
    others = _threads()
    # The compiler prints a line on standard output; `bench --json` must stay pure.
    with contextlib.redirect_stdout(io.StringIO()):
        ti.init(
            arch=getattr(ti, arch),
            cpu_max_num_threads=wanted.threads,
            default_fp=ti.f32,
            log_level=ti.ERROR,
            offline_cache=True,
            offline_cache_file_path=str(_cache_folder()),
        )
    found = ti.lang.impl.current_cfg().arch
    if arch != "cpu" and found != getattr(ti, arch):
        raise MissingPartError(f"--arch {arch}: this machine has no usable {arch} device")
    if arch == "cpu" and wanted.threads == available_cores():
        _spread(sorted(_threads() - others)[-wanted.threads :])  # those that compile were made before
    _started = wanted
    return wanted


def _threads() -> set[int]:
    """Numbers of the threads of this process; none where the system does not tell."""
    folder = Path("/proc/self/task")
    return {int(task.name) for task in folder.iterdir()} if folder.is_dir() else set()


def _spread(workers: list[int]) -> None:
    """Give each worker a core of its own, where there are as many of both.

    Left alone, a scheduler may keep two workers on one core for half a second, each waiting for the other:
    one step of a cloth in ten took 12 ms, not 3. With fewer workers than cores other processes may have the
    rest, and nothing is said about which.
    """
    cores = sorted(os.sched_getaffinity(0)) if hasattr(os, "sched_setaffinity") else []
    if len(workers) == len(cores) > 1:
        for worker, core in zip(workers, cores, strict=True):
            with contextlib.suppress(OSError):  # it may have ended
                os.sched_setaffinity(worker, {core})


def _cache_folder() -> Path:
    """Folder of compiled kernels; a read-only home falls back to the temporary folder."""
    home = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    for folder in (
        home / "tianim" / COMPILER,
        Path(tempfile.gettempdir()) / f"tianim-{os.getuid()}" / COMPILER,
    ):
        with contextlib.suppress(OSError):
            folder.mkdir(parents=True, exist_ok=True)
            with tempfile.TemporaryFile(dir=folder):
                return folder
    return Path(tempfile.mkdtemp(prefix="tianim-"))
