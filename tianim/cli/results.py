"""`tianim export`, `render` and `view`: what is made of a run's frames afterwards."""

from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from tianim.cli.options import Out, Overrides, Quiet, RunFolder, Threads, Up, format_names, setting
from tianim.errors import SceneError
from tianim.terminal import Bar, note, rows, say, show_table

if TYPE_CHECKING:
    from tianim.run_folder import Run
    from tianim.view.look import Look


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

    names = format_names(formats)
    changes: dict[str, Any] = {"formats": [], "up_axis": up and up.value, "scale": scale}
    overrides = [setting(key, value) for key, value in changes.items() if value is not None]
    done = Run.open(run_folder)
    options = section(OutputOptions, done.record["scene"]["output"], overrides)
    with Bar("writing", quiet) as bar:
        where = export_run(done.folder, names, options, out, bar.so_far)
    if not quiet:
        say(str(where))


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
    draw(done, overrides or (), out, quiet)
    if not quiet:
        show_outputs(done, out or done.folder)


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


def draw(done: "Run", overrides: Sequence[str], out: Path | None, quiet: bool) -> None:
    """Draw a run; the runtime must have been started. What was chosen or left out is said."""
    from tianim.export.files import make_folder
    from tianim.view.render import render_run
    from tianim.view.tank import with_tank

    look = _look(done, overrides)
    make_folder(out or done.folder)
    frames = with_tank(done.frames(), done.record["scene"]["bounds"])
    say_so = (lambda line: None) if quiet else note
    with Bar("drawing", quiet) as bar:
        render_run(frames, look, out or done.folder, done.record["fps"], done.metrics, bar.so_far, say_so)


def _look(done: "Run", overrides: Sequence[str]) -> "Look":
    """The view that the run's scene asks for, with `camera.azimuth=60` or `view.camera.azimuth=60`."""
    from tianim.run_folder import section
    from tianim.view.look import Look

    return section(Look, done.record["scene"]["view"], [text.removeprefix("view.") for text in overrides])


def show_outputs(done: "Run", folder: Path) -> None:
    """Say what of a run is in `folder`."""
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
