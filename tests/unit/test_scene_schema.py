"""The JSON schema for editors, and the description of fields for the docs."""

from pathlib import Path
from typing import Any

import jsonschema
import pytest
from bad_scenes import BAD_SCENES
from stub_system import Rule, Stub, StubParams

from tianim.errors import SceneError
from tianim.scene import describe, json_schema, load_scene
from tianim.scene.fields import words
from tianim.scene.loading import PACKAGED, read
from tianim.scene.models import MOST_FRAMES, Checkpoint, scene_model
from tianim.systems import SYSTEMS, SystemKind

SCENES = sorted(PACKAGED.glob("*.yaml"))


@pytest.fixture(scope="module")
def validator() -> Any:
    schema = json_schema()
    jsonschema.Draft202012Validator.check_schema(schema)
    return jsonschema.Draft202012Validator(schema)


@pytest.mark.parametrize("path", SCENES, ids=lambda path: path.stem)
def test_packaged_scenes_fit_the_schema_and_load(path: Path, validator: Any) -> None:
    validator.validate(read(path).data)
    load_scene(path)


# What JSON schema can say; rules between fields and files are the loader's.
BEYOND_SCHEMA = 0.5


def test_schema_refuses_most_wrong_scenes_that_can_be_read(validator: Any, tmp_path: Path) -> None:
    """An editor marks what is wrong with keys, types and ranges."""
    refused = []
    for index, case in enumerate(BAD_SCENES):
        folder = tmp_path / str(index)
        folder.mkdir()
        scene, overrides = case.prepare(folder)
        if overrides:
            continue
        try:
            data = read(scene).data
        except SceneError:
            continue
        refused.append(not validator.is_valid(data))
    assert sum(refused) > BEYOND_SCHEMA * len(refused)


def test_schema_has_every_kind_and_description() -> None:
    text = str(json_schema())
    for kind in SYSTEMS:
        assert f"'{kind}'" in text
    assert "frames a second [1/s]" in text


def test_model_follows_the_table(monkeypatch: pytest.MonkeyPatch) -> None:
    before = scene_model()
    assert scene_model() is before, "made once"
    monkeypatch.setitem(SYSTEMS, "stub", SystemKind(StubParams, Stub))  # type: ignore[arg-type]
    assert scene_model() is not before
    assert "StubParams" in str(json_schema())


def test_describe() -> None:
    fields = {".".join(map(str, field.path)): field for field in describe(StubParams)}
    weight = fields["rule.weight"]
    assert (weight.words, weight.default, weight.description, weight.animatable) == (
        "a number greater than or equal to 0",
        1.0,
        "strength",
        True,
    )
    assert not fields["rule.radius"].animatable
    assert fields["rule"].default == Rule(radius=2.0, weight=3.0)
    assert fields["wishes.*.pull.body"].words == "text"
    assert fields["size"].words == "'auto' or a number greater than 0 or a list of 2 numbers greater than 0"
    assert [name for name in fields if name.startswith("helper")] == [
        "helper",
        "helper.radius",
        "helper.weight",
    ]


def test_every_field_of_a_scene_is_described() -> None:
    """The docs table and the editor's hints are made of these."""
    missing = [
        ".".join(map(str, field.path))
        for field in describe(scene_model())
        if not field.description and field.path[-1] != "kind"
    ]
    assert missing == []


@pytest.mark.parametrize(
    ("model", "name", "expected"),
    [
        (Checkpoint, "every", f"a whole number from 1 to {MOST_FRAMES}"),
        (StubParams, "helper", "a mapping or null"),
        (StubParams, "wishes", "a list of mappings with kind one of 'push', 'pull'"),
        (StubParams, "kind", "'stub'"),
    ],
)
def test_words(model: Any, name: str, expected: str) -> None:
    field = next(field for field in describe(model) if field.path == (name,))
    assert words(field.annotation) == expected
