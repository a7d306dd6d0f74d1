"""Indexes of a part's frames with their physical times: `<part>.pvd` and `<part>.vtu.series`.

Both are rewritten whole after every frame, so a killed run's indexes are right up to its last
frame, and a resumed run makes the same bytes: the entries before the frame it resumes at come
from the files themselves.
"""

import json
import re
import shutil
from collections.abc import Iterable
from contextlib import suppress
from pathlib import Path

from tianim.export.files import os_errors, write_text
from tianim.export.vtu import read_stamp

SUFFIX = ".vtu"


def frame_name(part: str, number: int, suffix: str) -> str:
    """Name of a part's file of a frame: four digits or more, as Blender and Houdini look for."""
    return f"{part}_{number:04d}{suffix}"


def frame_files(folder: Path, part: str, suffix: str) -> dict[int, Path]:
    """The part's files that are there, by number, in order."""
    pattern = re.compile(rf"{re.escape(part)}_(\d{{4,}}){re.escape(suffix)}")
    found = ((pattern.fullmatch(path.name), path) for path in folder.iterdir())
    return dict(sorted((int(match[1]), path) for match, path in found if match))


def parts_in(folder: Path) -> list[str]:
    """Names of the parts that have an index in `folder`."""
    return sorted(path.name.removesuffix(".vtu.series") for path in folder.glob("*.vtu.series"))


class Series:
    """The two indexes of one part. `entries` maps file number to (time [s], file name), rising."""

    def __init__(self, folder: Path, part: str) -> None:
        self.folder, self.part = folder, part
        self.entries: dict[int, tuple[float, str]] = {}

    def load(self, end: int) -> None:
        """Take the frames with numbers below `end` from the files that are there."""
        files = frame_files(self.folder, self.part, SUFFIX)
        self.entries = {
            number: (read_stamp(path).time, path.name) for number, path in files.items() if number < end
        }

    def add(self, number: int, time: float) -> None:
        """Put in one frame, after those before it, and rewrite the indexes."""
        self.entries[number] = (time, frame_name(self.part, number, SUFFIX))
        self.save()

    def save(self) -> None:
        """Write both indexes; without frames there are none."""
        pvd, series = self.folder / f"{self.part}.pvd", self.folder / f"{self.part}.vtu.series"
        if not self.entries:
            with os_errors(pvd):
                pvd.unlink(missing_ok=True)
                series.unlink(missing_ok=True)
            return
        lines = (
            f'<DataSet timestep="{time!r}" part="0" file="{name}"/>\n' for time, name in self.entries.values()
        )
        write_text(
            pvd,
            '<?xml version="1.0"?>\n<VTKFile type="Collection" version="1.0" byte_order="LittleEndian">\n'
            f"<Collection>\n{''.join(lines)}</Collection>\n</VTKFile>\n",
        )
        files = ",\n".join(json.dumps({"name": name, "time": time}) for time, name in self.entries.values())
        write_text(series, f'{{"file-series-version": "1.0", "files": [\n{files}\n]}}\n')


def drop_from(folder: Path, number: int, suffixes: Iterable[str]) -> dict[str, Series]:
    """Remove the frames from `number` on of every part that has an index; gives the rest, by part.

    Half-written files of a killed run go too. Other files are left alone: only a part with an
    index is ours.
    """
    for path in folder.glob(".*.tmp"):
        with os_errors(path):
            shutil.rmtree(path) if path.is_dir() else path.unlink()
    left = {}
    for part in parts_in(folder):
        for suffix in suffixes:
            for found, path in frame_files(folder, part, suffix).items():
                if found >= number:
                    with os_errors(path), suppress(FileNotFoundError):
                        path.unlink()
        left[part] = Series(folder, part)
        left[part].load(number)
        left[part].save()
    return left
