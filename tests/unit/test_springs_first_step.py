"""What `tianim check` knows of a scene's steps: as many as the run takes, by the same solver."""

from pathlib import Path
from typing import Any

import pytest

from tianim.errors import SceneError
from tianim.scene import build, load_scene, summarise
from tianim.system import Bounds
from tianim.systems.springs import SpringsParams
from tianim.systems.springs.params import TimeStep
from tianim.validate.build import built

OBJ = "".join(f"v {0.1 * i} 0 {0.1 * (j + 0.3 * i)}\n" for i in range(4) for j in range(4)) + "".join(
    f"f {4 * i + j + 1} {4 * i + j + 2} {4 * i + j + 6}\nf {4 * i + j + 1} {4 * i + j + 6} {4 * i + j + 5}\n"
    for i in range(3)
    for j in range(3)
)
SHEET = {"kind": "sheet", "segments": (21, 13), "size": (2.1, 0.9), "bend": 0.1, "skip": 3.0}
BLOCK = {"kind": "block", "size": (0.9, 0.21, 0.6), "spacing": 0.05, "rotation": (20.0, 0.0, 0.0)}
PIECES: dict[str, Any] = {
    "sheet": {"a": SHEET},
    "one diagonal": {"a": {**SHEET, "diagonals": 1, "bend": 0.0}},
    "a few cells": {"a": {**SHEET, "segments": (3, 1)}},
    "block": {"a": BLOCK},
    "solid": {"a": {**BLOCK, "kind": "solid", "damping": 1e-3}},
    "rope and strands": {
        "a": {"kind": "rope", "points": ((0.0, 0.0, 0.0), (1.0, 0.0, 0.0), (1.0, 1.0, 0.0)), "bend": 1e-4},
        "b": {"kind": "strands", "count": 50, "segments": 5},
    },
    "sheet and block": {"a": SHEET, "b": BLOCK},
}


def springs(pieces: Any, **fields: Any) -> SpringsParams:
    return SpringsParams.model_validate({"kind": "springs", "pieces": pieces, **fields})


@pytest.mark.parametrize("pieces", PIECES.values(), ids=PIECES)
def test_the_first_step_is_that_of_the_whole(pieces: Any) -> None:
    known = springs(pieces, solver="explicit").largest_step()
    assert known == pytest.approx(built("springs", pieces=pieces, solver="explicit").max_step(), rel=1e-6)
    assert known < 1.0 / 120.0


def test_meshes_and_what_is_stitched_are_built_whole(tmp_path: Path) -> None:
    path = tmp_path / "cloth.obj"
    path.write_text(OBJ)
    cloth = {"kind": "mesh", "file": path, "bend": 1e-3}
    seam = {"first": {"piece": "a", "points": "left"}, "second": {"piece": "a", "points": "right"}}
    for pieces, stitches in (({"a": cloth}, {}), ({"a": SHEET}, {"seam": {**seam, "stiffness": 1e6}})):
        fields: Any = {"pieces": pieces, "stitches": stitches, "solver": "explicit"}
        known = SpringsParams.model_validate({"kind": "springs", **fields}).largest_step()
        assert known == pytest.approx(built("springs", **fields).max_step(), rel=1e-6)


@pytest.mark.parametrize(
    ("pieces", "solver"),
    [
        ({"a": SHEET}, "projective"),
        ({"a": {**SHEET, "stretch": 1.0, "shear": 0.1, "bend": 0.0, "skip": 0.0}}, "explicit"),
        (PIECES["solid"], "explicit"),
        (PIECES["rope and strands"], "strands"),
        ({**PIECES["rope and strands"], "c": SHEET}, "projective"),
    ],
)
def test_auto_takes_the_solver_that_is_known_before(pieces: Any, solver: str) -> None:
    assert springs(pieces).chosen_solver() == solver
    assert built("springs", pieces=pieces).solver.name == solver


SCENE = """tianim: 1
fps: 25
duration: 0.08
systems:
  cloth:
    kind: springs
    solver: explicit
    time_step: {{most_substeps: {most}}}
    pieces: {{cloth: {{kind: sheet, segments: [40, 40]}}}}
"""


def test_check_counts_the_steps_of_the_run_and_refuses_what_it_refuses(tmp_path: Path) -> None:
    path = tmp_path / "cloth.yaml"
    path.write_text(SCENE.format(most=5000))
    simulation = build(load_scene(path))
    frame = list(simulation.frames())[1]
    steps = frame.diagnostics["substeps"]
    assert steps > 10
    assert summarise(load_scene(path)).steps == 2 * steps
    path.write_text(SCENE.format(most=int(steps) - 1))
    with pytest.raises(SceneError) as refused:
        load_scene(path)
    # The same words as of a run that comes to it.
    system = simulation.systems["cloth"]
    system.params = system.params.model_copy(update={"time_step": TimeStep(most_substeps=int(steps) - 1)})  # type: ignore[attr-defined]
    with pytest.raises(SceneError) as in_the_run:
        simulation.check_substeps()
    assert str(in_the_run.value).removeprefix("cloth: ") in str(refused.value)


def test_check_says_what_cannot_be_built() -> None:
    params = springs({"cloth": {**SHEET, "segments": (2, 100)}})
    with pytest.raises(ValueError, match=r"pieces\.cloth: cells of .* too oblong"):
        params.check_scene(Bounds(), (), ())
