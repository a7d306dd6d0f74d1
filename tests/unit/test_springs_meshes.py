"""Meshes from files: order and texture coordinates kept, bent as they are, stiffness painted on."""

from pathlib import Path
from typing import Any

import meshio
import numpy as np
import pytest
import trimesh
from pydantic import ValidationError

from tianim.spatial.bodies import Bodies
from tianim.system import Bounds, World
from tianim.systems.springs import SpringsParams, SpringSystem

SINGLE = 1e-6
# A square of four triangles about its middle; the seam between the halves has two points in each place.
OBJ = """\
v 1 0 0
v 0 0 0
v 0.5 0 0.5
v 1 0 1
v 0 0 1
vt 0 0
vt 1 0
vt 0.5 0.5
vt 1 1
vt 0 1
f 2/1 1/2 3/3
f 1/2 4/4 3/3
f 4/4 5/5 3/3
f 5/5 2/1 3/3
"""


def system(path: Path, pins: dict[str, Any] | None = None, **more: Any) -> SpringSystem:
    piece = {"kind": "mesh", "file": str(path), **more}
    params = SpringsParams.model_validate(
        {"kind": "springs", "pieces": {"cloth": piece}, "pins": pins or {}, "solver": "explicit"}
    )
    return SpringSystem("one", params, World(Bounds(), Bodies({}), 1))


def written(path: Path, points: Any, triangles: Any, **fields: Any) -> Path:
    meshio.Mesh(np.asarray(points, np.float64), [("triangle", triangles)], point_data=fields).write(path)
    return path


def test_points_triangles_and_uv_are_those_of_the_file(tmp_path: Path) -> None:
    path = tmp_path / "square.obj"
    path.write_text(OBJ)
    file = trimesh.load_mesh(path, process=False)
    shown: Any = system(path).snapshot()[0]
    np.testing.assert_allclose(shown.position, file.vertices, atol=SINGLE)
    np.testing.assert_array_equal(shown.triangles, file.faces)
    np.testing.assert_allclose(shown.data["uv"], file.visual.uv, atol=SINGLE)


def test_points_in_one_place_move_as_one(tmp_path: Path) -> None:
    """Two triangles that name the points of their common edge twice."""
    points = [[0, 0, 0], [1, 0, 0], [0, 0, 1], [1, 0, 0], [0, 0, 1], [1, 0, 1]]
    one = system(written(tmp_path / "seam.ply", points, [[0, 1, 2], [3, 5, 4]]))
    assert one.count == 4
    for step in range(20):
        one.step(step * 1e-3, 1e-3)
    shown = one.snapshot()[0].position
    assert shown.shape == (6, 3)
    np.testing.assert_array_equal(shown[[1, 2]], shown[[3, 4]])


def ball(path: Path) -> Path:
    mesh = trimesh.creation.icosphere(subdivisions=2, radius=0.2)
    return written(path, mesh.vertices, mesh.faces)


def test_a_ball_is_at_rest_as_it_is(tmp_path: Path) -> None:
    """Bending that took it for a sheet would press it together."""
    params = {"bend": 1e-2, "density": 1.0}
    one = system(ball(tmp_path / "ball.ply"), **params)
    still = SpringsParams.model_validate({**one.params.model_dump(), "gravity": (0.0, 0.0, 0.0)})
    one = SpringSystem("one", still, World(Bounds(), Bodies({}), 1))
    assert one.diagnostics()["elastic_energy"] == pytest.approx(0.0, abs=1e-9)
    dt = one.max_step()
    for step in range(200):
        one.step(step * dt, dt)
    assert np.abs(one.read("velocity")).max() < 1e-4


def test_forces_of_what_is_bent_are_the_slope_of_its_energy(tmp_path: Path) -> None:
    one = system(ball(tmp_path / "ball.ply"), bend=1e-2, density=1.0, damping=0.0)
    still = SpringsParams.model_validate(
        {**one.params.model_dump(), "gravity": (0.0, 0.0, 0.0), "air": {"density": 0.0}}
    )
    one = SpringSystem("one", still, World(Bounds(), Bodies({}), 1))
    rng = np.random.default_rng(5)
    x = one.read("position") + 0.01 * rng.normal(size=(one.count, 3))
    one.write("position", x)
    dt = 1e-7
    one.step(0.0, dt)
    got = one.read("velocity") / dt * one.read("mass")[:, None]
    scale = np.abs(got).max()
    for i, c in ((0, 0), (7, 1), (60, 2)):
        ahead, behind = x.copy(), x.copy()
        ahead[i, c] += 1e-6
        behind[i, c] -= 1e-6
        slope = (one.report.elastic(ahead) - one.report.elastic(behind)) / 2e-6
        assert got[i, c] == pytest.approx(-slope, abs=1e-5 * scale)  # float32 forces


def test_maps_that_are_painted_on(tmp_path: Path) -> None:
    points = [[0, 0, 0], [1, 0, 0], [2, 0, 0], [0, 0, 1], [1, 0, 1], [2, 0, 1]]
    triangles = [[0, 1, 4], [0, 4, 3], [1, 2, 5], [1, 5, 4]]
    heavy, held = np.array([1.0, 2.0, 3.0, 1.0, 2.0, 3.0]), np.array([0.0, 0.0, 1.0, 0.0, 0.0, 1.0])
    path = written(tmp_path / "painted.ply", points, triangles, heavy=heavy, held=held)
    plain = system(path)
    one = system(
        path,
        {"a": {"piece": "cloth", "points": "painted"}},
        maps={"density": "heavy", "stretch": "heavy", "pin": "held"},
    )
    x = one.read("position")
    np.testing.assert_allclose(one.read("mass"), plain.read("mass") * (1.0 + x[:, 0]))
    ends = one.whole.springs.ends
    factor = (1.0 + x[ends, 0]).mean(axis=1)
    np.testing.assert_allclose(one.whole.springs.stiffness, plain.whole.springs.stiffness * factor)
    one.step(0.0, 1e-3)
    moved = np.abs(one.read("position") - x).max(axis=1) > 0.0
    np.testing.assert_array_equal(moved, x[:, 0] < 1.5)


def test_maps_that_are_not_there_are_refused(tmp_path: Path) -> None:
    zero = np.array([0.0, 1.0, 1.0])
    path = written(tmp_path / "bare.ply", [[0, 0, 0], [1, 0, 0], [0, 0, 1]], [[0, 1, 2]], zero=zero)
    with pytest.raises(
        ValidationError, match=r"maps.stretch: .*bare.ply: has no 'soft' painted.*it has zero"
    ):
        system(path, maps={"stretch": "soft"})
    with pytest.raises(ValidationError, match=r"maps.density: zero must be positive; the least is 0"):
        system(path, maps={"density": "zero"})
