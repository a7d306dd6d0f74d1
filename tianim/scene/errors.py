"""What is wrong with a scene, in lines for people.

    configs/x.yaml:12: systems.boids.count = -5: must be greater than or equal to 0

A ValidationError of pydantic becomes Problems: the path in the user's data, without the labels
that pydantic adds for members of unions, and what is allowed there, said in words.
"""

import reprlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, get_args

from pydantic import ValidationError
from pydantic_core import ErrorDetails

from tianim.errors import SceneError
from tianim.params import Keyframes
from tianim.scene.fields import (
    LIMIT_WORDS,
    Key,
    Model,
    child,
    dotted,
    keyframes,
    kinds,
    literals,
    model_for,
    models,
    nearest,
    peel,
    suggestion,
    unknown_key,
    words,
)
from tianim.scene.loading import Document

# Problems that are shown; more are counted.
SHOWN = 2
# A value is cut to this many characters.
VALUE_LENGTH = 60
# An integer of more bits is said by its length.
LARGEST_SHOWN = 128

KEYFRAME_KEYS = tuple(Keyframes.model_fields)
_ABSENT = object()

# Errors of pydantic that say only that the value is of another type.
TYPE_ERRORS = ("_type", "literal_error")


@dataclass(frozen=True)
class Problem:
    """One thing that is wrong: where in the data, what is allowed, and the value there if it helps.

    `key` is the wrong key of the mapping at `path`, where it is a key that is wrong.
    """

    path: Key
    message: str
    value: Any = _ABSENT
    key: str | None = None


class _Repr(reprlib.Repr):
    """Values as a scene file writes them, cut short."""

    def __init__(self) -> None:
        super().__init__()
        self.maxlevel, self.maxstring, self.maxother = 3, VALUE_LENGTH, VALUE_LENGTH
        self.maxlist = self.maxtuple = self.maxdict = 4

    def repr_bool(self, value: bool, level: int) -> str:
        return str(value).lower()

    def repr_int(self, value: int, level: int) -> str:
        # Python does not convert integers of thousands of digits.
        return (
            str(value) if value.bit_length() < LARGEST_SHOWN else f"an integer of {value.bit_length()} bits"
        )

    def repr_float(self, value: float, level: int) -> str:
        return f"{value:.15g}"

    def repr_NoneType(self, value: None, level: int) -> str:  # noqa: N802  (reprlib's naming)
        return "null"

    def repr_tuple(self, value: tuple[Any, ...], level: int) -> str:
        return self.repr_list(list(value), level)


def shown(value: Any) -> str:
    """`value` on one line, at most some 60 characters."""
    text = " ".join(_Repr().repr(value).split())
    return text if len(text) <= VALUE_LENGTH else text[: VALUE_LENGTH - 3] + "..."


def scene_error(problems: Sequence[Problem], document: Document, overrides: Mapping[Key, str]) -> SceneError:
    """The first problems as lines of file, line, key, value and what is allowed."""
    lines = [_line(problem, document, overrides) for problem in problems[:SHOWN]]
    more = len(problems) - SHOWN
    if more > 0:
        lines[-1] += f" (and {more} more problem{'s' * (more > 1)})"
    return SceneError("\n".join(lines))


def _line(problem: Problem, document: Document, overrides: Mapping[Key, str]) -> str:
    path = problem.path
    value = "" if problem.value is _ABSENT else f" = {shown(problem.value)}"
    what = (f"{dotted(path)}{value}: " if path else "") + problem.message
    source = path if problem.key is None else (*path, problem.key)
    above = [source[:length] for length in range(len(source), -1, -1)]
    for place in above:
        if place in overrides:
            return f"override {overrides[place]}: " + (problem.message if place == path else what)
    line = next((f":{document.lines[place]}" for place in above if place in document.lines), "")
    return f"{document.name}{line}: {what}"


def problems_of(error: ValidationError, data: Any, model: Model) -> list[Problem]:
    """The problems that pydantic found in `data`, each said once."""
    places = [_place(details, data, model) for details in error.errors(include_url=False)]
    problems = {}
    for place in _best_branches(places):
        # A list whose items are wrong is also called too short.
        here = len(place.path)
        beneath = any(len(other.path) > here and other.path[:here] == place.path for other in places)
        if place.type != "too_short" or not beneath:
            problem = _problem(place)
            problems[problem.path, problem.message] = problem
    return list(problems.values())


@dataclass(frozen=True)
class _Place:
    """An error of pydantic, with its path in the data and the annotation and value there and above.

    `branch` is where a union without kinds was tried, with pydantic's label of the member.
    """

    details: ErrorDetails
    path: Key
    annotation: Any
    value: Any
    parent_annotation: Any
    parent: Any
    branch: tuple[Key, str | int] | None

    @property
    def type(self) -> str:
        return self.details["type"]


def _place(details: ErrorDetails, data: Any, annotation: Any) -> _Place:
    path: list[str | int] = []
    branch = None
    parent_annotation, parent = annotation, data
    loc = list(details["loc"])
    for position, key in enumerate(loc):
        if _is_kind(annotation, data, key):
            annotation = model_for(annotation, data)
            continue
        names_absent = position == len(loc) - 1 and details["type"] == "missing"
        if not names_absent and not _has(data, key):
            if key != "[key]":
                branch = branch or (tuple(path), key)
            continue
        parent_annotation, parent = annotation, data
        annotation = child(annotation, data, key)
        data = data[key] if _has(data, key) else _ABSENT
        path.append(key)
    return _Place(details, tuple(path), annotation, data, parent_annotation, parent, branch)


def _is_kind(annotation: Any, data: Any, key: str | int) -> bool:
    """True where `key` is the label that pydantic adds for the member of a union by kind."""
    return isinstance(data, Mapping) and len(models(annotation)) > 1 and data.get("kind") == key


def _has(data: Any, key: str | int) -> bool:
    if isinstance(data, Mapping):
        return key in data
    return isinstance(data, list | tuple) and isinstance(key, int) and key < len(data)


def _best_branches(places: Sequence[_Place]) -> list[_Place]:
    """The errors, with those of a union without kinds replaced by the ones of the member that was meant."""
    rivals: dict[Key, list[_Place]] = {}
    for place in places:
        if place.branch is not None:
            rivals.setdefault(place.branch[0], []).append(place)
    best = [place for place in places if place.branch is None]
    for at, group in rivals.items():
        labels = dict.fromkeys(place.branch[1] for place in group if place.branch is not None)
        meant = [
            place for place in group if len(place.path) > len(at) or not place.type.endswith(TYPE_ERRORS)
        ]
        if len(labels) == 1:
            best += group
        elif meant:
            best += [place for place in meant if place.branch == meant[0].branch]
        else:
            best.append(replace(group[0], details={**group[0].details, "type": "union_type"}))
    return sorted(best, key=_order(places))


def _order(places: Sequence[_Place]) -> Any:
    """Key that sorts as pydantic reported, which is the order of the fields."""
    order = {place.path: position for position, place in reversed(list(enumerate(places)))}
    return lambda place: order[place.path]


def _problem(place: _Place) -> Problem:
    """The problem that an error of pydantic stands for."""
    if place.details["loc"][-1:] == ("[key]",):
        return _wrong_name(place)
    say = _SAYINGS.get(place.type)
    if say is not None:
        return say(place)
    if place.type in _LIMITS:
        name, key = _LIMITS[place.type]
        limit = place.details["ctx"][key]
        return Problem(place.path, f"must be {LIMIT_WORDS[name]} {limit:.15g}", place.value)
    if place.type.endswith(TYPE_ERRORS) or place.type.startswith("string_"):
        return _must_be(place.path, place.annotation, place.value)
    message = place.details["msg"].removeprefix("Value error, ").replace("Input should", "must")
    return Problem(place.path, message, place.value)


def _wrong_name(place: _Place) -> Problem:
    if place.type == "string_too_long":
        return Problem(place.path, f"a name has at most {place.details['ctx']['max_length']} characters")
    return Problem(
        place.path, "a name has letters, digits and _, begins with a letter and does not end in a digit"
    )


_LIMITS = {
    "greater_than": ("gt", "gt"),
    "greater_than_equal": ("ge", "ge"),
    "less_than": ("lt", "lt"),
    "less_than_equal": ("le", "le"),
}


def _must_be(path: Key, annotation: Any, value: Any) -> Problem:
    if _looks_keyframed(value) and keyframes(annotation) is None:
        return Problem(path, f"may not be keyframed; must be {words(annotation)}")
    if path[-1:] == ("kind",):
        return Problem(path, "unknown kind" + suggestion(value, literals(annotation)), value)
    like = nearest(value, map(str, literals(annotation))) if isinstance(value, str) else None
    message = f"must be {words(annotation)}"
    message += ", or keyframes" if keyframes(annotation) is not None else ""
    meant = "" if like in (None, value) else f"; did you mean {like!r}?"
    return Problem(path, message + meant, value)


def _looks_keyframed(value: Any) -> bool:
    return isinstance(value, Mapping) and "keys" in value


def _missing(place: _Place) -> Problem:
    above = place.path[:-1]
    if isinstance(place.parent, list | tuple):
        return _must_be(above, place.parent_annotation, place.parent)
    if place.path[-1:] == ("kind",):
        return Problem(above, f"missing key 'kind': {words(place.annotation)}")
    return Problem(above, f"missing key {str(place.path[-1])!r}: {words(place.annotation)}")


def _unknown(place: _Place) -> Problem:
    above, key = place.path[:-1], place.path[-1]
    if _looks_keyframed(place.parent) and keyframes(place.parent_annotation) is None and key in KEYFRAME_KEYS:
        return Problem(above, f"may not be keyframed; must be {words(place.parent_annotation)}")
    return Problem(above, unknown_key(str(key), place.parent_annotation, place.parent), key=str(key))


def _no_kind(place: _Place) -> Problem:
    if _looks_keyframed(place.value):
        return _must_be(place.path, place.annotation, place.value)
    return Problem(place.path, f"missing key 'kind' (allowed: {', '.join(kinds(place.annotation))})")


def _wrong_kind(place: _Place) -> Problem:
    kind = place.value["kind"] if _has(place.value, "kind") else place.value
    if _looks_keyframed(kind):
        return Problem((*place.path, "kind"), f"may not be keyframed; must be {words(place.annotation)}")
    return Problem((*place.path, "kind"), "unknown kind" + suggestion(kind, kinds(place.annotation)), kind)


def _too_short(place: _Place) -> Problem:
    least = place.details["ctx"]["min_length"]
    message = f"must hold at least {least} entr{'y' if least == 1 else 'ies'}"
    return Problem(place.path, f"{message}, as {words(place.annotation)}", place.value)


def _too_long(place: _Place) -> Problem:
    most = place.details["ctx"]["max_length"]
    if place.type == "string_too_long":
        return Problem(place.path, f"must have at most {most} characters", place.value)
    arguments = get_args(peel(place.annotation)[0])
    if isinstance(place.value, Mapping) or arguments[-1:] == (Ellipsis,):
        return Problem(place.path, f"must hold at most {most} entries, not {len(place.value)}")
    return _must_be(place.path, place.annotation, place.value)


def _rule(place: _Place) -> Problem:
    """A rule of a model's own; a whole mapping would say little as its value."""
    value = _ABSENT if isinstance(place.value, Mapping) else place.value
    return Problem(place.path, " ".join(str(place.details["ctx"]["error"]).split()), value)


_SAYINGS: dict[str, Callable[[_Place], Problem]] = {
    "missing": _missing,
    "extra_forbidden": _unknown,
    "union_tag_not_found": _no_kind,
    "union_tag_invalid": _wrong_kind,
    "too_short": _too_short,
    "too_long": _too_long,
    "string_too_long": _too_long,
    "value_error": _rule,
    "finite_number": lambda place: Problem(place.path, "must be a finite number", place.value),
    "invalid_key": lambda place: Problem(place.path, "a key must be text"),
}
