"""`<name>.csv` beside a part's frames: a row of numbers a frame, rewritten whole after every frame.

A killed run's table is right up to its last frame, and a resumed run makes the same bytes.
"""

import csv
import io
from collections.abc import Mapping
from pathlib import Path

from tianim.errors import OutputError
from tianim.export.files import os_errors, write_text

FIRST_COLUMNS = ("frame", "time")


class Table:
    """The rows of one table by frame index; `rows` hold numbers by column, `time` [s] among them."""

    def __init__(self, folder: Path, name: str) -> None:
        self.path = folder / f"{name}.csv"
        self.rows: dict[int, dict[str, float]] = {}

    def load(self, end: int) -> None:
        """Take the rows of frames below `end` from the file, where it is there. OutputError where damaged."""
        if not self.path.is_file():
            return
        try:
            with self.path.open(encoding="utf-8", newline="") as file:
                rows = [{name: _value(text) for name, text in row.items()} for row in csv.DictReader(file)]
            self.rows = {int(row.pop("frame")): row for row in rows if row["frame"] < end}
        except (OSError, ValueError, TypeError, KeyError, AttributeError) as error:
            raise OutputError(f"{self.path}: damaged; remove it to go on without its rows") from error

    def remove(self) -> None:
        """Remove the file, where it is there."""
        with os_errors(self.path):
            self.path.unlink(missing_ok=True)
        self.rows = {}

    def add(self, index: int, time: float, row: Mapping[str, float]) -> None:
        """Put in the row of a frame, after those before it, and rewrite the file."""
        self.rows[index] = {"time": time, **row}
        text = io.StringIO()
        writer = csv.writer(text, lineterminator="\n")
        writer.writerow((*FIRST_COLUMNS, *row))
        for frame, values in self.rows.items():
            writer.writerow((frame, *(_number(value) for value in values.values())))
        write_text(self.path, text.getvalue())


def _number(value: float) -> str:
    return str(value) if isinstance(value, int) else repr(float(value))


def _value(text: str) -> float:
    return int(text) if text.isdigit() else float(text)
