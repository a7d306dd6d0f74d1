"""Running the `tianim` command on a scene of drifting points, within this process or in one of its own."""

import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import drift
import pytest
from command import SCENE, Cli, Start
from typer.testing import CliRunner, Result

from tianim.cli import app


@pytest.fixture(autouse=True)
def _drift() -> Iterator[None]:
    with drift.registered():
        yield


@pytest.fixture
def scene(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A scene file; the current folder is the one it is in."""
    path = tmp_path / "dust.yaml"
    path.write_text(SCENE)
    monkeypatch.chdir(tmp_path)
    return path


@pytest.fixture
def cli() -> Cli:
    """Run a command in this process: `cli("run", "dust.yaml")`."""

    def call(*arguments: object) -> Result:
        result = CliRunner().invoke(app, [str(argument) for argument in arguments])
        if result.exception is not None and not isinstance(result.exception, SystemExit):
            raise result.exception
        return result

    return call


@pytest.fixture
def start() -> Iterator[Start]:
    """Start a command in a process of its own."""
    children = []

    def call(*arguments: object, **options: object) -> "subprocess.Popen[str]":
        command = [sys.executable, drift.__file__, *map(str, arguments)]
        project = Path(drift.__file__).parents[1]
        environment = {**os.environ, "PYTHONPATH": str(project)}
        child: subprocess.Popen[str] = subprocess.Popen(  # type: ignore[call-overload]
            command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=environment, **options
        )
        children.append(child)
        return child

    yield call
    for child in children:
        child.kill()
        child.communicate()
