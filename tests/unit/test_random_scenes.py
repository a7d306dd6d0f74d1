"""Random valid scenes run: three frames, everything finite, no particles and one particle included."""

from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, assume, given, reject, settings
from scene_sites import files
from scene_strategies import FRAMES, valid_scenes

from tianim.errors import SceneError
from tianim.scene import build, scene_from, summarise
from tianim.scene.models import scene_model

FEW, MANY = 25, 500
# A step of some microseconds is valid, but three frames of it take minutes.
MOST_STEPS = 300

QUICK = settings(
    max_examples=FEW,
    deadline=None,
    derandomize=True,
    database=None,
    suppress_health_check=[HealthCheck.too_slow, HealthCheck.filter_too_much],
)


def run(data: dict[str, Any]) -> None:
    scene = scene_from(data, files())
    assume(summarise(scene).steps <= MOST_STEPS)
    try:
        simulation = build(scene)
    except SceneError as error:
        assert "\n" not in str(error)  # noqa: PT017  (a system may refuse at its start, in one line)
        reject()
    frames = list(simulation.frames())
    assert [frame.index for frame in frames] == list(range(FRAMES + 1))
    for frame in frames:
        for part in frame.parts:
            assert np.isfinite(part.position).all(), f"{part.name}: position in frame {frame.index}"
            for name, values in part.data.items():
                assert np.isfinite(values.astype(float)).all(), f"{part.name}: {name} in frame {frame.index}"
        assert np.isfinite(list(frame.diagnostics.values())).all(), frame.diagnostics


@given(valid_scenes())
@QUICK
def test_random_scene_runs(data: dict[str, Any]) -> None:
    run(data)


@pytest.mark.slow
@given(valid_scenes())
@settings(QUICK, max_examples=MANY, derandomize=False)
def test_many_random_scenes_run(data: dict[str, Any]) -> None:
    run(data)


@given(valid_scenes())
@QUICK
def test_random_scene_survives_its_own_record(data: dict[str, Any]) -> None:
    """The JSON that run.json holds gives the same scene again: a run is resumed from it."""
    scene = scene_from(data, files())
    assert scene_from(scene.model_dump(mode="json")) == scene
    assert isinstance(scene, scene_model())
