"""Wrong scenes on the command line: one or two clear lines, exit code 2, nothing written."""

import sys
from pathlib import Path

import pytest
from command import Cli

sys.path.append(str(Path(__file__).parents[1] / "unit"))

from bad_scenes import BAD_SCENES, BadScene

MOST_LINES = 2


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
