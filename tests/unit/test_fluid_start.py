"""The fluid at the start: blocks are filled as they say, and what cannot be is refused in one line."""

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from fluid_scenes import (
    OPEN,
    bodies,
    box,
    contained,
    filled,
    fluid,
    nearest_neighbour,
    write_box_mesh,
)
from pydantic import ValidationError

from tianim.errors import SceneError
from tianim.system import Bounds

D = 0.1  # the spacing of all these fluids [m]
# Positions are float32: of the order of a metre, they are this exact [m].
EXACT = 1e-6
RHO_G = 1000.0 * 9.81
CUBE = box((0, 0, 0), (1, 1, 1))


def axis(x: np.ndarray[Any, Any], c: int) -> np.ndarray[Any, Any]:
    """The different coordinates along an axis, rising."""
    return np.unique(np.round(x[:, c].astype(np.float64), 5))


@pytest.mark.parametrize("lower", [(0.0, 0.0, 0.0), (-3.7, 12.3, 0.05)])
def test_a_box_of_whole_spacings_is_filled_exactly(lower: tuple[float, float, float]) -> None:
    """Also where rounding makes 0.7 / 0.1 a little less than 7."""
    upper = tuple(a + n * D for a, n in zip(lower, (10, 3, 7), strict=True))
    x = filled(blocks={"a": box(lower, upper)}).position
    assert x.shape == (210, 3)
    for c, count in enumerate((10, 3, 7)):
        np.testing.assert_allclose(axis(x, c), lower[c] + D * (np.arange(count) + 0.5), atol=1e-5)
    assert fluid(blocks={"a": box(lower, upper)}).block_count() == 210
    assert fluid(blocks={"a": box((0, 0, 0), (0.3, 0.6, 0.7))}).block_count() == 3 * 6 * 7


def test_a_box_takes_as_many_layers_as_fit() -> None:
    x = filled(blocks={"a": box((0, 0, 0), (0.59, 0.39, 0.21))}).position
    assert [len(axis(x, c)) for c in range(3)] == [5, 3, 2]
    np.testing.assert_allclose(x.min(axis=0), 0.5 * D, atol=EXACT)


def test_in_two_dimensions_z_counts_for_nothing() -> None:
    blocks = {"a": box((0, 0, 5), (1, 0.5, 6)), "b": {"kind": "sphere", "centre": (2, 0, 9), "radius": 0.3}}
    start = filled(dimension=2, blocks=blocks)
    assert len(start.position) == 50 + 29
    assert not start.position[:, 2].any()


def test_a_ball_has_its_volume_and_its_centre() -> None:
    x = filled(blocks={"a": {"kind": "sphere", "centre": (1.03, 2.0, 0.5), "radius": 0.8}}).position
    assert len(x) * D**3 == pytest.approx(4 / 3 * np.pi * 0.8**3, rel=0.02)
    np.testing.assert_allclose(x.mean(axis=0), (1.03, 2.0, 0.5), atol=1e-5)
    assert np.linalg.norm(x - np.array((1.03, 2.0, 0.5)), axis=1).max() < 0.8 + EXACT


@pytest.mark.parametrize(("rotation", "seen"), [((0, 0, 0), (6, 4, 10)), ((0, 0, 90), (4, 6, 10))])
def test_a_mesh_is_filled_inside(tmp_path: Path, rotation: tuple[float, ...], seen: tuple[int, ...]) -> None:
    file = write_box_mesh(tmp_path / "box.off", (0.3, 0.2, 0.5))
    block = {"kind": "mesh", "file": file, "scale": 2.0, "position": (1, 2, 3), "rotation": rotation}
    x = filled(blocks={"a": block}).position
    assert tuple(len(axis(x, c)) for c in range(3)) == seen
    np.testing.assert_allclose(x.mean(axis=0), (1, 2, 3), atol=1e-5)
    assert fluid(blocks={"a": block}).block_count() == len(x) == 240


def test_a_turned_mesh_keeps_its_volume(tmp_path: Path) -> None:
    file = write_box_mesh(tmp_path / "box.off", (1.0, 1.0, 1.0))
    x = filled(blocks={"a": {"kind": "mesh", "file": file, "rotation": (20, 40, 10)}}).position
    assert len(x) * D**3 == pytest.approx(1.0, rel=0.05)
    np.testing.assert_allclose(nearest_neighbour(x), D, atol=1e-5)


def test_a_mesh_is_cut_by_the_plane_in_two_dimensions(tmp_path: Path) -> None:
    file = write_box_mesh(tmp_path / "box.off", (1.0, 0.5, 0.3))
    assert len(filled(dimension=2, blocks={"a": {"kind": "mesh", "file": file}}).position) == 50


def test_points_stand_where_they_are_given(tmp_path: Path) -> None:
    position = np.array([[0.0, 0, 0], [0.5, 0, 0], [0.0, 0.7, 0.2]])
    np.savez(tmp_path / "drops.npz", position=position, velocity=2.0 * position)
    listed = filled(blocks={"a": {"kind": "points", "positions": position.tolist()}})
    np.testing.assert_allclose(listed.position, position, atol=EXACT)
    block = {"kind": "points", "file": tmp_path / "drops.npz", "velocity": (0, 1, 0)}
    read = filled(blocks={"a": block})
    np.testing.assert_allclose(read.velocity, 2.0 * position + [0, 1, 0], atol=EXACT)


def test_blocks_have_velocities_and_phases() -> None:
    start = filled(
        phases={"oil": {"density": 900.0}, "tar": {"density": 1200.0}},
        blocks={
            "a": box((0, 0, 0), (0.2, 0.1, 0.1), velocity=(1, 2, 3)),
            "b": box((1, 0, 0), (1.3, 0.1, 0.1), phase="tar"),
        },
    )
    np.testing.assert_array_equal(start.phase, [0, 0, 2, 2, 2])
    np.testing.assert_array_equal(start.velocity, [[1, 2, 3]] * 2 + [[0, 0, 0]] * 3)
    assert not start.pressure.any()


def test_a_settled_column_has_the_pressure_of_rest() -> None:
    """Under a step too: each column by the surface over it; what is not settled weighs but gets none."""
    start = filled(
        blocks={
            "low": box((0, 0, 0), (1, 1, 0.5), settled=True),
            "on": box((0, 1, 0), (0.5, 1.5, 0.5)),
            "drop": box((0, 3, 0), (0.2, 3.2, 0.2), settled=True),
        }
    )
    x, y, _ = start.position.T
    surface = np.where(y > 2.5, 3.2, np.where(x < 0.5, 1.5, 1.0))
    expected = np.where((y > 1.0) & (y < 2.5), 0.0, RHO_G * (surface - y))
    np.testing.assert_allclose(start.pressure, expected, rtol=1e-5, atol=0.1)


@pytest.mark.parametrize("dimension", [2, 3])
def test_pressure_of_rest_goes_by_the_phases_and_by_gravity(dimension: int) -> None:
    """Oil of 0.4 m on water; gravity points to +x, so that depth counts from the left."""
    start = filled(
        dimension=dimension,
        gravity=(5, 0, 0),
        phases={"oil": {"density": 800.0}},
        blocks={
            "water": box((0.4, 0, 0), (1, 0.3, 0.3), settled=True),
            "oil": box((0, 0, 0), (0.4, 0.3, 0.3), settled=True, phase="oil"),
        },
    )
    x = start.position[:, 0]
    expected = 5.0 * np.where(x < 0.4, 800.0 * x, 800.0 * 0.4 + 1000.0 * (x - 0.4))
    # Over the two half layers that meet, the density is the mean of both: exact at the particles.
    np.testing.assert_allclose(start.pressure, expected, rtol=1e-5)


def test_under_a_body_the_pressure_is_that_beside_it() -> None:
    plate = bodies(plate={"kind": "box", "size": (0.4, 0.2, 2.0), "position": (0.5, 0.7, 0.5)})
    pool = {"a": box((0, 0, 0), (1, 1, 1), settled=True, carve=True)}
    start = filled(contained((0, 0, 0), (1, 2, 1)), plate, blocks=pool)
    np.testing.assert_allclose(start.pressure, RHO_G * (1.0 - start.position[:, 1]), rtol=1e-4)
    assert len(start.position) == 1000 - 4 * 2 * 10


def test_what_is_carved_leaves_out_bodies_and_earlier_blocks() -> None:
    ball = bodies(ball={"kind": "sphere", "radius": 0.3, "position": (0.5, 0.5, 0.5)})
    start = filled(
        contained((0, 0, 0), (1, 1, 1)),
        ball,
        phases={"oil": {"density": 900.0}},
        blocks={
            "drop": {"kind": "sphere", "centre": (0.2, 0.2, 0.2), "radius": 0.15, "phase": "oil"},
            "rest": box((0, 0, 0), (1, 1, 1), carve=True),
        },
    )
    assert np.linalg.norm(start.position - 0.5, axis=1).min() > 0.3 + 0.5 * D - 1e-3 * D
    assert nearest_neighbour(start.position).min() > (0.5 - 1e-3) * D
    water = start.position[start.phase == 0]
    assert np.linalg.norm(water - 0.2, axis=1).min() > 0.15 - 1e-3 * D
    lattice = (np.indices((10, 10, 10)).reshape(3, -1).T + 0.5) * D
    free = (np.linalg.norm(lattice - 0.5, axis=1) > 0.3 + 0.5 * D) & (
        np.linalg.norm(lattice - 0.2, axis=1) > 0.15
    )
    assert len(water) == free.sum() == 832


def test_blocks_that_touch_one_another_and_the_walls_are_welcome() -> None:
    """Rounding too: a box pushed 1e-4 of a spacing into the floor, a ball that rests on the pool."""
    floor = bodies(
        floor={"kind": "plane"},
        tank={"kind": "box", "size": (2, 2, 2), "position": (1, 1, 1), "inside": True},
    )
    start = filled(
        contained((0, 0, 0), (2, 2, 2)),
        floor,
        blocks={
            "left": box((0, -1e-5, 0), (0.5, 0.5, 2)),
            "right": box((0.5, 0, 0), (2, 0.5, 2)),
            "drop": {"kind": "sphere", "centre": (1, 0.8, 1), "radius": 0.3},
        },
    )
    assert len(start.position) == 2000 + 123


SPHERE = {"kind": "sphere", "centre": (0.5, 0.5, 0.5), "radius": 0.3}
IN_THE_WAY: dict[str, tuple[dict[str, Any], Bounds, tuple[str, ...]]] = {
    "a body in a box": (
        {"a": CUBE},
        OPEN,
        ("blocks.a: 32 of its 1,000 particles", "bodies.ball", "first at (0.35, 0.45, 0.45)", "carve"),
    ),
    "a box half in the floor": (
        {"a": box((3, -0.05, 3), (4, 0.95, 4))},
        contained((-5, 0, -5), (5, 5, 5)),
        ("blocks.a: 100 of its 1,000 particles", "the bounds", "(3.05, 0, 3.05)"),
    ),
    "a ball that is half out of the bounds": (
        {"a": {**SPHERE, "centre": (5, 2, 0)}},
        contained((-5, 0, -5), (5, 5, 5)),
        ("blocks.a: 76 of its 123 particles", "the bounds"),
    ),
    "two boxes that overlap by a fifth of a spacing": (
        {"a": box((3, 0, 3), (4, 1, 4)), "b": box((3.98, 0, 3), (4.98, 1, 4))},
        OPEN,
        ("blocks.b: 100 of its 1,000 particles overlap blocks.a", "(4.03, 0.05, 3.05)"),
    ),
    "a ball in a box": (
        {"a": box((3, 0, 3), (4, 1, 4)), "b": {**SPHERE, "centre": (3.55, 1.02, 3.55)}},
        OPEN,
        ("blocks.b: 47 of its 123 particles overlap blocks.a",),
    ),
    "a box between the points of a ball": (
        {"a": {**SPHERE, "centre": (3, 3, 3)}, "b": box((2.9, 2.9, 2.9), (3.1, 3.1, 3.1))},
        OPEN,
        ("blocks.b: 8 of its 8 particles overlap blocks.a",),
    ),
    "points twice": (
        {
            "a": box((3, 0, 3), (4, 1, 4)),
            "b": {"kind": "points", "positions": ((9, 0, 0), (3.56, 0.56, 3.56))},
        },
        OPEN,
        ("blocks.b: 1 of its 2 particles overlap blocks.a, the first at (3.56, 0.56, 3.56)",),
    ),
    "points on one another": (
        {"a": {"kind": "points", "positions": ((3, 0, 0), (4, 0, 0), (4, 0, 0))}},
        OPEN,
        ("blocks.a: 2 of its 3 particles are nearer than 0.01 spacings to another", "first at (4, 0, 0)"),
    ),
    "too far away for float32": (
        {"a": box((1e5, 0, 0), (1e5 + 1, 1, 1))},
        OPEN,
        ("blocks.a: reaches 100001 m away from the origin, where places are exact to 0.0078 m only",),
    ),
    "nothing at all": (
        {"a": {"kind": "sphere", "radius": 1e-3, "centre": (0.5, 3, 0.5)}, "b": CUBE},
        OPEN,
        ("blocks.b",),
    ),
}


@pytest.mark.parametrize("case", IN_THE_WAY)
def test_what_starts_in_the_way_is_counted_and_its_place_named(case: str) -> None:
    blocks, bounds, words = IN_THE_WAY[case]
    ball = bodies(ball={"kind": "sphere", "radius": 0.15, "position": (0.5, 0.5, 0.5)})
    with pytest.raises(SceneError) as caught:
        filled(bounds, ball, blocks=blocks)
    message = str(caught.value)
    assert "\n" not in message
    for word in words:
        assert word in message


def test_a_mesh_that_overlaps_is_noticed_between_its_particles(tmp_path: Path) -> None:
    file = write_box_mesh(tmp_path / "box.off", (1.0, 1.0, 1.0))
    mesh = {"kind": "mesh", "file": file, "position": (0.52, 1.44, 0.52)}
    for blocks in ({"a": CUBE, "b": mesh}, {"a": mesh, "b": CUBE}):
        with pytest.raises(SceneError, match=r"blocks\.b: 100 of its 1,000 particles overlap blocks\.a"):
            filled(blocks=blocks)


def test_a_fluid_of_which_nothing_is_left_is_refused() -> None:
    hull = bodies(hull={"kind": "sphere", "radius": 9})
    carved = {"blocks": {"a": {**CUBE, "carve": True}}}
    with pytest.raises(SceneError, match=r"blocks: carve leaves out all .* particles, and there is no emit"):
        filled(OPEN, hull, **carved)
    hose = {"kind": "disc", "radius": 0.25, "position": (0, 20, 0), "speed": 1.0, "end": 9.0}
    assert len(filled(OPEN, hull, **carved, emitters={"hose": hose}).position) == 0


def test_blocks_over_capacity_are_refused() -> None:
    with pytest.raises(SceneError, match=r"capacity 999: the blocks alone hold 1,000 particles"):
        filled(blocks={"a": CUBE}, capacity=999)


HOSE = {"kind": "disc", "radius": 0.2}
BAD: dict[str, tuple[dict[str, Any], str]] = {
    "no fluid": ({}, "a fluid needs one of them"),
    "an unknown phase": ({"blocks": {"a": {**CUBE, "phase": "oil"}}}, "no phase 'oil' in phases"),
    "an unknown phase of an emitter": (
        {"blocks": {"a": CUBE}, "emitters": {"e": {**HOSE, "speed": 1.0, "end": 1.0, "phase": "oil"}}},
        "emitters.e.phase: no phase 'oil'",
    ),
    "a phase that is too light": (
        {"blocks": {"a": CUBE}, "phases": {"gas": {"density": 99.0}}},
        "phases.gas.density 99 kg/m3: differs from the fluid's, 1000, by a factor 10.1; at most 10",
    ),
    "phases that are too far apart": (
        {"blocks": {"a": CUBE}, "phases": {"a": {"density": 200.0}, "b": {"density": 2100.0}}},
        "differs from b's, 2100, by a factor 10.5",
    ),
    "a thin box": ({"blocks": {"a": box((0, 0, 0), (1, 0.05, 1))}}, "0.05 m in y, less than the spacing"),
    "a box upside down": ({"blocks": {"a": box((0, 1, 0), (1, 0, 1))}}, "in y, 1 is not below 0"),
    "settled and moving": (
        {"blocks": {"a": {**CUBE, "settled": True, "velocity": (1, 0, 0)}}},
        "what is settled is at rest",
    ),
    "points from nowhere": ({"blocks": {"a": {"kind": "points"}}}, "a block of points needs one of the two"),
    "speed and rate": (
        {"emitters": {"e": {**HOSE, "speed": 1.0, "rate": 1.0}}},
        "an emitter needs one of the two",
    ),
    "an endless emitter": ({"emitters": {"e": {**HOSE, "speed": 1.0}}}, "emitters.e: give its end"),
    "an end before the start": (
        {"emitters": {"e": {**HOSE, "speed": 1.0, "start": 2.0, "end": 1.0}}},
        "end 1 s: must be later than start, 2 s",
    ),
    "a direction out of the plane": (
        {"dimension": 2, "emitters": {"e": {**HOSE, "speed": 1.0, "end": 1.0, "direction": (0, 0, 1)}}},
        "emitters.e.direction: has no part in the plane z = 0",
    ),
    "gravity out of the plane": (
        {"dimension": 2, "blocks": {"a": CUBE}, "gravity": (0, 0, -9.81)},
        "gravity: has no part in the plane z = 0",
    ),
    "a front out of the plane": (
        {
            "dimension": 2,
            "blocks": {"a": CUBE},
            "gauges": {"f": {"kind": "front", "direction": (0, 0, 1)}},
        },
        "gauges.f.direction: has no part in the plane z = 0",
    ),
    "far too many": ({"blocks": {"a": CUBE}, "spacing": 1e-3}, "1,000,000,000 particles; at most 16,777,216"),
    "steps": ({"blocks": {"a": CUBE}, "time_step": {"largest": 1e-3, "smallest": 1e-2}}, "smallest 0.01 s"),
    "iterations": ({"blocks": {"a": CUBE}, "dfsph": {"least_iterations": 200}}, "least_iterations 200"),
}


@pytest.mark.parametrize("case", BAD)
def test_bad_parameters_are_refused(case: str) -> None:
    fields, words = BAD[case]
    with pytest.raises(ValidationError, match=re.escape(words)):
        fluid(**fields)


def test_an_open_mesh_is_refused_with_its_open_edges(tmp_path: Path) -> None:
    file = write_box_mesh(tmp_path / "open.off", (1.0, 1.0, 1.0), lid=False)
    with pytest.raises(ValidationError, match=r"not watertight \(4 open edges\), so it has no inside"):
        fluid(blocks={"a": {"kind": "mesh", "file": file}})


SCENE_BAD: dict[str, tuple[dict[str, Any], Bounds, str]] = {
    "spacing": (
        {"spacing": 2.0, "capacity": 5},
        contained((0, 0, 0), (9, 1, 9)),
        "spacing 2 m: larger than the bounds",
    ),
    "out of the bounds": (
        {},
        contained((0, 0, 0), (2, 0.95, 2)),
        "blocks.a: reaches 0.05 m out of the bounds in y",
    ),
    "periodic bounds": (
        {},
        contained((0, 0, 0), (9, 0.5, 9), "periodic"),
        "must be at least 3.003 support radii",
    ),
    "friction": (
        {"walls": {"bodies": {"keel": {"friction": 1.0}}}},
        OPEN,
        "walls.bodies.keel: no body 'keel'; there are mast",
    ),
    "a force": ({"gauges": {"g": {"kind": "force", "body": "keel"}}}, OPEN, "gauges.g.body: no body 'keel'"),
    "a carrier": (
        {"emitters": {"e": {**HOSE, "speed": 1.0, "end": 1.0, "on": "keel"}}},
        OPEN,
        "emitters.e.on: no body 'keel'",
    ),
}


@pytest.mark.parametrize("case", SCENE_BAD)
def test_what_does_not_fit_the_scene_is_refused(case: str) -> None:
    fields, bounds, words = SCENE_BAD[case]
    blocks = {"a": box((0, 0, 0), (2, 1, 2)) if case != "spacing" else SPHERE}
    with pytest.raises(ValueError, match=re.escape(words)):
        fluid(**{"blocks": blocks, **fields}).check_scene(bounds, ("mast",), ("water",))


def test_estimates_grow_with_the_particles() -> None:
    small, large = fluid(blocks={"a": CUBE}), fluid(blocks={"a": CUBE}, spacing=0.02)
    assert (small.particle_count(), large.particle_count()) == (1000, 125_000)
    assert 100 * 2**20 < large.memory_bytes() < 1.25 * 2**30
    assert large.seconds_per_step() > small.seconds_per_step() > 0.0
    assert large.largest_step() == 0.005
    fast = fluid(blocks={"a": {**CUBE, "velocity": (0, -20, 0)}})
    assert fast.largest_step() == pytest.approx(fast.cfl * D / 20.0)
