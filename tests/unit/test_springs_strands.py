"""Strands: no wall is overlooked, length is kept on what they wrap, threads change nothing."""

import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from numpy.typing import NDArray
from pydantic import TypeAdapter

from tianim.lang import f32_1d, f32_2d, i32_1d, ti
from tianim.spatial.bodies import Bodies, BodyParams
from tianim.systems.springs.contact import met_wall
from tianim.systems.springs.strand_walls import KNOWN, look, met
from tianim.validate.build import built
from tianim.validate.springs_scenes import springs

THICKNESS, STEP = 0.01, 0.02
# The two follow a way by steps of other lengths, so that a few of those that turn about an edge find another
# plane where they enter: 0.5 % of them, and up to 0.02 m of ways of half a metre.
OTHER_PLANE, LONGEST = 0.01, 0.5


@ti.kernel
def meetings(
    n: ti.i32, table: f32_2d, samples: f32_1d, count: ti.i32, bounds: f32_2d, start: f32_2d, end: f32_2d,
    known: f32_2d, found: f32_2d, looked: i32_1d,
):  # fmt: skip
    """Depth and normal of each way, by both; whether the quicker one looked at all."""
    for i in range(n):
        a = ti.Vector([start[i, 0], start[i, 1], start[i, 2]])
        b = ti.Vector([end[i, 0], end[i, 1], end[i, 2]])
        look(table, samples, count, bounds, THICKNESS, STEP, a, known, i)
        hit, _ = met(table, samples, count, bounds, THICKNESS, STEP, a, b, known, i)
        whole, _ = met_wall(table, samples, count, bounds, THICKNESS, STEP, a, b)
        depth = ti.min(whole.w - THICKNESS, 0.0)
        looked[i] = ti.select(hit.xyz.norm_sqr() > 0.0, 1, 0)
        found[i, 0], found[i, 1] = hit.w, depth
        for c in ti.static(range(3)):
            found[i, 2 + c] = ti.select(depth < 0.0, hit[c] - whole[c], 0.0)


def test_no_wall_is_overlooked() -> None:
    """Random ways among bodies that move and turn fast: what is in reach is found, much is not looked at."""
    keys = {"interpolation": "linear", "keys": [[0, [0, 0, 0]], [1, [400, 200, 0]]]}
    paths = {"interpolation": "linear", "keys": [[0, [0.6, 0, 0]], [1, [3, 2, 0]]]}
    given: dict[str, Any] = {
        "box": {"kind": "box", "size": [0.5, 0.1, 0.3], "rotation": keys},
        "ball": {"kind": "sphere", "radius": 0.1, "position": paths},
        "floor": {"kind": "plane", "position": [0, -0.4, 0]},
    }
    one: TypeAdapter[Any] = TypeAdapter(BodyParams)
    bodies = Bodies({name: one.validate_python(body) for name, body in given.items()})
    bodies.move(0.0, STEP)
    rng = np.random.default_rng(11)
    n = 40_000
    start = rng.uniform(-0.8, 0.8, (n, 3)).astype(np.float32)
    end = (start + rng.normal(size=(n, 3)) * rng.choice([0.003, 0.03, 0.2], (n, 1))).astype(np.float32)
    bounds = np.array([[-0.9] * 3, [0.9] * 3], np.float32)
    known, found, looked = (
        np.zeros((n, KNOWN), np.float32),
        np.zeros((n, 5), np.float32),
        np.zeros(n, np.int32),
    )
    meetings(n, bodies.table, bodies.samples, bodies.count, bounds, start, end, known, found, looked)
    assert 0.05 < (found[:, 1] < 0.0).mean() < 0.95
    np.testing.assert_array_equal(found[:, 0] < 0.0, found[:, 1] < 0.0)
    same = (abs(found[:, 0] - found[:, 1]) < 1e-6) & (abs(found[:, 2:]).max(axis=1) < 1e-5)
    assert same.mean() > 1.0 - OTHER_PLANE
    assert abs(found[:, 0] - found[:, 1]).max() < 0.1 * LONGEST
    assert looked.mean() < 0.8


def even(start: Any, velocity: Any) -> dict[str, Any]:
    """A place or turn that changes evenly [1/s]."""
    end = [a + b for a, b in zip(start, velocity, strict=True)]
    return {"interpolation": "linear", "keys": [[0, list(start)], [1, end]]}


@pytest.mark.parametrize("turning", [False, True])
def test_what_is_aimed_at_a_wall_meets_it(turning: bool, tmp_path: Path) -> None:
    """Ways that end where a wall will be, and ways along with one: those that are not looked at meet none."""
    rock = trimesh.creation.icosphere(3, 0.15)
    rock.apply_translation((0.4, 0.0, 0.0))
    rock.export(tmp_path / "rock.obj")
    given: dict[str, Any] = {
        "box": {"kind": "box", "size": [0.5, 0.1, 0.3], "rotation": even((0, 0, 0), (400, 200, 0)),
                "position": even((0, 0, 0), (-1, 1, 0.5))},
        "ball": {"kind": "sphere", "radius": 0.1, "position": even((-0.5, 0, 0), (6, -2, 0))},
        "rock": {"kind": "mesh", "file": tmp_path / "rock.obj", "rotation": even((0, 0, 0), (0, 0, 700)),
                 "position": even((0, 0.1, -0.3), (-1, -3, 0))},
        "floor": {"kind": "plane", "position": [0, -0.5, 0]},
        "near": {"kind": "sphere", "radius": 0.1, "position": even((0.74, 0.4, 0.4), (4, 0, 0))},
    }  # fmt: skip
    if not turning:
        given = {name: {**body, "rotation": [0, 0, 0]} for name, body in given.items()}
        given["rock"]["position"] = [0, 0.1, -0.3]
    one: TypeAdapter[Any] = TypeAdapter(BodyParams)
    params = {name: one.validate_python(body) for name, body in given.items()}
    rng = np.random.default_rng(12)
    n = 80_000
    start, aim = rng.uniform(-0.8, 0.8, (n, 3)), rng.integers(len(params) + 1, size=n)
    way, rides = np.zeros((n, 3)), rng.uniform(size=n) < 0.3
    for b, body in enumerate(params.values()):
        alone, of = Bodies({"alone": body}), aim == b
        alone.move(0.0, STEP)
        gap, normal, _ = alone.distance(start[of])
        nearer = gap - THICKNESS - 0.01 * rng.uniform(size=len(gap))
        start[of] -= np.where(rides[of], nearer, 0.0)[:, None] * normal
        gap, normal, velocity = alone.distance(start[of])
        if b == 2:  # far from a mesh its distance is up to 5 % too far
            normal = start[of] - (0.4, 0.1, -0.3)
            gap = np.linalg.norm(normal, axis=1)
            normal /= gap[:, None]
            gap -= 0.15
        comes = STEP * (velocity * normal).sum(axis=1)
        ahead = comes - rng.uniform(0.9, 1.1, len(gap)) * (gap - THICKNESS)
        way[of] = np.where(rides[of][:, None], STEP * velocity, ahead[:, None] * normal)
    sides = np.flatnonzero(aim == len(params))
    c = rng.integers(3, size=len(sides))
    way[sides, c] = rng.uniform(0.9, 1.1, len(sides)) * (0.9 - THICKNESS - start[sides, c])
    bodies = Bodies(params)
    bodies.move(0.0, STEP)
    bounds = np.array([[-0.9] * 3, [0.9] * 3], np.float32)
    known, found, looked = (
        np.zeros((n, KNOWN), np.float32),
        np.zeros((n, 5), np.float32),
        np.zeros(n, np.int32),
    )
    start, end = start.astype(np.float32), (start + way).astype(np.float32)
    meetings(n, bodies.table, bodies.samples, bodies.count, bounds, start, end, known, found, looked)
    assert 0.1 < (looked == 0).mean() < 0.5
    assert 0.2 < (found[:, 1] < 0.0).mean() < 0.8
    np.testing.assert_array_equal(found[looked == 0, 1], 0.0)
    if not turning:  # a wall that turns may be grazed by steps of one length, and not by those of another
        np.testing.assert_array_equal(found[found[:, 1] < 0.0, 0] < 0.0, True)


def shaken(count: int) -> Any:
    """Hair on a head that turns to and fro, as in the scene of that name."""
    turn = {"interpolation": "pchip", "keys": [[0, [0, 0, 0]], [0.3, [0, 70, 0]], [0.8, [0, -70, 0]]]}
    hair = {
        "kind": "strands",
        "count": count,
        "length": 0.26,
        "axis": (0, 1, -0.45),
        "angle": 88,
        "bend": 4e-8,
    }
    return springs(
        hair, {"head": {"kind": "sphere", "radius": 0.1, "rotation": turn}}, gravity=(0.0, -9.81, 0.0),
        pins={"scalp": {"piece": "p", "points": "roots", "body": "head"}},
        contact={"thickness": 0.002, "friction": 0.25}, air={"density": 0.0, "drag": 0.6},
    )  # fmt: skip


def test_what_wraps_a_head_keeps_its_length_and_its_distance() -> None:
    system, free, near = shaken(60), np.ones(60 * 32, np.bool_), 0
    dt = 1.0 / 120.0
    for step in range(120):
        system.world.bodies.move(step * dt, dt)
        system.step(step * dt, dt)
        if step == 0:
            free = ~system.pins.held
        x = system.read("position")
        gap = np.linalg.norm(x, axis=1)[free] - 0.1
        near += int((gap < 0.0021).sum())
        assert gap.min() > 0.00199
        assert np.abs(system.report.strains(x)[0]).max() < 0.0101
    assert near > 5000


def test_a_rope_that_does_not_bend_is_not_stiffened_by_one_that_does() -> None:
    """Both in one system move as each does alone, though the strands share their rows of equations."""

    def swung(pieces: dict[str, float]) -> dict[str, NDArray[np.float64]]:
        ropes = {
            name: {"kind": "rope", "points": [(0, 0, z), (0.6, 0.3, z)], "segments": 24, "bend": bend}
            for z, (name, bend) in enumerate(pieces.items())
        }
        pins = {name: {"piece": name, "points": "first"} for name in pieces}
        system = built("springs", pieces=ropes, pins=pins, solver="strands", air={"density": 0.0})
        for step in range(60):
            system.step(step * STEP, STEP)
        x = system.read("position")
        first = system.whole.first
        return {name: x[first[name] : first[name] + 25] - x[first[name]] for name in pieces}

    for order in (("stiff", "limp"), ("limp", "stiff")):
        bends = {name: 1e-3 if name == "stiff" else 0.0 for name in order}
        both = swung(bends)
        for name in order:
            np.testing.assert_allclose(both[name], swung({name: bends[name]})[name], rtol=0.0, atol=1e-12)
        assert np.abs(both["stiff"] - both["limp"]).max() > 0.01


PROGRAM = """
import hashlib, sys
from tianim import runtime
runtime.start(threads=int(sys.argv[1]))
sys.path.insert(0, sys.argv[2])
from test_springs_strands import shaken
system = shaken(30)
for step in range(60):
    system.world.bodies.move(step / 120, 1 / 120)
    system.step(step / 120, 1 / 120)
print(hashlib.sha256(system.read("position").tobytes()).hexdigest())
"""


COILED = """
import hashlib, sys
from tianim import runtime
runtime.start(threads=int(sys.argv[1]))
sys.path.insert(0, sys.argv[2])
from test_springs_strand_contact import ropes, steps
rope = {"points": [(0, 0.05, 0), (0.004, 0.7, 0.002)], "segments": 65, "bend": 3e-4}
system = ropes({"p": rope}, {"floor": {"kind": "plane"}}, friction=0.4)
for _ in steps(system, 90):
    pass
assert system.diagnostics()["self_contacts"] > 50
print(hashlib.sha256(system.read("position").tobytes()).hexdigest())
"""


@pytest.mark.parametrize(
    "program", [PROGRAM, pytest.param(COILED, marks=pytest.mark.slow)], ids=["walls", "each other"]
)
def test_bytes_do_not_depend_on_the_number_of_threads(program: str, request: pytest.FixtureRequest) -> None:
    found = {
        subprocess.run(
            [sys.executable, "-c", program, threads, str(request.path.parent)],
            capture_output=True, text=True, check=True,
        ).stdout.split()[-1]
        for threads in ("1", "2")
    }  # fmt: skip
    assert len(found) == 1
