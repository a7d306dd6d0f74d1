"""Writing that does not hold the simulation up: a process of its own, fed through shared memory.

A thread would not do: kernel launches hold Python's interpreter lock. Large frames are handed to
a spawned process, which sees their arrays in shared memory and writes them while the simulation
goes on; with two under way the simulation waits, so memory stays bounded. Small frames are written
at once where they are: a process takes 0.3 s to start.

The process is started afresh (no fork, no import of the user's script), never loads the
compiler, ignores Ctrl-C, and ends when this one does: its end of the link closes then.
An error comes back as OutputError at the next `write`, `wait` or at the end.
"""

import mmap
import os
import pickle
import signal
import subprocess
import sys
from collections import deque
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from itertools import count
from multiprocessing import Pipe
from multiprocessing.connection import Connection
from multiprocessing.reduction import recv_handle, send_handle
from pathlib import Path

from tianim import errors
from tianim.buffers import Buffer
from tianim.errors import OutputError, TianimError
from tianim.export.exporters import Exporters, Plan, plan_output
from tianim.export.options import OutputOptions
from tianim.export.parts import byte_count
from tianim.export.shared import Parcel, map_memory, pack, unpack
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

    def write(self, frame: Frame) -> None:
        """Write `frame`, or hand it over to be written; arrays handed over become read-only.

        Raises FormatError where a format cannot hold it, OutputError where it or one before
        it could not be written.
        """
        frame = self._plan.select(frame)
        if not self._begun:
            self._plan.check_parts(part.name for part in frame.parts)
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
    folder: Path, formats: Sequence[str], options: OutputOptions, fps: float, resume_from: int = 0
) -> Iterator[FrameWriter]:
    """Write a run's frames into `folder`: the VTU record always, `formats` and the options' beside it.

    `resume_from` is the index of the first frame that will be written; what `folder` has from
    it on is removed. The formats with one file for a whole run are written when the block ends
    well and has not called `abandon`.

    Raises FormatError, MissingPartError or OutputError before the first frame.
    """
    writer = FrameWriter(plan_output(folder, (*options.formats, *formats), options, fps, resume_from))
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
        self._link, theirs = Pipe()
        self._process = subprocess.Popen(
            [sys.executable, "-c", "from tianim.export.writer import serve; serve()", str(theirs.fileno())],
            pass_fds=(theirs.fileno(),),
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            env={
                **os.environ,
                "PYTHONPATH": os.pathsep.join(path or os.getcwd() for path in sys.path),
                "PYTHONSAFEPATH": "1",
            },
            # Out of reach of the terminal's Ctrl-C, which this process handles.
            start_new_session=True,
        )
        theirs.close()
        self._under_way: deque[Parcel] = deque()
        # The buffers that the process has mapped; to map one anew costs as much as to write it.
        self._mapped: dict[Buffer, int] = {}
        self._numbers = count()
        self._failure: TianimError | None = None
        self._send(plan)

    def write(self, frame: Frame) -> None:
        while self._link.poll() or len(self._under_way) >= SLOTS:
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
            _send(self._link, message)

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
            with suppress(subprocess.TimeoutExpired):
                self._process.wait(1.0)
            code = self._process.returncode
            self._failure = OutputError(
                f"the process that writes frames ended (exit code {code}); was memory short?"
            )
            raise self._failure from error
        if failure:
            kind, text = failure
            self._failure = getattr(errors, kind)(text)
        elif written:
            self._under_way.popleft()
        self._raise_failure()

    def _raise_failure(self) -> None:
        if self._failure:
            raise self._failure


def _send(link: Connection, message: object) -> None:
    """What `link.send` does, with bytes: its view of a buffer raises once more when a send has failed."""
    link.send_bytes(pickle.dumps(message))


def serve() -> None:
    """The writer process: takes frames from the link until it closes or one cannot be written."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    with Connection(int(sys.argv[1])) as link, suppress(EOFError, ConnectionError):
        try:
            _serve_frames(link)
        except (EOFError, ConnectionError):
            raise
        except TianimError as error:
            _send(link, (False, (type(error).__name__, str(error))))
        except Exception as error:
            _send(link, (False, ("OutputError", f"writing failed: {type(error).__name__}: {error}")))


def _serve_frames(link: Connection) -> None:
    exporters = Exporters(link.recv())
    mapped: dict[int, mmap.mmap] = {}
    while True:
        order: _Order | None = link.recv()
        if order is None:
            exporters.finish()
        else:
            for number in order.gone:
                del mapped[number]
            for number in order.fresh:
                mapped[number] = map_memory(recv_handle(link))
            exporters.write(unpack(order.skeleton, [mapped[number] for number in order.buffers]))
        _send(link, (order is not None, None))
