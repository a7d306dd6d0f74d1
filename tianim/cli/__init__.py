"""The `tianim` command: its commands in the order of `tianim --help`, each a thin function.

Scenes come from `tianim.scene`, frames go to `tianim.run`, pictures come from `tianim.view`.
What only some commands need is imported within them: `list`, `check` and `--help` must be quick.
"""

import os
from collections.abc import Callable
from typing import Annotated

import typer

from tianim import __version__
from tianim.cli.measures import bench, info, validate
from tianim.cli.passes import foam, surface
from tianim.cli.results import export, render, view
from tianim.cli.runs import run, sweep
from tianim.cli.scenes import check, list_scenes, schema
from tianim.terminal import Commands, say

app = typer.Typer(
    cls=Commands,
    add_completion=False,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100},
)


def example(*lines: str) -> str:
    """Epilog of a command's help; the backspace keeps the lines as they are."""
    return "\b\nExample:\n" + "\n".join(f"  {line}" for line in lines)


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


def _add(name: str, command: Callable[..., None], *examples: str) -> None:
    app.command(name, epilog=example(*examples))(command)


_add("run", run, "tianim run murmuration boids.count=10000 --out out/small --frames 60 --format vtu,ply")
_add("list", list_scenes, "tianim list")
_add("check", check, "tianim check murmuration boids.count=1000000")
_add(
    "schema",
    schema,
    "tianim schema --out scene.schema.json",
    "then let a scene begin with: # yaml-language-server: $schema=scene.schema.json",
)
_add("export", export, "tianim export out/murmuration --format usd --up z", "tianim export --formats")
_add("surface", surface, "tianim surface out/dam_break --of water cube_size=0.5 --format ply")
_add("foam", foam, "tianim foam out/dam_break speed=[0.5,2] lifetime=[1,3]")
_add("render", render, "tianim render out/murmuration camera.azimuth=60 background=night")
_add("view", view, "tianim view out/murmuration")
_add("sweep", sweep, "tianim sweep vicsek vicsek.noise=0.1,0.2,0.4 seed=1,2,3 --jobs 2")
_add("bench", bench, "tianim bench boids --n 10000,100000")
_add("validate", validate, "tianim validate boids --out out/validation")
_add("info", info, "tianim info")


def main() -> None:
    """Run the command of this process and end with its exit code.

    NumPy, which is not loaded yet, gets one thread for its products, unless the user has said how many: more
    of them go on turning for some ten milliseconds when they are done, on cores that the kernels need. One
    product of a matrix and a vector a frame made the steps of 2,000 hairs a fifth slower.
    """
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    app()
