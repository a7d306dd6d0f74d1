"""What the command line shows: results on standard output, progress and errors on standard error.

Rich is imported when something is drawn with it, so that the light commands stay quick.
"""

import errno
import shutil
import sys
import textwrap
from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import typer
from typer.core import TyperGroup

from tianim.errors import TianimError

if TYPE_CHECKING:
    from rich.console import Console
    from rich.progress import Progress, TaskID
    from rich.table import Table

NAME = "tianim"
# Columns of text of a table that goes to a file or a pipe.
FILE_WIDTH = 160
# Between columns of lines that are printed one by one, and how narrow these may become on a terminal.
GAP, NARROWEST = "  ", 6


def say(text: str) -> None:
    """A line of the result."""
    typer.echo(text)


def note(text: str) -> None:
    """A line beside the result: progress, a hint, an error."""
    typer.echo(text, err=True)


def rows(pairs: Iterable[tuple[str, str]], indent: str = "") -> None:
    """Pairs as two aligned columns."""
    pairs = list(pairs)
    width = max((len(name) for name, _ in pairs), default=0)
    for name, text in pairs:
        say(f"{indent}{name:<{width}}  {text}".rstrip())


class Commands(TyperGroup):
    """The group of commands: every error is one or two lines on standard error, never a traceback.

    Errors of tianim end with their own exit code, wrong usage with 2, Ctrl-C with 130. What is
    left is a defect of the program and keeps its traceback.
    """

    def main(self, args: Sequence[str] | None = None, *_: object, **extra: Any) -> None:
        """Run the command of `args` (default: of the process) and end with its exit code."""
        arguments = list(sys.argv[1:] if args is None else args)
        extra |= {"prog_name": NAME, "standalone_mode": False, "obj": arguments}
        sys.exit(self._status(arguments, extra))

    def _status(self, arguments: list[str], extra: dict[str, Any]) -> int:
        try:
            return super().main(arguments, **extra) or 0
        except TianimError as error:
            note(f"{NAME}: {error}")
            return error.exit_code
        except MemoryError:
            note(f"{NAME}: out of memory")
            return 1
        except (KeyboardInterrupt, typer.Abort):
            return 130
        except OSError as error:
            if error.errno not in (errno.ENOSPC, errno.EDQUOT):
                raise
            note(f"{NAME}: the disk is full")
            return 1
        except SystemExit as error:
            return self._left_by_library(error)
        except Exception as error:
            # Wrong usage: typer has it from click or, in newer versions, of its own.
            if not hasattr(error, "format_message"):
                raise
            command = getattr(getattr(error, "ctx", None), "command_path", NAME)
            note(f"{command}: {' '.join(error.format_message().split())} (see {command} --help)")
            return 2

    def _left_by_library(self, error: SystemExit) -> int:
        if isinstance(error.code, int | None):
            if error.code and not isinstance(error.__context__, BrokenPipeError):
                note(f"{NAME}: a library ended the program with status {error.code}")
            return error.code or 0
        note(f"{NAME}: {error.code}")
        return 1


class Bar:
    """A progress bar on standard error with rate and time left; silent where that is no terminal."""

    def __init__(self, title: str, quiet: bool = False) -> None:
        self._title, self._quiet = title, quiet
        self._bar: Progress | None = None
        self._task: TaskID | None = None

    def __enter__(self) -> "Bar":
        return self

    def __exit__(self, *_: object) -> None:
        if self._bar is not None:
            self._bar.stop()

    def start(self, first: int, frame_count: int) -> None:
        """Frames `first` to `frame_count` - 1 will be made."""
        from rich.console import Console
        from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

        console = Console(stderr=True)
        self._bar = Progress(
            TextColumn("{task.description}"),
            BarColumn(),
            MofNCompleteColumn(),
            TextColumn("{task.fields[rate]}"),
            TimeRemainingColumn(),
            console=console,
            disable=self._quiet or not console.is_terminal,
            transient=True,
        )
        self._task = self._bar.add_task(self._title, total=frame_count, completed=first, rate="")
        self._bar.start()

    def frame(self, index: int) -> None:
        """Frame `index` is made."""
        if self._bar is not None and self._task is not None:
            speed = self._bar.tasks[0].speed
            self._bar.update(self._task, completed=index + 1, rate=f"{speed:.3g} frames/s" if speed else "")

    def so_far(self, done: int, total: int) -> None:
        """`done` of `total` frames are made."""
        if self._bar is None:
            self.start(0, total)
        self.frame(done - 1)

    def stopping(self) -> None:
        """Asked to stop: the frame in hand is being finished."""
        if not self._quiet:
            note("stopping after this frame; again to stop at once")


class Lines:
    """A table on standard output whose rows are printed as they come, to a pipe too.

    `columns` are the names and the widest that each may be; they are narrower on a narrow terminal, and
    cells go on below.
    """

    def __init__(self, columns: Mapping[str, int]) -> None:
        self._columns = {name: max(width, len(name)) for name, width in columns.items()}
        self._begun = False
        room = _console().width
        while sum(self._columns.values()) + len(GAP) * (len(columns) - 1) > room:
            widest = max(self._columns, key=lambda name: self._columns[name])
            if self._columns[widest] <= NARROWEST:
                break
            self._columns[widest] -= 1

    def add(self, row: Mapping[str, Any]) -> None:
        """Print a row; the names of the columns above the first."""
        if not self._begun:
            self._begun = True
            self._print(list(self._columns))
            say(GAP.join("-" * width for width in self._columns.values()))
        self._print([cell(row.get(name)) for name in self._columns])

    def _print(self, texts: Sequence[str]) -> None:
        widths = self._columns.values()
        parts = [textwrap.wrap(text, width) or [""] for text, width in zip(texts, widths, strict=True)]
        for k in range(max(map(len, parts))):
            line = [part[k] if k < len(part) else "" for part in parts]
            say(GAP.join(f"{text:<{width}}" for text, width in zip(line, widths, strict=True)).rstrip())


class Now:
    """What is being done, on a line of a terminal's standard error; silent where that is no terminal."""

    def __init__(self) -> None:
        self._shown = False

    def show(self, text: str) -> None:
        """Say it in place of what was said before."""
        if sys.stderr.isatty():
            self._shown = True
            room = shutil.get_terminal_size().columns - 1
            typer.echo(f"\r{text[:room]}\x1b[K", err=True, nl=False)

    def clear(self) -> None:
        """Take it away, before something else is said."""
        if self._shown:
            self._shown = False
            typer.echo("\r\x1b[K", err=True, nl=False)


def show_table(title: str, table_rows: Sequence[Mapping[str, Any]], only_fitting: bool = False) -> None:
    """Print a table with the columns of all rows, wrapped, or only as many as fit into the terminal."""
    console = _console()
    names = list(dict.fromkeys(name for row in table_rows for name in row))
    if only_fitting:
        names = _fitting(names, table_rows, console.width)
    table = _table(title, names)
    for row in table_rows:
        _add(table, row, names)
    console.print(table)


def _fitting(names: Sequence[str], table_rows: Sequence[Mapping[str, Any]], room: int) -> list[str]:
    shown: list[str] = []
    width = 1
    for name in names:
        width += 3 + max(len(cell(value)) for value in (name, *(row.get(name) for row in table_rows)))
        if width <= room or not shown:
            shown.append(name)
    return shown


def cell(value: Any) -> str:
    """A value as text for a cell of a table."""
    if value is None:
        return ""
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, Mapping):
        return ", ".join(f"{name} {cell(item)}" for name, item in value.items())
    if isinstance(value, list):
        return ", ".join(map(cell, value))
    return f"{value:.4g}" if isinstance(value, float) else str(value)


def _console() -> "Console":
    from rich.console import Console

    console = Console()
    return console if console.is_terminal else Console(width=FILE_WIDTH)


def _table(title: str, names: Sequence[str]) -> "Table":
    from rich.table import Table

    table = Table(title=title, title_justify="left")
    for name in names:
        table.add_column(name, overflow="fold")
    return table


def _add(table: "Table", row: Mapping[str, Any], names: Sequence[str]) -> None:
    from rich.text import Text

    # As Text: a list in brackets is no markup.
    table.add_row(*(Text(cell(row.get(name))) for name in names))
