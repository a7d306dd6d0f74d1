"""Passes over a finished run: parts that are made of its frames afterwards and stand beside the others."""

from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from dataclasses import replace
from pathlib import Path

from tianim.export import surfaces
from tianim.export.exporters import Exporters, plan_output
from tianim.export.options import OutputOptions, SurfaceOptions
from tianim.export.record import RunFrames
from tianim.export.workers import Job, SurfaceWorkers
from tianim.frame import Frame, Part

Progress = Callable[[int, int], None]
Row = Mapping[str, float]
# A part and its row of numbers; a frame may get several.
Made = tuple[Part, Row]


def add_parts(
    frames: RunFrames,
    names: Collection[str],
    made: Iterable[Iterable[Made]],
    formats: Iterable[str],
    options: OutputOptions,
    progress: Progress | None = None,
) -> dict[str, list[dict[str, float]]]:
    """Write the parts `names`, made of each of `frames` in turn, into the run's record and `formats`.

    What the record has of those parts is replaced. `options` are the run's own. Gives the rows of
    `<name>.csv` by part, with `frame` and `time`. Raises OutputError and FormatError.
    """
    if options.parts != "all":
        options = options.model_copy(update={"parts": (*options.parts, *names)})
    # Data arrays of the run are those that it kept; a part made afterwards has its own.
    options = options.model_copy(update={"fields": "all"})
    plan = plan_output(frames.folder, formats, options, frames.fps)
    exporters = Exporters(replace(plan, resume_from=frames.index_of(-1) + 1))
    rows: dict[str, list[dict[str, float]]] = {name: [] for name in names}
    try:
        for position, parts in enumerate(made):
            frame = Frame(frames.index_of(position), frames.times[position], ())
            checked = [(plan.select(replace(frame, parts=(part,))), part.name, row) for part, row in parts]
            if position == 0:  # what a format cannot hold, or cannot be made, must not cost what was there
                for name in names:
                    exporters.drop(name)
            for chosen, name, row in checked:
                exporters.write(chosen)
                exporters.add_row(name, frame, row)
                rows[name].append({"frame": frame.index, "time": frame.time, **row})
            if progress:
                progress(position + 1, len(frames))
        exporters.finish()
    finally:
        exporters.release()
    return rows


def surface_run(
    run_folder: Path,
    wanted: Mapping[str, SurfaceOptions],
    formats: Iterable[str],
    options: OutputOptions,
    workers: int = 1,
    progress: Progress | None = None,
) -> dict[str, list[dict[str, float]]]:
    """Make the surfaces `wanted`, by name, of a finished run, as they would have been made in it.

    `workers` processes make a frame each. Gives the rows of each surface's table. Raises
    MissingPartError without pysplashsurf, FormatError where a part or its spacing is not there.
    """
    surfaces.require()
    surfaces.check(RunFrames(run_folder)[0], wanted)
    sources = {one for options_ in wanted.values() for one in options_.parts}
    frames = RunFrames(run_folder, sources)
    with SurfaceWorkers(workers) as pool:
        made = ([(one.mesh, one.row) for one in found] for found in pool.run(_jobs(frames, wanted)))
        return add_parts(frames, tuple(wanted), made, formats, options, progress)


def _jobs(frames: Iterable[Frame], wanted: Mapping[str, SurfaceOptions]) -> Iterator[Job]:
    for frame in frames:
        yield surfaces.tasks(frame, wanted)
