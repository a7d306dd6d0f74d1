"""`tianim list`, `check` and `schema`: what can be said of scenes without running them."""

from pathlib import Path
from typing import Annotated

import typer

from tianim.cli.options import Overrides, SceneName
from tianim.errors import SceneError
from tianim.terminal import note, rows, say


def list_scenes() -> None:
    """List the scenes that can be run by name."""
    from tianim.scene import find_scenes

    scenes = find_scenes()
    if not scenes:
        note("no scenes: there is no folder configs here")
    rows((scene.name, scene.description or scene.title) for scene in scenes)


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


def schema(
    out: Annotated[
        Path | None, typer.Option(metavar="FILE", help="File to write; printed if left out.")
    ] = None,
) -> None:
    """Give the JSON schema of scenes, for editors."""
    import json

    from tianim.scene import json_schema

    text = json.dumps(json_schema(), indent=1)
    if out is None:
        say(text)
        return
    from tianim.export.files import write_text

    if out.is_dir():
        raise SceneError(f"--out {out}: a folder; must be the name of a file")
    write_text(out, text + "\n")
    note(f"wrote {out}")


def duration(seconds: float) -> str:
    """Seconds for people: `40 s`, `3 min`, `2.5 h`."""
    if seconds < 99.5:  # from here on two digits would be 1e+02
        return f"{seconds:.2g} s"
    return f"{seconds / 60:.0f} min" if seconds < 6000 else f"{seconds / 3600:.1f} h"
