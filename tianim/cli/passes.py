"""`tianim surface` and `foam`: what is made of a finished run's particles and stands among its frames."""

from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Annotated, Any

import typer

from tianim.cli.options import Overrides, Quiet, RunFolder, Threads, format_names
from tianim.errors import SceneError
from tianim.terminal import Bar, say, show_table

if TYPE_CHECKING:
    from tianim.export import OutputOptions, SurfaceOptions
    from tianim.foam import Surroundings
    from tianim.run_folder import Run

# Rows of a table that are shown; the file has them all.
SHOWN = 12

Formats = Annotated[
    str | None, typer.Option("--format", metavar="F,F...", help="Formats to write; the run's if left out.")
]
Row = Mapping[str, float]


def surface(
    run_folder: RunFolder,
    overrides: Overrides = None,
    of: Annotated[
        list[str] | None,
        typer.Option(
            metavar="PART", help="Part of particles; with commas several as one volume. May be repeated."
        ),
    ] = None,
    formats: Formats = None,
    jobs: Annotated[
        int | None, typer.Option(min=1, help="Frames at a time, a core each; all cores if left out.")
    ] = None,
    quiet: Quiet = False,
) -> None:
    """Make the surface of a run's particles.

    A triangle mesh a frame, the part <part>_surface, beside the other frames; area and volume go to
    <part>_surface.csv. Keys are those of a surface in the scene's `output.surfaces`, which are made
    anew where no --of is given; without any, each part of particles gets one.
    """
    from tianim.export import OutputOptions, surface_run
    from tianim.run_folder import Run, alone, section
    from tianim.runtime import available_cores

    done = Run.open(run_folder)
    options = section(OutputOptions, done.record["scene"]["output"], ())
    wanted = _surfaces(done, options, of or (), overrides or ())
    with alone(done.folder), Bar("surfaces", quiet) as bar:
        rows = surface_run(
            done.folder, wanted, _formats(formats, options), options, jobs or available_cores(), bar.so_far
        )
    if not quiet:
        _show(done, rows)


def _surfaces(
    done: "Run", options: "OutputOptions", of: Sequence[str], overrides: Sequence[str]
) -> dict[str, "SurfaceOptions"]:
    """What is to be made, by name: as asked, as the scene has it, or a surface of each fluid."""
    from tianim.export import SurfaceOptions
    from tianim.run_folder import section

    chosen = [_names(text) for text in of]
    data = {name: one.model_dump(mode="json") for name, one in options.surfaces.items()}
    if chosen:
        data = {
            f"{names[0]}_surface": data.get(f"{names[0]}_surface", {}) | {"of": names} for names in chosen
        }
    elif not data:
        data = {f"{name}_surface": {"of": name} for name in _fluids(done)}
    for name in data:
        _must_be_free(done, name)
    return {name: section(SurfaceOptions, one, overrides) for name, one in data.items()}


def foam(
    run_folder: RunFolder,
    overrides: Overrides = None,
    of: Annotated[
        str | None, typer.Option(metavar="PART,PART...", help="Parts of the fluid; all fluids if left out.")
    ] = None,
    formats: Formats = None,
    threads: Threads = None,
    quiet: Quiet = False,
) -> None:
    """Make the foam, spray and bubbles of a run's fluid.

    Points with `kind` (0 spray, 1 foam, 2 bubble), age and velocity, the part <part>_foam, beside the
    other frames; counts go to <part>_foam.csv. Keys are those of the options, among them `trapped_air`,
    `wave_crest` and `speed` (thresholds) and `trapped_air_rate` and `wave_crest_rate` (how much).
    """
    from tianim import runtime
    from tianim.export import OutputOptions, RunFrames, add_parts
    from tianim.foam import FoamOptions
    from tianim.run_folder import Run, alone, section

    done = Run.open(run_folder)
    parts = _fluids(done) if of is None else _names(of)
    there = RunFrames(done.folder).parts
    for part in parts:
        if part not in there:
            raise SceneError(f"--of {of}: no part is called {part!r}; there are {', '.join(there)}")
    name = f"{parts[0]}_foam"
    output = section(OutputOptions, done.record["scene"]["output"], ())
    _must_be_free(done, name, output.surfaces)
    options = section(FoamOptions, {}, overrides or ())
    runtime.start("cpu", threads)
    from tianim.foam import make_foam

    frames = RunFrames(done.folder, parts)
    made = make_foam(frames, _surroundings(done, parts), options, name)
    with alone(done.folder), Bar("foam", quiet) as bar:
        rows = add_parts(
            frames, (name,), ([one] for one in made), _formats(formats, output), output, bar.so_far
        )
    if not quiet:
        _show(done, rows)


def _surroundings(done: "Run", parts: tuple[str, ...]) -> "Surroundings":
    """What the run's scene says of the fluid that `parts` are of."""
    from tianim.foam import Surroundings
    from tianim.scene import scene_from

    scene = scene_from(done.record["scene"])
    named = [name for name in scene.systems if f"{parts[0]}_".startswith(f"{name}_")]
    known: Any = scene.systems[max(named, key=len)] if named else None
    more = {"gravity": known} if hasattr(known, "gravity") else {}
    return Surroundings(
        parts,
        getattr(known, "dimension", 3),
        scene.seed,
        scene.bounds.value(),
        scene.bodies,
        **more,
    )


def _names(text: str) -> tuple[str, ...]:
    """The parts of `--of water,oil`. SceneError where it names none."""
    names = tuple(name.strip() for name in text.split(",") if name.strip())
    if not names:
        raise SceneError(f"--of {text!r}: must name parts, with commas between those that are one volume")
    return names


def _fluids(done: "Run") -> tuple[str, ...]:
    """The parts of particles that fill a volume. SceneError where there is none."""
    fluids = tuple(part.name for part in done.frames()[0].parts if getattr(part, "spacing", 0.0))
    if not fluids:
        raise SceneError(f"{done.folder}: no part tells the spacing of its particles: choose one with --of")
    return fluids


def _must_be_free(done: "Run", name: str, surfaces: Iterable[str] = ()) -> None:
    """SceneError where the scene itself has a part of that name, which must not be replaced."""
    scene = done.record["scene"]
    phases = [f"{key}_{phase}" for key, one in scene["systems"].items() for phase in one.get("phases", ())]
    if name in (*scene["systems"], *phases, *scene["bodies"], *surfaces):
        raise SceneError(f"{done.folder}: the scene has a {name!r} already, which is not replaced")


def _formats(text: str | None, options: "OutputOptions") -> Sequence[str]:
    return options.formats if text is None else format_names(text)


def _show(done: "Run", tables: Mapping[str, Sequence[Row]]) -> None:
    """Print some rows of each table, and where all of them are."""
    for name, rows in tables.items():
        step = max(1, -(-len(rows) // SHOWN))
        show_table(name, [*rows[:-1:step], rows[-1]])
        say(str(done.frames_folder / f"{name}.csv"))
