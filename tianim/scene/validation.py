"""From plain data to a Scene, or to one SceneError that says what is wrong."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from tianim.errors import SceneError
from tianim.scene.checks import problems_between
from tianim.scene.errors import problems_of, scene_error
from tianim.scene.loading import Document, read
from tianim.scene.models import Scene, scene_model
from tianim.scene.overrides import Overrides, apply
from tianim.scene.yaml_reader import ReadError, check_size


def load_scene(path: str | Path, overrides: Overrides = ()) -> Scene:
    """The scene of a file, or the packaged one of that name, with `key=value` overrides.

    Raises SceneError of one or two lines that name file, line, key and what is allowed.
    """
    return _validated(read(path), overrides)


def scene_from(data: Mapping[str, Any], folder: str | Path | None = None, overrides: Overrides = ()) -> Scene:
    """A scene from plain data; files that it names are relative to `folder` (default: the current one).

    Raises SceneError as `load_scene` does.
    """
    if not isinstance(data, Mapping):
        raise SceneError(f"scene: must be a mapping, not {type(data).__name__}")
    try:
        check_size(dict(data))
    except ReadError as error:
        raise SceneError(f"scene: {error.reason}") from None
    base = Path.cwd() if folder is None else Path(folder).resolve()
    return _validated(Document(dict(data), folder=base), overrides)


def _validated(document: Document, overrides: Overrides) -> Scene:
    model = scene_model()
    data, texts = apply(document.data, overrides, model)
    try:
        scene = model.model_validate(data, context={"folder": document.folder})
    except ValidationError as error:
        raise scene_error(problems_of(error, data, model), document, texts) from None
    problems = problems_between(scene)
    if problems:
        raise scene_error(problems, document, texts)
    return scene
