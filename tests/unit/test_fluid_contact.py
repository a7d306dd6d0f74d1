"""Contacts of a fluid with walls: what is held, how it rubs, and that nothing ever gets out."""

from typing import Any

import numpy as np
import pytest
import trimesh
from numpy.typing import NDArray

from tianim.lang import f32_2d, ti
from tianim.params import Keyframes, Vector3
from tianim.spatial.bodies import (
    Bodies,
    BodyParams,
    Box,
    Capsule,
    Cylinder,
    MeshSequence,
    Plane,
    Sphere,
    TriangleMesh,
)
from tianim.system import Bounds
from tianim.systems.fluid.params import Walls as WallParams
from tianim.systems.fluid.particles import Particles
from tianim.systems.fluid.wall_contact import CREEP
from tianim.systems.fluid.walls import LEAST, Walls

Floats = NDArray[np.float64]

D = 0.04  # spacing [m]
RHO = 1000.0
# float32 places of about a metre, and velocities that are differences of them over a millisecond.
PLACE = 1e-6
SPEED = 1e-3


@ti.kernel
def advance(n: ti.i32, dt: ti.f32, x: f32_2d, v: f32_2d):
    for i in range(n):
        for c in ti.static(range(3)):
            x[c, i] += dt * v[c, i]


class Spray:
    """Free particles among walls, without pressure."""

    def __init__(
        self,
        x: Any,
        v: Any,
        bodies: dict[str, BodyParams],
        bounds: Bounds = Bounds(),
        friction: float = 0.0,
        dimension: int = 3,
    ) -> None:
        place, velocity = np.atleast_2d(np.asarray(x, float)), np.atleast_2d(np.asarray(v, float))
        self.n, self.time, self.clamped = len(place), 0.0, 0
        self.fluid = Particles(self.n, dimension, D, 2.0, np.array([RHO], np.float32))
        self.fluid.columns.append(
            self.n, {"position": place, "velocity": np.broadcast_to(velocity, place.shape)}
        )
        self.bodies = Bodies(bodies)
        self.walls = Walls(self.bodies, bounds, self.fluid, WallParams(friction=friction))

    def step(self, dt: float, gravity: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> None:
        x, v = self.fluid["position"], self.fluid["velocity"]
        self.bodies.move(self.time, dt)
        self.walls.measure(self.n, x)
        self.set_velocity(self.velocity + dt * np.array(gravity))
        self.walls.hold(self.n, x, v, dt)
        advance(self.n, dt, x, v)
        self.clamped += self.walls.clamp(self.n, x, v)
        self.time += dt

    def distances(self) -> Floats:
        """To the nearest body, posed at the time of now."""
        self.bodies.move(self.time, 0.0)
        return np.asarray(self.bodies.distance(self.position)[0])

    @property
    def position(self) -> Floats:
        return np.asarray(self.fluid.columns.read("position"))

    @property
    def velocity(self) -> Floats:
        return np.asarray(self.fluid.columns.read("velocity"))

    def set_velocity(self, velocity: Floats) -> None:
        self.fluid.columns.write("velocity", velocity.astype(np.float32))


def test_a_falling_drop_stops_at_the_floor_without_a_bounce() -> None:
    spray = Spray([0.0, 0.1, 0.0], [1.0, -2.0, 0.0], {"floor": Plane()})
    for _ in range(100):
        spray.step(0.002, (0.0, -9.81, 0.0))
    np.testing.assert_allclose(spray.position, [[0.2, LEAST * D, 0.0]], atol=100 * PLACE)
    np.testing.assert_allclose(spray.velocity, [[1.0, 0.0, 0.0]], atol=SPEED)
    assert spray.clamped == 0


def test_what_would_not_go_through_is_left_as_it_is() -> None:
    """A lattice with its first layer half a spacing from each wall, moving less than a quarter."""
    cells = np.stack(np.meshgrid(*[np.arange(6) + 0.5] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
    velocity = np.random.default_rng(0).uniform(-0.24, 0.24, cells.shape) * D / 0.01
    spray = Spray(cells * D, velocity, {}, Bounds("contained", (0, 0, 0), (6 * D, 6 * D, 6 * D)))
    x, v = spray.fluid["position"], spray.fluid["velocity"]
    before = v.to_numpy()
    spray.walls.measure(spray.n, x)
    spray.walls.hold(spray.n, x, v, 0.01)
    np.testing.assert_array_equal(v.to_numpy(), before)
    assert not spray.walls.impulses()["bounds"].any()


def test_what_lies_deeper_is_not_thrown_out_and_goes_no_deeper() -> None:
    spray = Spray(
        [[0.0, 0.1 * D, 0.0], [0.5, 0.1 * D, 0.0]], [[0.0, -5.0, 0.0], [0.0, 0.0, 0.0]], {"floor": Plane()}
    )
    spray.step(0.005)
    np.testing.assert_allclose(spray.position[:, 1], (0.1 + CREEP * LEAST) * D, atol=PLACE)
    assert spray.velocity[:, 1].max() <= 2 * CREEP * LEAST * D / 0.005
    assert spray.clamped == 0


@pytest.mark.parametrize(("friction", "rest"), [(0.0, 3.0), (0.2, 2.5), (1.0, 0.0)])
def test_friction_takes_off_coulombs_part_of_the_blow(friction: float, rest: float) -> None:
    """Coefficient f / (1 - f): 0.2 gives 0.25, and the blow is 2 m/s."""
    spray = Spray([0.0, LEAST * D, 0.0], [3.0, -2.0, 0.0], {"floor": Plane()}, friction=friction)
    spray.step(0.001)
    np.testing.assert_allclose(spray.velocity, [[rest, 0.0, 0.0]], atol=SPEED)


def test_what_sticks_is_carried_by_a_belt() -> None:
    path = Keyframes[Vector3](keys=((0.0, (0.0, 0.0, 0.0)), (1.0, (2.0, 0.0, 0.0))))
    belt = Box.model_validate({"position": path, "size": (9.0, 0.2, 1.0)})
    for friction, speed in ((1.0, 2.0), (0.0, 0.0)):
        spray = Spray([0.0, 0.1 + LEAST * D, 0.0], [0.0, -1.0, 0.0], {"belt": belt}, friction=friction)
        spray.step(0.002)
        np.testing.assert_allclose(spray.velocity, [[speed, 0.0, 0.0]], atol=SPEED)


def test_a_piston_pushes_with_its_velocity_and_gets_the_impulse() -> None:
    path = Keyframes[Vector3](keys=((0.0, (0.0, 0.0, 0.0)), (1.0, (3.0, 0.0, 0.0))))
    piston = Box.model_validate({"position": path, "size": (0.2, 1.0, 1.0)})
    spray = Spray([0.1 + LEAST * D, 0.3, -0.2], [0.0, 0.0, 0.0], {"piston": piston})
    spray.step(0.002)
    np.testing.assert_allclose(spray.velocity, [[3.0, 0.0, 0.0]], atol=SPEED)
    given = -RHO * spray.fluid.volume * np.array([3.0, 0.0, 0.0])
    impulse = spray.walls.impulses()["piston"]
    np.testing.assert_allclose(impulse[:3], given, atol=1e-3 * abs(given[0]))
    arm = np.array([0.1, 0.3, -0.2])
    np.testing.assert_allclose(
        impulse[3:], np.cross(arm, given), atol=0.1 * np.abs(np.cross(arm, given)).max()
    )


def test_a_blow_followed_in_pieces_gives_the_wall_all_momentum_that_is_lost() -> None:
    """Seven spacings in a step, into the corner of two walls, with friction."""
    bodies: dict[str, BodyParams] = {"floor": Plane(), "left": Plane(normal=(1.0, 0.0, 0.0))}
    velocity = np.array([-20.0, -40.0, 10.0])
    spray = Spray([0.1, 0.2, 0.0], velocity, bodies, friction=0.1)
    spray.step(0.007)
    lost = RHO * spray.fluid.volume * (velocity - spray.velocity[0])
    total = sum(impulse[:3] for impulse in spray.walls.impulses().values())
    np.testing.assert_allclose(total, lost, atol=1e-3 * np.linalg.norm(lost))
    assert spray.position[0, :2].min() > LEAST * D - PLACE
    assert np.linalg.norm(lost) > 0.5


@pytest.mark.parametrize("dt", [0.001, 0.01])
def test_a_particle_thrown_into_a_corner_stays_there(dt: float) -> None:
    bounds = Bounds("contained", (0, 0, 0), (1, 1, 1))
    spray = Spray([0.9, 0.9, 0.9], [13.0, 17.0, 11.0], {}, bounds)
    for _ in range(20):
        spray.step(dt, (100.0, 100.0, 100.0))
    np.testing.assert_allclose(spray.position, 1.0 - LEAST * D, atol=0.02 * D)
    assert spray.clamped == 0


PLATES: dict[str, dict[str, Any]] = {
    "box": {"kind": "box", "size": (2.0, 0.2 * D, 2.0)},
    "cylinder": {"kind": "cylinder", "radius": 1.2, "length": 0.2 * D},
}


@pytest.mark.parametrize("moves", [False, True])
@pytest.mark.parametrize("shape", PLATES)
def test_a_thin_plate_is_not_jumped_over(shape: str, moves: bool) -> None:
    """Up to 15 spacings a step, through a plate of a fifth of a spacing that comes towards them."""
    rng = np.random.default_rng(2)
    kinds: dict[str, Any] = {"box": Box, "cylinder": Cylinder}
    body = dict(PLATES[shape])
    if moves:
        path = Keyframes[Vector3](keys=((0.0, (0.0, -0.2, 0.0)), (1.0, (0.0, 3.8, 0.0))))
        body["position"] = path
    x = np.stack(
        [rng.uniform(-0.2, 0.2, 500), rng.uniform(0.1, 0.7, 500), rng.uniform(-0.2, 0.2, 500)], axis=1
    )
    v = np.stack([rng.normal(0, 1, 500), rng.uniform(-60, 0, 500), rng.normal(0, 1, 500)], axis=1)
    spray = Spray(x, v, {"plate": kinds[shape].model_validate(body)})
    for _ in range(8):
        spray.step(0.01, (0.0, -500.0, 0.0))
    level = -0.2 + 4.0 * spray.time if moves else 0.0
    assert spray.position[:, 1].min() > level
    assert np.median(spray.position[:, 1]) < level + D
    assert spray.clamped == 0


def test_a_turning_paddle_sweeps_all_before_it() -> None:
    """Ten turns a second, 0.6 m long: 4 spacings a step at its end."""
    turn = Keyframes[Vector3](
        keys=((0.0, (0.0, 0.0, 0.0)), (1.0, (0.0, 0.0, 170.0)), (2.0, (0.0, 0.0, 340.0)))
    )
    paddle = Box.model_validate({"rotation": turn, "size": (1.2, 0.5 * D, 0.4)})
    rng = np.random.default_rng(3)
    x = np.stack(
        [rng.uniform(0.1, 0.5, 300), rng.uniform(0.05, 0.3, 300), rng.uniform(-0.1, 0.1, 300)], axis=1
    )
    spray = Spray(x, [0.0, 0.0, 0.0], {"paddle": paddle}, friction=1.0)
    for _ in range(25):
        spray.step(0.02)
        assert spray.distances().min() > 0.9 * LEAST * D
    # Half a turn or so later all have been hit, and go before the paddle.
    assert spray.clamped == 0
    assert (np.linalg.norm(spray.velocity, axis=1) > 0.1).all()


def test_places_shifted_after_the_measurement_are_held_all_the_same() -> None:
    """Solvers may shift places a little between `measure` and `hold`."""
    spray = Spray([0.0, (LEAST + 0.3) * D, 0.0], [0.0, 0.0, 0.0], {"floor": Plane()})
    x, v = spray.fluid["position"], spray.fluid["velocity"]
    spray.walls.measure(1, x)
    spray.fluid.columns.write("position", np.array([[0.0, (LEAST + 0.11) * D, 0.0]], np.float32))
    spray.set_velocity(np.array([[0.0, -0.2 * D / 0.001, 0.0]]))
    spray.walls.hold(1, x, v, 0.001)
    advance(1, 0.001, x, v)
    np.testing.assert_allclose(spray.position[0, 1], LEAST * D, atol=PLACE)


def test_a_shift_ends_before_the_walls_and_keeps_velocities() -> None:
    """Before the nearest wall and the next; what is nearer than allowed stays so; periods are gone round."""
    near = 0.02 * LEAST
    bodies: dict[str, BodyParams] = {"floor": Plane(), "wall": Plane(normal=(1.0, 0.0, 0.0))}
    x = np.array([[0.3 * D, 0.25 * D, 0.0], [1.0, near * D, 0.0], [0.5, 0.5, 0.99]])
    spray = Spray(x, [0.0, 0.0, 0.0], bodies)
    way = ti.ndarray(ti.f32, (3, 3))
    way.from_numpy(np.array([[-0.3, -0.3, 0.1], [0.05, -0.05, 0.0], [0.1, 0.1, 0.1]], np.float32).T * D)
    lower, length = ti.ndarray(ti.f32, 3), ti.ndarray(ti.f32, 3)
    lower.fill(0.0)
    length.from_numpy(np.array([0.0, 0.0, 0.99 + 0.06 * D], np.float32))
    spray.walls.measure(3, spray.fluid["position"])
    spray.walls.hold(3, spray.fluid["position"], spray.fluid["velocity"], 1e-4)
    before = spray.velocity
    spray.walls.shift(3, spray.fluid["position"], spray.fluid["velocity"], way, lower, length)
    least = min(LEAST, 0.25)
    expected = np.array([
        [least * D, least * D, 0.1 * D], [1.0 + 0.05 * D, near * D, 0.0],
        [0.5 + 0.1 * D, 0.5 + 0.1 * D, 0.04 * D],
    ])  # fmt: skip
    np.testing.assert_allclose(spray.position, expected, atol=PLACE)
    assert np.array_equal(spray.velocity, before)


def test_what_is_in_a_wall_is_moved_out_and_counted() -> None:
    bodies: dict[str, BodyParams] = {"floor": Plane(), "rock": Sphere(radius=0.2, position=(1.0, 0.5, 0.0))}
    x = [[0.0, -0.1, 0.0], [1.0, 0.45, 0.1], [0.5, 0.5, 0.0], [0.0, LEAST * D, 0.0]]
    spray = Spray(x, [0.0, -1.0, 0.0], bodies)
    spray.walls.measure(4, spray.fluid["position"])
    spray.walls.hold(4, spray.fluid["position"], spray.fluid["velocity"], 1e-4)
    spray.set_velocity(np.tile([0.0, -1.0, 0.0], (4, 1)))
    assert spray.walls.clamp(4, spray.fluid["position"], spray.fluid["velocity"]) == 2
    distance = spray.distances()
    np.testing.assert_allclose(distance[[0, 1, 3]], LEAST * D, atol=PLACE)
    np.testing.assert_allclose(spray.velocity[[0, 2, 3], 1], [0.0, -1.0, -1.0], atol=PLACE)
    assert spray.walls.clamp(4, spray.fluid["position"], spray.fluid["velocity"]) == 0


def shaken(seconds: float) -> dict[str, Any]:
    """Position and rotation of a body that is shaken and turned about by a strong hand."""
    rng = np.random.default_rng(1)
    times = np.arange(0.0, seconds + 0.5, 0.25)
    places = rng.uniform(-0.3, 0.3, (len(times), 3))
    angles = np.cumsum(rng.uniform(-60.0, 60.0, (len(times), 3)), axis=0)

    def keys(values: Floats) -> Any:
        pairs: Any = tuple((float(t), tuple(map(float, row))) for t, row in zip(times, values, strict=True))
        return Keyframes[Vector3](keys=pairs, interpolation="cubic")

    return {"position": keys(places), "rotation": keys(angles)}


CONTAINERS = ("box", "cylinder", "sphere", "mesh")


def container(kind: str, seconds: float, folder: Any) -> BodyParams:
    rest: dict[str, Any] = {"inside": True, **shaken(seconds)}
    if kind == "box":
        return Box.model_validate({"size": (1.0, 0.8, 1.2), **rest})
    if kind == "cylinder":
        return Cylinder.model_validate({"radius": 0.5, "length": 1.0, **rest})
    if kind == "sphere":
        return Sphere.model_validate({"radius": 0.6, **rest})
    file = folder / "ring.ply"
    trimesh.creation.torus(0.5, 0.3, major_sections=40, minor_sections=20).export(file)
    return TriangleMesh.model_validate({"file": file, "resolution": 48, **rest})


def slosh(spray: Spray, steps: int, dt: float, speed: float) -> float:
    """Throw all about anew every 40 steps; the least distance from the wall that was seen."""
    rng = np.random.default_rng(7)
    least = np.inf
    for step in range(steps):
        if step % 40 == 0:
            least = min(least, float(spray.distances().min()))
            spray.set_velocity(spray.velocity + rng.normal(0.0, speed, (spray.n, 3)))
        spray.step(dt, (0.0, -9.81, 0.0))
    return min(least, float(spray.distances().min()))


@pytest.mark.parametrize("kind", CONTAINERS)
def test_nothing_gets_out_of_a_shaken_container(kind: str, tmp_path: Any) -> None:
    """2,000 free particles at 8 m/s and more, up to 3 spacings a step, with some friction."""
    steps, dt = 320, 0.005
    tank = container(kind, steps * dt, tmp_path)
    x = np.random.default_rng(4).uniform(-0.7, 0.7, (40_000, 3)) + np.array(tank.at(0.0).position)
    x = x[Bodies({"tank": tank}).distance(x)[0] > 0.5 * D][:2000]
    spray = Spray(x, [0.0, 0.0, 0.0], {"tank": tank}, friction=0.2)
    assert slosh(spray, steps, dt, 8.0) > 0.99 * LEAST * D
    assert spray.clamped == 0
    assert len(x) == 2000


@pytest.mark.slow
@pytest.mark.parametrize("speed", [1.0, 30.0])
@pytest.mark.parametrize("friction", [0.0, 1.0])
@pytest.mark.parametrize("kind", CONTAINERS)
def test_nothing_gets_out_for_thousands_of_steps(
    kind: str, friction: float, speed: float, tmp_path: Any
) -> None:
    """30 m/s is 7 to 15 spacings a step."""
    steps, dt = 4000, 0.005
    tank = container(kind, steps * dt, tmp_path)
    x = np.random.default_rng(4).uniform(-0.7, 0.7, (40_000, 3)) + np.array(tank.at(0.0).position)
    x = x[Bodies({"tank": tank}).distance(x)[0] > 0.5 * D][:2000]
    spray = Spray(x, [0.0, 0.0, 0.0], {"tank": tank}, friction=friction)
    assert slosh(spray, steps, dt, speed) > 0.0
    assert spray.clamped == 0


def test_nothing_gets_out_of_bounds_with_things_in_them() -> None:
    """A tank with a stirring paddle, a rock on the floor and a capsule, thrown about in it."""
    rest = shaken(3.0)
    bodies: dict[str, BodyParams] = {
        "paddle": Box.model_validate({"size": (0.5, 0.05, 0.3), **rest}),
        "rock": Sphere(radius=0.2, position=(0.7, -0.8, 0.0)),
        "log": Capsule(radius=0.1, length=0.5, position=(-0.7, -0.5, 0.0), rotation=(0.0, 0.0, 50.0)),
    }
    bounds = Bounds("contained", (-1.0, -1.0, -0.6), (1.0, 1.0, 0.6))
    x = np.random.default_rng(4).uniform(-0.55, 0.55, (4000, 3)) * [1.7, 1.7, 1.0]
    x = x[Bodies(bodies).distance(x)[0] > 0.5 * D][:2000]
    spray = Spray(x, [0.0, 0.0, 0.0], bodies, bounds, friction=0.1)
    # Squeezed between a paddle and another wall it may come nearer.
    assert slosh(spray, 200, 0.005, 8.0) > 0.0
    assert spray.clamped == 0
    assert (np.abs(spray.position) < [1.0, 1.0, 0.6]).all()


def test_nothing_gets_out_of_a_rectangle_in_two_dimensions() -> None:
    bounds = Bounds("contained", (0.0, 0.0, -0.01), (2.0, 1.0, 0.01))
    wheel = Keyframes[Vector3](keys=((0.0, (0.0, 0.0, 0.0)), (1.0, (0.0, 0.0, 175.0))))
    bodies: dict[str, BodyParams] = {
        "paddle": Box.model_validate(
            {"position": (1.0, 0.5, 0.0), "rotation": wheel, "size": (0.8, 0.05, 0.1)}
        )
    }
    rng = np.random.default_rng(5)
    x = np.concatenate([rng.uniform(0.05, 0.4, (1000, 2)), np.zeros((1000, 1))], axis=1)
    v = np.concatenate([rng.normal(0.0, 20.0, (1000, 2)), np.zeros((1000, 1))], axis=1)
    spray = Spray(x, v, bodies, bounds, dimension=2)
    for _ in range(200):
        spray.step(0.005, (0.0, -9.81, 0.0))
    assert (spray.position[:, :2] > 0.0).all()
    assert (spray.position[:, :2] < [2.0, 1.0]).all()
    assert not spray.position[:, 2].any()
    assert spray.clamped == 0


@pytest.mark.parametrize("friction", [0.0, 0.5])
def test_nothing_leaves_the_plane_in_two_dimensions(friction: float) -> None:
    """Whichever way the bodies lean and go; a plane holds where it cuts the plane z = 0."""
    way = Keyframes[Vector3](keys=((0.0, (2.0, 0.6, -0.2)), (1.0, (2.0, 0.6, 0.2))))
    bodies: dict[str, BodyParams] = {
        "floor": Plane(normal=(0.0, 1.0, 0.75)),
        "box": Box(size=(0.4, 0.4, 0.4), position=(1.0, 0.4, 0.0), rotation=(20.0, 10.0, 0.0)),
        "ball": Sphere.model_validate({"radius": 0.3, "position": way}),
    }
    rng = np.random.default_rng(6)
    x = np.stack([rng.uniform(0.5, 2.5, 500), rng.uniform(1.0, 1.5, 500), np.zeros(500)], axis=1)
    spray = Spray(x, [0.0, 0.0, 0.0], bodies, friction=friction, dimension=2)
    for _ in range(400):
        spray.step(0.002, (0.0, -9.81, 0.0))
    assert not spray.position[:, 2].any()
    assert not spray.velocity[:, 2].any()
    assert spray.clamped == 0
    assert spray.position[:, 1].min() == pytest.approx(LEAST * D, abs=100 * PLACE)


def test_a_growing_mesh_sequence_pushes_out(tmp_path: Any) -> None:
    ball = trimesh.creation.icosphere(subdivisions=3)
    for key, radius in enumerate((0.2, 0.4, 0.6)):
        ball.copy().apply_scale(radius).export(tmp_path / f"ball_{key}.ply")
    grows = MeshSequence(files=tmp_path, fps=5.0, resolution=32)
    direction = np.random.default_rng(9).normal(size=(400, 3))
    x = 0.3 * direction / np.linalg.norm(direction, axis=1, keepdims=True)
    spray = Spray(x, [0.0, 0.0, 0.0], {"ball": grows})
    for _ in range(70):
        spray.step(0.005)
    assert spray.time < 0.4
    # The surface grows at 1 m/s: 0.55 m after 0.35 s; facets lie up to 1 % inside.
    radius = np.linalg.norm(spray.position, axis=1)
    assert radius.min() > 0.55
    assert radius.max() < 0.55 + D
    assert spray.clamped == 0
