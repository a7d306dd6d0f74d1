"""Overrides: any field by its dotted key, with defaults where the file says nothing."""

from pathlib import Path
from typing import Any

import pytest
from stub_system import Stub, StubParams

from tianim.errors import SceneError
from tianim.scene import load_scene, scene_from
from tianim.systems import SYSTEMS, SystemKind

DATA: dict[str, Any] = {
    "tianim": 1,
    "bodies": {"rock": {"kind": "sphere"}},
    "systems": {"swarm": {"kind": "stub", "count": 10}, "other": {"kind": "stub"}},
}


@pytest.fixture(autouse=True)
def stub_kind(monkeypatch: pytest.MonkeyPatch) -> None:
    """The table has the kind `stub`: the scene's model follows the table."""
    monkeypatch.setitem(SYSTEMS, "stub", SystemKind(StubParams, Stub))  # type: ignore[arg-type]


def swarm(*overrides: str) -> StubParams:
    params = scene_from(DATA, overrides=overrides).systems["swarm"]
    assert isinstance(params, StubParams)
    return params


def test_top_key_system_name_and_body_name() -> None:
    scene = scene_from(
        DATA, overrides=["fps=60", "swarm.count=1e5", "rock.radius=3", "systems.other.count=2"]
    )
    assert scene.fps == 60
    assert scene.systems["swarm"].particle_count() == 100_000
    assert scene.systems["other"].particle_count() == 2
    assert scene.bodies["rock"].radius == 3.0  # type: ignore[union-attr]


def test_defaults_of_the_owner_are_kept() -> None:
    """`rule` has radius 2 and weight 3 by StubParams, not Rule's own 1 and 1."""
    rule = swarm("swarm.rule.weight=7").rule
    assert (rule.radius, rule.weight) == (2.0, 7)


def test_item_of_a_default_list() -> None:
    wishes = swarm("swarm.wishes.1.strength=9").wishes
    assert [wish.strength for wish in wishes] == [5.0, 9]


def test_item_of_a_list_in_the_file() -> None:
    data = {**DATA, "systems": {"swarm": {"kind": "stub", "wishes": [{"kind": "push"}, {"kind": "pull"}]}}}
    params = scene_from(data, overrides=["swarm.wishes.0.strength=4"]).systems["swarm"]
    assert [wish.strength for wish in params.wishes] == [4, 1.0]  # type: ignore[attr-defined]


def test_optional_part_that_is_left_out() -> None:
    helper = swarm("swarm.helper.radius=4").helper
    assert helper is not None
    assert helper.radius == 4


def test_keyframes() -> None:
    assert swarm("swarm.rule.weight={keys: [[0, 1], [2, 3]]}").rule.at(1.0).weight == 2.0
    assert swarm("swarm.rule.weight.keys=[[0, 1], [2, 3]]").rule.at(1.0).weight == 2.0
    again = swarm("swarm.rule.weight.keys=[[0, 1], [2, 3]]", "swarm.rule.weight.keys.1.1=5").rule
    assert again.at(1.0).weight == 3.0


def test_lists_mappings_words_and_another_kind() -> None:
    scene = scene_from(
        DATA,
        overrides=[
            "bounds={kind: periodic, lower: [0,0,0], upper: [1,2,3]}",
            "bounds.upper.2=4",
            "title=new",
        ],
    )
    assert scene.bounds.value().upper == (1.0, 2.0, 4.0)
    assert scene.title == "new"
    assert swarm("swarm.size=[1, 2]").size == (1.0, 2.0)
    assert scene_from(DATA, overrides=["rock={kind: box, size: [1, 1, 1]}"]).bodies["rock"].kind == "box"
    assert set(scene_from(DATA, overrides=["systems.third={kind: stub}"]).systems) == {
        "swarm",
        "other",
        "third",
    }


def test_later_overrides_win_and_the_data_stays_as_it_was() -> None:
    before = repr(DATA)
    assert swarm("swarm.count=1", "swarm.count=2").count == 2
    assert repr(DATA) == before


def test_mapping_of_overrides_takes_values_as_they_are() -> None:
    scene = scene_from(DATA, overrides={"swarm.count": 5, "title": "a: b", "seed": "3"} | {"title": "plain"})
    assert (scene.systems["swarm"].particle_count(), scene.seed, scene.title) == (5, 3, "plain")


def test_value_may_hold_an_equals_sign() -> None:
    assert scene_from(DATA, overrides=["title=a=b"]).title == "a=b"


@pytest.mark.parametrize(
    ("override", "message"),
    [
        ("swarm.count=-1", "override {}: must be greater than or equal to 0"),
        ("swarm.count=1.5", "override {}: must be a whole number from 0 to 100000000"),
        (
            "swarm.cuont=1",
            "override {}: unknown key 'systems.swarm.cuont' for kind 'stub'; did you mean 'count'? "
            "(allowed: count, helper, kind, rule, size, wishes)",
        ),
        (
            "swarm.rule.wieght=1",
            "override {}: unknown key 'systems.swarm.rule.wieght'; did you mean 'weight'? "
            "(allowed: radius, weight)",
        ),
        ("swarn.count=1", "override {}: unknown key 'swarn'; did you mean 'swarm'?"),
        (
            "swarm.wishes.2.strength=1",
            "'2' must be a number from 0 to 1: systems.swarm.wishes is a list of 2",
        ),
        ("swarm.wishes.x=1", "'x' must be a number from 0 to 1"),
        ("swarm.wishes.0.body=a", "unknown key 'systems.swarm.wishes.0.body' for kind 'push'"),
        ("swarm.count.keys=[[0, 1]]", "systems.swarm.count may not be keyframed"),
        (
            "swarm.rule.radius={keys: [[0, 1]]}",
            "override {}: may not be keyframed; must be a number greater than 0",
        ),
        ("swarm.title.x=1", "unknown key 'systems.swarm.title'"),
        ("title.x=1", "title is not a mapping; it takes text"),
        ("swarm.size=huge", "override {}: must be 'auto' or a number greater than 0 or a list of 2 numbers"),
        ("swarm.size=[1]", "override {}: must be 'auto' or a number greater than 0 or a list of 2 numbers"),
        ("swarm.size=-1", "override {}: must be greater than 0"),
        ("swarm.kind=stubb", "override {}: unknown kind; did you mean 'stub'?"),
        ("bodies.rok.radius=1", "no bodies.rok; did you mean 'rock'?"),
        (
            "swarm={kind: stub, rule: {radius: 0}}",
            "override {}: systems.swarm.rule.radius = 0: must be greater than 0",
        ),
    ],
)
def test_wrong_overrides_name_themselves(override: str, message: str) -> None:
    with pytest.raises(SceneError) as caught:
        scene_from(DATA, overrides=[override])
    assert message.replace("{}", override) in str(caught.value)


def test_an_override_that_was_replaced_is_not_blamed() -> None:
    with pytest.raises(SceneError) as caught:
        scene_from(DATA, overrides=["swarm.count=5", "swarm={kind: stub, count: -1}"])
    assert str(caught.value).startswith(
        "override swarm={kind: stub, count: -1}: systems.swarm.count = -1: must be"
    )


def test_overrides_must_be_a_list() -> None:
    with pytest.raises(SceneError, match="must be a list of key=value"):
        scene_from(DATA, overrides="fps=3")
    for wrong in ([3], {3: 4}):
        with pytest.raises(SceneError, match="override 3: a key must be text"):
            scene_from(DATA, overrides=wrong)  # type: ignore[arg-type]


def test_errors_of_the_file_still_name_the_file(tmp_path: Path) -> None:
    path = tmp_path / "a.yaml"
    path.write_text("tianim: 1\nseed: -1\nsystems:\n  swarm: {kind: stub}\n")
    with pytest.raises(SceneError) as caught:
        load_scene(path, ["swarm.count=5"])
    assert str(caught.value) == f"{path}:2: seed = -1: must be greater than or equal to 0"
