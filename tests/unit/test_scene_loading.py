"""Scene files: the same data from YAML, TOML and JSON, numbers as people write them, scenes by name."""

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from tianim.errors import SceneError
from tianim.scene import find_scenes, load_scene, loading, scene_from
from tianim.scene.loading import read
from tianim.scene.yaml_reader import MOST_VALUES, ReadError, check_size, read_yaml

YAML = """
tianim: 1
title: A few boids
seed: 7
fps: 25
duration: 1e1
bounds: {kind: periodic, lower: [-4, -4, -4], upper: [1.5, 1e0, 2.5e-1]}
systems:
  boids:
    kind: boids
    count: 1e2
"""
TOML = """
tianim = 1
title = "A few boids"
seed = 7
fps = 25
duration = 1e1
bounds = {kind = "periodic", lower = [-4, -4, -4], upper = [1.5, 1e0, 2.5e-1]}
[systems.boids]
kind = "boids"
count = 1e2
"""
DATA = {
    "tianim": 1,
    "title": "A few boids",
    "seed": 7,
    "fps": 25,
    "duration": 10,
    "bounds": {"kind": "periodic", "lower": [-4, -4, -4], "upper": [1.5, 1, 0.25]},
    "systems": {"boids": {"kind": "boids", "count": 100}},
}


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("a.yaml", YAML),
        ("a.yml", YAML),
        ("A.YAML", YAML),
        ("a.toml", TOML),
        ("a.json", json.dumps(DATA)),
        ("a.json", "\ufeff" + json.dumps(DATA)),
        ("a.json", json.dumps(DATA).replace("100", "1e2")),
    ],
)
def test_all_formats_give_one_scene(name: str, text: str, tmp_path: Path) -> None:
    path = tmp_path / name
    path.write_text(text, encoding="utf-8")
    assert load_scene(path) == scene_from(DATA)
    assert load_scene(str(path)) == scene_from(DATA)


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("1e-2", 0.01),
        ("1e5", 100_000),
        ("1.5e3", 1500),
        ("-2E+2", -200),
        ("1.5e-3", 0.0015),
        ("1e400", float("inf")),
        ("1.", 1.0),
        (".5", 0.5),
        ("10", 10),
        ("010", 10),
        ("1_000_000", 1_000_000),
        ("0x10", 16),
        ("+3", 3),
        (".inf", float("inf")),
        ("true", True),
        ("null", None),
        ("", None),
        ("~", None),
        ("no", "no"),
        ("on", "on"),
        ("1:30", "1:30"),
        ("2001-01-01", "2001-01-01"),
        ("nan", "nan"),
        ("'1e5'", "1e5"),
        ('"true"', "true"),
        ("[1, 2.5, a]", [1, 2.5, "a"]),
        ("{kind: open}", {"kind": "open"}),
    ],
)
def test_yaml_values(text: str, value: Any) -> None:
    read_value = read_yaml(text).data
    assert read_value == value
    assert type(read_value) is type(value), "100 and 100.0 are equal, but only one is a count"


def test_yaml_lines_are_those_of_the_keys() -> None:
    plain = read_yaml("a: 1\n\nb:\n  c: [1,\n    2]\n  d: 3\n")
    assert plain.lines == {
        (): 1,
        ("a",): 1,
        ("b",): 3,
        ("b", "c"): 4,
        ("b", "c", 0): 4,
        ("b", "c", 1): 5,
        ("b", "d"): 6,
    }


def test_yaml_aliases_are_copies() -> None:
    data = read_yaml("a: &x {k: [1]}\nb: *x\n").data
    assert data == {"a": {"k": [1]}, "b": {"k": [1]}}
    assert data["a"] is not data["b"]


def test_size_limits_hold_for_data_from_code() -> None:
    check_size({"a": [0] * (MOST_VALUES - 2)})
    with pytest.raises(ReadError, match="more than"):
        check_size({"a": [0] * MOST_VALUES})
    circle: list[Any] = []
    circle.append(circle)
    with pytest.raises(SceneError, match="nested deeper"):
        scene_from({**DATA, "title": circle})
    with pytest.raises(SceneError, match="seed = an integer of 16610 bits: must be less than"):
        scene_from({**DATA, "seed": 10**5000})
    with pytest.raises(SceneError, match="must be a mapping"):
        scene_from([])  # type: ignore[arg-type]


def test_files_are_relative_to_the_scene_not_to_the_current_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = tmp_path / "scenes"
    folder.mkdir()
    (folder / "rock.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    (folder / "a.yaml").write_text(YAML + "bodies:\n  rock: {kind: mesh, file: rock.obj, thickness: 0.2}\n")
    monkeypatch.chdir(tmp_path)
    body = load_scene("scenes/a.yaml").bodies["rock"]
    assert body.model_dump()["file"] == folder / "rock.obj"


@pytest.fixture
def folders(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Scenes in ./configs, and others that come with the package."""
    packaged = tmp_path / "packaged"
    for path, title in (
        ("configs/swarm.yaml", "Mine"),
        ("packaged/swarm.yaml", "Theirs"),
        ("packaged/school.toml", "School"),
    ):
        (tmp_path / path).parent.mkdir(exist_ok=True)
        text = (
            YAML.replace("A few boids", title)
            if path.endswith("yaml")
            else TOML.replace("A few boids", title)
        )
        (tmp_path / path).write_text(text)
    (tmp_path / "configs/broken.yaml").write_text("a: [")
    (tmp_path / "configs/notes.txt").write_text("not a scene")
    monkeypatch.setattr(loading, "PACKAGED", packaged)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_scenes_by_name(folders: Path) -> None:
    assert load_scene("swarm").title == "Mine"
    assert load_scene("school").title == "School"
    with pytest.raises(SceneError, match="no scene 'schol'; did you mean 'school'"):
        load_scene("schol")


def test_a_folder_of_that_name_does_not_hide_a_scene(folders: Path) -> None:
    (folders / "school").mkdir()
    assert load_scene("school").title == "School"


def test_list_shows_every_scene_and_says_what_is_broken(folders: Path) -> None:
    found = {scene.name: scene for scene in find_scenes()}
    assert {name: scene.title for name, scene in found.items()} == {
        "broken": "",
        "school": "School",
        "swarm": "Mine",
    }
    assert "not valid YAML" in found["broken"].description


def test_unreadable_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "a.yaml"
    path.write_text(YAML)

    def denied(self: Path) -> bytes:
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(Path, "read_bytes", denied)
    with pytest.raises(SceneError, match=r"a\.yaml: cannot be read: Permission denied"):
        read(path)


def test_listing_scenes_starts_no_compiler() -> None:
    """`tianim list` answers at once: it needs neither kernels nor their compiler."""
    code = "import sys; from tianim.scene import find_scenes; find_scenes(); print('taichi' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "False"
