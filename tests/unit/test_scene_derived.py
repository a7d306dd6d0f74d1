"""Wrong inputs derived from the models: for every field of every part of a scene, one clear line each.

A new system or field is covered without a change here: the sites come from the SYSTEMS table.
"""

import math
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Literal, get_args, get_origin

import pytest
from pydantic import BeforeValidator
from scene_sites import NAME, Site, all_sites, example, files

from tianim.errors import SceneError
from tianim.params import Keyframes
from tianim.scene import scene_from
from tianim.scene.fields import MAPPINGS, dotted, keyframes, members, models, peel

SITES = all_sites()

# Words of pydantic or Python that say nothing to a user.
JARGON = re.compile(
    r"Input should|input_value|type=|errors\.pydantic|function-|constrained|\[key\]|\.constant|\.keyframes|"
    r"Traceback|NoneType|<class|tuple\[|literal\[|model_attributes|Value error"
)
MOST_LINES = 2
LONGEST_LINE = 700  # a list of allowed kinds or keys makes most of it

# A value of each sort; each alternative of a field takes some of them, the rest must be refused.
WRONG: dict[str, Any] = {
    "text": "no such word",
    "fraction": 1.5,
    "integer": 7,
    "true": True,
    "list": [[[]]],
    "mapping": {"nonsense": 1},
    "null": None,
}


@pytest.mark.parametrize("site", SITES, ids=lambda site: site.label)
def test_example_is_valid(site: Site) -> None:
    """Otherwise the tests below would see another error than the one they make."""
    scene_from(site.example, files())


@pytest.mark.parametrize("site", SITES, ids=lambda site: site.label)
def test_wrong_types(site: Site) -> None:
    for value in wrong_types(site.annotation):
        refused(site.place(value), dotted(site.key))


@pytest.mark.parametrize("site", SITES, ids=lambda site: site.label)
def test_out_of_range(site: Site) -> None:
    for value, limit in out_of_range(site.annotation):
        assert limit in refused(site.place(value), dotted(site.key))


@pytest.mark.parametrize("site", SITES, ids=lambda site: site.label)
def test_not_finite(site: Site) -> None:
    for value in not_finite(site.annotation):
        refused(site.place(value), dotted(site.key))


@pytest.mark.parametrize("site", SITES, ids=lambda site: site.label)
def test_misspelt_key(site: Site) -> None:
    """The key is named, and the right one suggested (a key of three letters or less is like none)."""
    wrong = f"{site.name}x"
    message = refused(site.beside(wrong), f"unknown key {wrong!r}")
    if len(site.name) > 3:
        assert f"did you mean {site.name!r}?" in message


@pytest.mark.parametrize("site", SITES, ids=lambda site: site.label)
def test_keyframes_only_where_allowed(site: Site) -> None:
    value = {"keys": [[0.0, _keyed(site.annotation)]]}
    if keyframes(site.annotation) is not None:
        assert accepted(site, value), f"{site.label} says that it may be keyframed, but {value} is refused"
    else:
        message = refused(site.place(value), dotted(site.key))
        takes_names = any(get_origin(peel(option)[0]) in MAPPINGS for option in members(site.annotation))
        assert takes_names or "may not be keyframed" in message


def refused(scene: dict[str, Any], fragment: str) -> str:
    """The message that refuses `scene`: short, free of jargon, with `fragment` in it."""
    with pytest.raises(SceneError) as caught:
        scene_from(scene, files())
    message = str(caught.value)
    assert fragment in message
    assert not JARGON.search(message), message
    lines = message.splitlines()
    assert 1 <= len(lines) <= MOST_LINES, message
    assert max(map(len, lines)) <= LONGEST_LINE, message
    return message


def accepted(site: Site, value: Any) -> bool:
    try:
        scene_from(site.place(value), files())
    except SceneError as error:
        return "must" not in str(error)  # a rule between fields may still be broken
    return True


def wrong_types(annotation: Any) -> list[Any]:
    """Values of sorts that no alternative of the field takes, and lists of the wrong length."""
    taken = {sort for option in members(annotation) for sort in _taken(option)}
    values = [value for sort, value in WRONG.items() if sort not in taken]
    for option in members(annotation):
        inner, _ = peel(option)
        if get_origin(inner) is tuple and get_args(inner)[-1] is not Ellipsis:
            right = [example(item) for item in get_args(inner)]
            values += [right[:-1], [*right, right[-1]], []]
    return values


def _taken(option: Any) -> set[str]:
    inner, metadata = peel(option)
    shorts = {"text"} if any(isinstance(item, BeforeValidator) for item in metadata) else set()
    by_type: dict[Any, set[str]] = {
        float: {"fraction", "integer"},
        int: {"integer"},
        bool: {"true"},
        str: {"text"},
        Path: {"text"},
        type(None): {"null"},
    }
    if get_origin(inner) is Literal:
        return {sort for sort, value in WRONG.items() if value in get_args(inner)}
    return shorts | by_type.get(inner, set())


def _numbers(annotation: Any) -> Iterator[tuple[Any, Any]]:
    """Each number that a field holds: its annotation, and a function that puts a value there."""
    for option in members(annotation):
        inner, _ = peel(option)
        if inner in (float, int):
            yield option, lambda value: value
        elif get_origin(inner) is tuple:
            items = [item for item in get_args(inner) if item is not Ellipsis]
            first = peel(items[0])[0]
            if first in (float, int):
                rest = [example(item) for item in items[1:]]
                yield items[0], lambda value, rest=rest: [value, *rest]


def out_of_range(annotation: Any) -> Iterator[tuple[Any, str]]:
    """Values just beyond each limit, and the limit as the message says it."""
    alone = len([option for option in members(annotation) if peel(option)[0] not in (type(None),)]) == 1
    for option, put in _numbers(annotation):
        inner, metadata = peel(option)
        step = next((item.multiple_of for item in metadata if hasattr(item, "multiple_of")), 1)
        for item in metadata:
            for name, towards in (("gt", -math.inf), ("ge", -math.inf), ("lt", math.inf), ("le", math.inf)):
                limit = getattr(item, name, None)
                if limit is None:
                    continue
                beyond = limit if name in ("gt", "lt") else _next(limit, towards, inner, step)
                said = f"{limit:.15g}" if alone or keyframes(annotation) is not None else ""
                yield put(inner(beyond)), said
                yield (
                    put(
                        math.copysign(1e300, towards)
                        if inner is float
                        else int(math.copysign(10**30, towards))
                    ),
                    said,
                )


def _next(limit: float, towards: float, kind: type, step: int) -> float:
    return limit + math.copysign(step, towards) if kind is int else math.nextafter(float(limit), towards)


def not_finite(annotation: Any) -> Iterator[Any]:
    for _, put in _numbers(annotation):
        yield from (put(value) for value in (math.nan, math.inf, -math.inf))


def _keyed(annotation: Any) -> Any:
    """A value of the field for a key: one of its constants."""
    for option in members(annotation):
        inner, _ = peel(option)
        if inner is not type(None) and not (isinstance(inner, type) and issubclass(inner, Keyframes)):
            return example(option)
    raise AssertionError(annotation)


def test_every_system_is_covered() -> None:
    """The walk reaches each model that a scene names."""
    reached = {site.model for site in SITES}
    for site in SITES:
        assert set(models(site.annotation)) <= reached
    assert NAME in {part for site in SITES for part in site.key}
