"""The fluid as a system of a scene: steps that a frame may have, what is left when all is gone, resuming."""

from typing import Any

import pytest
from fluid_scenes import box, floats

from tianim.errors import SceneError
from tianim.frame import Frame
from tianim.scene import build, scene_from
from tianim.simulation import Simulation

D = 0.05
POOL = box((0, 0, 0), (0.4, 0.3, 0.4))


def water(scene: dict[str, Any] | None = None, **fields: Any) -> Simulation:
    """328 particles in a tank where nothing else is said."""
    tank = {"kind": "contained", "lower": [0, 0, 0], "upper": [0.4, 0.6, 0.4]}
    system = {"kind": "fluid", "spacing": D, "blocks": {"pool": POOL}, **fields}
    given = {"tianim": 1, "fps": 30, "duration": 1, "bounds": tank, **(scene or {})}
    return build(scene_from(floats(given) | {"tianim": 1, "systems": {"water": floats(system)}}))


def test_more_substeps_than_are_wanted_are_refused_at_the_start() -> None:
    """5 cm / 2 at 30 m/s are 0.83 ms, of which a frame at 30 a second takes 41."""
    quick = {"pool": {**POOL, "velocity": (30, 0, 0)}}
    with pytest.raises(SceneError) as caught:
        water(blocks=quick, time_step={"most_substeps": 40})
    text = str(caught.value)
    assert text.startswith("systems.water: a frame would need 41 substeps, of 0.000833 s (flow), more than")
    assert "time_step.most_substeps, 40: the fluid is fast for its spacing: a larger spacing" in text
    assert water(blocks=quick, time_step={"most_substeps": 41})
    assert water({"duration": 0}, blocks=quick, time_step={"most_substeps": 1})


def test_a_step_that_is_too_short_names_the_system() -> None:
    quick = {"pool": {**POOL, "velocity": (30, 0, 0)}}
    with pytest.raises(SceneError, match=r"^systems\.water: needs a step of 0\.000833 s \(flow\)"):
        water(blocks=quick, time_step={"smallest": 1e-3})


def test_more_substeps_than_are_wanted_stop_a_run() -> None:
    """Free fall at 200 m/s2: the first frame has a few, a later one more than 10; done ones count."""
    fall = {"gravity": (0, -200, 0), "time_step": {"largest": 0.1, "most_substeps": 10}}
    simulation = water({"bounds": {"kind": "open"}}, **fall)
    made: list[float] = []
    with pytest.raises(SceneError, match=r"would need 1\d substeps, of .* s \(flow\).*or a larger most_sub"):
        made.extend(frame.diagnostics["substeps"] for frame in simulation.frames())
    assert 1 < made[1] <= made[-1] <= 10
    assert simulation.substeps < 10


def resumed(simulation: Simulation, again: Simulation) -> tuple[Frame, Frame]:
    """The next frame, and what it is after a restart."""
    again.restore(simulation.state())
    return simulation.advance(), again.advance()


def test_when_all_is_drained_nothing_presses_and_a_restart_changes_nothing() -> None:
    scene = {"bodies": {"ball": {"kind": "sphere", "radius": 0.1, "position": [0.2, 0.1, 0.2]}}}
    drain = {"kind": "box", "lower": (-1, -1, -1), "upper": (1, 1, 1), "start": 0.05}
    fields = {"gauges": {"f": {"kind": "force", "body": "ball"}}, "sinks": {"drain": drain}}
    fields["blocks"] = {"pool": {**POOL, "carve": True}}
    simulation = water(scene, **fields)
    assert simulation.advance().diagnostics["water.gauge_f_y"] != 0.0
    emptied = [simulation.advance() for _ in range(3)][-1]
    assert emptied.diagnostics["water.particles"] == 0.0
    assert [emptied.diagnostics[f"water.gauge_f_{axis}"] for axis in "xyz"] == [0.0, 0.0, 0.0]
    on, again = resumed(simulation, water(scene, **fields))
    assert on.diagnostics == again.diagnostics


def test_a_restart_under_gravity_that_changes_makes_the_same_steps() -> None:
    """The limit of the flow goes by the gravity of the step before; at the start it was 200 times less."""
    fields = {"gravity": {"keys": [[0, [0, -1, 0]], [0.2, [0, -200, 0]]]}, "time_step": {"largest": 1}}
    scene = {"bounds": {"kind": "open"}}
    simulation = water(scene, **fields)
    for _ in range(2):
        simulation.advance()
    on, again = resumed(simulation, water(scene, **fields))
    assert on.diagnostics == again.diagnostics
    assert on.parts[0].position.tobytes() == again.parts[0].position.tobytes()
