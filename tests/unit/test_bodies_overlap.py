"""Depth of overlap of fixed bodies, beside cases that can be worked out by hand."""

import numpy as np
import pytest

from tianim.spatial.bodies import Bodies
from tianim.spatial.body_overlap import overlap
from tianim.spatial.body_params import BodyParams, Box, Capsule, Cylinder, Plane, Sphere

# Double precision through a rotation and a small least-squares solve.
EXACT = 1e-9
# With a cylinder the direction is searched for; the gap is flat there to the square of its error.
SEARCHED = 1e-7
ROOT = np.sqrt(2.0)


CASES: list[tuple[BodyParams, BodyParams, float]] = [
    (Sphere(), Sphere(position=(1.5, 0.0, 0.0)), 0.5),
    (Sphere(), Sphere(position=(2.0, 0.0, 0.0)), 0.0),
    (Sphere(), Sphere(position=(9.0, 0.0, 0.0)), 0.0),
    (Sphere(), Sphere(), 2.0),
    (Box(), Box(position=(0.75, 0.0, 0.0)), 0.25),
    (Box(), Box(position=(1.0, 0.0, 0.0)), 0.0),
    (Box(), Box(position=(1.0, 1.0, 1.0)), 0.0),
    (Box(), Box(position=(1.2, 0.0, 0.0), rotation=(0.0, 45.0, 0.0)), 0.5 + ROOT / 2 - 1.2),
    (Box(), Sphere(radius=0.5, position=(0.0, 0.9, 0.0)), 0.1),
    (Box(), Sphere(radius=0.5, position=(0.0, 0.1, 0.0)), 0.9),
    (Box(), Sphere(radius=1.0, position=(1.0, 1.0, 0.5)), 1.0 - ROOT / 2),
    (Capsule(), Sphere(radius=1.0, position=(1.2, 0.0, 0.0)), 0.3),
    (Capsule(), Sphere(radius=1.0, position=(0.0, 1.9, 0.0)), 0.1),
    (Capsule(), Capsule(position=(0.9, 0.3, 0.0)), 0.1),
    (Capsule(), Capsule(position=(0.9, 0.0, 0.0), rotation=(90.0, 0.0, 0.0)), 0.1),
    (Capsule(), Capsule(rotation=(90.0, 0.0, 0.0)), 1.0),
    (Box(), Capsule(position=(0.8, 0.0, 0.0)), 0.2),
    (Box(size=(4.0, 4.0, 4.0)), Capsule(position=(1.5, 0.0, 0.0)), 1.0),
    (Plane(), Sphere(position=(3.0, 0.75, 0.0)), 0.25),
    (Plane(), Sphere(position=(3.0, 1.0, 0.0)), 0.0),
    (Plane(), Box(position=(0.0, 0.5, 0.0)), 0.0),
    (Plane(), Box(position=(0.0, 0.5, 0.0), rotation=(0.0, 0.0, 45.0)), ROOT / 2 - 0.5),
    (Plane(normal=(0.0, 2.0, 0.0)), Capsule(position=(0.0, 0.9, 0.0)), 0.1),
    (Plane(rotation=(0.0, 0.0, 90.0)), Sphere(position=(-0.5, 0.0, 0.0)), 0.5),
    (Plane(), Cylinder(position=(0.0, 0.5, 0.0)), 0.0),
    (Plane(), Cylinder(position=(0.0, 0.5, 0.0), rotation=(90.0, 0.0, 0.0)), 0.0),
    (Plane(), Cylinder(position=(0.0, 0.5, 0.0), rotation=(0.0, 0.0, 45.0)), ROOT / 2 - 0.5),
]

CYLINDERS: list[tuple[BodyParams, BodyParams, float]] = [
    (Cylinder(), Cylinder(position=(0.0, 0.9, 0.3)), 0.1),
    (Cylinder(), Cylinder(position=(0.6, 0.0, 0.0)), 0.4),
    (Cylinder(), Cylinder(position=(1.0, 0.0, 0.0)), 0.0),
    (Cylinder(), Cylinder(position=(0.0, 1.0, 0.0)), 0.0),
    # On its side: rim over end, parted along y.
    (Cylinder(), Cylinder(position=(0.0, 0.9, 0.0), rotation=(90.0, 0.0, 0.0)), 0.1),
    (Cylinder(), Sphere(radius=0.5, position=(0.9, 0.2, 0.0)), 0.1),
    # The sphere's centre is off the rim: as far apart as the rim is.
    (Cylinder(), Sphere(radius=0.5, position=(0.5 + 0.3, 0.5 + 0.3, 0.0)), 0.5 - 0.3 * ROOT),
    (Cylinder(), Sphere(radius=0.4, position=(0.5 + 0.3, 0.5 + 0.3, 0.0)), 0.0),
    (Box(), Cylinder(position=(0.8, 0.3, 0.0)), 0.2),
    # An edge of the box towards the cylinder's side.
    (Box(rotation=(0.0, 45.0, 0.0)), Cylinder(position=(1.0, 0.0, 0.0)), ROOT / 2 - 0.5),
    (Cylinder(length=4.0), Capsule(position=(0.9, 0.3, 0.0), rotation=(90.0, 0.0, 0.0)), 0.1),
]


@pytest.mark.parametrize(("a", "b", "depth"), CASES)
def test_depth(a: BodyParams, b: BodyParams, depth: float) -> None:
    assert overlap(a, b) == pytest.approx(depth, abs=EXACT)


@pytest.mark.parametrize(("a", "b", "depth"), CYLINDERS)
def test_depth_of_cylinders(a: BodyParams, b: BodyParams, depth: float) -> None:
    assert overlap(a, b) == pytest.approx(depth, abs=SEARCHED)
    assert overlap(b, a) == pytest.approx(depth, abs=SEARCHED)
    assert overlap(b, a) == pytest.approx(depth, abs=EXACT)


@pytest.mark.parametrize(
    ("a", "b"),
    [
        (Plane(), Plane(position=(0.0, -1.0, 0.0))),
        (Sphere(inside=True), Sphere()),
        (Box(inside=True), Sphere()),
        (Sphere(), Sphere.model_validate({"position": {"keys": [[0.0, [0.0, 0.0, 0.0]]]}})),
    ],
)
def test_undecided(a: BodyParams, b: BodyParams) -> None:
    assert overlap(a, b) is None
    assert overlap(b, a) is None


def test_bodies_in_a_common_turn_overlap_as_before() -> None:
    depths = [
        overlap(
            Box(rotation=(0.0, 0.0, turn)),
            Box(
                rotation=(0.0, 0.0, turn),
                position=(0.8 * np.cos(np.radians(turn)), 0.8 * np.sin(np.radians(turn)), 0.0),
            ),
        )
        for turn in (0.0, 33.0, 120.0)
    ]
    assert depths == pytest.approx([0.2] * 3, abs=EXACT)


def test_boxes_overlap_where_and_only_where_a_point_is_in_both() -> None:
    """Random pairs beside a search for a common point, with the run-time distance as the judge."""
    rng = np.random.default_rng(3)
    grid = np.stack(np.meshgrid(*[np.linspace(-0.5, 0.5, 21)] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
    overlapping = 0
    for _ in range(40):
        other = Box(position=tuple(rng.uniform(-1.2, 1.2, 3)), rotation=tuple(rng.uniform(0.0, 360.0, 3)))
        depth = overlap(Box(), other)
        assert depth is not None
        found = -Bodies({"b": other}).distance(grid)[0].min()
        overlapping += depth > 0.0
        # A common point deeper than 0 proves an overlap; an overlap by over a grid step (0.05 m,
        # 0.087 m across) leaves room for a point of the grid.
        assert (depth > 0.0) or (found <= 1e-6)
        assert (found > 0.0) or (depth < 0.1)
    assert 5 < overlapping < 35
