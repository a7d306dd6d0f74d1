"""What is installed: pins for every Python, packages declared as imported, the machine's check."""

import ast
import importlib.util
import re
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

ROOT = Path(__file__).parents[2]
PYTHONS = ("3.10", "3.11", "3.12", "3.13")
PLATFORMS = (("linux", "x86_64"), ("darwin", "arm64"))
# Modules that are named otherwise than the package that brings them.
PACKAGES = {
    "PIL": "pillow",
    "yaml": "pyyaml",
    "pxr": "usd-core",
    "open3d": "open3d-cpu",
    "pydantic_core": "pydantic",
}


def project() -> dict[str, Any]:
    data: dict[str, Any] = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    return data


def extras() -> dict[str, list[Requirement]]:
    named = project()["optional-dependencies"]
    return {extra: [Requirement(line) for line in lines] for extra, lines in named.items()}


def core() -> list[Requirement]:
    return [Requirement(line) for line in project()["dependencies"]]


def everything() -> list[Requirement]:
    chosen = [*core(), *(requirement for group in extras().values() for requirement in group)]
    return [requirement for requirement in chosen if requirement.name != "tianim"]


def pins() -> list[str]:
    lines = (ROOT / "constraints.txt").read_text().splitlines()
    return [line for line in lines if not line.startswith("#")]


def test_pins_are_names_and_versions_only() -> None:
    """No addresses, no hashes: any index of packages will do."""
    form = re.compile(
        r"[\w.-]+==[\w.]+(; python_version (<=|==|>=) '3\.1\d'( and python_version <= '3\.1\d')?)?"
    )
    assert [line for line in pins() if not form.fullmatch(line)] == []


@pytest.mark.parametrize("python", PYTHONS)
@pytest.mark.parametrize(("system", "machine"), PLATFORMS)
def test_each_requirement_has_one_pin_that_it_allows(python: str, system: str, machine: str) -> None:
    place = {"python_version": python, "sys_platform": system, "platform_machine": machine}

    def holds(requirement: Requirement) -> bool:
        return requirement.marker is None or requirement.marker.evaluate(place)

    pinned: dict[str, list[str]] = {}
    for pin in filter(holds, map(Requirement, pins())):
        pinned.setdefault(canonicalize_name(pin.name), []).append(str(pin.specifier).removeprefix("=="))
    assert [name for name, versions in pinned.items() if len(versions) > 1] == []
    for requirement in filter(holds, everything()):
        (version,) = pinned[canonicalize_name(requirement.name)]
        assert requirement.specifier.contains(version), f"{requirement}: pinned to {version}"


def test_packages_are_declared_as_they_are_imported() -> None:
    imported = {PACKAGES.get(name, name.lower()) for name in imports() if name not in sys.stdlib_module_names}
    needed = {canonicalize_name(requirement.name) for requirement in core()}
    optional = {canonicalize_name(part.name) for part in everything()} - needed
    # Where there is no open3d-cpu, and where the standard library does it, others stand in.
    needed -= {"open3d"}
    names = {canonicalize_name(name) for name in imported} - {"tianim"}
    assert names - needed - optional == set()
    assert needed - names == set()


def imports() -> Iterator[str]:
    for tree in trees().values():
        for node in ast.walk(tree):
            if isinstance(node, ast.Import):
                yield from (alias.name.partition(".")[0] for alias in node.names)
            elif isinstance(node, ast.ImportFrom) and node.module and not node.level:
                yield node.module.partition(".")[0]
    # `lang` imports the compiler by its name.
    yield "taichi"


def trees() -> dict[Path, ast.Module]:
    return {path: ast.parse(path.read_text()) for path in (ROOT / "tianim").rglob("*.py")}


def test_functions_outside_of_kernels_say_their_types() -> None:
    """The settings of mypy let kernels go without annotations, and so cannot hold the others to them."""
    bare = [
        f"{path.relative_to(ROOT)}:{node.lineno} {node.name}"
        for path, tree in trees().items()
        for node in functions(tree)
        if node.returns is None or any(argument.annotation is None for argument in arguments(node))
    ]
    assert bare == []


def functions(tree: ast.AST) -> Iterator[ast.FunctionDef]:
    """The functions of the tree that Python runs, kernels and what is in them left out."""
    for node in ast.iter_child_nodes(tree):
        if isinstance(node, ast.FunctionDef):
            if any(ast.unparse(decorator).startswith("ti.") for decorator in node.decorator_list):
                continue
            yield node
        yield from functions(node)


def arguments(node: ast.FunctionDef) -> list[ast.arg]:
    return [
        argument
        for argument in (*node.args.posonlyargs, *node.args.args, *node.args.kwonlyargs)
        if argument.arg not in ("self", "cls")
    ]


@pytest.fixture
def machine() -> ModuleType:
    spec = importlib.util.spec_from_file_location("machine", ROOT / "tools" / "machine.py")
    assert spec
    assert spec.loader
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


Patch = pytest.MonkeyPatch
Said = pytest.CaptureFixture[str]


def has_only(*libraries: str) -> Callable[[str], bool]:
    return lambda library: library in libraries


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="other systems' wheels need nothing")
def test_user_without_libraries_is_told(machine: ModuleType, monkeypatch: Patch, capsys: Said) -> None:
    monkeypatch.setattr(machine, "can_install", lambda: False)
    monkeypatch.setattr(machine, "loads", has_only("libX11.so.6", "libGL.so.1"))
    assert machine.main() == 0
    (line,) = capsys.readouterr().out.splitlines()
    assert "libegl1 libudev1" in line
    assert "everything else works without" in line
    assert "libgl1" not in line

    monkeypatch.setattr(machine, "loads", has_only())
    assert machine.main() == 1
    (line,) = capsys.readouterr().out.splitlines()
    assert line.endswith("apt-get install libx11-6")


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="other systems' wheels need nothing")
def test_root_gets_them_installed(machine: ModuleType, monkeypatch: Patch, capsys: Said) -> None:
    commands: list[list[str]] = []
    monkeypatch.setattr(machine, "can_install", lambda: True)
    monkeypatch.setattr(machine, "loads", lambda library: bool(commands))
    monkeypatch.setattr(machine, "DRIVER_FILES", (str(Path(__file__)),))
    monkeypatch.setattr(machine.subprocess, "run", lambda command, **_: commands.append(command))
    assert machine.main() == 0
    update, install = commands
    assert update[-1] == "update"
    assert {"--yes", "libx11-6", "libusb-1.0-0"} <= set(install)
    (line,) = capsys.readouterr().out.splitlines()
    assert line.startswith("tianim: installing system packages: libx11-6 ")


def test_wrong_python_is_refused(machine: ModuleType, monkeypatch: Patch, capsys: Said) -> None:
    monkeypatch.setattr(machine, "NEWEST", (3, 9))
    assert machine.main() == 1
    (line,) = capsys.readouterr().out.splitlines()
    assert "make PYTHON=" in line
