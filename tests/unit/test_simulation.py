"""The clock, the substeps, the frames and the saved state of a Simulation, with drifting points."""

from collections.abc import Mapping
from typing import Any

import drift
import numpy as np
import pytest

from tianim.errors import BlowupError, SceneError, TianimError
from tianim.simulation import Simulation
from tianim.spatial.bodies import Bodies
from tianim.spatial.body_params import Sphere
from tianim.system import Bounds, World

FPS = 24.0


def make(
    fps: float = FPS, frames: int = 5, bodies: Mapping[str, Any] | None = None, **params: Any
) -> Simulation:
    shapes = Bodies(bodies or {})
    world = World(Bounds(), shapes, seed=7)
    systems = {"dust": drift.Drift("dust", drift.DriftParams(**params), world)}
    return Simulation(systems, shapes, fps, frames, Bounds())


def test_frames_start_at_zero_and_times_are_exact() -> None:
    # 1/24 is no binary fraction: a sum of 400 steps would be off by some ulp.
    simulation = make(frames=401)
    frames = list(simulation.frames())
    assert [frame.index for frame in frames] == list(range(401))
    assert [frame.time for frame in frames] == [index / FPS for index in range(401)]
    assert simulation.time == 400 / FPS


@pytest.mark.parametrize(
    ("time_step", "substeps"),
    [(1.0, 1), (1 / FPS, 1), (1 / FPS / 4, 4), (0.99 / FPS / 4, 5), (1e18, 1), (0.009, 5)],
)
def test_substeps_are_as_few_as_the_largest_step_allows(time_step: float, substeps: int) -> None:
    simulation = make(time_step=time_step)
    steps: list[tuple[float, float]] = []
    simulation.on_step(lambda now, dt: steps.append((now.time, dt)))
    frame = simulation.advance()
    assert frame.diagnostics["substeps"] == substeps == len(steps)
    assert all(dt == 1 / FPS / substeps for _, dt in steps)
    assert steps[-1][0] == pytest.approx(1 / FPS, rel=1e-12)  # rounding of one product and one sum


def test_the_smallest_step_of_all_systems_counts() -> None:
    simulation = make(time_step=1.0)
    world = World(Bounds(), simulation.bodies, seed=1)
    simulation.systems["fine"] = drift.Drift("fine", drift.DriftParams(time_step=1 / FPS / 3), world)
    assert simulation.advance().diagnostics["substeps"] == 3


@pytest.mark.parametrize("step", [0.0, -1.0, float("nan"), 1e-12])
def test_a_collapsed_step_is_refused(step: float, monkeypatch: pytest.MonkeyPatch) -> None:
    simulation = make()
    monkeypatch.setattr(simulation["dust"], "max_step", lambda: step)
    with pytest.raises(TianimError, match=r"dust: frame 1 would need more than 1,000,000 substeps"):
        simulation.advance()


def test_frames_go_on_where_they_were_left() -> None:
    simulation = make(frames=5)
    first = simulation.frames()
    assert [next(first).index, next(first).index] == [0, 1]
    assert [frame.index for frame in simulation.frames()] == [2, 3, 4]
    assert list(simulation.frames()) == []


def test_the_start_is_not_given_after_an_advance() -> None:
    simulation = make(frames=3)
    assert simulation.advance().index == 1
    assert [frame.index for frame in simulation.frames()] == [2]


def test_a_frame_holds_parts_of_systems_and_bodies_and_named_diagnostics() -> None:
    frame = make(bodies={"ball": Sphere(radius=0.5)}).frame()
    assert [part.name for part in frame.parts] == ["dust", "ball"]
    assert set(frame.diagnostics) == {"dust.steps", "dust.spread", "substeps"}


def test_a_body_stands_where_the_frame_says() -> None:
    path = {"keys": [(0.0, (0.0, 0.0, 0.0)), (1.0, (24.0, 0.0, 0.0))]}
    simulation = make(
        bodies={"ball": Sphere.model_validate({"radius": 0.5, "position": path})}, time_step=0.01
    )
    for frame in simulation.frames():
        ball = frame.part("ball")
        middle = (ball.position.min(axis=0) + ball.position.max(axis=0)) / 2
        np.testing.assert_allclose(middle, (frame.index, 0.0, 0.0), atol=1e-5)  # float32 at 4 m
        velocity = np.asarray(ball.data["velocity"], np.float32)
        np.testing.assert_allclose(velocity[:, 0], 24.0, rtol=1e-5)


def test_a_blow_up_names_system_frame_and_particle() -> None:
    simulation = make(count=4, blow_up_at=2 / FPS)
    with pytest.raises(BlowupError, match=r"dust: particle 3 in frame 3: position is not finite") as caught:
        list(simulation.frames())
    assert (caught.value.system, caught.value.frame, caught.value.particle) == ("dust", 3, 3)


def test_a_start_that_is_not_finite_is_found_in_frame_0() -> None:
    simulation = make(count=2)
    simulation["dust"].write("position", np.full((2, 3), np.inf))
    with pytest.raises(BlowupError, match="frame 0"):
        next(simulation.frames())


def test_restore_goes_on_with_the_same_bytes() -> None:
    straight = list(make(frames=9, time_step=0.02).frames())
    first = make(frames=9, time_step=0.02)
    for _ in range(4):
        first.advance()
    saved = {key: value.copy() for key, value in first.state().items()}
    first.advance()
    assert all(value.dtype != object for value in saved.values())
    second = make(frames=9, time_step=0.02)
    second.restore(saved)
    assert (second.index, second.time) == (4, 4 / FPS)
    assert second.frame().diagnostics == straight[4].diagnostics
    rest = list(second.frames())
    assert [frame.index for frame in rest] == [5, 6, 7, 8]
    for ours, theirs in zip(rest, straight[5:], strict=True):
        assert ours.diagnostics == theirs.diagnostics
        assert ours.part("dust").position.tobytes() == theirs.part("dust").position.tobytes()


def test_the_state_is_a_copy() -> None:
    simulation = make()
    before = simulation.state()["dust.position"].copy()
    saved = simulation.state()
    simulation["dust"].position[:] = 5.0  # type: ignore[attr-defined]
    np.testing.assert_array_equal(saved["dust.position"], before)


def test_a_state_of_other_systems_is_refused() -> None:
    state = make().state()
    state["systems"] = np.array(["dust", "smoke"])
    with pytest.raises(SceneError, match=r"\['dust', 'smoke'\].*\['dust'\]"):
        make().restore(state)


def test_an_unknown_system_names_the_nearest() -> None:
    with pytest.raises(SceneError, match=r"no system 'dusk': did you mean 'dust'\?"):
        make()["dusk"]
    with pytest.raises(SceneError, match=r"no system 'water': there are dust"):
        make()["water"]
