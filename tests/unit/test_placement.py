"""Placement: shapes are filled evenly, in two and three dimensions; headings point as they say."""

import numpy as np
import pytest
from numpy.typing import ArrayLike, NDArray
from pydantic import TypeAdapter, ValidationError
from scipy.spatial import cKDTree
from scipy.stats import kstest

from tianim.errors import SceneError
from tianim.spatial.placement import Heading, Placement, directions, own_count, place, random_directions

COUNT = 4000
# The seed is fixed: a test that passes keeps passing. An even filling fails one seed in a thousand.
CHANCE = 1e-3
# float32 points of a few metres.
LENGTH = 1e-5

CENTRE = (1.0, -2.0, 0.5)


def fill(kind: str, dimension: int = 3, count: int | None = COUNT, **fields: object) -> NDArray[np.float64]:
    placement = TypeAdapter(Placement).validate_python({"kind": kind, **fields})
    placed = place(placement, count, np.random.default_rng(7), dimension)
    assert placed.position.dtype == np.float32
    assert placed.count == len(placed.position)
    assert placed.velocity is None
    return placed.position.astype(np.float64)


def assert_uniform(values: ArrayLike, lower: float = 0.0, upper: float = 1.0) -> None:
    """Values spread evenly between two limits, none outside."""
    shares = (np.asarray(values) - lower) / (upper - lower)
    assert shares.min() > -LENGTH
    assert shares.max() < 1.0 + LENGTH
    assert kstest(np.clip(shares, 0.0, 1.0), "uniform").pvalue > CHANCE


def assert_round(arm: NDArray[np.float64]) -> None:
    """Directions without a preferred one: by Archimedes each coordinate is uniform on a sphere."""
    unit = arm / np.linalg.norm(arm, axis=1, keepdims=True)
    for axis in range(3):
        assert_uniform(unit[:, axis], -1.0, 1.0)


def assert_turned(x: NDArray[np.float64], y: NDArray[np.float64]) -> None:
    assert_uniform(np.arctan2(y, x), -np.pi, np.pi)


def test_ball() -> None:
    arm = fill("ball", centre=CENTRE, radius=2.0) - CENTRE
    assert_uniform((np.linalg.norm(arm, axis=1) / 2.0) ** 3)
    assert_round(arm)


def test_a_ball_in_two_dimensions_is_a_disc() -> None:
    x = fill("ball", 2, centre=CENTRE, radius=2.0)
    arm = x - CENTRE
    assert not x[:, 2].any()
    assert_uniform(np.hypot(arm[:, 0], arm[:, 1]) ** 2, 0.0, 4.0)
    assert_turned(arm[:, 0], arm[:, 1])


def test_shell() -> None:
    arm = fill("shell", centre=CENTRE, radius=2.0, thickness=0.5) - CENTRE
    assert_uniform(np.linalg.norm(arm, axis=1) ** 3, 1.5**3, 2.0**3)
    assert_round(arm)


def test_a_shell_without_thickness_is_a_surface() -> None:
    arm = fill("shell", radius=2.0)
    np.testing.assert_allclose(np.linalg.norm(arm, axis=1), 2.0, atol=LENGTH)
    flat = fill("shell", 2, radius=2.0)
    np.testing.assert_allclose(np.hypot(flat[:, 0], flat[:, 1]), 2.0, atol=LENGTH)


@pytest.mark.parametrize("dimension", [2, 3])
def test_box(dimension: int) -> None:
    size = np.array([1.0, 2.0, 3.0])
    x = fill("box", dimension, centre=CENTRE, size=tuple(size))
    for axis in range(dimension):
        assert_uniform((x - CENTRE)[:, axis], -0.5 * size[axis], 0.5 * size[axis])
    if dimension == 2:
        assert not x[:, 2].any()


def test_disc() -> None:
    normal = np.array([1.0, 2.0, -2.0])
    arm = fill("disc", centre=CENTRE, radius=2.0, hole=1.0, normal=tuple(normal)) - CENTRE
    np.testing.assert_allclose(arm @ normal / 3.0, 0.0, atol=LENGTH)
    assert_uniform((arm * arm).sum(axis=1), 1.0, 4.0)
    across = np.cross(normal, [1.0, 0.0, 0.0])
    across /= np.linalg.norm(across)
    assert_turned(arm @ across, arm @ np.cross(across, normal / 3.0))


def test_torus() -> None:
    arm = fill("torus", centre=CENTRE, ring_radius=2.0, tube_radius=1.0, axis=(0.0, 0.0, 3.0)) - CENTRE
    ring = np.hypot(arm[:, 0], arm[:, 1])
    out, up = ring - 2.0, arm[:, 2]
    assert_uniform(out**2 + up**2)
    assert_turned(arm[:, 0], arm[:, 1])
    # By Pappus the share with angle below a is (a + c sin a) / 2 pi, c = tube / ring at each depth.
    angle, c = np.arctan2(up, out), np.hypot(out, up) / 2.0
    assert_uniform((angle + c * np.sin(angle)) / (2 * np.pi), -0.5, 0.5)


def test_a_torus_in_two_dimensions_is_a_ring() -> None:
    x = fill("torus", 2, ring_radius=2.0, tube_radius=0.5)
    assert_uniform(np.hypot(x[:, 0], x[:, 1]) ** 2, 1.5**2, 2.5**2)
    assert not x[:, 2].any()


@pytest.mark.parametrize(("dimension", "count"), [(3, 27), (3, 1000), (2, 25), (2, 1024)])
def test_lattice(dimension: int, count: int) -> None:
    x = fill("lattice", dimension, count, centre=(1.0, 2.0, 0.0), spacing=0.5)
    distance, _ = cKDTree(x).query(x, k=2)
    np.testing.assert_allclose(distance[:, 1], 0.5, atol=LENGTH)
    np.testing.assert_allclose(x.mean(axis=0), (1.0, 2.0, 0.0), atol=LENGTH)
    side = round(count ** (1 / dimension))
    np.testing.assert_allclose(np.ptp(x[:, :dimension], axis=0), 0.5 * (side - 1), atol=LENGTH)


def test_a_lattice_is_filled_from_below() -> None:
    x = fill("lattice", 3, 30)
    # 30 of 4^3: a full layer of 16, then 14.
    assert sorted(np.unique(x[:, 1], return_counts=True)[1]) == [14, 16]
    assert (x[:, 1] < 0).sum() == 16


def test_jitter_moves_each_point_within_its_cell() -> None:
    still, shaken = fill("lattice", 3, 1000, spacing=2.0), fill("lattice", 3, 1000, spacing=2.0, jitter=0.5)
    for axis in range(3):
        assert_uniform((shaken - still)[:, axis], -0.5, 0.5)


def test_points() -> None:
    positions = ((0.0, 1.0, 2.0), (3.0, 4.0, 5.0))
    np.testing.assert_array_equal(fill("points", 3, None, positions=positions), positions)
    np.testing.assert_array_equal(fill("points", 2, 2, positions=positions), [[0, 1, 0], [3, 4, 0]])
    assert fill("points", 3, None, positions=()).shape == (0, 3)
    assert own_count(TypeAdapter(Placement).validate_python({"kind": "points", "positions": positions})) == 2
    assert own_count(TypeAdapter(Placement).validate_python({"kind": "ball"})) is None


def test_counts_that_do_not_fit() -> None:
    with pytest.raises(SceneError, match="count 3: the points placement has 1 points"):
        fill("points", 3, 3, positions=((0.0, 0.0, 0.0),))
    with pytest.raises(SceneError, match="count: must be given"):
        fill("ball", 3, None)


KINDS = ("ball", "shell", "box", "disc", "torus", "lattice")


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("dimension", [2, 3])
@pytest.mark.parametrize("count", [0, 1, 2])
def test_few_particles(kind: str, dimension: int, count: int) -> None:
    x = fill(kind, dimension, count)
    assert x.shape == (count, 3)
    assert np.isfinite(x).all()


@pytest.mark.parametrize("kind", KINDS)
def test_the_same_seed_gives_the_same_points(kind: str) -> None:
    np.testing.assert_array_equal(fill(kind), fill(kind))


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        (
            {"kind": "shell", "radius": 1.0, "thickness": 2.0},
            "thickness 2 m: must not exceed the radius, 1 m",
        ),
        ({"kind": "disc", "radius": 1.0, "hole": 1.0}, "hole 1 m: must be less than the radius, 1 m"),
        (
            {"kind": "torus", "ring_radius": 1.0, "tube_radius": 2.0},
            "tube_radius 2 m: must not exceed ring_radius",
        ),
        ({"kind": "disc", "normal": (0.0, 0.0, 0.0)}, "must not be the zero vector"),
        ({"kind": "ball", "radius": 0.0}, "greater than 0"),
        ({"kind": "lattice", "jitter": 1.5}, "less than or equal to 1"),
        ({"kind": "cube"}, "does not match any of the expected tags"),
    ],
)
def test_bad_placements(fields: dict[str, object], message: str) -> None:
    with pytest.raises(ValidationError, match=message):
        TypeAdapter(Placement).validate_python(fields)


def heads(kind: str, position: ArrayLike, dimension: int = 3, **fields: object) -> NDArray[np.float64]:
    heading = TypeAdapter(Heading).validate_python({"kind": kind, **fields})
    unit = directions(heading, position, np.random.default_rng(7), dimension).astype(np.float64)
    np.testing.assert_allclose(np.linalg.norm(unit, axis=1), 1.0, atol=LENGTH)
    if dimension == 2:
        assert not unit[:, 2].any()
    return unit


NOWHERE = np.zeros((COUNT, 3))


def test_random_headings() -> None:
    assert_round(heads("random", NOWHERE))
    flat = heads("random", NOWHERE, 2)
    assert_turned(flat[:, 0], flat[:, 1])


def test_headings_along_a_direction() -> None:
    np.testing.assert_allclose(
        heads("along", NOWHERE, direction=(0.0, 3.0, 4.0)), np.tile([0, 0.6, 0.8], (COUNT, 1)), atol=LENGTH
    )
    np.testing.assert_allclose(
        heads("along", NOWHERE, 2, direction=(3.0, 4.0, 0.0)), np.tile([0.6, 0.8, 0], (COUNT, 1)), atol=LENGTH
    )


def test_headings_fill_a_cone() -> None:
    axis = np.array([2.0, -1.0, 2.0]) / 3.0
    cosine = heads("along", NOWHERE, direction=tuple(axis), spread=40.0) @ axis
    assert_uniform(cosine, np.cos(np.radians(40.0)), 1.0)
    flat = heads("along", NOWHERE, 2, direction=(0.0, 1.0, 0.0), spread=40.0)
    assert_uniform(np.degrees(np.arctan2(-flat[:, 0], flat[:, 1])), -40.0, 40.0)
    assert_round(heads("along", NOWHERE, spread=180.0))


def test_headings_round_an_axis() -> None:
    x = np.array([[2.0, 5.0, 0.0], [0.0, 1.0, 3.0]])
    np.testing.assert_allclose(heads("swirl", x), [[0, 0, -1], [1, 0, 0]], atol=LENGTH)
    np.testing.assert_allclose(heads("swirl", x, inward=90.0), [[-1, 0, 0], [0, 0, -1]], atol=LENGTH)
    half = np.sqrt(0.5)
    np.testing.assert_allclose(
        heads("swirl", x, inward=45.0), [[-half, 0, -half], [half, 0, -half]], atol=LENGTH
    )
    np.testing.assert_allclose(heads("swirl", [[2.0, 0.0, 0.0]], 2), [[0, 1, 0]], atol=LENGTH)
    np.testing.assert_allclose(
        heads("swirl", [[2.0, 0.0, 0.0]], centre=(2.0, 0.0, -1.0)), [[1, 0, 0]], atol=LENGTH
    )


def test_on_the_axis_any_heading_will_do() -> None:
    assert len(heads("swirl", NOWHERE)) == COUNT
    assert len(heads("along", NOWHERE, 2, direction=(0.0, 0.0, 1.0))) == COUNT


@pytest.mark.parametrize("dimension", [2, 3])
def test_random_directions_are_of_unit_length(dimension: int) -> None:
    unit = random_directions(COUNT, np.random.default_rng(0), dimension)
    np.testing.assert_allclose(np.linalg.norm(unit, axis=1), 1.0, atol=1e-12)
