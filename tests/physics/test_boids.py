"""Boids: every validation case, and what a scene may ask of them beside."""

from typing import Any

import numpy as np
import pytest
from checks import as_tests, assert_passes

from tianim.system import Bounds
from tianim.systems.boids.params import BoidsParams
from tianim.systems.boids.tables import interaction_table
from tianim.validate import CASES, Case, flocking
from tianim.validate.build import OFF, acceleration, advance, built, periodic, rule, runner
from tianim.validate.flocking import oracle_of

# float32 positions of some metres.
PLACE = 1e-5
# Wishes of 3 m/s whose direction is seen over some centimetres between places rounded by 1e-6 m.
WISH = 1e-3


@pytest.mark.parametrize("case", as_tests(case for case in CASES["boids"] if case.system == "boids"))
def test_case(case: Case) -> None:
    assert_passes(case)


def neighbour_numbers(k: int, **fields: Any) -> np.ndarray:
    system = flocking.flock_of(
        "three dimensions", neighbourhood={"kind": "topological", "k": k}, separation=OFF, cohesion=OFF,
        alignment=rule(40.0), **fields,
    )  # fmt: skip
    return flocking.minds(system).sum(axis=1)


@pytest.mark.parametrize("k", [1, 2, 6, 7, 8, 20])
def test_k_nearest_are_exactly_k(k: int) -> None:
    assert np.all(neighbour_numbers(k) == k)


def test_fewer_than_k_are_all_of_them() -> None:
    assert np.all(neighbour_numbers(7, count=5) == 4)


def test_rules_hold_step_after_step() -> None:
    """The flock is sorted anew each step: ids stay with their boids, and the law holds on."""
    system = flocking.flock_of("two species, 7 nearest, budget")
    for step in range(8):
        oracle = oracle_of(system)
        before = system.read("velocity").astype(np.float64)
        system.step(0.05 * step, 0.05)
        got = (system.read("velocity") - before) / 0.05
        off = np.linalg.norm(got - oracle.acceleration(), axis=1)
        # Read as a difference of velocities over 0.05 s: 20 times the rounding of the velocities.
        assert (off / (oracle.scale() + 20.0 * np.linalg.norm(before, axis=1))).max() < flocking.ROUNDING


def test_permuting_the_input_permutes_the_flight() -> None:
    """To rounding over a few steps; later a chaotic flock magnifies it."""
    order = np.random.default_rng(5).permutation(300)
    system, other = (flocking.flock_of("7 nearest", limits={"max_speed": 3.0}) for _ in range(2))
    for name in ("position", "velocity"):
        other.write(name, system.read(name)[order])
    advance(system, 10, 0.02)
    advance(other, 10, 0.02)
    np.testing.assert_allclose(other.read("position"), system.read("position")[order], atol=PLACE)


@pytest.mark.parametrize("kind", ["periodic", "contained"])
@pytest.mark.parametrize("dimension", [2, 3])
def test_nobody_leaves_the_bounds(kind: str, dimension: int) -> None:
    lower, upper = np.array([-3.0, -2.0, -4.0]), np.array([3.0, 5.0, 4.0])
    system = built(
        "boids", Bounds(kind, tuple(lower), tuple(upper)), count=200, dimension=dimension, speed=5.0,
        start={"kind": "ball", "radius": 9.0}, limits={"max_speed": 6.0, "min_speed": 4.0},
        behaviours=({"kind": "wander", "weight": 5.0},),
    )  # fmt: skip
    axes = slice(dimension)
    for _ in range(60):
        x = system.read("position").astype(np.float64)[:, axes]
        assert np.all((x >= lower[axes]) & (x <= upper[axes]))
        advance(system, 2, 1 / 30)


def test_what_leaves_a_periodic_box_comes_in_on_the_other_side() -> None:
    way = np.array([0.6, -0.8, 0.0])
    system = built(
        "boids", periodic(4.0, -1.5), separation=OFF, alignment=OFF, cohesion=OFF, speed=1.0,
        start={"kind": "points", "positions": ((1.0, 1.0, 1.0),)},
        heading={"kind": "along", "direction": tuple(way)},
    )  # fmt: skip
    for step in range(1, 200):
        system.step(0.1 * step, 0.1)
        wanted = -1.5 + np.mod(1.0 + 0.1 * step * way + 1.5, 4.0)
        off = system.read("position")[0] - wanted
        # A hundred and more float32 additions at 4 m.
        assert np.abs(off - 4.0 * np.round(off / 4.0)).max() < 1e-4


def test_a_wall_reflects() -> None:
    system = built(
        "boids", Bounds("contained", (-1.0,) * 3, (1.0,) * 3), separation=OFF, alignment=OFF, cohesion=OFF,
        start={"kind": "points", "positions": ((0.95, 0.0, 0.5),)}, speed=1.0,
        heading={"kind": "along", "direction": (3.0, 0.0, 4.0)},
    )  # fmt: skip
    system.step(0.0, 0.2)
    np.testing.assert_allclose(system.read("velocity")[0], [-0.6, 0.0, 0.8], atol=PLACE)
    assert system.read("position")[0, 0] == 1.0


def test_nobody_is_inside_a_moving_body() -> None:
    """A wall of rock sweeps through a resting flock without obstacle avoidance: all are carried along."""
    sweep = {"keys": ((0.0, (-6.0, 0.0, 0.0)), (2.0, (6.0, 0.0, 0.0)))}
    system = built(
        "boids", bodies={"rock": {"kind": "box", "size": (2.0, 20.0, 20.0), "position": sweep}},
        count=100, start={"kind": "ball", "radius": 3.0}, speed=0.0, limits={"max_speed": 20.0},
        separation=rule(0.5, 0.1), alignment=OFF, cohesion=OFF,
    )  # fmt: skip
    for step in range(120):
        advance(system, 1, 1 / 60, start=step / 60)
        front = -6.0 + step / 60 * 6.0 + 1.0
        assert system.read("position")[:, 0].min() > front - PLACE
    assert system.read("position")[:, 0].min() > 5.9


def test_a_target_species_without_members_is_minded_by_nobody() -> None:
    """A sweep over the number of predators starts at none."""
    hawks = {"target": {"kind": "species", "name": "hawks"}}
    behaviours = (
        {"kind": "flee", "radius": 50.0, **hawks}, {"kind": "evasion", "radius": 50.0, **hawks},
        {"kind": "pursuit", **hawks}, {"kind": "leader", "leaders": "hawks"},
    )  # fmt: skip
    system = built(
        "boids", count=20, separation=OFF, alignment=OFF, cohesion=OFF, behaviours=behaviours,
        species={"hawks": {"count": 0}},
    )  # fmt: skip
    assert np.abs(acceleration(system)).max() == 0.0


def test_a_target_that_is_oneself_is_minded_by_nobody() -> None:
    chase = ({"kind": "pursuit", "target": {"kind": "species", "name": "flock"}},)
    system = built("boids", count=1, separation=OFF, alignment=OFF, cohesion=OFF, behaviours=chase)
    assert np.abs(acceleration(system)).max() == 0.0


def test_a_body_is_a_target() -> None:
    """A body that moves is followed; a target at rest would be missed."""
    way = {"keys": ((0.0, (0.0, 0.0, 0.0)), (10.0, (10.0, 0.0, 0.0)))}
    system = built(
        "boids", bodies={"bait": {"kind": "sphere", "radius": 0.01, "position": way}}, count=5,
        separation=OFF, alignment=OFF, cohesion=OFF, limits={"max_speed": 4.0},
        start={"kind": "ball", "radius": 3.0},
        behaviours=({"kind": "seek", "target": {"kind": "body", "name": "bait"}, "weight": 2.0},),
    )  # fmt: skip
    advance(system, 300, 1 / 30)
    assert np.abs(system.read("position")[:, 1:]).max() < 4.0
    assert np.abs(system.read("position")[:, 0] - 10.0).max() < 4.0


@pytest.mark.parametrize("kind", ["point", "body"])
def test_pursuit_aims_where_a_keyframed_target_will_be(kind: str) -> None:
    """At rest 8 m off at a top speed of 4 m/s: in 2 s a target with 3 m/s along z is 6 m on."""
    way = {"keys": ((0.0, (8.0, 0.0, 0.0)), (10.0, (8.0, 0.0, 30.0)))}
    target = {"kind": "point", "position": way} if kind == "point" else {"kind": "body", "name": "bait"}
    system = built(
        "boids", bodies={"bait": {"kind": "sphere", "radius": 0.01, "position": way}},
        separation=OFF, alignment=OFF, cohesion=OFF, limits={"max_speed": 4.0, "max_acceleration": 100.0},
        start={"kind": "points", "positions": ((0.0, 0.0, 0.0),)}, speed=0.0,
        behaviours=({"kind": "pursuit", "target": target, "horizon": 5.0},),
    )  # fmt: skip
    np.testing.assert_allclose(acceleration(system)[0], [4.0 * 0.8, 0.0, 4.0 * 0.6], atol=PLACE)


SEAM_BEHAVIOURS: dict[str, dict[str, Any]] = {
    "seek": {"target": "point"},
    "flee": {"target": "point", "radius": 4.0},
    "arrival": {"target": "point", "slowing_radius": 3.0},
    "pursuit": {"target": "species", "horizon": 0.5},
    "evasion": {"target": "species", "horizon": 0.5, "radius": 4.0},
    "leader": {"leaders": "other", "distance": 0.5, "slowing_radius": 3.0},
    "roost": {"centre": "point", "radius": 1.5, "vertical": 0.3},
}


@pytest.mark.parametrize("dimension", [2, 3])
@pytest.mark.parametrize("kind", SEAM_BEHAVIOURS)
def test_a_target_is_sought_the_shortest_way_round(kind: str, dimension: int) -> None:
    """A periodic box and all in it moved until the seam is before the target: nothing changes."""
    off = {"separation": OFF, "alignment": OFF, "cohesion": OFF}
    axes = np.arange(3) < dimension

    def wishes(shift: np.ndarray) -> np.ndarray:
        centre = tuple(float(c) for c in axes * ((5.0 + shift) % 10.0))
        targets = {
            "point": {"kind": "point", "position": centre},
            "species": {"kind": "species", "name": "other"},
        }
        behaviour = {"kind": kind, **SEAM_BEHAVIOURS[kind]}
        if "target" in behaviour:
            behaviour["target"] = targets[behaviour["target"]]
        if kind == "roost":
            behaviour["centre"] = centre
        others = {"count": 3, "start": {"kind": "ball", "centre": (5.0, 5.0, 5.0), "radius": 1.0}, **off}
        system = built(
            "boids", periodic(10.0), **off, count=100, dimension=dimension, behaviours=(behaviour,),
            start={"kind": "ball", "centre": (5.0, 5.0, 5.0), "radius": 3.5}, species={"other": others},
            limits={"max_speed": 3.0, "max_acceleration": 1e3},
        )  # fmt: skip
        system.write("position", (system.read("position") + shift) % 10.0)
        return acceleration(system)[:100]

    unmoved = wishes(np.zeros(3))
    assert np.count_nonzero(np.linalg.norm(unmoved, axis=1)) > 20
    np.testing.assert_allclose(wishes(axes * [4.5, 6.0, 3.0]), unmoved, atol=WISH)


def test_written_places_in_two_dimensions_lie_in_the_plane() -> None:
    system = built("boids", count=10, dimension=2)
    system.write("position", np.ones((10, 3)))
    system.write("velocity", np.ones((10, 3)))
    assert not system.read("position")[:, 2].any()
    assert not system.read("velocity")[:, 2].any()
    assert np.all(system.read("position")[:, :2] == 1.0)


def test_written_places_are_brought_into_the_bounds() -> None:
    system = built("boids", periodic(4.0), count=2)
    system.write("position", np.array([[5.0, -1.0, 2.0], [4.0, 0.0, 12.0]]))
    np.testing.assert_allclose(system.read("position"), [[1.0, 3.0, 2.0], [0.0, 0.0, 0.0]])


def test_rules_that_are_off_need_no_room_in_a_periodic_box() -> None:
    system = built(
        "boids", periodic(0.5), count=20, start={"kind": "ball", "radius": 0.2},
        separation=OFF, alignment=OFF, cohesion=OFF, behaviours=({"kind": "wander"},),
    )  # fmt: skip
    advance(system, 10, 0.01)
    assert np.isfinite(system.read("position")).all()


def test_a_force_of_ones_own_is_added() -> None:
    system = flocking.flock_of("three dimensions")
    before = acceleration(system)
    system.add_force(lambda time, position, velocity: 3.0 * position + velocity)
    wanted = before + 3.0 * system.read("position") + system.read("velocity")
    np.testing.assert_allclose(acceleration(system), wanted, atol=2e-4)


def test_in_two_dimensions_a_force_out_of_the_plane_does_nothing() -> None:
    """Not even through the limit of the speed."""
    system = runner(dimension=2)
    system.add_force(lambda time, position, velocity: np.full((1, 3), (0.0, 0.0, 100.0)))
    assert np.abs(acceleration(system)).max() == 0.0


def test_keyframed_weights_and_radii_are_those_of_the_moment() -> None:
    keys = {"keys": ((0.0, 0.5), (2.0, 2.5))}
    moving = flocking.flock_of("three dimensions", cohesion={"radius": keys, "weight": keys})
    for time in (0.0, 1.0, 2.0):
        value = 0.5 + time
        fixed = flocking.flock_of("three dimensions", cohesion=rule(value, value))
        x, v = moving.read("position"), moving.read("velocity")
        moving.step(time, 1.0)
        np.testing.assert_allclose(moving.read("velocity") - v, acceleration(fixed), atol=2e-5)
        moving.write("position", x)
        moving.write("velocity", v)


def test_orientation_points_ahead_and_leans_into_the_turn() -> None:
    from scipy.spatial.transform import Rotation

    system = runner(limits={"max_speed": 1e3, "max_bank": 80.0, "bank_time": 0.1}, speed=10.0)
    system.add_force(lambda time, position, velocity: np.cross((0.0, 0.8, 0.0), velocity))
    advance(system, 60, 1 / 60)
    part = system.snapshot()[0]
    turn = Rotation.from_quat(part.data["orientation"][0])
    velocity = np.asarray(part.data["velocity"][0], np.float64)
    np.testing.assert_allclose(turn.apply([0.0, 0.0, 1.0]), velocity / np.linalg.norm(velocity), atol=1e-5)
    inward = np.cross([0.0, 0.8, 0.0], velocity)
    up = turn.apply([0.0, 1.0, 0.0])
    assert up @ inward > 0.0
    assert up[1] > 0.0


@pytest.mark.parametrize(
    ("fields", "words"),
    [
        ({"behaviours": ({"kind": "seek", "target": {"kind": "body", "name": "rock"}},)}, "no body 'rock'"),
        ({"behaviours": ({"kind": "containment"},)}, "containment needs a size"),
    ],
)
def test_a_scene_that_does_not_fit_is_refused(fields: dict[str, Any], words: str) -> None:
    params = BoidsParams.model_validate({"kind": "boids", "count": 1, **fields})
    with pytest.raises(ValueError, match=words):
        params.check_scene(Bounds(), ("stone",), ())


def test_more_boids_than_a_target_can_be_found_among_are_refused() -> None:
    """Ids of targets are exact up to 2^24 only: one more would aim at another boid."""
    hawks = {"count": 2, "behaviours": ()}
    flee = {"kind": "flee", "target": {"kind": "species", "name": "hawks"}}
    most = (1 << 24) - 2
    BoidsParams.model_validate(
        {"kind": "boids", "count": most, "species": {"hawks": hawks}, "behaviours": (flee,)}
    )
    with pytest.raises(ValueError, match="at most 16,777,216 boids in all"):
        BoidsParams.model_validate(
            {"kind": "boids", "count": most + 1, "species": {"hawks": hawks}, "behaviours": (flee,)}
        )


def test_an_interaction_leaves_what_it_does_not_name() -> None:
    minds = {"flock": {"flock": {"separation": 2.0}, "hawks": {"cohesion": 0.5}}}
    params = BoidsParams.model_validate(
        {"count": 1, "species": {"hawks": {"count": 1}}, "interactions": minds}
    )
    # Rows: flock-flock, flock-hawks, hawks-flock, hawks-hawks.
    assert interaction_table(params).tolist() == [[2, 1, 1], [1, 0, 0.5], [1, 0, 0], [1, 1, 1]]
