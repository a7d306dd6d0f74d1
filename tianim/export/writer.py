"""Writing that does not hold the simulation up: a process of its own, fed through shared memory.

A thread would not do: kernel launches hold Python's interpreter lock. Large frames are handed to
a spawned process, which sees their arrays in shared memory and writes them while the simulation
goes on; with two under way the simulation waits, so memory stays bounded. Small frames are written
at once where they are: a process takes 0.3 s to start.

Surfaces of particles are made there too, by workers of its own (`workers`): more frames may then be
under way, as many more as there are workers.

An error comes back as OutputError at the next `write`, `wait` or at the end.
"""

import mmap
import subprocess
from collections import deque
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from itertools import count
from multiprocessing.connection import Connection, wait
from multiprocessing.reduction import recv_handle, send_handle
from pathlib import Path

from tianim.buffers import Buffer
from tianim.errors import TianimError
from tianim.export import surfaces
from tianim.export.exporters import Exporters, Plan, plan_output
from tianim.export.options import OutputOptions
from tianim.export.parts import byte_count
from tianim.export.processes import ended, error_of, failure_of, own_link, send, start
from tianim.export.shared import Parcel, map_memory, pack, unpack
from tianim.export.workers import SurfaceWorkers
from tianim.frame import Frame

# Frames of this many bytes go to the process: below, writing takes 2 ms.
LARGE_FRAME = 4 << 20
# Text formats take about so many times the time of binary ones.
TEXT_COST = 100
# Frames under way: one is written while the next waits for it.
SLOTS = 2
# Seconds that the process may take to end, once it has nothing to do.
PATIENCE = 60.0


class FrameWriter:
    """Writes the frames of a run, each once and in order; made by `open_exporters`."""

    def __init__(self, plan: Plan) -> None:
        self._plan = plan
        self._local = Exporters(plan)
        self._remote: _Remote | None = None
        self._begun = self._ended = False
        is_text = any(one.is_text for one in plan.tables)
        self._large = LARGE_FRAME // TEXT_COST if is_text else LARGE_FRAME
        if plan.options.surfaces:
            self._large = 0

    def write(self, frame: Frame) -> None:
        """Write `frame`, or hand it over to be written; arrays handed over become read-only.

        Raises FormatError where a format cannot hold it, OutputError where it or one before
        it could not be written.
        """
        frame = self._plan.select(frame)
        if not self._begun:
            self._plan.check_start(frame)
            self._begun = True
        if self._remote is None and sum(map(byte_count, frame.parts)) >= self._large:
            self._local.release()
            self._remote = _Remote(replace(self._plan, resume_from=frame.index))
        if self._remote:
            self._remote.write(frame)
        else:
            self._local.write(frame)

    def wait(self) -> None:
        """Wait until every frame given is in its file and in the indexes (a checkpoint may say so then)."""
        if self._remote:
            self._remote.wait()

    def close(self) -> None:
        """Wait for the frames, then write the formats that have one file for the whole run."""
        if self._ended:
            return
        if self._remote:
            self._remote.finish()
        else:
            self._local.finish()
        self.abandon()

    def abandon(self) -> None:
        """End without the files of the whole run: frames that were given are still written."""
        self._ended = True
        if self._remote:
            self._remote.stop()
        self._local.release()


@contextmanager
def open_exporters(
    folder: Path,
    formats: Sequence[str],
    options: OutputOptions,
    fps: float,
    resume_from: int = 0,
    workers: int = 1,
) -> Iterator[FrameWriter]:
    """Write a run's frames into `folder`: the VTU record always, `formats` and the options' beside it.

    `resume_from` is the index of the first frame that will be written; what `folder` has from
    it on is removed. `workers` processes make the options' surfaces. The formats with one file for a
    whole run are written when the block ends well and has not called `abandon`.

    Raises FormatError, MissingPartError or OutputError before the first frame.
    """
    if options.surfaces:
        surfaces.require()
    plan = plan_output(folder, (*options.formats, *formats), options, fps, resume_from)
    writer = FrameWriter(replace(plan, workers=workers))
    try:
        yield writer
        writer.close()
    except BaseException:
        writer.abandon()
        raise


@dataclass(frozen=True)
class _Order:
    """What the process is to write: a skeleton and the numbers of its buffers.

    `fresh` are the buffers that it has not seen, whose descriptors follow; `gone` it may forget.
    """

    skeleton: Frame
    buffers: list[int]
    fresh: list[int]
    gone: list[int]


class _Remote:
    """The writer process, seen from the simulation."""

    def __init__(self, plan: Plan) -> None:
        self._process, self._link = start(f"{__name__}:serve")
        self._slots = SLOTS + (plan.workers if plan.options.surfaces else 0)
        self._under_way: deque[Parcel] = deque()
        # The buffers that the process has mapped; to map one anew costs as much as to write it.
        self._mapped: dict[Buffer, int] = {}
        self._numbers = count()
        self._failure: TianimError | None = None
        self._send(plan)

    def write(self, frame: Frame) -> None:
        while self._link.poll() or len(self._under_way) >= self._slots:
            self._receive()
        parcel = pack(frame)
        gone = [self._mapped.pop(buffer) for buffer in list(self._mapped) if buffer.closed]
        fresh = [buffer for buffer in parcel.buffers if buffer not in self._mapped]
        self._mapped |= zip(fresh, self._numbers, strict=False)
        order = _Order(
            parcel.skeleton,
            [self._mapped[buffer] for buffer in parcel.buffers],
            [self._mapped[buffer] for buffer in fresh],
            gone,
        )
        self._send(order)
        with self._lost_link():
            for buffer in fresh:
                send_handle(self._link, buffer.descriptor, self._process.pid)
        self._under_way.append(parcel)

    def wait(self) -> None:
        while self._under_way:
            self._receive()
        self._raise_failure()

    def finish(self) -> None:
        self.wait()
        self._send(None)
        try:
            self._receive()
        except KeyboardInterrupt:
            # Files of a whole run take long and are made again from the record.
            self._process.kill()
            raise

    def stop(self) -> None:
        try:
            with suppress(TianimError):
                self.wait()
            self._link.close()
            self._process.wait(PATIENCE)
        except BaseException as error:
            self._process.kill()
            self._process.wait()
            if not isinstance(error, subprocess.TimeoutExpired):
                raise

    def _send(self, message: object) -> None:
        self._raise_failure()
        with self._lost_link():
            send(self._link, message)

    @contextmanager
    def _lost_link(self) -> Iterator[None]:
        """Where the process is gone, raise what it said last, or that it is gone."""
        try:
            yield
        except OSError:
            while True:
                self._receive()

    def _receive(self) -> None:
        self._raise_failure()
        try:
            written, failure = self._link.recv()
        except (EOFError, OSError) as error:
            self._failure = ended(self._process, "writes frames")
            raise self._failure from error
        if failure:
            self._failure = error_of(failure)
        elif written:
            self._under_way.popleft()
        self._raise_failure()

    def _raise_failure(self) -> None:
        if self._failure:
            raise self._failure


def serve() -> None:
    """The writer process: takes frames from the link until it closes or one cannot be written."""
    with own_link() as link:
        try:
            _serve_frames(link)
        except (EOFError, ConnectionError):
            raise
        except Exception as error:
            send(link, (False, failure_of(error, "writing")))


def _serve_frames(link: Connection) -> None:
    plan: Plan = link.recv()
    exporters = Exporters(plan)
    mapped: dict[int, mmap.mmap] = {}
    waiting: deque[Frame] = deque()
    with SurfaceWorkers(plan.workers) as workers:
        while True:
            ready = wait([*workers.links, *([] if workers.is_full else [link])])
            if link not in ready:
                made = workers.take()
                exporters.write_with(waiting.popleft(), made)
                send(link, (True, None))
                continue
            order: _Order | None = link.recv()
            if order is None:  # by now nothing is under way
                exporters.finish()
                send(link, (False, None))
                continue
            frame = _taken(order, link, mapped)
            if plan.options.surfaces:
                workers.give(surfaces.tasks(frame, plan.options.surfaces))
                waiting.append(frame)
            else:
                exporters.write(frame)
                send(link, (True, None))


def _taken(order: _Order, link: Connection, mapped: dict[int, mmap.mmap]) -> Frame:
    """The frame of an order; `mapped` is the memory that this process sees, by number."""
    for number in order.gone:
        del mapped[number]
    for number in order.fresh:
        mapped[number] = map_memory(recv_handle(link))
    return unpack(order.skeleton, [mapped[number] for number in order.buffers])
