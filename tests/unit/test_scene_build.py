"""From a scene to a simulation: systems with their world and seed, estimates, memory, the last checks."""

import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from stub_system import BYTES_PER_ITEM, SECONDS_PER_STEP, Stub, StubParams

from tianim.errors import SceneError
from tianim.scene import Scene, build, check_memory, scene_from, summarise
from tianim.scene import summary as summary_module
from tianim.scene.building import system_seed
from tianim.scene.models import scene_model
from tianim.scene.summary import available_memory
from tianim.systems import SYSTEMS, SystemKind

CORNERS = {"lower": [-1, -2, -3], "upper": [1, 2, 3]}


@pytest.fixture(autouse=True)
def stub_kind(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(SYSTEMS, "stub", SystemKind(StubParams, Stub))  # type: ignore[arg-type]


def scene(**top: Any) -> Scene:
    return scene_from({"tianim": 1, "systems": {"one": {"kind": "stub"}, "two": {"kind": "stub"}}, **top})


@pytest.mark.parametrize(
    ("fps", "duration", "count"), [(30, 10, 301), (24, 0, 1), (0.5, 4, 3), (29.97, 1, 31), (1000, 0.0004, 1)]
)
def test_frame_count(fps: float, duration: float, count: int) -> None:
    assert scene(fps=fps, duration=duration).frame_count == count


def test_scene_is_of_the_model_and_of_the_base() -> None:
    made = scene()
    assert isinstance(made, Scene)
    assert type(made) is scene_model()


def test_systems_get_bounds_bodies_and_a_seed_of_their_own() -> None:
    simulation = build(
        scene(bounds={"kind": "periodic", **CORNERS}, bodies={"rock": {"kind": "sphere"}}, fps=24, duration=2)
    )
    one, two = (simulation.systems[name] for name in ("one", "two"))
    assert isinstance(one, Stub)
    assert isinstance(two, Stub)
    assert (one.name, two.name) == ("one", "two")
    assert one.world.bounds.kind == "periodic"
    assert one.world.bounds.upper == (1.0, 2.0, 3.0)
    assert one.world.bodies is simulation.bodies
    assert simulation.bodies.count == 1
    assert one.world.seed != two.world.seed
    assert simulation.frame_count == 49
    assert one.world.fields is None
    few = build(scene(output={"fields": ["velocity"]})).systems["one"]
    assert few.world.fields == {"velocity"}  # type: ignore[attr-defined]


def test_seeds_are_the_same_everywhere() -> None:
    """Fixed numbers: another machine, Python or hash seed must not change a scene's randomness."""
    assert system_seed(1, "boids") == 1_609_291_035
    assert system_seed(2, "boids") != system_seed(1, "boids")
    assert system_seed(1, "2 x") != system_seed(12, " x")
    assert all(0 <= system_seed(seed, "boids") < 2**31 for seed in range(100))


def test_adding_a_system_leaves_the_seeds_of_the_others() -> None:
    alone = build(scene_from({"tianim": 1, "systems": {"one": {"kind": "stub"}}})).systems["one"]
    beside = build(scene()).systems["one"]
    assert alone.world.seed == beside.world.seed  # type: ignore[attr-defined]


def test_error_at_a_systems_start_names_the_system(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: Any) -> None:
        raise SceneError("the file has 3 points, needed are 4")

    monkeypatch.setattr(Stub, "__init__", refuse)
    with pytest.raises(SceneError, match=r"^systems\.one: the file has 3 points"):
        build(scene())


def test_summary() -> None:
    """At 30 frames a second a step of 0.01 s makes 4 substeps; 300 frames after the start."""
    summary = summarise(scene(fps=30, duration=10))
    assert summary.particles == 20
    assert summary.frames == 301
    assert summary.steps == 1200
    assert summary.seconds == 1200 * 2 * SECONDS_PER_STEP
    more = summarise(scene(systems={"one": {"kind": "stub", "count": 1_000_020}}))
    assert more.memory - summary.memory >= 1_000_000 * BYTES_PER_ITEM


def test_a_step_far_below_a_frame_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    """Such a run would end in its first frame; a start alone has no step."""
    monkeypatch.setattr(StubParams, "largest_step", lambda _: 1e-9)
    with pytest.raises(SceneError, match=r"systems\.one: .* more than 1,000,000 substeps of 1e-09 s"):
        scene(fps=30)
    assert summarise(scene(fps=1e-320, duration=0)).steps == 0


def test_scene_beyond_the_memory_is_refused_before_anything_is_allocated() -> None:
    large = scene(systems={"one": {"kind": "stub", "count": 100_000_000}})
    with pytest.raises(SceneError) as caught:
        check_memory(large, available=8_000_000_000)
    message = str(caught.value)
    assert message.startswith("the scene needs about 10")
    assert "100,000,000 particles" in message
    assert "8.0 GB" in message
    assert check_memory(large, available=200_000_000_000).particles == 100_000_000


def test_available_memory_is_known_here() -> None:
    available = available_memory()
    assert available is None or 10_000_000 < available < 1 << 50


@pytest.mark.parametrize(
    ("files", "left"),
    [
        ({"memory.max": 5000, "memory.current": 3000, "memory.stat": "anon 7\ninactive_file 400"}, 2400),
        ({"memory.max": 5000, "memory.current": 6000, "memory.stat": "anon 7"}, 0),
        ({"memory.max": "max", "memory.current": 3000, "memory.stat": ""}, None),
        (
            {
                "memory/memory.limit_in_bytes": 9000,
                "memory/memory.usage_in_bytes": 3000,
                "memory/memory.stat": "total_inactive_file 50",
            },
            6050,
        ),
        (
            {
                "memory/memory.limit_in_bytes": 9223372036854771712,
                "memory/memory.usage_in_bytes": 3000,
                "memory/memory.stat": "",
            },
            None,
        ),
        ({}, None),
    ],
    ids=["version 2", "over its limit", "no limit", "version 1", "version 1, no limit", "no container"],
)
def test_a_containers_limit_counts(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, files: dict[str, Any], left: int | None
) -> None:
    monkeypatch.setattr(summary_module, "CONTROL_GROUPS", tmp_path)
    machine = available_memory()
    assert machine is not None
    for name, content in files.items():
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text(f"{content}\n")
    if left is None:
        assert available_memory() == pytest.approx(machine, rel=0.5)  # others on this machine take and give
    else:
        assert available_memory() == left


SPHERES = {"a": {"kind": "sphere"}, "b": {"kind": "sphere", "position": [2, 0, 0]}}


@pytest.mark.parametrize(
    "bodies",
    [
        SPHERES,
        {"floor": {"kind": "plane"}, "ball": {"kind": "sphere", "position": [0, 1, 0]}},
        {
            "floor": {"kind": "plane"},
            "block": {"kind": "box", "position": [0, 0.5, 0], "rotation": [0, 30, 0]},
        },
        {"room": {"kind": "box", "inside": True, "size": [9, 9, 9]}, "ball": {"kind": "sphere"}},
        {"floor": {"kind": "plane"}, "wall": {"kind": "plane", "normal": [1, 0, 0]}},
    ],
    ids=["touching", "on the floor", "turned on the floor", "inside a container", "corner of planes"],
)
def test_bodies_may_touch(bodies: dict[str, Any]) -> None:
    scene(bodies=bodies)


def test_bodies_may_meet_later_but_not_at_the_start() -> None:
    """What is keyframed is looked at where it is at time 0."""
    away = {"keys": [[0, [5, 0, 0]], [1, [0, 0, 0]]]}
    scene(bodies={"a": {"kind": "sphere"}, "b": {"kind": "sphere", "position": away}})
    near = {"keys": [[0, [0.5, 0, 0]], [1, [9, 0, 0]]]}
    with pytest.raises(SceneError, match=r"bodies\.b: overlaps bodies\.a by 1\.5 m at time 0"):
        scene(bodies={"a": {"kind": "sphere"}, "b": {"kind": "sphere", "position": near}})


def test_systems_check_the_rest_of_the_scene() -> None:
    wish = {"kind": "pull", "body": "rock"}
    with pytest.raises(SceneError, match=r"^scene: systems\.one: no body 'rock'$"):
        scene(systems={"one": {"kind": "stub", "wishes": [wish]}})
    scene(systems={"one": {"kind": "stub", "wishes": [wish]}}, bodies={"rock": {"kind": "sphere"}})


def test_params_made_in_code_are_taken() -> None:
    params = StubParams(count=4)
    made = scene_from({"tianim": 1, "systems": {"one": params}}, overrides=["one.count=5"])
    assert made.systems["one"].particle_count() == 5
    assert params.count == 4


def test_submodules_do_not_hide_the_functions() -> None:
    """`tianim.scene.build` stays the function whatever was imported before."""
    code = (
        "import tianim.scene.building, tianim.scene.summary, tianim.scene\n"
        "from tianim.scene import build, load_scene\n"
        "print(callable(build) and callable(load_scene))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "True"
