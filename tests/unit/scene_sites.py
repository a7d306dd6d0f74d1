"""Every field of every model that a scene may hold, with a smallest valid scene around it.

Tests derive wrong inputs from these, so that a new system or field is covered by itself. Values
come from the models: defaults, `Field(examples=...)`, or the first candidate that is accepted.
"""

import atexit
import shutil
import tempfile
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any, Literal, get_args, get_origin

import annotated_types
import numpy as np
from pydantic import ValidationError, create_model
from pydantic.fields import FieldInfo

from tianim.errors import SceneError
from tianim.params import Keyframes, Params
from tianim.scene import scene_from
from tianim.scene.fields import (
    MAPPINGS,
    Model,
    field_annotation,
    kind_of,
    members,
    models,
    peel,
)
from tianim.scene.models import scene_model
from tianim.systems import SYSTEMS

Place = Callable[[Any], dict[str, Any]]
Key = tuple[str | int, ...]

# As many of all: points of the file, items of a list, particles.
THREE = 3
# One name for all that must refer to each other: species, bodies that are targets.
NAME = "flock"
OTHER_NAME = "south"
CORNERS = {"lower": [-50.0, -50.0, -50.0], "upper": [50.0, 50.0, 50.0]}
BOUNDS = ({"kind": "contained", **CORNERS}, {"kind": "periodic", **CORNERS}, {"kind": "open"})
WORDS = (NAME, "#336699")
NUMBERS = (1.0, 0.5, THREE, 16, 0.001, 100.0, 0.0, -1.0)
CUBE = """v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nv 0 0 1\nv 1 0 1\nv 1 1 1\nv 0 1 1
f 1 3 2\nf 1 4 3\nf 5 6 7\nf 5 7 8\nf 1 2 6\nf 1 6 5
f 2 3 7\nf 2 7 6\nf 3 4 8\nf 3 8 7\nf 4 1 5\nf 4 5 8
"""


@dataclass(frozen=True)
class Site:
    """A field of a model, and scenes about it.

    `place(value)` has `value` there and is valid otherwise; `beside(key)` has another key beside it.
    """

    model: Model
    name: str
    annotation: Any
    field: FieldInfo
    key: Key
    place: Place
    beside: Callable[[str], dict[str, Any]]
    example: dict[str, Any]

    @property
    def label(self) -> str:
        return f"{self.model.__name__}.{self.name}"


@cache
def files() -> Path:
    """A folder with a file of each sort that a scene may name; removed when Python ends."""
    folder = Path(tempfile.mkdtemp(prefix="tianim-sites-"))
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    (folder / "swim").mkdir()
    for path in ("cube.obj", "swim/swim_a_1.obj", "swim/swim_a_2.obj"):
        (folder / path).write_text(CUBE)
    points = np.arange(3 * THREE, dtype=np.float32).reshape(THREE, 3)
    np.savez(folder / "points.npz", position=points, velocity=points + 1.0, mass=np.ones(THREE))
    return folder


FILES = ("cube.obj", "points.npz", "swim")


def accepts(annotation: Any, value: Any) -> bool:
    """Whether the field takes `value`, files relative to `files()`."""
    probe = create_model("Probe", __base__=Params, value=(annotation, ...))
    try:
        probe.model_validate({"value": value}, context={"folder": files()})
    except ValidationError:
        return False
    return True


def example(annotation: Any) -> Any:
    """A plain value that `annotation` takes."""
    for option in members(annotation):
        for value in candidates(option):
            if accepts(annotation, value):
                return value
    raise LookupError(f"no example for {annotation}: give the field examples=[...]")


def candidates(option: Any) -> Iterator[Any]:
    inner, metadata = peel(option)
    origin, arguments = get_origin(inner), get_args(inner)
    if origin is Literal:
        yield from arguments
    elif origin is tuple and arguments[-1] is Ellipsis:
        least = max(
            (item.min_length for item in metadata if isinstance(item, annotated_types.MinLen)), default=0
        )
        yield from ([example(arguments[0])] * length for length in (max(least, THREE), least))
    elif origin is tuple:
        yield [example(argument) for argument in arguments]
        yield [float(position) for position in range(len(arguments))]
    elif origin in MAPPINGS:
        yield from ({}, {NAME: example(arguments[1])})
    elif models(option):
        yield from map(example_of, models(option))
    elif isinstance(inner, type) and not issubclass(inner, Keyframes):
        yield from {bool: (True,), str: WORDS, Path: FILES, type(None): (None,)}.get(inner, NUMBERS)


@cache
def example_of(model: Model) -> dict[str, Any]:
    """A smallest valid mapping for `model`."""
    kind = kind_of(model)
    base: dict[str, Any] = {} if kind is None else {"kind": kind}
    fields = model.model_fields.items()
    # An example of what may be left out is for models that need one of several.
    wanted = [name for name, field in fields if field.is_required() or field.examples or name == "count"]
    for name in wanted:
        field = model.model_fields[name]
        given = field.examples or []
        choices = (*given, *(value for o in members(field_annotation(field)) for value in candidates(o)))
        taken = [value for value in choices if accepts(field_annotation(field), value)]
        # The first that the model takes too, where it is the last one wanted; else the first.
        whole = [value for value in taken if name == wanted[-1] and accepts(model, {**base, name: value})]
        base[name] = (whole or taken)[0]
    assert accepts(model, base), f"{model.__name__}: no example found, give its fields examples=[...]: {base}"
    return base


@cache
def base_bounds(kind: str) -> Mapping[str, Any]:
    """Bounds that a system of `kind` works in."""
    for bounds in BOUNDS:
        if valid(_scene({"bounds": bounds}, {"main": example_of(SYSTEMS[kind].params)})):
            return bounds
    raise LookupError(f"{kind}: none of the usual bounds will do")


def valid(scene: Mapping[str, Any]) -> bool:
    """Whether `scene` is accepted, files relative to `files()`."""
    try:
        scene_from(scene, files())
    except SceneError:
        return False
    return True


def _scene(top: Mapping[str, Any], systems: Mapping[str, Any]) -> dict[str, Any]:
    return {"tianim": 1, "systems": dict(systems), **top}


def base_scene() -> dict[str, Any]:
    """A small valid scene of the first kind of system."""
    kind = next(iter(SYSTEMS))
    return _scene({"bounds": base_bounds(kind)}, {"main": example_of(SYSTEMS[kind].params)})


def all_sites() -> list[Site]:
    """One site a field of each model; a model that stands in several places is taken once."""
    seen: set[Model] = set()

    def of_system(kind: str) -> Place:
        def place(raw: Any) -> dict[str, Any]:
            # A body with the usual name, for fields that name one.
            return _scene({"bounds": base_bounds(kind), "bodies": {NAME: {"kind": "sphere"}}}, {"main": raw})

        return place

    found: list[Site] = []
    for kind, system in SYSTEMS.items():
        found += _sites(system.params, of_system(kind), ("systems", "main"), seen)
    top = scene_model()
    for name, field in top.model_fields.items():
        annotation = field_annotation(field)
        found.append(Site(top, name, annotation, field, (name,), _top(name), _beside_top, base_scene()))
        if name != "systems":
            found += _within(annotation, _top(name), (name,), seen)
    return found


def _top(name: str) -> Place:
    return lambda raw: {**base_scene(), name: raw}


def _beside_top(name: str) -> dict[str, Any]:
    return {**base_scene(), name: 1}


def _sites(model: Model, place: Place, key: Key, seen: set[Model]) -> Iterator[Site]:
    if model in seen:
        return
    seen.add(model)
    base = example_of(model)

    def with_field(name: str) -> Place:
        return lambda value: place({**base, name: value})

    def beside(name: str) -> dict[str, Any]:
        return place({**base, name: 1})

    for name, field in model.model_fields.items():
        annotation = field_annotation(field)
        yield Site(model, name, annotation, field, (*key, name), with_field(name), beside, place(base))
        yield from _within(annotation, with_field(name), (*key, name), seen)


def _within(annotation: Any, place: Place, key: Key, seen: set[Model]) -> Iterator[Site]:
    """Sites of the models within a field, through lists and mappings."""

    def in_list(raw: Any) -> dict[str, Any]:
        return place([raw])

    def in_mapping(name: str, item: Any) -> Place:
        # Another beside it, for those that refer to each other; bodies (of many kinds) would overlap.
        beside = {OTHER_NAME: example(item)}
        alike = name == NAME and len(models(item)) == 1
        beside = beside if alike and valid(place({**beside, name: example(item)})) else {}
        return lambda raw: place({**beside, name: raw})

    for model in models(annotation):
        yield from _sites(model, place, key, seen)
    for option in members(annotation):
        inner, _ = peel(option)
        if get_origin(inner) is tuple and get_args(inner)[-1] is Ellipsis:
            yield from _within(get_args(inner)[0], in_list, (*key, 0), seen)
        elif get_origin(inner) in MAPPINGS:
            item = get_args(inner)[1]
            name = NAME if valid(place({NAME: example(item)})) else OTHER_NAME
            yield from _within(item, in_mapping(name, item), (*key, name), seen)
