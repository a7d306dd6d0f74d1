"""A finished run read back: its frames from the VTU record, one at a time, when asked for."""

import json
import re
from collections.abc import Collection, Sequence
from functools import cached_property
from pathlib import Path
from typing import overload

from tianim.errors import OutputError
from tianim.export.series import parts_in
from tianim.export.vtu import read_stamp, read_vtu
from tianim.frame import Frame


class RunFrames(Sequence[Frame]):
    """The frames that a run wrote, in internal axes; each is read when it is asked for.

    `folder` is the run's, or its `frames` folder. With `parts`, frames have those alone. Diagnostics
    are not kept here (metrics.csv has them). OutputError where there is no record, or a file of it
    is damaged.
    """

    def __init__(self, folder: Path, parts: Collection[str] | None = None) -> None:
        inner = folder / "frames"
        self.folder = inner if inner.is_dir() else folder
        if not self.folder.is_dir():
            raise OutputError(f"{folder}: no such folder")
        self.parts = tuple(name for name in parts_in(self.folder) if parts is None or name in parts)
        self._files: dict[int, list[Path]] = {}
        self._times: dict[int, float] = {}
        for part in self.parts:
            for number, name, time in self._index(part):
                self._files.setdefault(number, []).append(self.folder / name)
                self._times[number] = time
        if not self._files:
            raise OutputError(f"{folder}: no frames of a run in there")
        self._numbers = sorted(self._files)

    def _index(self, part: str) -> list[tuple[int, str, float]]:
        """Number, file name and time [s] of each frame of a part."""
        path = self.folder / f"{part}.vtu.series"
        try:
            entries = json.loads(path.read_text(encoding="utf-8"))["files"]
            return [(_number(entry["name"]), entry["name"], float(entry["time"])) for entry in entries]
        except (OSError, ValueError, KeyError, TypeError) as error:
            raise OutputError(f"{path}: cannot read this index of frames ({error})") from error

    def __len__(self) -> int:
        return len(self._numbers)

    @cached_property
    def times(self) -> tuple[float, ...]:
        """Time [s] of each frame."""
        return tuple(self._times[number] for number in self._numbers)

    @cached_property
    def fps(self) -> float:
        """Frames a second, from the last frame's time; 24 where only frame 0 is there."""
        return round(self.index_of(-1) / self.times[-1], 6) if self.times[-1] > 0.0 else 24.0

    @cached_property
    def _first_number(self) -> int:
        number = self._numbers[0]
        return number - read_stamp(self._files[number][0]).index

    def index_of(self, position: int) -> int:
        """Frame index of the frame at `position` (they differ where a record has gaps)."""
        return self._numbers[position] - self._first_number

    @overload
    def __getitem__(self, position: int) -> Frame: ...
    @overload
    def __getitem__(self, position: slice) -> list[Frame]: ...
    def __getitem__(self, position: int | slice) -> Frame | list[Frame]:
        if isinstance(position, slice):
            return [self[one] for one in range(*position.indices(len(self)))]
        number = self._numbers[position]
        parts = tuple(read_vtu(path) for path in self._files[number])
        return Frame(self.index_of(position), self._times[number], parts)


def _number(name: str) -> int:
    """The number in a file's name; ValueError where it has none."""
    found = re.search(r"_(\d+)\.vtu$", name)
    if not found:
        raise ValueError(f"{name!r} has no frame number")
    return int(found[1])
