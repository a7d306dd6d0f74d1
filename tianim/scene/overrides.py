"""Overrides `key=value` of the command line, applied to a scene's plain data before it is validated.

boids.count=1e5              a system's or a body's name stands for systems.<name>, bodies.<name>
view.color.map=viridis       keys that the file leaves out begin with their defaults
boids.behaviours.0.weight=2  a number counts the items of a list from 0
bounds={kind: open}          a value is YAML in flow style
"""

import copy
from collections.abc import Mapping, Sequence
from typing import Any

from pydantic import BaseModel
from pydantic.fields import FieldInfo

from tianim.errors import SceneError
from tianim.params import Keyframes
from tianim.scene.fields import (
    Key,
    Model,
    child,
    dotted,
    keyframes,
    kind_of,
    kinds,
    model_for,
    models,
    nearest,
    suggestion,
    takes_mapping,
    unknown_key,
    words,
)
from tianim.scene.yaml_reader import ReadError, read_yaml

Overrides = Mapping[str, Any] | Sequence[str]

# The mappings of a scene whose names may begin a key.
NAMED = ("systems", "bodies")


def apply(
    data: Mapping[str, Any], overrides: Overrides, model: Model
) -> tuple[dict[str, Any], dict[Key, str]]:
    """A copy of `data` with the overrides set, and for each path that was set its `key=value`.

    Raises SceneError where a key is not in the schema of the kinds that the data selects.
    """
    result = copy.deepcopy(dict(data))
    texts: dict[Key, str] = {}
    for key, value, text in _parsed(overrides):
        try:
            path = _set(result, _full_path(result, key, model), value, model)
        except ReadError as error:
            raise SceneError(f"override {text}: {error.reason}") from None
        # What an earlier override set beneath this place is gone.
        texts = {other: said for other, said in texts.items() if other[: len(path)] != path}
        texts[path] = text
    return result, texts


def _parsed(overrides: Overrides) -> list[tuple[str, Any, str]]:
    """Each override as key, value and the text that messages show."""
    for one in overrides:
        if not isinstance(one, str):
            raise SceneError(f"override {_shown(one)}: a key must be text, as in boids.count=1000")
    if isinstance(overrides, Mapping):
        return [(key, _value(key, value), f"{key}={_shown(value)}") for key, value in overrides.items()]
    if isinstance(overrides, str):
        raise SceneError(f"override {overrides!r}: must be a list of key=value")
    parsed = []
    for text in overrides:
        key, equals, value = text.partition("=")
        if not equals or not key.strip():
            raise SceneError(f"override {_shown(text)!r}: must be key=value, for example boids.count=1000")
        parsed.append((key.strip(), _value(key, value), _shown(text)))
    return parsed


def _value(key: str, value: Any) -> Any:
    if not isinstance(value, str):
        return value
    try:
        return read_yaml(value).data
    except ReadError as error:
        raise SceneError(f"override {key}={_shown(value)}: {error.reason}") from None


def _shown(value: Any) -> str:
    text = " ".join(str(value).split())
    return text if len(text) <= 60 else text[:57] + "..."


def _full_path(data: dict[str, Any], key: str, model: Model) -> Key:
    parts = tuple(key.split("."))
    if not all(parts):
        raise ReadError("a key is made of words with dots between them")
    if parts[0] in model.model_fields:
        return parts
    names = {name: group for group in NAMED if isinstance(data.get(group), dict) for name in data[group]}
    if parts[0] not in names:
        raise ReadError(f"unknown key {parts[0]!r}{suggestion(parts[0], {*model.model_fields, *names})}")
    return (names[parts[0]], *parts)


def _set(data: Any, path: Key, value: Any, annotation: Any) -> Key:
    """Set `value` at `path` in `data`, making what stands between from defaults."""
    walked: Key = ()
    for position, part in enumerate(path):
        last = position == len(path) - 1
        if isinstance(data, list):
            key: str | int = _index(data, str(part), walked)
        else:
            key = str(part)
            _check_key(annotation, data, key, walked, last)
        inner = child(annotation, data, key)
        if last:
            data[key] = value
        else:
            ahead = str(path[position + 1])
            if isinstance(data, dict) and key not in data:
                data[key] = _default(annotation, data, str(key))
            data[key] = _opened(data[key], inner, ahead, (*walked, key))
            data, annotation = data[key], inner
        walked = (*walked, key)
    return walked


def _index(data: list[Any], part: str, walked: Key) -> int:
    if part.isdecimal() and len(part) < 9 and int(part) < len(data):
        return int(part)
    if not data:
        raise ReadError(f"{dotted(walked)} is an empty list; set it as a whole")
    raise ReadError(
        f"{part!r} must be a number from 0 to {len(data) - 1}: {dotted(walked)} is a list of {len(data)}"
    )


def _check_key(annotation: Any, data: dict[str, Any], key: str, walked: Key, last: bool) -> None:
    if child(annotation, data, key) is None:
        if key != "kind" and model_for(annotation, data) is None and models(annotation):
            raise ReadError(
                f"{dotted(walked)} has no kind yet; set {dotted(walked)}.kind first{_kinds(annotation)}"
            )
        if key == "kind" and kinds(annotation):
            return
        raise ReadError(unknown_key(dotted((*walked, key)), annotation, data))
    if walked and walked[-1] in NAMED and len(walked) == 1 and key not in data and not last:
        like = nearest(key, data)
        raise ReadError(f"no {dotted((*walked, key))}" + (f"; did you mean {like!r}?" if like else ""))


def _kinds(annotation: Any) -> str:
    return f" (allowed: {', '.join(kinds(annotation))})"


def _opened(value: Any, annotation: Any, ahead: str, walked: Key) -> Any:
    """`value` as something that a key can be set in."""
    if isinstance(value, BaseModel):
        value = _plain(value)
    if isinstance(value, tuple):
        value = list(value)
    frames = keyframes(annotation)
    if frames is not None and not isinstance(value, dict) and ahead in frames.model_fields:
        return {}
    if value is None and takes_mapping(annotation):
        return {}
    if isinstance(value, dict | list):
        return value
    allowed = f"{dotted(walked)} is not a mapping; it takes {words(annotation)}"
    raise ReadError(
        allowed
        if frames is not None or ahead not in Keyframes.model_fields
        else f"{dotted(walked)} may not be keyframed"
    )


def _default(annotation: Any, data: dict[str, Any], key: str) -> Any:
    model = model_for(annotation, data)
    if model is None:
        return None
    field: FieldInfo = model.model_fields[key]
    return None if field.is_required() else _plain(field.get_default(call_default_factory=True))


def _plain(value: Any) -> Any:
    """A default as it would stand in a file: what it sets itself, and its kind."""
    if isinstance(value, BaseModel):
        kind = kind_of(type(value))
        plain = {
            name: _plain(getattr(value, name))
            for name in type(value).model_fields
            if name in value.model_fields_set
        }
        return plain if kind is None else {"kind": kind, **plain}
    if isinstance(value, Mapping):
        return {name: _plain(item) for name, item in value.items()}
    return [_plain(item) for item in value] if isinstance(value, tuple | list) else value
