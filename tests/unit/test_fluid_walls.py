"""Walls of a fluid: shares beside sums over lattices and integrals over the kernel, forces on bodies."""

from typing import Any

import numpy as np
import pytest
import trimesh
from numpy.typing import NDArray

from tianim.lang import f32_1d, f32_2d, ti
from tianim.math.rotations import from_euler, rotate, rotate_back
from tianim.math.smoothing import SUPPORT, spline_scale, spline_values
from tianim.params import Keyframes, Vector3
from tianim.spatial.bodies import Bodies, BodyParams, Box, Capsule, Cylinder, Plane, Sphere, TriangleMesh
from tianim.system import Bounds
from tianim.systems.fluid import walls as walls_module
from tianim.systems.fluid.params import BodyWall
from tianim.systems.fluid.params import Walls as WallParams
from tianim.systems.fluid.particles import Particles
from tianim.systems.fluid.wall_shares import wall_terms
from tianim.systems.fluid.walls import Walls

Floats = NDArray[np.float64]

D = 0.05  # spacing of the particles [m]
# The tables hold 96 samples a support, linear between them, and lattices are met to their fourth digit.
LATTICE = 5e-4
# Support of the kernel whose integral over a half space is what a lattice misses [spacings].
WALL_KERNEL = 1.7144
# Quadrature with 44^3 points 1e-3; a curvature between two rows of the table 2e-3.
SHARE = 4e-3
# Two kernels round differently [m, lengths below one].
ROUNDING = 1e-7
# Central differences of float32 shares over a hundredth of a support; slopes are interpolated too.
GRADIENT = 0.02

POSE: dict[str, Any] = {"position": (0.3, -0.2, 0.1), "rotation": (25.0, -40.0, 70.0)}


def particles(x: Floats, dimension: int = 3, support: float | None = None) -> Particles:
    """Water at `x` (n, 3), at rest."""
    made = Particles(len(x), dimension, D, support or SUPPORT[dimension], np.array([1000.0], np.float32))
    made.columns.append(len(x), {"position": x.astype(np.float32)})
    return made


def walls_of(
    fluid: Particles, bodies: Bodies, bounds: Bounds = Bounds(), params: WallParams = WallParams()
) -> Walls:
    """Walls, measured."""
    walls = Walls(bodies, bounds, fluid, params)
    walls.measure(fluid.count, fluid["position"])
    return walls


def share_at(
    x: Floats, bodies: Bodies, bounds: Bounds = Bounds(), dimension: int = 3
) -> tuple[Floats, Floats]:
    """Shares (n,) and their gradients (n, 3) [1/m] at `x`."""
    walls = walls_of(particles(x, dimension), bodies, bounds)
    n = len(x)
    return walls.share.to_numpy()[:n].astype(float), walls.gradient.to_numpy()[:, :n].T.astype(float)


def lattice(lower: tuple[int, ...], upper: tuple[int, ...]) -> Floats:
    """Particles in the middle of cells of edge D, from cell `lower` up to but without `upper`."""
    axes = [np.arange(a, b) + 0.5 for a, b in zip(lower, upper, strict=True)]
    x = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, len(axes)) * D
    return np.concatenate([x, np.zeros((len(x), 3 - len(axes)))], axis=1)


def kernel_sums(fluid: Particles, x: Floats) -> Floats:
    """The particles' part of the relative density, over all pairs."""
    sums = np.zeros(len(x))
    for i, place in enumerate(x):
        sums[i] = spline_values(np.linalg.norm(x - place, axis=1) / fluid.h, fluid.dimension).sum()
    return fluid.volume * fluid.scale * sums


def densities(x: Floats, bodies: Bodies, bounds: Bounds = Bounds(), dimension: int = 3) -> Floats:
    fluid = particles(x, dimension)
    return kernel_sums(fluid, x) + walls_of(fluid, bodies, bounds).share.to_numpy()[: len(x)]


@pytest.mark.parametrize("dimension", [2, 3])
@pytest.mark.parametrize("support", [2.0, 2.5, 3.0])
def test_the_first_layers_bear_the_pressure_on_their_area(dimension: int, support: float) -> None:
    """V P sum grad lambda = P d^(dim - 1); with a small support the first one alone."""
    fluid = particles(D * np.array([[0.0, 0.5, 0.0], [0.0, 1.5, 0.0]]), dimension, support)
    gradient = D * walls_of(fluid, Bodies({"floor": Plane()})).gradient.to_numpy()[:, :2]
    np.testing.assert_allclose(gradient.sum(axis=1), [0.0, -1.0, 0.0], atol=LATTICE)
    if support == 2.0:
        np.testing.assert_allclose(gradient[:, 0], [0.0, -1.0, 0.0], atol=LATTICE)
        assert not gradient[:, 1].any()
    else:
        assert -0.06 < gradient[1, 1] < -0.001


@pytest.mark.parametrize("dimension", [2, 3])
@pytest.mark.parametrize("support", [2.0, 2.5, 3.0])
def test_every_layer_before_a_plane_has_density_one(dimension: int, support: float) -> None:
    x = lattice((-4, 0, -4)[:dimension], (5, 6, 5)[:dimension])
    fluid = particles(x, dimension, support)
    density = kernel_sums(fluid, x) + walls_of(fluid, Bodies({"floor": Plane()})).share.to_numpy()[: len(x)]
    middle = np.abs(x[:, [0, 2]] - [0.5 * D, 0.5 * D * (dimension == 3)]).max(axis=1) < 0.1 * D
    first, second, third = density[middle][:3]
    assert first == pytest.approx(1.0, abs=LATTICE)
    assert second == pytest.approx(1.0, abs=LATTICE)
    assert third == pytest.approx(1.0, abs=LATTICE)


def test_a_fluid_that_fills_a_box_has_density_one_in_corners_and_on_edges_and_faces() -> None:
    x = lattice((0, 0, 0), (6, 5, 7))
    upper = (6 * D, 5 * D, 7 * D)
    np.testing.assert_allclose(
        densities(x, Bodies({}), Bounds("contained", (0, 0, 0), upper)), 1.0, atol=LATTICE
    )
    turn = from_euler(POSE["rotation"])
    tank = Box(size=upper, inside=True, **POSE)
    turned = rotate(turn, x - 0.5 * np.array(upper)) + POSE["position"]
    np.testing.assert_allclose(densities(turned, Bodies({"tank": tank})), 1.0, atol=LATTICE)


def test_a_fluid_that_fills_a_rectangle_has_density_one() -> None:
    x = lattice((0, 0), (6, 5))
    # The depth does not matter, however small.
    bounds = Bounds("contained", (0, 0, -0.1 * D), (6 * D, 5 * D, 0.1 * D))
    np.testing.assert_allclose(densities(x, Bodies({}), bounds, 2), 1.0, atol=LATTICE)


def test_a_fluid_around_a_box_has_density_one_at_its_edges_and_corners() -> None:
    x = lattice((-5, -5, -5), (6, 6, 6)) - 0.5 * D
    solid = (np.abs(x) < 1.5 * D).all(axis=1)  # 3^3 cells
    x = x[~solid]
    density = densities(x, Bodies({"rock": Box(size=(3 * D, 3 * D, 3 * D))}))
    inner = np.abs(x).max(axis=1) < 3.1 * D
    assert inner.sum() == 7**3 - 3**3
    tip = inner & (np.abs(np.abs(x) - 2.0 * D) < 0.1 * D).all(axis=1)
    np.testing.assert_allclose(density[inner & ~tip], 1.0, atol=LATTICE)
    # Before a corner's tip, 0.87 d from it, the solid's 0.0015 is left out.
    np.testing.assert_allclose(density[tip], 0.9985, atol=LATTICE)
    assert tip.sum() == 8


def test_a_corner_of_planes_and_a_rock_on_the_floor_have_density_one() -> None:
    x = lattice((0, 0, 0), (6, 6, 6))
    planes = {"floor": Plane(), "left": Plane(normal=(1, 0, 0)), "back": Plane(normal=(0, 0, 1))}
    inner = (x < 3 * D).all(axis=1)
    # Planes share no body: their corner is a product, 0.3 % on an edge, 0.8 % in the corner.
    np.testing.assert_allclose(densities(x, Bodies(planes))[inner], 1.0, atol=0.01)
    rock = Box(size=(2 * D, 2 * D, 20 * D), position=(4 * D, D, 0.0))
    free = ~((x[:, 1] < 2 * D) & (np.abs(x[:, 0] - 4 * D) < D))
    beside = (np.abs(x[free] - [2.5 * D, 0.5 * D, 2.5 * D]).max(axis=1)) < 0.1 * D
    assert beside.sum() == 1
    density = densities(x[free], Bodies({"floor": Plane(), "rock": rock}))[beside]
    np.testing.assert_allclose(density, 1.0, atol=0.01)


SHAPES: dict[str, BodyParams] = {
    "plane": Plane(normal=(1.0, 2.0, -1.0), **POSE),
    "box": Box(size=(0.3, 0.4, 0.5), **POSE),
    "plate": Box(size=(0.5, 0.4, 0.6 * D), **POSE),
    "box container": Box(size=(0.5, 0.4, 0.6), inside=True, **POSE),
    "ball": Sphere(radius=0.3, **POSE),
    "pebble": Sphere(radius=D, **POSE),
    "ball container": Sphere(radius=0.25, inside=True, **POSE),
    "capsule": Capsule(radius=0.15, length=0.3, **POSE),
    "cylinder": Cylinder(radius=0.2, length=0.4, **POSE),
    "wire": Cylinder(radius=0.6 * D, length=0.4, **POSE),
    "cylinder container": Cylinder(radius=0.2, length=0.4, inside=True, **POSE),
}


def near_surface(bodies: Bodies, reach: float, count: int) -> Floats:
    """Random places in free space that are nearer than `reach` to a body."""
    x = np.random.default_rng(4).uniform(-0.7, 0.7, (60_000, 3))
    distance = bodies.distance(x)[0]
    found = x[(distance > 0.0) & (distance < reach)][:count]
    assert len(found) == count
    return found


# Where their surface is smooth; edges and corners are for the lattices above.
ROUND = ("plane", "ball", "pebble", "ball container", "capsule", "cylinder", "wire", "cylinder container")


def kernel_share(x: Floats, bodies: Bodies, support: float) -> Floats:
    """Share of a kernel of `support` [m] about each of `x` that is solid, by quadrature."""
    axis = (np.arange(44) + 0.5) / 22 - 1.0
    offset = np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), axis=-1).reshape(-1, 3)
    weight = spline_values(np.linalg.norm(offset, axis=1), 3)
    offset, weight = offset[weight > 0.0], weight[weight > 0.0] / weight.sum()
    solid = bodies.distance((x[:, None] + support * offset).reshape(-1, 3))[0] < 0.0
    return np.asarray(solid.reshape(len(x), -1) @ weight)


@pytest.mark.parametrize("name", ROUND)
def test_curved_walls_take_the_part_that_the_kernel_says(name: str) -> None:
    """At the first layer: the integral over the body of a kernel of which a half space is right."""
    bodies = Bodies({"b": SHAPES[name]})
    x = near_surface(bodies, D, 80)
    distance, normal, _ = bodies.distance(x)
    x = x + (0.5 * D - distance)[:, None] * normal
    local = rotate_back(from_euler(POSE["rotation"]), x - POSE["position"])
    if "cylinder" in name or name == "wire":
        x = x[np.abs(local[:, 1]) < 0.2 - 2.0 * D]
    if name == "capsule":  # between its ends a blend
        x = x[np.abs(np.abs(local[:, 1]) - 0.15) > D]
    x = x[:20]
    share, _ = share_at(x, bodies)
    assert len(x) == 20
    np.testing.assert_allclose(share, kernel_share(x, bodies, WALL_KERNEL * D), atol=SHARE)


def test_the_share_falls_off_as_a_square() -> None:
    z = np.array([0.3, 0.4, 0.5, 0.6, 0.7, 0.79, 0.81, 1.5])
    share, _ = share_at(z[:, None] * [0.0, D, 0.0], Bodies({"floor": Plane()}))
    c = 0.14969  # of a lattice at a support of 2
    np.testing.assert_allclose(share, c * np.maximum(1.0 - (z - 0.5) / (2 * c), 0.0) ** 2, atol=LATTICE)


# Without edges that stick out, along which shares have steps (0.25 d about the edge they are 1/2).
SMOOTH = ("plane", "box container", "ball", "pebble", "ball container", "capsule", "cylinder container")


@pytest.mark.parametrize("name", SMOOTH)
def test_gradient_is_that_of_the_share(name: str) -> None:
    bodies = Bodies({"b": SHAPES[name]})
    x = near_surface(bodies, 0.78 * D, 50)
    x = x[bodies.distance(x)[0] > 0.27 * D]  # nearer the slope stays what it is
    step = 0.01 * D
    _, gradient = share_at(x, bodies)
    differences = [share_at(x + e, bodies)[0] - share_at(x - e, bodies)[0] for e in step * np.eye(3)]
    np.testing.assert_allclose(D * gradient, 0.5 / step * D * np.stack(differences, axis=1), atol=GRADIENT)
    assert D * np.abs(gradient).max() > 0.5


def test_the_rim_of_a_wide_cylinder_is_the_edge_of_a_box() -> None:
    """At 10 m radius the side is as good as flat: the rim's share is that of the lattice's edge."""
    x = np.array([[10.0 - 0.5 * D, 5.0 - 0.5 * D, 0.0], [10.0 - 0.8 * D, 5.0 - 0.6 * D, 0.0]])
    wide = Bodies({"b": Cylinder(radius=10.0, length=10.0, inside=True)})
    box = Bodies({"b": Box(size=(20.0, 10.0, 20.0), inside=True)})
    np.testing.assert_allclose(share_at(x, wide)[0], share_at(x, box)[0], atol=1e-3)
    solid = Bodies({"b": Cylinder(radius=10.0, length=10.0)}), Bodies({"b": Box(size=(20.0, 10.0, 20.0))})
    beyond = x + np.array([D, D, 0.0])
    np.testing.assert_allclose(share_at(beyond, solid[0])[0], share_at(beyond, solid[1])[0], atol=1e-3)


def test_share_far_from_all_is_zero_and_within_the_solid_one() -> None:
    ball = Bodies({"b": Sphere(radius=0.3)})
    share, gradient = share_at(np.array([[0.6, 0.0, 0.0], [0.3 + 0.81 * D, 0.0, 0.0], [0.0, 0.1, 0.0]]), ball)
    np.testing.assert_array_equal(share, [0.0, 0.0, 1.0])
    assert not gradient[:2].any()
    np.testing.assert_allclose(gradient[2], 0.0, atol=1e-4)


@ti.kernel
def terms_at(
    n: ti.i32, count: ti.i32, support: ti.f32, table: f32_2d, samples: f32_1d, shares: f32_2d, x: f32_2d,
    out: f32_2d,
):  # fmt: skip
    for i in range(n):
        found = wall_terms(table, samples, shares, support, count, ti.Vector([x[0, i], x[1, i], x[2, i]]))
        for c in ti.static(range(4)):
            out[i, c] = found[c]


def test_wall_terms_are_what_is_measured() -> None:
    bodies = Bodies({"a": SHAPES["box container"], "b": Sphere(radius=0.1, **POSE), "c": Plane()})
    x = near_surface(bodies, 2.0 * D, 150)
    fluid = particles(x)
    walls = walls_of(fluid, bodies)
    out = np.zeros((len(x), 4), np.float32)
    terms_at(
        len(x), walls.count, walls.support, walls.table, walls.samples, walls.shares, fluid["position"], out
    )
    np.testing.assert_array_equal(out[:, 3], walls.share.to_numpy()[: len(x)])
    np.testing.assert_array_equal(out[:, :3], walls.gradient.to_numpy()[:, : len(x)].T)


SPIN = Keyframes[Vector3](keys=((0.0, (0.0, 0.0, 0.0)), (1.0, (80.0, 0.0, 40.0))))
SHIFT = Keyframes[Vector3](keys=((0.0, (0.0, 0.0, 0.0)), (1.0, (0.5, -1.0, 2.0))))


def moving(kind: Any, **rest: Any) -> Any:
    return kind.model_validate({"position": SHIFT, "rotation": SPIN, **rest})


def test_distance_normal_speed_and_flux_are_those_of_the_bodies() -> None:
    bodies = Bodies(
        {"tank": moving(Box, size=(0.6, 0.6, 0.6), inside=True), "ball": moving(Sphere, radius=0.1)}
    )
    bodies.move(0.0, 0.01)
    x = np.random.default_rng(1).uniform(-0.28, 0.28, (500, 3))
    fluid = particles(x)
    walls = walls_of(fluid, bodies)
    distance, normal, velocity = bodies.distance(x)
    n = len(x)
    np.testing.assert_allclose(walls.distance.to_numpy()[:n], distance, atol=ROUNDING)
    np.testing.assert_allclose(walls.normal.to_numpy()[:, :n].T, normal, atol=10 * ROUNDING)
    near = distance < fluid.h
    speed = walls.speed.to_numpy()[:, :n].T
    np.testing.assert_allclose(speed[near], velocity[near], atol=10 * ROUNDING)
    assert not speed[~near].any()
    assert 20 < near.sum() < n - 20
    assert set(np.unique(walls.nearest.to_numpy()[:n])) == {0, 1}
    gradient = walls.gradient.to_numpy()[:, :n].T
    # Both bodies move alike and nothing is near both: the flux is the gradient along the velocity.
    np.testing.assert_allclose(walls.flux.to_numpy()[:n], (gradient * speed).sum(axis=1), atol=1e-4)
    assert np.abs(walls.flux.to_numpy()[:n]).max() > 1.0


def test_without_walls_there_is_nothing() -> None:
    fluid = particles(lattice((0, 0, 0), (2, 2, 2)))
    walls = walls_of(fluid, Bodies({}))
    walls.hold(fluid.count, fluid["position"], fluid["velocity"], 0.1)
    assert walls.clamp(fluid.count, fluid["position"], fluid["velocity"]) == 0
    assert walls.count == 0
    assert not walls.share.to_numpy().any()
    assert walls.nearest.to_numpy().max() == -1
    assert walls.impulses() == {}


def test_share_is_added_to_the_density() -> None:
    fluid = particles(lattice((0, 0, 0), (3, 3, 3)))
    fluid.density.fill(0.5)
    walls = Walls(Bodies({"floor": Plane()}), Bounds(), fluid, WallParams())
    walls.measure(fluid.count, fluid["position"], fluid.density)
    expected = 0.5 + walls.share.to_numpy()[: fluid.count]
    np.testing.assert_array_equal(fluid.density.to_numpy()[: fluid.count], expected.astype(np.float32))


def test_friction_is_by_body_and_else_the_fluids() -> None:
    params = WallParams(friction=0.25, bodies={"paddle": BodyWall(friction=1.0)})
    walls = walls_of(
        particles(np.zeros((1, 3))),
        Bodies({"paddle": Box(), "rock": Sphere()}),
        Bounds("contained", (-1, -1, -1), (1, 1, 1)),
        params,
    )
    assert walls.names == ("paddle", "rock", "bounds")
    np.testing.assert_array_equal(walls.friction.to_numpy(), [1.0, 0.25, 0.25])


def pressed(fluid: Particles, walls: Walls, pressure: Floats, dt: float) -> dict[str, Floats]:
    """Forces and moments by wall."""
    values = np.zeros(fluid.pressure.shape[0], np.float32)
    values[: fluid.count] = pressure
    fluid.pressure.from_numpy(values)
    walls.push(fluid.count, fluid["position"], fluid.pressure, dt)
    return {name: impulse / dt for name, impulse in walls.impulses().items()}


def test_a_pressure_on_a_tank_pushes_each_wall_with_pressure_times_area() -> None:
    x = lattice((0, 0, 0), (8, 6, 7))
    fluid = particles(x)
    planes = {"floor": Plane(), "left": Plane(normal=(1, 0, 0))}
    forces = pressed(fluid, walls_of(fluid, Bodies(planes)), np.full(len(x), 500.0), 0.01)
    felt = 500.0 * D**2
    floor, left = felt * 8 * 7, felt * 6 * 7
    # Along the edge of the two planes each pushes only with what the other leaves free, 15 % less.
    np.testing.assert_allclose(forces["floor"][:3], [0.0, -floor * (1 - 0.15 / 8), 0.0], rtol=0.01, atol=1e-3)
    np.testing.assert_allclose(forces["left"][:3], [-left * (1 - 0.15 / 6), 0.0, 0.0], rtol=0.01, atol=1e-3)
    # It acts in the middle of the wall, but for the edge: moment about the origin, r x F.
    np.testing.assert_allclose(forces["floor"][3], 3.5 * D * floor * (1 - 0.15 / 8), rtol=0.01)


def test_forces_are_volume_pressure_gradient() -> None:
    bodies = Bodies({"rock": Sphere(radius=0.2, position=(0.4, 0.1, 0.0))})
    x = near_surface(bodies, 0.7 * D, 300)
    pressure = np.random.default_rng(3).uniform(0.0, 2000.0, len(x))
    fluid = particles(x)
    walls = walls_of(fluid, bodies)
    (force,) = pressed(fluid, walls, pressure, 0.02).values()
    each = fluid.volume * pressure[:, None] * walls.gradient.to_numpy()[:, : len(x)].T
    np.testing.assert_allclose(force[:3], each.sum(axis=0), rtol=1e-4, atol=1e-3)
    moment = np.cross(x - [0.4, 0.1, 0.0], each).sum(axis=0)
    np.testing.assert_allclose(force[3:], moment, atol=1e-3)
    assert np.linalg.norm(force[:3]) > 1.0


def test_walls_bear_the_reaction_to_what_pulls_the_fluid() -> None:
    x = np.array([[0.1, 0.5 * D, 0.2], [0.3, 0.4 * D, -0.1], [5.0, 2.0 - 0.5 * D, 0.0]])
    fluid = particles(x)
    walls = walls_of(fluid, Bodies({"floor": Plane(), "lid": Plane(position=(0, 2, 0), normal=(0, -1, 0))}))
    pull = np.zeros((3, fluid.columns.capacity), np.float32)
    pull[:, :3] = np.array([[1.0, 0.0, 2.0], [0.5, 0.0, 0.0], [0.0, 0.0, -4.0]]).T
    fluid.acceleration.from_numpy(pull)
    walls.bear(3, fluid["position"], fluid.acceleration, 0.01)
    mass = 1000.0 * fluid.volume * 0.01
    impulses = walls.impulses()
    np.testing.assert_allclose(impulses["floor"][:3], -mass * np.array([1.5, 0.0, 2.0]), rtol=1e-5)
    np.testing.assert_allclose(impulses["lid"][:3], -mass * np.array([0.0, 0.0, -4.0]), rtol=1e-5)
    moment = sum(np.cross(x[i], -mass * pull[:, i]) for i in (0, 1))
    np.testing.assert_allclose(impulses["floor"][3:], moment, rtol=1e-4, atol=1e-7)


def test_impulses_do_not_depend_on_the_number_of_threads(monkeypatch: pytest.MonkeyPatch) -> None:
    found = []
    for tasks in (1, 2, 3):
        monkeypatch.setattr(walls_module, "workers", lambda tasks=tasks: (tasks, 512))
        bodies = Bodies({"tank": Box(size=(0.5, 0.5, 0.5), inside=True, rotation=(0.0, 20.0, 10.0))})
        rng = np.random.default_rng(6)
        x = rng.uniform(-0.15, 0.15, (3000, 3))
        fluid = particles(x)
        fluid.columns.write("velocity", rng.normal(0.0, 20.0, (3000, 3)).astype(np.float32))
        walls = walls_of(fluid, bodies)
        walls.push(3000, fluid["position"], fluid.density, 1e-3)
        walls.hold(3000, fluid["position"], fluid["velocity"], 0.01)
        found.append((walls.impulses()["tank"], fluid.columns.read("velocity")))
    for impulse, velocity in found[1:]:
        np.testing.assert_array_equal(impulse, found[0][0])
        np.testing.assert_array_equal(velocity, found[0][1])
    assert np.abs(found[0][0]).max() > 1.0


def test_a_mesh_away_from_its_edges_is_a_plane(tmp_path: Any) -> None:
    file = tmp_path / "block.ply"
    trimesh.creation.box((1.0, 1.0, 1.0)).export(file)
    x = np.stack([np.linspace(-0.3, 0.3, 50), 0.5 + np.linspace(0.2, 2.0, 50) * D, np.zeros(50)], axis=1)
    share, gradient = share_at(x, Bodies({"b": TriangleMesh(file=file, resolution=32)}))
    expected, slope = share_at(x, Bodies({"b": Plane(position=(0.0, 0.5, 0.0))}))
    np.testing.assert_allclose(share, expected, atol=1e-4)
    np.testing.assert_allclose(gradient, slope, atol=1e-2)


# In two dimensions a body is what the plane z = 0 cuts out of it.
SECTIONS: dict[str, tuple[BodyParams, BodyParams]] = {
    "a lying cylinder is a disc": (
        Cylinder(radius=0.2, length=0.1, rotation=(90.0, 0.0, 0.0)),
        Sphere(radius=0.2),
    ),
    "a lying capsule is a disc": (
        Capsule(radius=0.2, length=0.1, rotation=(90.0, 0.0, 0.0)),
        Sphere(radius=0.2),
    ),
    "an upright cylinder is a rectangle": (Cylinder(radius=0.2, length=0.4), Box(size=(0.4, 0.4, 0.01))),
    "so it is when turned about its axis": (
        Cylinder(radius=0.2, length=0.4, rotation=(0.0, 90.0, 0.0)),
        Box(size=(0.4, 0.4, 0.01)),
    ),
    "and when it is half turned": (
        Cylinder(radius=0.2, length=0.3, rotation=(0.0, 45.0, 0.0)),
        Box(size=(0.4, 0.3, 0.01)),
    ),
    "a leaning cylinder is a leaning rectangle": (
        Cylinder(radius=0.2, length=0.3, rotation=(0.0, 0.0, 30.0)),
        Box(size=(0.4, 0.3, 0.01), rotation=(0.0, 0.0, 30.0)),
    ),
    "a leaning plane is the line in which it cuts": (
        Plane(position=(0.0, 0.1, 0.0), normal=(0.0, 1.0, 0.75)),
        Plane(position=(0.0, 0.1, 0.0)),
    ),
    "a thin box is a rectangle": (Box(size=(0.4, 0.4, 0.01)), Box(size=(0.4, 0.4, 9.0))),
    "a box on its side is a rectangle": (
        Box(size=(0.4, 0.01, 0.3), rotation=(90.0, 0.0, 0.0)),
        Box(size=(0.4, 0.3, 9.0)),
    ),
}


@pytest.mark.parametrize("name", SECTIONS)
def test_bodies_in_two_dimensions_are_sections(name: str) -> None:
    rng = np.random.default_rng(8)
    x = np.concatenate([rng.uniform(-0.35, 0.35, (2000, 2)), np.zeros((2000, 1))], axis=1)
    (share, gradient), (expected, slope) = (
        share_at(x, Bodies({"b": body}), dimension=2) for body in SECTIONS[name]
    )
    np.testing.assert_allclose(share, expected, atol=1e-5)
    np.testing.assert_allclose(gradient, slope, atol=1e-3)
    assert ((share > 0.01) & (share < 0.99)).sum() > 100


def test_a_disc_in_two_dimensions_is_the_integral_of_its_kernel() -> None:
    bodies = Bodies({"b": Sphere(radius=0.15)})
    first = np.array([[0.15 + 0.5 * D, 0.0, 0.0]])
    axis = (np.arange(400) + 0.5) / 200 - 1.0
    offset = np.stack(np.meshgrid(axis, axis, indexing="ij"), axis=-1).reshape(-1, 2)
    weight = spline_scale(1.0, 2) * spline_values(np.linalg.norm(offset, axis=1), 2) / 200**2
    # Its support is such that half the plane, half a spacing away, weighs what a lattice misses there.
    wide = 2.4606 * D
    rows = np.stack(np.meshgrid(np.arange(-3.0, 4.0), np.arange(-3.0, 4.0)), axis=-1).reshape(-1, 2)
    weights = spline_values(np.linalg.norm(rows, axis=1) / SUPPORT[2], 2)
    missing = weights[rows[:, 0] < 0.0].sum() / weights.sum()
    assert weight[wide * offset[:, 0] < -0.5 * D].sum() == pytest.approx(missing, abs=SHARE)
    solid = np.linalg.norm(first[0, :2] + wide * offset, axis=1) < 0.15
    share, gradient = share_at(first, bodies, dimension=2)
    np.testing.assert_allclose(share, solid @ weight, atol=SHARE)
    assert not gradient[:, 2].any()
    x = near_surface(bodies, 0.8 * D, 100) * [1.0, 1.0, 0.0]
    share, _ = share_at(x, bodies, dimension=2)
    # The tank's own pose does not matter.
    turn = from_euler((0.0, 0.0, 30.0))
    np.testing.assert_allclose(share_at(rotate_back(turn, x), bodies, dimension=2)[0], share, atol=1e-5)
