"""What a scene file may hold: the JSON schema for editors, the fields for the docs and for tests."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, get_args, get_origin

from pydantic.fields import FieldInfo

from tianim.scene.fields import (
    MAPPINGS,
    Key,
    Model,
    field_annotation,
    keyframes,
    kind_of,
    members,
    models,
    peel,
    words,
)
from tianim.scene.models import scene_model


def json_schema() -> dict[str, Any]:
    """The JSON schema of a scene, for an editor's completion and checks.

    It is a little wider than the loader: rules between fields (a lower corner below the upper) are not in it.
    """
    schema = scene_model().model_json_schema()
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", **schema, "title": "tianim scene"}


@dataclass(frozen=True)
class Described:
    """One field of a model: where it is, and what it takes."""

    path: Key
    annotation: Any
    field: FieldInfo

    @property
    def words(self) -> str:
        """What the field takes, in words."""
        return words(self.annotation)

    @property
    def required(self) -> bool:
        """True where the field has no default."""
        return self.field.is_required()

    @property
    def default(self) -> Any:
        """The default; None where the field is required."""
        return None if self.required else self.field.get_default(call_default_factory=True)

    @property
    def description(self) -> str:
        """One line, with the unit in brackets."""
        return self.field.description or ""

    @property
    def animatable(self) -> bool:
        """True where the field may be keyframed."""
        return keyframes(self.annotation) is not None


def describe(model: Model, path: Key = (), seen: frozenset[Model] = frozenset()) -> Iterator[Described]:
    """Each field of `model` and of the models within it, depth first.

    In a path, the kind of a union's member stands after the field (`bounds`, `periodic`,
    `lower`), `*` for the names of a mapping and the items of a list. A model within itself is
    described once.
    """
    for name, field in model.model_fields.items():
        annotation = field_annotation(field)
        yield Described((*path, name), annotation, field)
        for steps, inner in nested(annotation):
            if inner not in seen and inner is not model:
                yield from describe(inner, (*path, name, *steps), seen | {model})


def nested(annotation: Any) -> Iterator[tuple[Key, Model]]:
    """The models within `annotation`, each with the steps that lead to it; keyframes aside."""
    found = models(annotation)
    for model in found:
        yield ((kind_of(model) or model.__name__,) if len(found) > 1 else ()), model
    for option in members(annotation):
        inner, _ = peel(option)
        if get_origin(inner) in (*MAPPINGS, tuple):
            items = get_args(inner)[1:] if get_origin(inner) in MAPPINGS else dict.fromkeys(get_args(inner))
            for item in items:
                yield from ((("*", *steps), model) for steps, model in nested(item))
