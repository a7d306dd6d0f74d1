"""`tianim run` and `tianim sweep`: scenes become run folders."""

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from tianim.cli.options import (
    Arch,
    Out,
    Overrides,
    Overwrite,
    Quiet,
    Resume,
    SceneName,
    Threads,
    format_names,
    setting,
)
from tianim.cli.results import draw, show_outputs
from tianim.errors import SceneError
from tianim.terminal import Bar, note, say, show_table

if TYPE_CHECKING:
    from tianim.run_folder import Run, RunOptions
    from tianim.scene import Scene


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

    output = [] if formats is None else [setting("output.formats", format_names(formats))]
    loaded = load_scene(scene, [*(overrides or ()), *output])
    folder = out or Path("out") / Path(scene).stem
    command = ("tianim", *context.obj)
    options = RunOptions(frames, resume, overwrite, arch.value, threads or 0, command, scene)
    claim(folder, loaded, options)
    done = _simulate(folder, loaded, options, quiet)
    if done.state == "stopped":
        import shlex

        on = command if resume else (*command, "--resume")
        again = shlex.join(part for part in on if part != "--overwrite")
        note(f"stopped after frame {done.record['frames_done'] - 1}; go on with: {again}")
        raise typer.Exit(done.exit_code)
    try:
        if not no_preview:
            draw(done, (), None, quiet)
    finally:  # the frames are there, whatever becomes of the pictures
        if not quiet:
            show_outputs(done, done.folder)


def _simulate(folder: Path, scene: "Scene", options: "RunOptions", quiet: bool) -> "Run":
    from tianim import runtime
    from tianim.run import simulate
    from tianim.scene import build
    from tianim.scene.loading import find

    started = runtime.start(options.arch, options.threads or None)  # type: ignore[arg-type]
    try:
        simulation = build(scene)
    except SceneError as error:  # of a scene that is in no file: which it was, is known here
        raise SceneError(f"{find(options.scene_file)}: {error}") from None
    if scene.view.parts:  # a style for what is not there must not come to light after the run
        from tianim.export.surfaces import promise
        from tianim.view.painter import check_look
        from tianim.view.tank import add_edges, tank_of

        frame = promise(simulation.frame(), scene.output.surfaces)
        check_look(add_edges(frame, tank_of(frame, scene.bounds.model_dump())), scene.view)
    with Bar(folder.name, quiet) as bar:
        return simulate(folder, scene, simulation, replace(options, threads=started.threads), bar)


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
