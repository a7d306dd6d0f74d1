"""The table of wrong scenes: one clear SceneError each, of one or two lines, and nothing written."""

import re
from pathlib import Path

import pytest
from bad_scenes import BAD_SCENES, BadScene

from tianim.errors import SceneError
from tianim.scene import load_scene

LEAST_CASES = 60
MOST_LINES = 2


@pytest.mark.parametrize("case", BAD_SCENES, ids=lambda case: case.id)
def test_one_clear_error(case: BadScene, tmp_path: Path) -> None:
    scene, overrides = case.prepare(tmp_path)
    before = sorted(tmp_path.rglob("*"))
    with pytest.raises(SceneError) as caught:
        load_scene(scene, overrides)
    message = str(caught.value)
    for fragment in case.fragments:
        assert re.search(fragment, message), f"{fragment!r} is not in: {message}"
    assert len(message.splitlines()) <= MOST_LINES
    assert caught.value.__suppress_context__ or caught.value.__context__ is None
    assert sorted(tmp_path.rglob("*")) == before


def test_table_is_large_and_its_cases_differ() -> None:
    assert len(BAD_SCENES) >= LEAST_CASES
    assert len({case.id for case in BAD_SCENES}) == len(BAD_SCENES)


def test_tag_does_not_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    case = next(case for case in BAD_SCENES if case.id == "YAML tag that would run code")
    scene, overrides = case.prepare(tmp_path)
    with pytest.raises(SceneError):
        load_scene(scene, overrides)
    assert not (tmp_path / "tianim_was_here").exists()
