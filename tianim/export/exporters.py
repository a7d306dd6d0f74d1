"""Which files a frame becomes: the VTU record with its indexes, and the other formats beside it."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import count
from pathlib import Path
from typing import overload

from tianim.errors import FormatError
from tianim.export import surfaces
from tianim.export.files import FolderLock, make_folder, os_errors, release_files
from tianim.export.formats import FORMATS, Format, RunInfo, Stamp, format_named
from tianim.export.options import OutputOptions
from tianim.export.parts import cell_data_of, check_frame
from tianim.export.record import RunFrames
from tianim.export.series import Series, drop_from, frame_files, frame_name
from tianim.export.surfaces import Surface, with_surfaces
from tianim.export.tables import Table
from tianim.export.vtu import write_part
from tianim.frame import Array, Frame, Part, Points

RECORD = "vtu"
# What a run's folder has beside the frames.
RUN_FILE = "run.json"


@dataclass(frozen=True)
class Plan:
    """What to write where; plain values, so that it can travel to the writer process.

    `formats` are names besides the record; `resume_from` is the index of the first frame that
    will be written: those from it on are removed, those before it stay. `workers` make surfaces.
    """

    folder: Path
    formats: tuple[str, ...]
    options: OutputOptions
    fps: float
    resume_from: int = 0
    record: bool = True
    workers: int = 1

    @property
    def tables(self) -> list[Format]:
        """The formats besides the record."""
        return [format_named(name) for name in self.formats]

    @property
    def run(self) -> RunInfo:
        """What the files of a whole run say of themselves."""
        return RunInfo(self.fps, self.options.axes, self.options.first_number)

    def select(self, frame: Frame) -> Frame:
        """The frame with the data arrays that the options ask for; FormatError where it cannot be written."""
        check_frame(frame)
        frame = _with_fields(frame, self.options)
        for part in self.chosen(frame):
            for format_ in self.tables:
                format_.refuse_others(part)
        return frame

    def check_start(self, frame: Frame) -> None:
        """FormatError where the options name what the first frame does not have, or cannot be written."""
        frame = self.select(frame)
        surfaces.check(frame, self.options.surfaces)
        whole = self.select(surfaces.promise(frame, self.options.surfaces))
        self.check_parts(part.name for part in whole.parts)

    def check_parts(self, names: Iterable[str]) -> None:
        """FormatError where `output.parts` names one that is not among `names`."""
        there = sorted(names)
        for name in self.options.parts if self.options.parts != "all" else ():
            if name not in there:
                raise FormatError(f"output.parts: no part is called {name!r}; there are {', '.join(there)}")

    def chosen(self, frame: Frame) -> tuple[Part, ...]:
        """The parts that go to the formats besides the record."""
        wanted = self.options.parts
        return frame.parts if wanted == "all" else tuple(part for part in frame.parts if part.name in wanted)


def plan_output(
    folder: Path, formats: Iterable[str], options: OutputOptions, fps: float, resume_from: int = 0
) -> Plan:
    """A checked plan of a run's output: the formats are known and installed, the folder can be written.

    Raises FormatError, MissingPartError or OutputError before anything is simulated.
    """
    names = dict.fromkeys(format_named(name).name for name in formats)
    names.pop(RECORD, None)
    for name in names:
        format_named(name).load()
    make_folder(folder)
    return Plan(folder, tuple(names), options, fps, resume_from)


class Exporters:
    """Writes frames here and now, in this process. `plan.select` must have passed each frame."""

    def __init__(self, plan: Plan) -> None:
        self.plan = plan
        self._writers = [(one, one.load()) for one in plan.tables if not one.whole_run]
        self._series: dict[str, Series] = {}
        self._tables: dict[str, Table] = {}
        self._lock = FolderLock(plan.folder) if plan.record else None
        if plan.record:
            suffixes = {".vtu", *(suffix for one, _ in self._writers for suffix in one.suffixes)}
            self._series = drop_from(plan.folder, plan.resume_from + plan.options.first_number, suffixes)

    def write(self, frame: Frame) -> None:
        """Write one frame in every format that has a file a frame: the record and its indexes first."""
        plan = self.plan
        stamp = Stamp(frame.index, frame.time, plan.options.axes)
        number = frame.index + plan.options.first_number
        converted = {part.name: stamp.axes.apply(part) for part in frame.parts}
        if plan.record:
            for name, part in converted.items():
                write_part(plan.folder / frame_name(name, number, ".vtu"), part, stamp)
            for name in converted:
                self._series.setdefault(name, Series(plan.folder, name)).add(number, frame.time)
        for part in plan.chosen(frame):
            for format_, module in self._writers:
                path = plan.folder / frame_name(part.name, number, format_.suffix)
                module.write_part(path, converted[part.name], stamp)

    def write_with(self, frame: Frame, made: Sequence[Surface]) -> None:
        """Write one frame and the surfaces made of it, and their rows."""
        self.write(with_surfaces(frame, made))
        for one in made:
            self.add_row(one.mesh.name, frame, one.row)

    def add_row(self, name: str, frame: Frame, row: Mapping[str, float]) -> None:
        """Put the numbers of `frame` into the table called `name`; those from before are kept."""
        if name not in self._tables:
            self._tables[name] = Table(self.plan.folder, name)
            self._tables[name].load(self.plan.resume_from)
        self._tables[name].add(frame.index, frame.time, row)

    def drop(self, name: str) -> None:
        """Remove all that there is of a part, in every format: it is made anew."""
        folder = self.plan.folder
        for suffix in {suffix for one in FORMATS.values() for suffix in one.suffixes}:
            for path in frame_files(folder, name, suffix).values():
                with os_errors(path):
                    path.unlink()
        Table(folder, name).remove()
        self._series[name] = Series(folder, name)
        self._series[name].save()

    def finish(self) -> None:
        """Write the files of the whole run, from the record."""
        if any(one.whole_run for one in self.plan.tables) and self._series:
            self.assemble(RunFrames(self.plan.folder))

    def release(self) -> None:
        """Let go of the folder: another writer may take it."""
        release_files()
        if self._lock is not None:
            self._lock.close()

    def assemble(self, frames: Sequence[Frame], tell: Callable[[], None] = lambda: None) -> None:
        """Write the files of the whole run from `frames` in internal axes; `tell` is called for each read."""
        converted = _Converted(frames, self.plan, tell)
        for one in self.plan.tables:
            if one.whole_run:
                one.load().assemble(self.plan.folder, converted, self.plan.run)


class _Converted(Sequence[Frame]):
    """Frames of the record as the files of a whole run have them: parts chosen, axes applied."""

    def __init__(self, frames: Sequence[Frame], plan: Plan, tell: Callable[[], None]) -> None:
        self._frames, self._plan, self._tell = frames, plan, tell

    def __len__(self) -> int:
        return len(self._frames)

    @overload
    def __getitem__(self, position: int) -> Frame: ...
    @overload
    def __getitem__(self, position: slice) -> list[Frame]: ...
    def __getitem__(self, position: int | slice) -> Frame | list[Frame]:
        if isinstance(position, slice):
            return [self[one] for one in range(*position.indices(len(self)))]
        frame = self._plan.select(self._frames[position])
        self._tell()
        axes = self._plan.options.axes
        return replace(frame, parts=tuple(axes.apply(part) for part in self._plan.chosen(frame)))


def _with_fields(frame: Frame, options: OutputOptions) -> Frame:
    """The frame with only the data arrays that `options.fields` names; FormatError where no part has one.

    Surfaces keep what they were made with, which their own options say.
    """
    wanted = options.fields
    if wanted == "all":
        return frame
    there = {name for part in frame.parts for name in (*part.data, *cell_data_of(part))}
    there |= {name for one in surfaces.placeholders(options.surfaces) for name in one.data}
    missing = [name for name in wanted if name not in there]
    if missing and any(len(part.position) for part in frame.parts):
        raise FormatError(
            f"output.fields: no part has {missing[0]!r}; there are {', '.join(sorted(there)) or 'none'}"
        )

    def keep(data: Mapping[str, Array]) -> dict[str, Array]:
        return {name: values for name, values in data.items() if name in wanted}

    return replace(
        frame,
        parts=tuple(
            part
            if part.name in options.surfaces
            else replace(part, data=keep(part.data))
            if isinstance(part, Points)
            else replace(part, data=keep(part.data), cell_data=keep(part.cell_data))
            for part in frame.parts
        ),
    )


def export_run(
    run_folder: Path,
    formats: Sequence[str],
    options: OutputOptions | None = None,
    folder: Path | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> Path:
    """Write a finished run's frames in other formats, without simulating; gives the folder they are in.

    `folder` defaults to the run's frames, beside its record. `progress(done, total)` is called
    for each frame read, which some formats do anew.

    Raises OutputError where there is no record, FormatError where a format is not known or
    cannot hold a part.
    """
    frames = RunFrames(run_folder)
    target = folder or frames.folder
    options = options or OutputOptions()
    wants_record = RECORD in (format_named(name).name for name in formats)
    if wants_record and (target.resolve() == frames.folder.resolve() or _is_of_a_run(target)):
        raise FormatError(
            f"{target}: a run's own record is vtu already; name another folder to write a converted copy"
        )
    plan = replace(plan_output(target, formats, options, frames.fps), record=wants_record)
    plan.check_parts(frames.parts)
    exporters = Exporters(plan)
    needs_frames = wants_record or any(not one.whole_run for one in plan.tables)
    total = len(frames) * (needs_frames + sum(one.whole_run for one in plan.tables))
    done = count(1)

    def tell() -> None:
        if progress:
            progress(next(done), total)

    try:
        for position in range(len(frames) if needs_frames else 0):
            exporters.write(plan.select(frames[position]))
            tell()
        exporters.assemble(frames, tell)
    finally:
        exporters.release()
    return target


def _is_of_a_run(folder: Path) -> bool:
    """Whether the folder is that of a run, or of its frames, whose record a copy would replace."""
    run_folder = folder.resolve().parent if folder.resolve().name == "frames" else folder
    return (run_folder / RUN_FILE).is_file()
