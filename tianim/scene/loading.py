"""Scene files: finding them, and reading YAML, TOML or JSON strictly by suffix.

Every mistake is a SceneError of one line that names the file, and the line where it is known.
"""

import json
import os
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from tianim.errors import SceneError
from tianim.scene.fields import Key, nearest
from tianim.scene.yaml_reader import PlainData, ReadError, check_size, duplicate, number, read_yaml

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

# A scene is text of some kilobytes; what is larger is not one.
LARGEST_FILE = 10_000_000
# Scenes that come with the project stand beside the package.
PACKAGED = Path(__file__).resolve().parents[2] / "configs"


@dataclass(frozen=True)
class Document:
    """A scene as it was written: plain data, and where each part of it came from."""

    data: Any
    name: str = "scene"
    folder: Path | None = None
    lines: dict[Key, int] = field(default_factory=dict)


@dataclass(frozen=True)
class SceneFile:
    """A scene that can be run, for `tianim list`."""

    name: str
    path: Path
    title: str
    description: str


def read(scene: str | Path) -> Document:
    """The scene file at a path, or the packaged one of that name (`murmuration`)."""
    path = find(scene)
    text = _text(path)
    try:
        plain = READERS[path.suffix.lower()](text)
    except ReadError as error:
        where = f"{path}:{error.line}" if error.line is not None else f"{path}"
        raise SceneError(f"{where}: {error.reason}") from None
    if plain.data is None:
        raise SceneError(f"{path}: empty; a scene is a mapping that begins with `tianim: 1`")
    if not isinstance(plain.data, dict):
        raise SceneError(f"{path}: a scene must be a mapping, not {_kind(plain.data)}")
    return Document(plain.data, str(path), path.resolve().parent, plain.lines)


def find(scene: str | Path) -> Path:
    """The file that `scene` means: a path, or the name of a scene in a `configs` folder."""
    if not str(scene).strip():
        raise SceneError("no scene: give the path of a scene file, or a name that `tianim list` shows")
    if not str(scene).isprintable():
        raise SceneError(
            f"{str(scene)[:60]!r}: not a path of a scene: it has characters that cannot be printed"
        )
    path = Path(scene)
    suffixes = ", ".join(READERS)
    try:
        exists, is_folder, is_file = path.exists(), path.is_dir(), path.is_file()
    except (OSError, ValueError) as error:  # too long
        raise SceneError(f"{str(scene)[:60]!r}: not a path of a scene: {_reason(error)}") from None
    if path.suffix.lower() in READERS and is_file:
        return path
    if path.parent == Path() and path.suffix.lower() not in READERS and not is_file:
        return _by_name(str(scene), is_folder)
    if is_folder:
        raise SceneError(f"{path}: a folder, not a scene file ({suffixes})")
    if not exists:
        beside = [other.name for other in _scene_files(path.parent)]
        like = nearest(path.name, beside)
        raise SceneError(f"{path}: no such file" + (f"; did you mean {path.parent / like}?" if like else ""))
    if not is_file:
        raise SceneError(f"{path}: not a regular file")
    raise SceneError(f"{path}: a scene file must end in {suffixes}")


def _by_name(name: str, is_folder: bool) -> Path:
    known = {path.stem: path for path in _all_scenes()}
    if name in known:
        return known[name]
    if is_folder:
        raise SceneError(f"{name}: a folder, not a scene file ({', '.join(READERS)})")
    like = nearest(name, known)
    hint = f"did you mean {like!r}?" if like else "`tianim list` shows those there are"
    raise SceneError(f"no scene {name!r}; {hint}")


def find_scenes() -> list[SceneFile]:
    """The scenes in `configs` of the current folder and of the project, by name; unreadable ones too."""
    return sorted(map(_listed, _all_scenes()), key=lambda scene: scene.name)


def _listed(path: Path) -> SceneFile:
    try:
        data = read(path).data
    except SceneError as error:
        return SceneFile(path.stem, path, "", str(error))
    return SceneFile(
        path.stem, path, *(" ".join(str(data.get(key, "")).split()) for key in ("title", "description"))
    )


def _all_scenes() -> Iterator[Path]:
    """Those of the current folder first: they go before the packaged ones of the same name."""
    seen = set()
    for folder in (Path("configs"), PACKAGED):
        for path in _scene_files(folder):
            if path.stem not in seen:
                seen.add(path.stem)
                yield path


def _scene_files(folder: Path) -> list[Path]:
    try:
        return sorted(path for path in folder.iterdir() if path.suffix.lower() in READERS and path.is_file())
    except OSError:
        return []


def _text(path: Path) -> str:
    try:
        size = path.stat().st_size
        if size > LARGEST_FILE:
            raise SceneError(
                f"{path}: {size / 1e6:.0f} MB; a scene file may have {LARGEST_FILE / 1e6:.0f} MB"
            )
        return path.read_bytes().decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise SceneError(f"{path}: not a text file (UTF-8): byte {error.start} cannot be read") from None
    except OSError as error:
        raise SceneError(f"{path}: cannot be read: {_reason(error)}") from None


def _reason(error: Exception) -> str:
    return os.strerror(error.errno) if isinstance(error, OSError) and error.errno else str(error)


def _kind(data: Any) -> str:
    return {list: "a list", str: "text", bool: "true or false"}.get(type(data), "a number")


def _read_toml(text: str) -> PlainData:
    try:
        data = tomllib.loads(text, parse_float=number)
    except (ValueError, RecursionError) as error:
        raise ReadError(f"not valid TOML: {_shorter(error)}") from None
    check_size(data)
    return PlainData(data or None)


def _read_json(text: str) -> PlainData:
    if not text.strip():
        return PlainData(None)
    try:
        data = json.loads(
            text, object_pairs_hook=_unique, parse_float=number, parse_int=number, parse_constant=_no_constant
        )
    except json.JSONDecodeError as error:
        raise ReadError(f"not valid JSON: {error.msg}", error.lineno) from None
    except RecursionError as error:
        raise ReadError(f"not valid JSON: {_shorter(error)}") from None
    check_size(data)
    return PlainData(data)


def _unique(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    data: dict[str, Any] = {}
    for key, value in pairs:
        if key in data:
            raise ReadError(duplicate((), key))
        data[key] = value
    return data


def _no_constant(word: str) -> float:
    raise ReadError(f"not valid JSON: {word} is not a number that JSON has")


def _shorter(error: Exception) -> str:
    return "nested too deep" if isinstance(error, RecursionError) else " ".join(str(error).split())


READERS: dict[str, Callable[[str], PlainData]] = {
    ".yaml": read_yaml,
    ".yml": read_yaml,
    ".toml": _read_toml,
    ".json": _read_json,
}
