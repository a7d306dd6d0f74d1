"""The `tianim` command: each function is one command, and thin.

Scenes come from `tianim.scene`, frames go to `tianim.run`, pictures come from `tianim.view`.
Heavy modules are imported within the commands: `list`, `check` and `--help` must be quick.
"""

import json
import shlex
from collections.abc import Iterable, Sequence
from dataclasses import replace
from enum import Enum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from tianim import __version__
from tianim.errors import MissingPartError, SceneError, TianimError
from tianim.terminal import Bar, Commands, live_table, note, rows, say, show_table

if TYPE_CHECKING:
    from tianim.run import Run, RunOptions
    from tianim.scene import Scene

app = typer.Typer(
    cls=Commands,
    add_completion=False,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100},
)


class Arch(str, Enum):
    """Where kernels run."""

    cpu = "cpu"
    cuda = "cuda"
    vulkan = "vulkan"


class Up(str, Enum):
    """Axis that points up in files."""

    y = "y"
    z = "z"


SceneName = Annotated[str, typer.Argument(metavar="SCENE", help="Scene file, or a name that `tianim list` shows.")]
Overrides = Annotated[
    list[str] | None, typer.Argument(metavar="[KEY=VALUE]...", help="Values to use instead of the scene's.")
]
RunFolder = Annotated[Path, typer.Argument(metavar="RUN", help="Folder of a run, for example out/murmuration.")]
Out = Annotated[Path | None, typer.Option(metavar="DIR", help="Folder to write to.")]
Threads = Annotated[int | None, typer.Option(min=1, max=1024, help="Worker threads; all cores if left out.")]
Quiet = Annotated[bool, typer.Option("--quiet", help="Show errors only.")]
Overwrite = Annotated[bool, typer.Option("--overwrite", help="Replace what an earlier run left in the folder.")]
Resume = Annotated[bool, typer.Option("--resume", help="Go on from the last checkpoint, where there is one.")]
Json = Annotated[bool, typer.Option("--json", help="One JSON object a line, and nothing else.")]


@app.callback(invoke_without_command=True)
def tianim(
    context: typer.Context,
    version: Annotated[bool, typer.Option("--version", help="Print the version and end.")] = False,
) -> None:
    """Particles, flocks and bodies for animation: a scene file becomes frames, pictures and numbers.

    \b
    Example:
      tianim run murmuration boids.count=10000
    """
    if version:
        say(f"tianim {__version__}")
    elif context.invoked_subcommand is None:
        say(context.get_help())


@app.command()
def run(
    context: typer.Context,
    scene: SceneName,
    overrides: Overrides = None,
    out: Out = None,
    frames: Annotated[
        int | None, typer.Option(min=1, help="Frames to make, the start included, instead of the scene's duration.")
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
    """Simulate a scene: frames, metrics, pictures and a film, in out/<scene> or DIR.

    Ctrl-C finishes the frame, saves a checkpoint and ends with status 130; `--resume` goes on
    from there. A folder that holds a run is left alone unless `--resume` or `--overwrite` is given.

    \b
    Example:
      tianim run murmuration boids.count=10000 --out out/small --frames 60 --format vtu,ply
    """
    from tianim.run import RunOptions, claim
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
    if not no_preview:
        _pictures(done, (), None, quiet)
    if not quiet:
        _show_outputs(done, done.folder)


def _simulate(folder: Path, scene: "Scene", options: "RunOptions", quiet: bool) -> "Run":
    from tianim import runtime
    from tianim.run import simulate
    from tianim.scene import build

    started = runtime.start(options.arch, options.threads or None)  # type: ignore[arg-type]
    simulation = build(scene)
    with Bar(folder.name, quiet) as bar:
        return simulate(folder, scene, simulation, replace(options, threads=started.threads), bar)


def _format_override(formats: str | None) -> list[str]:
    if formats is None:
        return []
    names = [name.strip() for name in formats.split(",") if name.strip()]
    return [f"output.formats={json.dumps(names)}"]


def _show_outputs(done: "Run", folder: Path) -> None:
    from tianim.run import OUTPUTS

    about = {
        "frames": f"{done.record['frames_done']} frames; open the .pvd files in ParaView",
        "metrics.csv": "diagnostics a frame",
        "preview.png": "picture",
        "preview.mp4": "film",
        "contact_sheet.png": "poses over time",
        "metrics.png": "diagnostics over time",
    }
    rows((str(folder / name), about[name]) for name in OUTPUTS if name in about and (folder / name).exists())
