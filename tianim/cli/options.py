"""Arguments and options that several commands share, and how their texts are read."""

from enum import Enum
from pathlib import Path
from typing import Annotated, Any

import typer

from tianim.errors import SceneError


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


def setting(key: str, value: Any) -> str:
    """An override `key=value` for a scene or a section of it."""
    import json

    return f"{key}={json.dumps(value)}"


def format_names(text: str) -> list[str]:
    """The formats of `--format vtu,ply`. SceneError where it names none."""
    names = [name.strip() for name in text.split(",") if name.strip()]
    if not names:
        raise SceneError(f"--format {text!r}: must name formats with commas between, as in vtu,ply")
    return names


def whole_numbers(text: str) -> list[int]:
    """The numbers of `--n 10000,1e6`. SceneError where one is not whole or below 1."""
    try:
        numbers = [float(part) for part in text.split(",")]
    except ValueError:
        numbers = [0.0]
    if not all(number >= 1 and number.is_integer() for number in numbers):
        raise SceneError(
            f"--n {text}: must be whole numbers of at least 1 with commas between, as in 10000,1e6"
        )
    return [int(number) for number in numbers]
