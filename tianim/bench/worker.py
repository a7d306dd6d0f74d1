"""One measurement in a process of its own: peak memory is its alone, and a crash ends only it.

The two talk in lines of JSON. The process is told the task, builds it, answers {"n", "dim",
"threads", "compiler"}; each line "round" is answered by {variant: Round}, "end" by
{"peak_memory_mb", "bytes_per_item"}. An error of tianim is answered by {"error": message}.
"""

import json
import os
import resource
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import asdict
from pathlib import Path
from typing import Any, cast

from tianim.bench.cases import Task, find_case
from tianim.bench.lines import Round
from tianim.errors import TianimError


class Worker:
    """The measuring process, seen from outside. `about` is what it first answers."""

    def __init__(self, process: "subprocess.Popen[str]", task: Task) -> None:
        self._process = process
        self.about = self._ask(json.dumps(asdict(task)))

    def round(self) -> dict[str, Round]:
        """Measure once more: a Round for each variant."""
        return {name: Round(**values) for name, values in self._ask("round").items()}

    def end(self) -> dict[str, float | None]:
        """Peak memory and bytes an item; the process ends."""
        return self._ask("end")

    def _ask(self, request: str) -> dict[str, Any]:
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        try:
            self._process.stdin.write(request + "\n")
            self._process.stdin.flush()
            answer = self._process.stdout.readline()
        except BrokenPipeError:
            answer = ""
        if not answer:
            raise TianimError(f"the measuring process ended with status {self._process.wait()}")
        values = cast("dict[str, Any]", json.loads(answer))
        if "error" in values:
            raise TianimError(values["error"])
        return values


@contextmanager
def worker(task: Task) -> Iterator[Worker]:
    """A process that measures `task`; it is ended with the block. Raises TianimError where it fails."""
    process = subprocess.Popen(
        [sys.executable, "-c", "from tianim.bench.worker import serve; serve()"],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
        env={**os.environ, "PYTHONPATH": os.pathsep.join(path or os.getcwd() for path in sys.path)},
    )
    try:
        yield Worker(process, task)
    finally:
        process.kill()
        process.communicate()


def serve() -> None:
    """The process: answer until told to end."""
    # Nothing else may get into the answers: what prints goes to standard error.
    answers = os.fdopen(os.dup(1), "w", buffering=1)
    os.dup2(2, 1)
    try:
        _answer_all(lambda values: print(json.dumps(values), file=answers))
    except TianimError as error:
        answers.write(json.dumps({"error": str(error)}) + "\n")


def _answer_all(answer: Callable[[dict[str, Any]], None]) -> None:
    task = Task(**json.loads(sys.stdin.readline()))
    measurement = find_case(task.case).measurement(task)
    from tianim import runtime

    started = runtime.current()
    answer(
        {"n": measurement.n, "dim": measurement.dim, "threads": started.threads, "compiler": started.compiler}
    )
    for request in sys.stdin:
        if request.strip() == "round":
            answer({name: asdict(one) for name, one in measurement.round().items()})
        else:
            answer({"peak_memory_mb": _peak_memory_mb(), "bytes_per_item": measurement.bytes_per_item()})
            return


def _peak_memory_mb() -> float:
    """Of this process alone: on Linux getrusage counts the parent's memory at the fork, too."""
    status = Path("/proc/self/status")
    if status.exists():
        (line,) = (line for line in status.read_text().splitlines() if line.startswith("VmHWM"))
        return int(line.split()[1]) * 1024 / 1e6
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak / 1e6 if sys.platform == "darwin" else peak * 1024 / 1e6
