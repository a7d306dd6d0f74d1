"""Wrong scenes on the command line: one or two clear lines, exit code 2, nothing written."""

import sys
from pathlib import Path

import pytest
from command import Cli

sys.path.append(str(Path(__file__).parents[1] / "unit"))

from bad_scenes import BAD_SCENES, BadScene

MOST_LINES = 2
POOL = """\
tianim: 1
bodies: {rock: {kind: box, size: [0.2, 0.2, 0.2], position: [0.1, 0.1, 0.1]}}
systems:
  water:
    kind: fluid
    spacing: 0.1
    blocks: {pool: {kind: box, lower: [0, 0, 0], upper: [0.3, 0.3, 0.3]}}
"""


def everything(folder: Path) -> dict[str, bytes | None]:
    return {str(path): path.read_bytes() if path.is_file() else None for path in folder.rglob("*")}


@pytest.mark.parametrize("bad", BAD_SCENES, ids=lambda bad: bad.id)
def test_a_bad_scene_is_a_line_and_exit_code_2(
    bad: BadScene, tmp_path: Path, cli: Cli, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    argument, overrides = bad.prepare(tmp_path)
    before = everything(tmp_path)
    result = cli("run", argument, *overrides, "--overwrite", "--no-preview")
    assert result.exit_code == 2
    assert 1 <= result.stderr.count("\n") <= MOST_LINES
    assert result.stderr.startswith("tianim: ")
    assert "Traceback" not in result.output
    assert result.stdout == ""
    assert everything(tmp_path) == before


def test_what_only_the_start_shows_names_the_file_too(
    tmp_path: Path, cli: Cli, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Whether water starts in a body is known when both are made, and not while the file is read."""
    monkeypatch.chdir(tmp_path)
    Path("pool.yaml").write_text(POOL)
    result = cli("run", "pool.yaml", "--no-preview")
    assert result.exit_code == 2
    assert result.stderr.startswith("tianim: pool.yaml: systems.water: blocks.pool: 8 of its 27 particles")
    assert result.stderr.count("\n") == 1
    assert list(everything(tmp_path)) == [str(tmp_path / "pool.yaml")]
