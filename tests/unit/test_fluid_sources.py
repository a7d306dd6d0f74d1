"""Emitters give layers of a lattice whatever the steps are; sinks take what is in them; both resume."""

import logging
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from fluid_scenes import OPEN, bodies, box, contained, fluid, nearest_neighbour, write_box_mesh

from tianim.errors import SceneError
from tianim.spatial.bodies import Bodies
from tianim.spatial.columns import Columns
from tianim.system import Bounds
from tianim.systems.fluid.emitters import Emitters
from tianim.systems.fluid.params import FluidParams
from tianim.systems.fluid.particles import WIDTHS
from tianim.systems.fluid.sinks import Sinks

D = 0.1  # the spacing of all these fluids [m]
ROOM = 20_000
# Places are float32 and times are added up: of a metre, they are this exact [m].
EXACT = 2e-5
HOSE: dict[str, Any] = {"kind": "disc", "radius": 0.25, "direction": (1, 0, 0), "speed": 2.0, "end": 9.0}


class Jet:
    """Particles that fly straight on from an emitter, in steps of any length."""

    def __init__(
        self, params: FluidParams, room: int = ROOM, solid: Bodies | None = None, bounds: Bounds = OPEN
    ) -> None:
        self.columns = Columns(0, WIDTHS, room=room)
        self.emitters = Emitters("water", params, bounds, solid or bodies(), seed=3)
        self.time = 0.0

    def run(self, steps: list[float]) -> "Jet":
        for dt in steps:
            self.emitters.emit(self.columns, self.time, dt)
            moved = self.columns.read("position") + dt * self.columns.read("velocity")
            self.columns.write("position", moved)
            self.time += dt
        return self

    @property
    def position(self) -> np.ndarray[Any, Any]:
        return np.asarray(self.columns.read("position"), np.float64)


def jet(steps: list[float], room: int = ROOM, **emitter: Any) -> Jet:
    return Jet(fluid(emitters={"hose": {**HOSE, **emitter}}, capacity=ROOM), room).run(steps)


def uneven(total: float, seed: int = 1) -> list[float]:
    """Steps of any length up to 0.03 s, in which a jet of 2 m/s goes 0.6 spacings, and one of 0.2 s."""
    rng = np.random.default_rng(seed)
    steps = [0.2]
    while sum(steps) < total:
        steps.append(rng.uniform(0.001, 0.03))
    return [*steps[:-1], total - sum(steps[:-1])]


@pytest.mark.parametrize("steps", [[0.04] * 25, [1.0 / 60] * 60, uneven(1.0)])
def test_a_jet_is_a_lattice_whatever_the_steps(steps: list[float]) -> None:
    """Layers stand a spacing apart, the fluid's end is where the flow is, and the last layer is whole."""
    x = jet(steps).position
    layers = np.unique(np.round(x[:, 0], 4))
    np.testing.assert_allclose(np.diff(layers), D, atol=1.01e-4)
    assert 0.5 * D < layers[0] <= 1.5 * D + 1e-4
    assert layers[-1] + 0.5 * D == pytest.approx(2.0 * 1.0, abs=1e-4)
    np.testing.assert_allclose(nearest_neighbour(x), D, atol=EXACT)
    # The twentieth layer is due just at the end, and would come with the next step.
    assert len(x) == 19 * 21


def test_the_same_time_gives_the_same_particles_in_other_steps() -> None:
    one, other = jet([0.05] * 20), jet(uneven(1.0))
    np.testing.assert_allclose(one.position, other.position, atol=EXACT)


@pytest.mark.parametrize("dimension", [2, 3])
def test_a_rate_is_the_volume_that_comes_out(dimension: int) -> None:
    """0.3 m3/s (2D: m2/s) for two seconds, though the lattice fills the mouth only roughly."""
    emitter = {**HOSE, "speed": None, "rate": 0.3, "end": 2.0}
    params = fluid(dimension=dimension, emitters={"hose": emitter})
    came = Jet(params).run([0.01] * 230).columns.count
    per_layer = 21 if dimension == 3 else 5
    assert abs(came * D**dimension - 0.6) <= per_layer * D**dimension
    assert came <= params.emitted_count() < 1.3 * came


@pytest.mark.parametrize(
    ("emitter", "count"),
    [
        ({"kind": "disc", "radius": 0.1}, 4),
        ({"kind": "disc", "radius": 0.15}, 9),
        ({"kind": "disc", "radius": 0.5}, 80),
        ({"kind": "disc", "radius": 0.001}, 1),
        ({"kind": "box", "radius": None, "width": 0.3, "height": 0.2}, 6),
        ({"kind": "box", "radius": None, "width": 0.39, "height": 0.05}, 3),
    ],
)
def test_a_layer_has_the_area_of_the_mouth(emitter: dict[str, Any], count: int) -> None:
    given = {key: value for key, value in {**HOSE, **emitter}.items() if value is not None}
    x = Jet(fluid(emitters={"hose": given})).run([0.05] * 2).position
    assert len(x) == count
    np.testing.assert_allclose(x[:, 1:].mean(axis=0), 0.0, atol=EXACT)


def test_the_mouth_of_a_mesh_is_its_outline(tmp_path: Path) -> None:
    """A box of 0.5 x 0.3 x 0.7 seen along y: 5 x 7 places; in two dimensions the line of 5."""
    file = write_box_mesh(tmp_path / "box.off", (1.0, 0.6, 1.4))
    emitter = {"kind": "mesh", "file": file, "scale": 0.5, "direction": (0, -1, 0), "speed": 1.0, "end": 1.0}
    x = Jet(fluid(emitters={"e": emitter})).run([0.05] * 3).position
    assert len(x) == 35
    np.testing.assert_allclose(np.ptp(x, axis=0), (0.4, 0.0, 0.6), atol=EXACT)
    flat = Jet(fluid(dimension=2, emitters={"e": emitter})).run([0.05] * 3).position
    np.testing.assert_allclose(np.ptp(flat, axis=0), (0.4, 0.0, 0.0), atol=EXACT)


@pytest.mark.parametrize("dimension", [2, 3])
def test_all_that_a_mesh_gives_has_room_however_it_is_turned(tmp_path: Path, dimension: int) -> None:
    """A cube seen along its diagonal has 1.7 times the area of a face, a square 1.4 times its side."""
    file = write_box_mesh(tmp_path / "box.off", (1.0, 1.0, 1.0))
    emitter = {"kind": "mesh", "file": file, "direction": (1, 1, 1), "speed": 2.0, "end": 2.0}
    params = fluid(dimension=dimension, emitters={"e": emitter})
    came = Jet(params).run([0.01] * 210).columns.count
    assert came <= params.emitted_count() < 1.3 * came
    sheet = write_box_mesh(tmp_path / "sheet.off", (1.0, 0.0, 1.0))
    edge = {**emitter, "file": sheet, "direction": (1, 0, 0), "speed": None, "rate": 1.0}
    assert 0.0 < fluid(dimension=dimension, emitters={"e": edge}).largest_step() < 1.0


def test_what_comes_out_across_a_periodic_face_comes_in_on_the_other_side() -> None:
    """At the mouth itself: neighbours of a place out of the box are not found."""
    bounds = contained((0, -1, -1), (2, 1, 1), "periodic")
    one, other = (
        Jet(fluid(emitters={"hose": {**HOSE, "position": (x, 0, 0)}}), bounds=bounds) for x in (0.95, 1.95)
    )
    for jet_ in (one, other):
        jet_.emitters.emit(jet_.columns, 0.0, 0.075)
        jet_.emitters.emit(jet_.columns, 0.075, 0.01)
    np.testing.assert_allclose(one.position[:, 0], 1.05, atol=EXACT)
    np.testing.assert_allclose(other.position[:, 0], 0.05, atol=EXACT)
    np.testing.assert_array_equal(one.position[:, 1:], other.position[:, 1:])


def test_a_mouth_opens_and_closes() -> None:
    slow = jet([0.01] * 100, start=0.3, end=0.7)
    assert slow.columns.count == 21 * 8
    assert slow.position[:, 0].max() + 0.5 * D == pytest.approx(2.0 * 0.7, abs=1e-4)
    assert jet([0.01] * 100, most=30).columns.count == 30


def test_a_keyframed_speed_flows_by_its_integral() -> None:
    """From 0 to 4 m/s in a second: 2 m, twenty layers; nothing comes while it stands."""
    ramp = {"keys": [[0.0, 0.0], [0.5, 0.0], [1.5, 4.0]]}
    assert jet([0.01] * 50, speed=ramp).columns.count == 0
    came = jet([0.001] * 1500, speed=ramp).columns.count
    assert abs(came - 20 * 21) <= 21
    counted = fluid(emitters={"e": {**HOSE, "speed": ramp, "end": 1.5}}).emitted_count()
    assert came <= counted < 1.4 * came


def test_a_moving_mouth_carries_its_velocity_and_its_place() -> None:
    """On a body that moves up and turns: the layers lie on a slanted line, and move with the body too."""
    lift = bodies(
        lift={
            "kind": "sphere",
            "position": {"keys": [[0.0, [0.0, 0.0, 0.0]], [2.0, [0.0, 6.0, 0.0]]]},
            "rotation": {"keys": [[0.0, [0.0, 90.0, 0.0]], [2.0, [0.0, 90.0, 0.0]]]},
        }
    )
    emitter = {**HOSE, "radius": 0.04, "on": "lift", "position": (0, 0, 2)}
    x = Jet(fluid(emitters={"e": emitter}), solid=lift).run(uneven(1.0)).position
    # Its +x is turned to the world's -z, and its place on z to the world's x.
    np.testing.assert_allclose(x[:, 0], 2.0, atol=1e-4)
    np.testing.assert_allclose(x[:, 1], 3.0, atol=1e-3)
    np.testing.assert_allclose(np.sort(-x[:, 2]), D * (np.arange(19) + 1.5), atol=1e-4)


def test_jitter_is_bounded_and_comes_from_the_seed_alone() -> None:
    plain, one = jet([0.01] * 200).position, jet([0.01] * 200, jitter=0.2).position
    shift = one - plain
    assert 0.18 * D < np.abs(shift).max() <= 0.2 * D + EXACT
    np.testing.assert_allclose(shift.mean(axis=0), 0.0, atol=0.02 * D)
    np.testing.assert_array_equal(jet([0.01] * 200, jitter=0.2).position, one)


def test_over_capacity_is_refused_warned_of_once_and_counted(caplog: pytest.LogCaptureFixture) -> None:
    with caplog.at_level(logging.WARNING, "tianim"):
        full = jet([0.05] * 20, room=100)
    assert full.columns.count == 4 * 21
    assert full.emitters.diagnostics() == {"emitted": 84.0, "emitter_refused": 15 * 21.0}
    assert len(caplog.records) == 1
    assert "room for 100 particles (capacity)" in caplog.text
    full.columns.remove(np.zeros(84, np.int32))
    assert full.emitters.emit(full.columns, full.time, 0.05) == 21
    assert full.columns.read("id")[0] == 84


def test_a_resumed_emitter_gives_the_same_bytes() -> None:
    steps = uneven(1.0)
    whole = jet(steps, jitter=0.3)
    first, second = jet(steps[:17], jitter=0.3), jet([], jitter=0.3)
    second.columns.restore(first.columns.state())
    second.emitters.restore(first.emitters.state())
    second.time = first.time
    second.run(steps[17:])
    for name, values in whole.columns.state().items():
        assert values.tobytes() == second.columns.state()[name].tobytes()
    assert second.emitters.diagnostics() == whole.emitters.diagnostics()


def test_a_mouth_in_a_wall_is_refused() -> None:
    params = fluid(emitters={"hose": {**HOSE, "position": (0.1, 0, 0), "direction": (0, 1, 0)}})
    ball = bodies(
        far={"kind": "sphere", "radius": 0.1, "position": (9, 0, 0)}, ball={"kind": "sphere", "radius": 0.2}
    )
    with pytest.raises(SceneError, match=r"emitters\.hose: its mouth reaches into bodies\.ball, at \("):
        Jet(params, solid=ball)
    with pytest.raises(SceneError, match="reaches out of the bounds, at"):
        Jet(params, bounds=contained((0, -1, -1), (1, 1, 1)))


def test_a_mouth_is_looked_at_when_it_opens() -> None:
    """A body that has left by then is welcome, one that has come is not; the bodies stay as they were."""
    hose = {**HOSE, "direction": (0, 1, 0), "start": 1.0}
    here, away = (0.0, 0.0, 0.0), (5.0, 0.0, 0.0)
    for first, then in ((here, away), (away, here)):
        keys = [(0.0, first), (1.0, then)]
        ball = bodies(ball={"kind": "sphere", "radius": 0.2, "position": {"keys": keys}})
        if then == here:
            with pytest.raises(SceneError, match=r"reaches into bodies\.ball, at \(.*\) at its start, 1 s"):
                Jet(fluid(emitters={"hose": hose}, capacity=9), solid=ball)
        else:
            Jet(fluid(emitters={"hose": hose}, capacity=9), solid=ball)
            assert ball.distance([first])[0][0] < 0.0


SINKS: dict[str, tuple[dict[str, Any], Any]] = {
    "box": (
        {"kind": "box", "lower": (0, 0, 0), "upper": (0.5, 1, 0.25)},
        lambda x, y, z: (x < 0.5) & (z < 0.25),
    ),
    "outside": (
        {"kind": "outside", "lower": (0.2, -1, -1), "upper": (0.7, 2, 2)},
        lambda x, y, z: (x < 0.2) | (x > 0.7),
    ),
    "sphere": (
        {"kind": "sphere", "centre": (1, 1, 1), "radius": 0.6},
        lambda x, y, z: (x - 1) ** 2 + (y - 1) ** 2 + (z - 1) ** 2 < 0.36,
    ),
    "plane": (
        {"kind": "plane", "position": (0, 0.4, 0), "normal": (1, 3, 0)},
        lambda x, y, z: x + 3 * (y - 0.4) < 0,
    ),
    "phase": (
        {"kind": "plane", "position": (0, 9, 0), "phase": "oil"},
        lambda x, y, z: np.arange(len(x)) % 2 == 1,
    ),
    "not yet": (
        {"kind": "plane", "position": (0, 9, 0), "start": 2.0},
        lambda x, y, z: np.zeros(len(x), bool),
    ),
}


def pool(count: int = 2000, flat: bool = False) -> Columns:
    """Particles anywhere in the unit cube, every second one oil."""
    columns = Columns(0, WIDTHS, room=count)
    x = np.random.default_rng(2).random((count, 3))
    if flat:
        x[:, 2] = 0.0
    columns.append(count, {"position": x, "phase": np.arange(count) % 2})
    return columns


@pytest.mark.parametrize("case", SINKS)
def test_a_sink_takes_what_is_in_it_and_nothing_else(case: str) -> None:
    sink, inside = SINKS[case]
    columns = pool()
    before = columns.read("position")
    params = fluid(blocks={"a": box((0, 0, 0), (1, 1, 1))}, sinks={"s": sink}, phases={"oil": {}})
    sinks = Sinks(params, columns.capacity)
    taken = sinks.drain(columns, 1.0)
    gone = inside(*before.T)
    assert taken == gone.sum() == sinks.diagnostics()["drained"]
    np.testing.assert_array_equal(columns.read("id"), np.flatnonzero(~gone))
    np.testing.assert_array_equal(columns.read("position"), before[~gone])
    assert sinks.drain(columns, 1.0) == 0


def test_sinks_add_up_and_move_and_their_count_resumes() -> None:
    moving = {"keys": [[0.0, [0.0, 0.0, 0.0]], [1.0, [0.0, 1.0, 0.0]]]}
    params = fluid(
        blocks={"a": box((0, 0, 0), (1, 1, 1))},
        sinks={
            "s": {"kind": "plane", "position": moving},
            "t": {"kind": "plane", "normal": (-1, 0, 0), "position": (0.9, 0, 0)},
        },
    )
    columns = pool()
    sinks = Sinks(params, columns.capacity)
    first = sinks.drain(columns, 0.25)
    x = columns.read("position")
    assert x[:, 1].min() > 0.25
    assert x[:, 0].max() < 0.9
    again = Sinks(params, columns.capacity)
    again.restore(sinks.state())
    second = again.drain(columns, 0.5)
    assert again.taken == first + second == 2000 - columns.count


def test_in_two_dimensions_the_depth_of_a_sink_counts_for_nothing() -> None:
    for sink in (
        {"kind": "box", "lower": (0, 0, 5), "upper": (0.5, 1, 6)},
        {"kind": "sphere", "centre": (0, 0, 5), "radius": 0.3},
    ):
        params = fluid(dimension=2, blocks={"a": box((0, 0, 0), (1, 1, 1))}, sinks={"s": sink})
        columns = pool(flat=True)
        assert Sinks(params, columns.capacity).drain(columns, 0.0) > 50
