"""Who may import whom, as the design draws it: each layer and the layers it may know."""

import ast
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

PACKAGE = Path(__file__).parents[1] / "tianim"

PLAIN = {"buffers", "errors", "lang", "params", "frame"}
PHYSICS = PLAIN | {"math", "spatial", "system"}
# The command line and what runs a scene for it; they know everything but single systems.
PROGRAM = {
    "checkpoint",
    "export",
    "foam",
    "info",
    "interrupts",
    "metrics",
    "run",
    "run_folder",
    "scene",
    "terminal",
    "view",
}
ALLOWED = {
    "buffers": set(),
    "errors": set(),
    "frame": set(),
    "lang": {"errors"},
    "params": {"errors"},
    "runtime": {"errors", "lang"},
    "math": {"lang", "errors"},
    "spatial": PLAIN | {"math", "system"},
    "system": {"frame", "params", "spatial"},
    "systems": PHYSICS,
    "rig": PHYSICS,
    "couplings": PHYSICS | {"systems"},
    "simulation": {"errors", "frame", "spatial", "system"},
    "scene": PHYSICS | {"systems", "rig", "couplings", "simulation", "export.options", "view.look"},
    "export": PLAIN | {"view.look"},
    # A pass over frames that needs the neighbour search and the bodies, which no exporter may.
    "foam": PHYSICS,
    "view": PLAIN | {"export", "math"},
    "checkpoint": {"errors"},
    "interrupts": set(),
    "metrics": {"errors", "frame"},
    "info": {"lang"},
    "run_folder": {"errors", "export", "frame", "info", "params", "scene"},
    "run": PROGRAM | {"errors", "frame", "simulation"},
    "sweep": {"errors", "export", "metrics", "run_folder", "scene"},
    "terminal": {"errors"},
    "cli": PROGRAM | {"bench", "errors", "runtime", "sweep", "validate"},
    "validate": PHYSICS | PROGRAM | {"runtime", "simulation", "systems"},
    "bench": PHYSICS | PROGRAM | {"runtime", "simulation", "systems", "validate"},
    "__init__": PROGRAM | {"errors", "frame", "runtime", "simulation"},
    "__main__": {"cli"},
}  # fmt: skip


def imports(path: Path) -> Iterator[str]:
    """The modules of the package that a file imports anywhere in it, as `scene.models`."""
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            yield from (name.name[7:] for name in node.names if name.name.startswith("tianim."))
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}:{node.lineno}: a relative import"
            if node.module == "tianim":
                yield from (name.name for name in node.names if not name.name.startswith("__"))
            elif (node.module or "").startswith("tianim."):
                yield str(node.module)[7:]


def layer(path: Path) -> str:
    return path.relative_to(PACKAGE).parts[0].removesuffix(".py")


FILES = sorted(PACKAGE.rglob("*.py"))


@pytest.mark.parametrize("path", FILES, ids=[str(path.relative_to(PACKAGE)) for path in FILES])
def test_a_file_imports_only_the_layers_below(path: Path) -> None:
    mine, inside = layer(path), path.relative_to(PACKAGE).parts
    for module in imports(path):
        within = module.split(".")
        if within[0] == mine:
            # A system knows no other system, and the table of them knows all.
            apart = mine in ("systems", "couplings") and inside != (mine, "__init__.py")
            assert not apart or within[1:2] == [inside[1].removesuffix(".py")], f"{path} imports {module}"
        else:
            assert {within[0], ".".join(within[:2])} & ALLOWED[mine], f"{path} imports {module}"


def test_the_rules_name_every_layer() -> None:
    assert {layer(path) for path in FILES} <= ALLOWED.keys()


def test_importing_the_package_loads_nothing() -> None:
    code = "import sys, tianim; sys.exit(bool({'numpy', 'pydantic', 'taichi'} & set(sys.modules)))"
    assert subprocess.run([sys.executable, "-c", code], cwd=PACKAGE.parent).returncode == 0
