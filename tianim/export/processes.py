"""Processes beside the simulation: started afresh, fed through a link, gone when their starter is.

A process is started afresh (no fork, no import of the user's script), never loads the compiler,
ignores Ctrl-C, and ends when its starter does: the other end of its link closes then.
"""

import os
import pickle
import signal
import subprocess
import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from multiprocessing import Pipe
from multiprocessing.connection import Connection

from tianim import errors
from tianim.errors import OutputError, TianimError

# What a process sends where it failed: the class of its error and the message.
Failure = tuple[str, str]


def start(
    function: str, more: Mapping[str, str] | None = None
) -> tuple["subprocess.Popen[bytes]", Connection]:
    """Start a process that calls `function` ("module:name"), which gets its end by `own_link()`; give both.

    `more` are variables of its environment.
    """
    module, name = function.split(":")
    ours, theirs = Pipe()
    process = subprocess.Popen(
        [sys.executable, "-c", f"from {module} import {name}; {name}()", str(theirs.fileno())],
        pass_fds=(theirs.fileno(),),
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        env={
            **os.environ,
            "PYTHONPATH": os.pathsep.join(path or os.getcwd() for path in sys.path),
            "PYTHONSAFEPATH": "1",
            **(more or {}),
        },
        # Out of reach of the terminal's Ctrl-C, which this process handles.
        start_new_session=True,
    )
    theirs.close()
    return process, ours


@contextmanager
def own_link() -> Iterator[Connection]:
    """The link of this process to the one that started it; its end is the end of the block."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    with Connection(int(sys.argv[1])) as link, suppress(EOFError, ConnectionError):
        yield link


def send(link: Connection, message: object) -> None:
    """What `link.send` does, with bytes: its view of a buffer raises once more when a send has failed."""
    link.send_bytes(pickle.dumps(message))


def failure_of(error: Exception, what: str) -> Failure:
    """An error as it is sent; one that is not ours becomes an OutputError that `what` failed."""
    if isinstance(error, TianimError):
        return type(error).__name__, str(error)
    return "OutputError", f"{what} failed: {type(error).__name__}: {error}"


def error_of(failure: Failure) -> TianimError:
    """The error that was sent."""
    kind, text = failure
    return getattr(errors, kind)(text)


def ended(process: "subprocess.Popen[bytes]", what: str) -> OutputError:
    """The error that a process that should be there has ended."""
    with suppress(subprocess.TimeoutExpired):
        process.wait(1.0)
    return OutputError(f"the process that {what} ended (exit code {process.returncode}); was memory short?")
