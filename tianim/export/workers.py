"""Processes that make surfaces, a frame and a thread each: the same bytes however many there are."""

import os
import subprocess
from collections import deque
from collections.abc import Iterable, Iterator
from contextlib import suppress
from itertools import islice
from multiprocessing.connection import Connection
from types import TracebackType

from typing_extensions import Self

from tianim.export.processes import ended, error_of, failure_of, own_link, send, start
from tianim.export.surfaces import THREADS_VARIABLE, Surface, SurfaceTask, make_surface

Job = tuple[SurfaceTask, ...]
# Of the system's 20: the simulation, or whatever the user does meanwhile, goes first.
NICENESS = 5
PATIENCE = 10.0  # seconds that an idle process may take to end


class SurfaceWorkers:
    """Takes the surfaces of one frame after the other and gives them back in the same order.

    A context manager. At most `count` frames are under way, each in a process of its own, which is
    started when it first has something to do.
    """

    def __init__(self, count: int) -> None:
        self._count = count
        self._idle: list[tuple[subprocess.Popen[bytes], Connection]] = []
        self._busy: deque[tuple[subprocess.Popen[bytes], Connection]] = deque()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        busy = [*self._busy]
        for process, link in (*busy, *self._idle):
            link.close()
            if (process, link) in busy:
                process.kill()
            with suppress(subprocess.TimeoutExpired):
                process.wait(PATIENCE)

    @property
    def is_full(self) -> bool:
        """Whether the oldest must be taken before another can be given."""
        return len(self._busy) >= self._count

    @property
    def links(self) -> list[Connection]:
        """What to wait on for the oldest; nothing where none is under way."""
        return [link for _, link in islice(self._busy, 1)]

    def give(self, job: Job) -> None:
        """Have the surfaces of a frame made; there must be room."""
        process, link = self._idle.pop() if self._idle else self._start()
        self._busy.append((process, link))
        try:
            send(link, job)
        except OSError as error:
            raise ended(process, "makes surfaces") from error

    def take(self) -> list[Surface]:
        """The surfaces of the oldest frame, when they are made; raises what made it fail."""
        process, link = self._busy[0]
        try:
            made, failure = link.recv()
        except (EOFError, OSError) as error:
            raise ended(process, "makes surfaces") from error
        self._idle.append(self._busy.popleft())
        if failure:
            raise error_of(failure)
        return made

    def run(self, jobs: Iterable[Job]) -> Iterator[list[Surface]]:
        """The surfaces of each frame, in order."""
        for job in jobs:
            if self.is_full:
                yield self.take()
            self.give(job)
        while self._busy:
            yield self.take()

    def _start(self) -> tuple["subprocess.Popen[bytes]", Connection]:
        return start(f"{__name__}:serve", {THREADS_VARIABLE: "1"})


def serve() -> None:
    """A worker: makes surfaces until its link closes."""
    os.nice(NICENESS)
    with own_link() as link:
        while True:
            job: Job = link.recv()
            try:
                answer: tuple[list[Surface], object] = ([make_surface(task) for task in job], None)
            except Exception as error:
                answer = [], failure_of(error, "making a surface")
            send(link, answer)
