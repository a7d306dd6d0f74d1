"""Primitive bodies: distance, normal and velocity beside formulas in float64."""

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from tianim.frame import Lines, Mesh
from tianim.math.rotations import from_euler, rotate, rotate_back
from tianim.params import Keyframes, Vector3
from tianim.spatial.bodies import WIDTH, Bodies, BodyParams, Box, Capsule, Cylinder, Plane, Sphere

# float32 has 24 bits: lengths of up to 10 m, through a rotation, are good to some 1e-6 m.
LENGTH = 1e-5
# The central difference of a float32 distance over STEP: rounding 1e-6 / STEP, curvature STEP.
STEP = 3e-3
GRADIENT = 5e-3

Floats = NDArray[np.float64]

POSE: dict[str, Any] = {"position": (0.4, -1.0, 2.0), "rotation": (25.0, -40.0, 70.0)}


def points(count: int = 2000) -> Floats:
    return np.random.default_rng(5).uniform(-4.0, 4.0, (count, 3))


def box_distance(p: Floats, half: Floats) -> Floats:
    """Nearest point of the box outside, nearest face inside."""
    gap = p - np.clip(p, -half, half)
    return np.asarray(np.linalg.norm(gap, axis=1) - np.maximum(np.min(half - np.abs(p), axis=1), 0.0))


def segment_distance(p: Floats, half: float) -> Floats:
    gap = p - np.stack([0 * p[:, 0], np.clip(p[:, 1], -half, half), 0 * p[:, 0]], axis=1)
    return np.asarray(np.linalg.norm(gap, axis=1))


def cylinder_distance(p: Floats, radius: float, half: float) -> Floats:
    """Nearest point of the cylinder outside, nearest side or end inside."""
    across = np.hypot(p[:, 0], p[:, 2]) - radius
    along = np.abs(p[:, 1]) - half
    outside = np.hypot(np.maximum(across, 0.0), np.maximum(along, 0.0))
    return np.asarray(outside + np.minimum(np.maximum(across, along), 0.0))


def expected(body: BodyParams, x: Floats) -> Floats:
    p = rotate_back(from_euler(body.rotation), x - np.array(body.position))
    if isinstance(body, Plane):
        return np.asarray(p @ np.array(body.normal) / np.linalg.norm(body.normal))
    if isinstance(body, Box):
        return box_distance(p, 0.5 * np.array(body.size)) * (-1.0 if body.inside else 1.0)
    if isinstance(body, Sphere):
        return np.asarray((np.linalg.norm(p, axis=1) - body.radius) * (-1.0 if body.inside else 1.0))
    if isinstance(body, Cylinder):
        return cylinder_distance(p, body.radius, 0.5 * body.length) * (-1.0 if body.inside else 1.0)
    assert isinstance(body, Capsule)
    return segment_distance(p, 0.5 * body.length) - body.radius


BODIES: dict[str, BodyParams] = {
    "plane": Plane(normal=(1.0, 2.0, -1.0), **POSE),
    "box": Box(size=(1.0, 2.0, 3.0), **POSE),
    "box container": Box(size=(5.0, 6.0, 7.0), inside=True, **POSE),
    "sphere": Sphere(radius=1.5, **POSE),
    "sphere container": Sphere(radius=3.5, inside=True, **POSE),
    "capsule": Capsule(radius=0.7, length=2.0, **POSE),
    "cylinder": Cylinder(radius=0.8, length=3.0, **POSE),
    "cylinder container": Cylinder(radius=2.5, length=6.0, inside=True, **POSE),
}


@pytest.mark.parametrize("name", BODIES)
def test_distance_is_that_of_the_formula(name: str) -> None:
    x = points()
    distance, _, _ = Bodies({"b": BODIES[name]}).distance(x)
    np.testing.assert_allclose(distance, expected(BODIES[name], x), atol=LENGTH)


@pytest.mark.parametrize("name", BODIES)
def test_normal_is_the_unit_gradient(name: str) -> None:
    bodies, x = Bodies({"b": BODIES[name]}), points()
    _, normal, _ = bodies.distance(x)
    np.testing.assert_allclose(np.linalg.norm(normal, axis=1), 1.0, atol=LENGTH)
    steps = STEP * np.eye(3)
    gradient = np.stack(
        [(expected(BODIES[name], x + e) - expected(BODIES[name], x - e)) for e in steps], axis=1
    )
    gradient /= 2.0 * STEP
    # Where the nearest surface point jumps (inside a box, on a capsule's axis) the difference
    # straddles two branches and is shorter than one.
    smooth = np.abs(np.linalg.norm(gradient, axis=1) - 1.0) < STEP
    assert smooth.mean() > 0.9
    np.testing.assert_allclose(normal[smooth], gradient[smooth], atol=GRADIENT)


def test_box_on_faces_edges_corners_and_centre() -> None:
    bodies = Bodies({"b": Box(size=(2.0, 4.0, 6.0))})
    x: list[list[float]] = [[1, 0, 0], [1, 2, 0], [1, 2, 3], [0, 0, 0], [0.5, 0, 0], [2, 3, 4], [0, 0, -4]]
    distance, normal, _ = bodies.distance(x)
    np.testing.assert_allclose(distance, [0, 0, 0, -1, -0.5, np.sqrt(3), 1], atol=LENGTH)
    np.testing.assert_allclose(np.linalg.norm(normal, axis=1), 1.0, atol=LENGTH)
    np.testing.assert_allclose(normal[[0, 4, 6]], [[1, 0, 0], [1, 0, 0], [0, 0, -1]], atol=LENGTH)
    np.testing.assert_allclose(normal[5], np.ones(3) / np.sqrt(3), atol=LENGTH)


@pytest.mark.parametrize("body", [Sphere(), Capsule(), Box(), Cylinder()])
def test_centre_has_a_unit_normal(body: BodyParams) -> None:
    distance, normal, _ = Bodies({"b": body}).distance([[0.0, 0.0, 0.0]])
    assert distance[0] < 0.0
    assert np.linalg.norm(normal[0]) == pytest.approx(1.0, abs=LENGTH)


@pytest.mark.parametrize("kind", [Sphere, Box, Cylinder])
def test_a_container_is_the_solid_with_the_other_sign(kind: type) -> None:
    x = points(500)
    solid, solid_normal, _ = Bodies({"b": kind(**POSE)}).distance(x)
    container, normal, _ = Bodies({"b": kind(inside=True, **POSE)}).distance(x)
    np.testing.assert_array_equal(container, -solid)
    np.testing.assert_array_equal(normal, -solid_normal)


def test_the_nearest_of_several_bodies_counts() -> None:
    named = {name: body for name, body in BODIES.items() if "container" not in name}
    x = points()
    distance, _, _ = Bodies(named).distance(x)
    each = np.stack([expected(body, x) for body in named.values()])
    np.testing.assert_allclose(distance, each.min(axis=0), atol=LENGTH)


def test_no_bodies_are_infinitely_far() -> None:
    bodies = Bodies({})
    distance, normal, velocity = bodies.distance(points(3))
    assert bodies.count == 0
    assert bodies.table.shape == (1, WIDTH)
    assert np.isinf(distance).all()
    assert not normal.any()
    assert not velocity.any()
    assert bodies.snapshot() == ()


def test_names_and_index() -> None:
    bodies = Bodies({"rock": Sphere(), "floor": Plane()})
    assert bodies.names == ("rock", "floor")
    assert bodies.index("floor") == 1
    with pytest.raises(KeyError, match="no body 'wall'; there are rock, floor"):
        bodies.index("wall")


PATH = Keyframes[Vector3](
    keys=((0.0, (0.0, 0.0, 0.0)), (1.0, (1.0, 2.0, 0.0)), (2.0, (4.0, 0.0, 1.0))), interpolation="cubic"
)
TURN = Keyframes[Vector3](keys=((0.0, (0.0, 0.0, 0.0)), (2.0, (90.0, 60.0, 30.0))))
MOVING = Box.model_validate({"position": PATH, "rotation": TURN})


def test_surface_velocity_is_how_material_points_move() -> None:
    time, dt = 0.7, 1e-3
    bodies = Bodies({"b": MOVING})
    bodies.move(time, dt)
    now, later = MOVING.at(time), MOVING.at(time + dt)
    local = points(200)
    x, after = (rotate(from_euler(pose.rotation), local) + pose.position for pose in (now, later))
    _, _, velocity = bodies.distance(x)
    # Over dt a point at r turns on a circle: the chord differs from the tangent by w^2 r dt / 2 < 5e-3.
    np.testing.assert_allclose(velocity, (after - x) / dt, atol=5e-3)
    assert np.linalg.norm(velocity, axis=1).max() > 2.0


def test_a_moved_body_is_where_its_keyframes_say() -> None:
    bodies, x = Bodies({"still": Sphere(position=(50.0, 0.0, 0.0)), "b": MOVING}), points(300)
    bodies.move(1.3, 0.01)
    distance, _, _ = bodies.distance(x)
    np.testing.assert_allclose(distance, expected(MOVING.at(1.3), x), atol=LENGTH)


def test_without_dt_bodies_stand_still() -> None:
    bodies = Bodies({"b": MOVING})
    bodies.move(0.5, 0.0)
    assert not bodies.distance(points(10))[2].any()


def test_fixed_bodies_are_packed_once(monkeypatch: pytest.MonkeyPatch) -> None:
    bodies = Bodies({"b": Box(), "p": Plane()})
    monkeypatch.setattr(bodies, "table", None)  # any use of it would fail
    bodies.move(1.0, 0.01)


SNAPSHOTS: dict[str, BodyParams] = {**BODIES, "moving": MOVING}


@pytest.mark.parametrize("name", SNAPSHOTS)
def test_snapshot_lies_on_the_surface(name: str) -> None:
    bodies = Bodies({"b": SNAPSHOTS[name]})
    bodies.move(0.7, 0.01)
    (part,) = bodies.snapshot()
    distance, _, velocity = bodies.distance(part.position)
    # The plane's square is 20 m wide: its corners are good to 1e-5 m in float32.
    np.testing.assert_allclose(distance, 0.0, atol=2e-5)
    np.testing.assert_allclose(np.asarray(part.data["velocity"], float), velocity, atol=1e-4)
    assert isinstance(part, Lines if "container" in name else Mesh)
    assert part.units == {"velocity": "m/s"}


@pytest.mark.parametrize("name", ["plane", "box", "sphere", "capsule", "cylinder"])
def test_snapshot_triangles_face_outwards(name: str) -> None:
    bodies = Bodies({"b": BODIES[name]})
    (part,) = bodies.snapshot()
    assert isinstance(part, Mesh)
    a, b, c = part.position[part.triangles].transpose(1, 0, 2).astype(np.float64)
    area = np.cross(b - a, c - a)
    assert np.linalg.norm(area, axis=1).min() > 0.0
    _, normal, _ = bodies.distance((a + b + c) / 3.0)
    assert ((area * normal).sum(axis=1) > 0.0).all()


@pytest.mark.parametrize(
    ("name", "volume"),
    [
        ("box", 6.0),
        ("sphere", 4 / 3 * np.pi * 1.5**3),
        ("capsule", np.pi * 0.49 * 2 + 4 / 3 * np.pi * 0.343),
        ("cylinder", np.pi * 0.64 * 3),
    ],
)
def test_snapshot_is_closed(name: str, volume: float) -> None:
    (part,) = Bodies({"b": BODIES[name]}).snapshot()
    assert isinstance(part, Mesh)
    a, b, c = part.position[part.triangles].transpose(1, 0, 2).astype(np.float64)
    # 24 pieces to a circle: the chords cut off some 1 % of each area, 2.3 % of a ball's volume.
    assert (a * np.cross(b, c)).sum() / 6.0 == pytest.approx(volume, rel=0.03)
