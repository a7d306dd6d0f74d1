"""Reading the models of a scene: which field is at a path, and what it takes, in words.

Errors, overrides and the docs all need the annotation behind a dotted key such as
`systems.boids.behaviours.0.weight`. A step goes into the model that the data at hand selects by
its `kind`, so the annotation is found only together with the data.
"""

import difflib
import types
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, Literal, Union, get_args, get_origin

from pydantic import BaseModel
from pydantic.fields import FieldInfo

from tianim.params import LARGE, Keyframes, Name, Params

Key = tuple[str | int, ...]
Model = type[BaseModel]

MAPPINGS = (dict, Mapping)

# An unknown word is likened to a known one from this share of equal letters on.
NEAREST_CUTOFF = 0.5
# A list of allowed words longer than this is cut.
LIST_LENGTH = 240


def dotted(path: Sequence[str | int]) -> str:
    """`("systems", "boids", "count")` as `systems.boids.count`."""
    return ".".join(str(part) for part in path)


def nearest(word: str, known: Iterable[str]) -> str | None:
    """The known word most like `word`, None where none is like it."""
    by_case = {name.casefold(): name for name in known}
    found = difflib.get_close_matches(word.casefold(), by_case, n=1, cutoff=NEAREST_CUTOFF)
    return by_case[found[0]] if found else None


def suggestion(word: Any, known: Iterable[str]) -> str:
    """`; did you mean 'count'? (allowed: count, speed)`."""
    known = sorted(known)
    like = nearest(word, known) if isinstance(word, str) else None
    listed = ", ".join(known) or "none"
    if len(listed) > LIST_LENGTH:
        listed = listed[: listed.rindex(",", 0, LIST_LENGTH)] + ", ..."
    return (f"; did you mean {like!r}?" if like else "") + f" (allowed: {listed})"


def peel(annotation: Any) -> tuple[Any, tuple[Any, ...]]:
    """An annotation without its metadata, and the metadata with each `Field(...)` opened."""
    metadata: list[Any] = []
    while get_origin(annotation) is Annotated:
        annotation, *added = get_args(annotation)
        metadata += added
    opened = [
        inner for item in metadata for inner in (item.metadata if isinstance(item, FieldInfo) else (item,))
    ]
    return annotation, tuple(opened)


def field_annotation(field: FieldInfo) -> Any:
    """The annotation of a model's field, its metadata included."""
    with_metadata = (field.annotation, *field.metadata)
    return Annotated[with_metadata] if field.metadata else field.annotation


def members(annotation: Any) -> tuple[Any, ...]:
    """The alternatives of a union, nested ones opened; anything else stands alone."""
    inner, _ = peel(annotation)
    if get_origin(inner) in (Union, types.UnionType):
        return tuple(option for member in get_args(inner) for option in members(member))
    return (annotation,)


def _is_model(option: Any, base: Model) -> bool:
    inner, _ = peel(option)
    # On Python 3.10 `tuple[int, ...]` passes for a type.
    return get_origin(inner) is None and isinstance(inner, type) and issubclass(inner, base)


def keyframes(annotation: Any) -> Model | None:
    """The model of keyframes that `annotation` takes, None where it may not be keyframed."""
    return next((peel(option)[0] for option in members(annotation) if _is_model(option, Keyframes)), None)


def models(annotation: Any) -> tuple[Model, ...]:
    """The models that `annotation` takes, keyframes aside."""
    found = (option for option in members(annotation) if _is_model(option, Params))
    return tuple(peel(option)[0] for option in found if not _is_model(option, Keyframes))


def takes_mapping(annotation: Any) -> bool:
    """True where a mapping other than keyframes may stand."""
    return bool(models(annotation)) or any(
        get_origin(peel(option)[0]) in MAPPINGS for option in members(annotation)
    )


def kind_of(model: Model) -> str | None:
    """The `kind` that selects `model` in a union; None where it has none."""
    field = model.model_fields.get("kind")
    words = get_args(field.annotation) if field is not None else ()
    return words[0] if len(words) == 1 else None


def kinds(annotation: Any) -> tuple[str, ...]:
    """The kinds that select a model of `annotation`."""
    return tuple(kind for model in models(annotation) if (kind := kind_of(model)) is not None)


def model_for(annotation: Any, data: Any) -> Model | None:
    """The model that `data` at this place is meant for: by its kind, or the only one."""
    if isinstance(data, BaseModel):
        return type(data)
    choice = models(annotation)
    frames = keyframes(annotation)
    if isinstance(data, Mapping):
        if frames is not None and (not choice or "keys" in data):
            return frames
        by_kind = [model for model in choice if kind_of(model) == data.get("kind")]
        if by_kind:
            return by_kind[0]
    return choice[0] if len(choice) == 1 else None


def child(annotation: Any, data: Any, key: str | int) -> Any:
    """The annotation of `key` within `annotation`, as `data` there selects it; None where there is none."""
    model = model_for(annotation, data)
    if model is not None and key in model.model_fields:
        return field_annotation(model.model_fields[str(key)])
    for option in members(annotation):
        inner, _ = peel(option)
        arguments = get_args(inner)
        if get_origin(inner) in MAPPINGS and isinstance(key, str):
            return arguments[1]
        if get_origin(inner) is tuple and isinstance(key, int):
            if arguments[-1] is Ellipsis:
                return arguments[0]
            if 0 <= key < len(arguments):
                return arguments[key]
    return None


def known_keys(annotation: Any, data: Any) -> tuple[str, ...]:
    """The keys that a mapping at this place may have; of every kind where none is selected."""
    model = model_for(annotation, data)
    chosen = (model,) if model is not None else models(annotation)
    return tuple(dict.fromkeys(name for model in chosen for name in model.model_fields))


def unknown_key(key: str, annotation: Any, data: Any) -> str:
    """The message for a key (or its dotted path) that the mapping `data` may not have."""
    model = model_for(annotation, data)
    kind = None if model is None else kind_of(model)
    of_kind = "" if kind is None else f" for kind {kind!r}"
    return f"unknown key {key!r}{of_kind}{suggestion(key.rpartition('.')[2], known_keys(annotation, data))}"


def literals(annotation: Any) -> tuple[Any, ...]:
    """The words that `annotation` takes as they stand."""
    inner = [peel(option)[0] for option in members(annotation)]
    return tuple(word for option in inner if get_origin(option) is Literal for word in get_args(option))


def bounds_of(annotation: Any) -> dict[str, float]:
    """The limits of a number by gt, ge, lt, le, multiple_of; without those that only keep float32 finite."""
    _, metadata = peel(annotation)
    found = {}
    for item in metadata:
        for name in (*LIMIT_WORDS, "multiple_of"):
            limit = getattr(item, name, None)
            if limit is not None and abs(limit) < LARGE:
                found[name] = limit
    return found


LIMIT_WORDS = {
    "gt": "greater than",
    "ge": "greater than or equal to",
    "lt": "less than",
    "le": "less than or equal to",
}


def _limits(annotation: Any) -> str:
    limits = bounds_of(annotation)
    if "multiple_of" in limits:
        return _limits_between(limits) + f", a multiple of {limits['multiple_of']:.15g}"
    return _limits_between(limits)


def _limits_between(limits: Mapping[str, float]) -> str:
    if "ge" in limits and "le" in limits:
        return f" from {limits['ge']:.15g} to {limits['le']:.15g}"
    return " and".join(f" {LIMIT_WORDS[name]} {limits[name]:.15g}" for name in LIMIT_WORDS if name in limits)


def words(annotation: Any) -> str:
    """What a field takes, for people: `a number greater than 0`, `a list of 3 numbers`."""
    options = [option for option in members(annotation) if not _is_model(option, Keyframes)]
    choice = literals(annotation)
    plain = [option for option in options if get_origin(peel(option)[0]) is not Literal]
    mappings = [option for option in plain if _is_model(option, Params)]
    parts = [_plain_words(option, many=False) for option in plain if option not in mappings]
    if choice:
        parts.insert(0, _one_of(choice))
    if mappings:
        parts.insert(0, _mapping_words(annotation))
    return " or ".join(parts)


def _one_of(choice: Sequence[Any]) -> str:
    listed = ", ".join(repr(word) if isinstance(word, str) else str(word) for word in choice)
    return listed if len(choice) == 1 else f"one of {listed}"


def _mapping_words(annotation: Any) -> str:
    found = kinds(annotation)
    return f"a mapping with kind {_one_of(found)}" if found else "a mapping"


def _plain_words(annotation: Any, many: bool) -> str:
    """Words of one alternative; `many` gives the plural without an article."""
    inner, metadata = peel(annotation)
    if get_origin(inner) is tuple:
        return ("lists of " if many else "a list of ") + _item_words(get_args(inner))
    if get_origin(inner) in MAPPINGS:
        return ("mappings" if many else "a mapping") + " of names to " + _many(get_args(inner)[1])
    pattern = _pattern(metadata)
    if pattern is not None and pattern == _pattern(peel(Name)[1]):
        return ("names" if many else "a name") + " (letters, digits and _, first a letter, last not a digit)"
    if pattern is not None:
        return ("texts" if many else "text") + f" of the form {pattern.strip('^$')}"
    nouns: dict[Any, tuple[str, str]] = {
        float: ("a number", "numbers"),
        int: ("a whole number", "whole numbers"),
        bool: ("true or false", "true or false"),
        str: ("text", "texts"),
        Path: ("a file name", "file names"),
        type(None): ("null", "null"),
    }
    singular, plural = nouns.get(inner, (str(inner), str(inner)))
    return (plural if many else singular) + _limits(annotation)


def _pattern(metadata: Sequence[Any]) -> str | None:
    return next((item.pattern for item in metadata if getattr(item, "pattern", None)), None)


def _many(annotation: Any) -> str:
    options = members(annotation)
    if models(annotation):
        return "mappings" + (f" with kind {_one_of(found)}" if (found := kinds(annotation)) else "")
    if len(options) > 1 or get_origin(peel(annotation)[0]) is Literal:
        return f"items, each {words(annotation)}"
    return _plain_words(annotation, many=True)


def _item_words(arguments: tuple[Any, ...]) -> str:
    if arguments[-1] is Ellipsis:
        return _many(arguments[0])
    if all(argument == arguments[0] for argument in arguments):
        return f"{len(arguments)} {_many(arguments[0])}"
    return f"{len(arguments)} items (" + ", ".join(words(argument) for argument in arguments) + ")"
