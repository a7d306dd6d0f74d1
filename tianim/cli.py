"""The `tianim` command: each function is one command, and thin.

Scenes come from `tianim.scene`, frames go to `tianim.run`, pictures come from `tianim.view`.
Heavy modules are imported within the commands: `list`, `check` and `--help` must be quick.
"""

import json
import shlex
from collections.abc import Iterable, Sequence
from dataclasses import asdict, replace
from enum import Enum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from tianim import __version__
from tianim.errors import SceneError
from tianim.terminal import Bar, Commands, live_table, note, rows, say, show_table

if TYPE_CHECKING:
    from tianim.run_folder import Run, RunOptions
    from tianim.scene import Scene
    from tianim.view.look import Look

app = typer.Typer(
    cls=Commands,
    add_completion=False,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100},
)


# What the tables show of each line; `--json` gives all of it.
BENCH_COLUMNS = (
    "case",
    "variant",
    "engine",
    "n",
    "dim",
    "ms_per_step",
    "ns_per_item_step",
    "ratio",
    "split_ms",
)
VALIDATE_COLUMNS = ("system", "check", "expected", "measured", "error", "tolerance", "passed", "seconds")


def example(*lines: str) -> str:
    """Epilog of a command's help; the backspace keeps the lines as they are."""
    return "\b\nExample:\n" + "\n".join(f"  {line}" for line in lines)


class Arch(str, Enum):
    """Where kernels run."""

    cpu = "cpu"
    cuda = "cuda"
    vulkan = "vulkan"


class Up(str, Enum):
    """Axis that points up in files."""

    y = "y"
    z = "z"


SceneName = Annotated[
    str, typer.Argument(metavar="SCENE", help="Scene file, or a name that `tianim list` shows.")
]
Overrides = Annotated[
    list[str] | None, typer.Argument(metavar="KEY=VALUE", help="Values to use instead of the scene's.")
]
RunFolder = Annotated[
    Path, typer.Argument(metavar="RUN", help="Folder of a run, for example out/murmuration.")
]
Out = Annotated[Path | None, typer.Option(metavar="DIR", help="Folder to write to.")]
Threads = Annotated[int | None, typer.Option(min=1, max=1024, help="Worker threads; all cores if left out.")]
Quiet = Annotated[bool, typer.Option("--quiet", help="Show errors only.")]
Overwrite = Annotated[
    bool, typer.Option("--overwrite", help="Replace what an earlier run left in the folder.")
]
Resume = Annotated[bool, typer.Option("--resume", help="Go on from the last checkpoint, where there is one.")]
Json = Annotated[bool, typer.Option("--json", help="One JSON object a line, and nothing else.")]


@app.callback(invoke_without_command=True, epilog=example("tianim run murmuration boids.count=10000"))
def tianim(
    context: typer.Context,
    version: Annotated[bool, typer.Option("--version", help="Print the version and end.")] = False,
) -> None:
    """Particles, flocks and bodies for animation: a scene file becomes frames, pictures and numbers."""
    if version:
        say(f"tianim {__version__}")
    elif context.invoked_subcommand is None:
        say(context.get_help())


@app.command(
    epilog=example("tianim run murmuration boids.count=10000 --out out/small --frames 60 --format vtu,ply")
)
def run(
    context: typer.Context,
    scene: SceneName,
    overrides: Overrides = None,
    out: Out = None,
    frames: Annotated[
        int | None,
        typer.Option(min=1, help="Frames to make, the start included, instead of the scene's duration."),
    ] = None,
    formats: Annotated[
        str | None, typer.Option("--format", metavar="F,F...", help="Formats to write beside vtu.")
    ] = None,
    threads: Threads = None,
    arch: Annotated[Arch, typer.Option(help="Where kernels run.")] = Arch.cpu,
    resume: Resume = False,
    overwrite: Overwrite = False,
    no_preview: Annotated[bool, typer.Option("--no-preview", help="Make no pictures and no film.")] = False,
    quiet: Quiet = False,
) -> None:
    """Simulate a scene.

    Writes frames, metrics, pictures and a film to out/<scene> or DIR.

    Ctrl-C finishes the frame, saves a checkpoint and ends with status 130; `--resume` goes on
    from there. A folder that holds a run is left alone unless `--resume` or `--overwrite` is given.
    """
    from tianim.run_folder import RunOptions, claim
    from tianim.scene import load_scene

    loaded = load_scene(scene, [*(overrides or ()), *_format_override(formats)])
    folder = out or Path("out") / Path(scene).stem
    command = ("tianim", *context.obj)
    options = RunOptions(frames, resume, overwrite, arch.value, threads or 0, command, scene)
    claim(folder, loaded, options)
    done = _simulate(folder, loaded, options, quiet)
    if done.state == "stopped":
        on = command if resume else (*command, "--resume")
        again = shlex.join(part for part in on if part != "--overwrite")
        note(f"stopped after frame {done.record['frames_done'] - 1}; go on with: {again}")
        raise typer.Exit(done.exit_code)
    try:
        if not no_preview:
            _pictures(done, (), None, quiet)
    finally:  # the frames are there, whatever becomes of the pictures
        if not quiet:
            _show_outputs(done, done.folder)


def _simulate(folder: Path, scene: "Scene", options: "RunOptions", quiet: bool) -> "Run":
    from tianim import runtime
    from tianim.run import simulate
    from tianim.scene import build

    started = runtime.start(options.arch, options.threads or None)  # type: ignore[arg-type]
    simulation = build(scene)
    if scene.view.parts:  # a style for what is not there must not come to light after the run
        from tianim.view.painter import check_look

        check_look(simulation.frame(), scene.view)
    with Bar(folder.name, quiet) as bar:
        return simulate(folder, scene, simulation, replace(options, threads=started.threads), bar)


def _format_override(formats: str | None) -> list[str]:
    if formats is None:
        return []
    names = [name.strip() for name in formats.split(",") if name.strip()]
    return [f"output.formats={json.dumps(names)}"]


def _show_outputs(done: "Run", folder: Path) -> None:
    from tianim.run_folder import OUTPUTS

    about = {
        "frames": f"{done.record['frames_done']} frames; open the .pvd files in ParaView",
        "metrics.csv": "diagnostics a frame",
        "preview.png": "picture",
        "preview.mp4": "film",
        "preview.webp": "film",
        "contact_sheet.png": "poses over time",
        "metrics.png": "diagnostics over time",
    }
    rows((str(folder / name), about[name]) for name in OUTPUTS if name in about and (folder / name).exists())


@app.command("list", epilog=example("tianim list"))
def list_scenes() -> None:
    """List the scenes that can be run by name."""
    from tianim.scene import find_scenes

    scenes = find_scenes()
    if not scenes:
        note("no scenes: there is no folder configs here")
    rows((scene.name, scene.description or scene.title) for scene in scenes)


@app.command(epilog=example("tianim check murmuration boids.count=1000000"))
def check(scene: SceneName, overrides: Overrides = None) -> None:
    """Check a scene without running it.

    Prints what it holds, the memory and the time that it will take.
    """
    from tianim.scene import check_memory, load_scene

    loaded = load_scene(scene, overrides or ())
    summary = check_memory(loaded)
    rows(
        (
            ("scene", loaded.title or Path(scene).stem),
            ("systems", ", ".join(f"{name} ({params.kind})" for name, params in loaded.systems.items())),
            ("particles", f"{summary.particles:,}"),
            ("frames", f"{summary.frames:,} at {loaded.fps:g} a second, {summary.steps:,} steps"),
            ("memory", f"about {summary.memory / 1e9:.2f} GB"),
            ("time", f"about {duration(summary.seconds)} on two cores, drawing and writing aside"),
        )
    )


@app.command(
    epilog=example(
        "tianim schema --out scene.schema.json",
        "then let a scene begin with: # yaml-language-server: $schema=scene.schema.json",
    )
)
def schema(
    out: Annotated[
        Path | None, typer.Option(metavar="FILE", help="File to write; printed if left out.")
    ] = None,
) -> None:
    """Give the JSON schema of scenes, for editors."""
    from tianim.scene import json_schema

    text = json.dumps(json_schema(), indent=1)
    if out is None:
        say(text)
        return
    from tianim.export.files import write_text

    write_text(out, text + "\n")
    note(f"wrote {out}")


@app.command(epilog=example("tianim export out/murmuration --format usd --up z", "tianim export --formats"))
def export(
    run_folder: Annotated[Path | None, typer.Argument(metavar="RUN", help="Folder of a run.")] = None,
    formats: Annotated[
        str | None, typer.Option("--format", metavar="F,F...", help="Formats to write.")
    ] = None,
    out: Out = None,
    up: Annotated[Up | None, typer.Option(help="Axis that points up; the run's if left out.")] = None,
    scale: Annotated[
        float | None, typer.Option(help="Length units in a metre; the run's if left out.")
    ] = None,
    table: Annotated[bool, typer.Option("--formats", help="Print what each format keeps, and end.")] = False,
    quiet: Quiet = False,
) -> None:
    """Write a run in other formats.

    Nothing is simulated again.
    """
    if table:
        from tianim.export import formats_table

        show_table("what each format keeps", [asdict(row) for row in formats_table()])
        return
    if run_folder is None or formats is None:
        raise SceneError(
            "export needs RUN and --format, for example: tianim export out/murmuration --format usd"
        )
    from tianim.export import OutputOptions, export_run
    from tianim.run_folder import Run, section

    names = [name.strip() for name in formats.split(",") if name.strip()]
    changes: dict[str, Any] = {"formats": [], "up_axis": up and up.value, "scale": scale}
    overrides = [f"{key}={json.dumps(value)}" for key, value in changes.items() if value is not None]
    done = Run.open(run_folder)
    options = section(OutputOptions, done.record["scene"]["output"], overrides)
    with Bar("writing", quiet) as bar:
        where = export_run(done.folder, names, options, out, bar.so_far)
    if not quiet:
        say(str(where))


@app.command(epilog=example("tianim render out/murmuration camera.azimuth=60 background=night"))
def render(
    run_folder: RunFolder,
    overrides: Overrides = None,
    out: Out = None,
    threads: Threads = None,
    quiet: Quiet = False,
) -> None:
    """Draw pictures and film of a run.

    Keys are those of the scene's `view`.
    """
    from tianim import runtime
    from tianim.run_folder import Run

    done = Run.open(run_folder)
    runtime.start("cpu", threads)
    _pictures(done, overrides or (), out, quiet)
    if not quiet:
        _show_outputs(done, out or done.folder)


@app.command(epilog=example("tianim view out/murmuration"))
def view(run_folder: RunFolder, overrides: Overrides = None) -> None:
    """Look at a run in a window.

    Goes through its frames; needs a display.
    """
    from tianim import runtime
    from tianim.run_folder import Run
    from tianim.view.open3d_view import view_run

    done = Run.open(run_folder)
    runtime.start()
    view_run(done.frames(), _look(done, overrides or ()), run_folder.name)


@app.command(epilog=example("tianim sweep vicsek vicsek.noise=0.1,0.2,0.4 seed=1,2,3 --jobs 2"))
def sweep(
    scene: SceneName,
    values: Annotated[
        list[str],
        typer.Argument(metavar="KEY=VALUE,VALUE...", help="Values to try; every combination is run."),
    ],
    jobs: Annotated[int, typer.Option(min=1, help="Runs at a time; they share the cores.")] = 1,
    out: Out = None,
    frames: Annotated[int | None, typer.Option(min=1, help="Frames of each run.")] = None,
    resume: Resume = False,
    overwrite: Overwrite = False,
    preview: Annotated[bool, typer.Option("--preview", help="Make pictures and a film of each run.")] = False,
) -> None:
    """Run every combination of some values.

    Each is a run in a process of its own. Ends with a table of the last frame's metrics, also in
    sweep.csv. A combination that fails is shown and does not stop the others; the exit code is
    then 1.
    """
    from tianim.runtime import available_cores
    from tianim.sweep import Sweep, run_sweep

    folder = out or Path("out") / f"{Path(scene).stem}_sweep"
    extra = (
        [f"--frames={frames}"] * (frames is not None) + ["--resume"] * resume + ["--overwrite"] * overwrite
    )
    extra += ["--no-preview"] * (not preview)
    plan = Sweep(scene, tuple(values), folder, max(1, available_cores() // jobs), tuple(extra))
    results = run_sweep(plan, jobs, lambda result: note(result.line()))
    show_table(f"sweep of {scene}", [result.row() for result in results], only_fitting=True)
    say(str(folder / "sweep.csv"))
    if any(result.failed for result in results):
        raise typer.Exit(1)


@app.command(epilog=example("tianim bench boids --n 10000,100000"))
def bench(
    case: Annotated[
        str | None, typer.Argument(metavar="[CASE]", help="Case to run; all if left out.")
    ] = None,
    sizes: Annotated[str | None, typer.Option("--n", metavar="N,N...", help="Numbers of items.")] = None,
    peers: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Folder of other programs to run beside.")
    ] = None,
    threads: Threads = None,
    as_json: Json = False,
) -> None:
    """Measure the speed of the kernels."""
    numbers = _numbers(sizes)
    from tianim import bench as cases

    _judge("bench", cases.run(case, numbers, peers, threads), as_json, BENCH_COLUMNS)


@app.command(epilog=example("tianim validate boids --out out/validation"))
def validate(
    system: Annotated[
        str | None, typer.Argument(metavar="[SYSTEM]", help="System to check; all if left out.")
    ] = None,
    slow: Annotated[bool, typer.Option("--slow", help="The long checks too.")] = False,
    out: Out = None,
    as_json: Json = False,
) -> None:
    """Check systems against published numbers.

    Exit code 1 when a check fails.
    """
    from tianim import validate as checks

    _judge("validation", checks.run(system, slow, out), as_json, VALIDATE_COLUMNS)


@app.command(epilog=example("tianim info"))
def info() -> None:
    """Show versions, machine and optional parts."""
    from tianim import info as facts

    sections: dict[str, dict[str, Any]] = {"versions": facts.versions(), "machine": facts.machine()}
    sections |= {"back ends": facts.back_ends(), "optional parts": facts.parts()}
    for title, pairs in sections.items():
        say(title)
        rows(((name, str(value)) for name, value in pairs.items()), indent="  ")


def _pictures(done: "Run", overrides: Sequence[str], out: Path | None, quiet: bool) -> None:
    """Draw a run; the runtime must have been started. What was chosen or left out is said."""
    from tianim.export.files import make_folder
    from tianim.view.render import render_run

    look = _look(done, overrides)
    make_folder(out or done.folder)
    say_so = (lambda line: None) if quiet else note
    with Bar("drawing", quiet) as bar:
        render_run(
            done.frames(), look, out or done.folder, done.record["fps"], done.metrics, bar.so_far, say_so
        )


def _look(done: "Run", overrides: Sequence[str]) -> "Look":
    """The view that the run's scene asks for, with `camera.azimuth=60` or `view.camera.azimuth=60`."""
    from tianim.run_folder import section
    from tianim.view.look import Look

    return section(Look, done.record["scene"]["view"], [text.removeprefix("view.") for text in overrides])


def _judge(title: str, results: Iterable[dict[str, Any]], as_json: bool, columns: Sequence[str]) -> None:
    """Show results as they come; exit code 1 where one did not pass."""
    passed = True
    if as_json:
        for row in results:
            say(json.dumps(row))
            passed = passed and row.get("passed", True)
    else:
        with live_table(title, columns) as add:
            for row in results:
                add(row)
                passed = passed and row.get("passed", True)
    if not passed:
        raise typer.Exit(1)


def _numbers(text: str | None) -> list[int] | None:
    if text is None:
        return None
    try:
        numbers = [int(float(part)) for part in text.split(",")]
    except (ValueError, OverflowError):
        numbers = [0]
    if min(numbers) < 1:
        raise SceneError(
            f"--n {text}: must be whole numbers of at least 1 with commas between, as in 10000,1e6"
        )
    return numbers


def duration(seconds: float) -> str:
    """Seconds for people: `40 s`, `3 min`, `2.5 h`."""
    if seconds < 100:
        return f"{seconds:.2g} s"
    return f"{seconds / 60:.0f} min" if seconds < 6000 else f"{seconds / 3600:.1f} h"


def main() -> None:
    """Run the command of this process and end with its exit code."""
    app()
