"""metrics.csv: one row a frame with every diagnostic, the time a step took, and the substeps.

Rows are appended as frames are made. A resumed run drops the rows after its checkpoint, and a
row torn by a kill, before it goes on.
"""

import csv
import os
from contextlib import suppress
from pathlib import Path
from types import TracebackType

from typing_extensions import Self

from tianim.errors import OutputError
from tianim.frame import Frame

FIRST_COLUMNS = ("frame", "time", "substeps", "step_seconds")
WHOLE = ("frame", "substeps")


def read(path: Path) -> list[dict[str, float]]:
    """The whole rows of a metrics file, each by column name; [] where there is no file.

    OutputError where it is no such file, or damaged before its last row.
    """
    if not path.is_file():
        return []
    try:
        lines = path.read_text(encoding="utf-8").split("\n")[:-1]  # what has no line end is torn
        table = csv.DictReader(lines)
        if lines and not {*FIRST_COLUMNS} <= {*(table.fieldnames or ())}:
            raise ValueError("other columns")
        return [
            {key: int(value) if key in WHOLE else float(value) for key, value in row.items()} for row in table
        ]
    except (OSError, ValueError, TypeError, csv.Error) as error:
        raise OutputError(f"{path}: damaged, or no table of metrics; remove it to go on without") from error


class Metrics:
    """Appends a row a frame to `path`; keeps the rows up to frame `kept` (-1: starts anew).

    A context manager. Raises OutputError where it cannot write.
    """

    def __init__(self, path: Path, kept: int = -1) -> None:
        self._path = path
        self._columns: list[str] = []
        rows = [row for row in read(path) if row["frame"] <= kept]
        beside = path.with_name(f".{path.name}.tmp")
        try:
            self._file = beside.open("w", encoding="utf-8", newline="")
            try:
                for row in rows:
                    self._append(row)
                self._file.flush()
                os.replace(beside, path)
            except BaseException:
                with suppress(OSError):
                    beside.unlink()
                with suppress(OSError):
                    self._file.close()
                raise
        except OSError as error:
            raise self._failed(error) from error

    def write(self, frame: Frame, step_seconds: float) -> None:
        """Append the row of `frame`; `step_seconds` is the wall time that its step took."""
        row = {"frame": frame.index, "time": frame.time, "step_seconds": step_seconds, **frame.diagnostics}
        try:
            self._append(row)
            self._file.flush()
        except OSError as error:
            raise self._failed(error) from error

    def sync(self) -> None:
        """Bring all rows to the disk: a checkpoint counts on them."""
        try:
            os.fsync(self._file.fileno())
        except OSError as error:
            raise self._failed(error) from error

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        try:
            self._file.close()
        except OSError as failure:
            if error is None:
                raise self._failed(failure) from failure

    def _append(self, row: dict[str, float]) -> None:
        if not self._columns:
            self._columns = [*FIRST_COLUMNS, *(key for key in row if key not in FIRST_COLUMNS)]
            csv.writer(self._file, lineterminator="\n").writerow(self._columns)
        if row.keys() != set(self._columns):
            raise ValueError(f"a system must report the same diagnostics in each frame: {sorted(row)}")
        values = (f"{row[key]:.0f}" if key in WHOLE else repr(float(row[key])) for key in self._columns)
        csv.writer(self._file, lineterminator="\n").writerow(values)

    def _failed(self, error: OSError) -> OutputError:
        return OutputError(f"cannot write {self._path}: {error.strerror or error}")
