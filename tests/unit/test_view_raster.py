"""What the raster kernels see: areas, depths, ties, order, and odd input."""

import numpy as np
import pytest

from tianim.view import layout, raster
from tianim.view.camera import camera_array

SIDE = 64
AREA_TOLERANCE = 0.06  # of a disc of 12 samples radius: its edge passes through 75 samples
DEPTH_TOLERANCE = 2e-5  # relative: float32 in a chain of a dozen operations


def camera(perspective=True, distance=5.0, near=None):
    half = 0.5 if perspective else 2.5
    out = camera_array(np.array([0.0, 0.0, distance]), np.zeros(3), SIDE, SIDE, half, perspective)
    if near is not None:
        out[layout.NEAR] = near
    return out


def empty():
    return np.full((SIDE, SIDE), layout.EMPTY, np.int64)


def found(key):
    return key != layout.EMPTY


def depth(key):
    return (key >> 32).astype(np.int32).view(np.float32)


def spheres(position, radius, view=None, first=0):
    key = empty()
    position = np.array(position, np.float32).reshape(-1, 3)
    raster.raster_spheres(
        key, camera() if view is None else view, position, np.full(len(position), radius, np.float32), first
    )
    return key


@pytest.mark.parametrize("perspective", [True, False])
def test_sphere_covers_its_disc_and_bulges_towards_the_camera(perspective) -> None:
    key = spheres([0, 0, 0], 1.0, camera(perspective))
    pixels = 0.5 * SIDE / (0.5 * 5.0 if perspective else 2.5)
    assert found(key).sum() == pytest.approx(np.pi * pixels**2, rel=AREA_TOLERANCE)
    assert depth(key)[SIDE // 2, SIDE // 2] == pytest.approx(4.0, abs=0.01)


def test_small_sphere_is_never_lost_between_samples() -> None:
    for shift in np.linspace(0, 0.1, 23):
        assert found(spheres([shift, shift, 0], 1e-6)).any()


def test_nearest_wins_whatever_the_order() -> None:
    pair = np.array([[0, 0, 0], [0.1, 0, 1]], np.float32)
    for order in ([0, 1], [1, 0]):
        key = spheres(pair[order], 0.5)
        assert key[SIDE // 2, SIDE // 2] & 0xFFFFFFFF == order.index(1)


def test_ties_go_to_the_smaller_id() -> None:
    key = spheres(np.zeros((50, 3)), 0.5, first=7)
    assert set(np.unique(key[found(key)] & 0xFFFFFFFF)) == {7}


@pytest.mark.parametrize("position", [[0, 0, 9], [0, 0, 5], [1e30, 0, 0], [100, 0, 0]], ids=str)
def test_what_is_behind_or_beside_the_camera_is_not_drawn(position) -> None:
    assert not found(spheres(position, 0.5)).any()


def test_nothing_to_draw() -> None:
    assert not found(spheres(np.zeros((0, 3)), 1.0)).any()


def triangles(position, indices, view=None):
    key = empty()
    raster.raster_triangles(
        key,
        camera() if view is None else view,
        np.array(position, np.float32),
        np.array(indices, np.int32),
        0,
    )
    return key


def test_triangles_that_share_an_edge_leave_no_gap() -> None:
    rng = np.random.default_rng(4)
    corners = [[-3, -3, 0], [3, -3, 0], [3, 3, 0], [-3, 3, 0]]
    for _ in range(20):
        middle = [*rng.uniform(-2, 2, 2), 0]
        key = triangles([*corners, middle], [[0, 1, 4], [1, 2, 4], [2, 3, 4], [3, 0, 4]])
        assert found(key).all()


@pytest.mark.parametrize("perspective", [True, False])
def test_depth_of_a_slanted_triangle_is_that_of_its_plane(perspective) -> None:
    # The plane z = x: in perspective the ray through slope s meets it at depth 5 / (1 + s).
    view = camera(perspective)
    key = triangles([[-9, -9, -9], [9, -9, 9], [0, 40, 0]], [[0, 1, 2]], view)
    column = np.arange(SIDE) + 0.5 - SIDE / 2
    across = column / view[layout.FOCAL]
    expected = 5 / (1 + across) if perspective else 5 - across
    row = SIDE // 2
    seen = found(key)[row] & (expected > 0.1)
    assert seen.sum() > SIDE // 2
    np.testing.assert_allclose(depth(key)[row][seen], expected[seen], rtol=DEPTH_TOLERANCE)


def test_triangle_through_the_camera_is_drawn_where_it_is_in_front() -> None:
    # A floor one metre below that reaches far behind the camera: all below the horizon.
    key = triangles([[-900, -1, 900], [900, -1, 900], [0, -1, -90000]], [[0, 1, 2]])
    assert not found(key)[: SIDE // 2].any()
    assert found(key)[SIDE // 2 + 3 :].all()


def test_tiny_triangles_far_from_the_middle_are_exact() -> None:
    # A grid of small triangles over the picture covers it as one large one does.
    ticks = np.linspace(-2.2, 2.2, 80)
    x, y = np.meshgrid(ticks, ticks)
    position = np.stack([x, y, np.zeros_like(x)], -1).reshape(-1, 3)
    k = np.arange(80 * 80).reshape(80, 80)
    a, b, c, d = (q.ravel() for q in (k[:-1, :-1], k[1:, :-1], k[1:, 1:], k[:-1, 1:]))
    key = triangles(position, np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)]))
    whole = triangles(
        [[-2.2, -2.2, 0], [2.2, -2.2, 0], [2.2, 2.2, 0], [-2.2, 2.2, 0]], [[0, 1, 2], [0, 2, 3]]
    )
    assert (found(key) == found(whole)).all()


def lines(position, radius=0.6, view=None):
    key = empty()
    raster.raster_lines(
        key, camera() if view is None else view, np.array(position, np.float32),
        np.array([[0, 1]], np.int32), np.array([radius], np.float32), 0,
    )  # fmt: skip
    return key


@pytest.mark.parametrize("end", [[1.5, 0, 0], [0, 1.5, 0], [1.1, 1.1, 0]], ids=str)
def test_line_has_its_length_and_thickness_in_every_direction(end) -> None:
    key = lines([[-end[0], -end[1], 0], end])
    pixels = SIDE / 5.0  # a metre
    expected = pixels**2 * (2 * np.hypot(*end[:2]) * 1.2 + np.pi * 0.6**2)
    assert found(key).sum() == pytest.approx(expected, rel=0.05)


def test_line_from_behind_the_camera_is_cut_there() -> None:
    key = lines([[0, -1, 20], [0, -1, -20]], 0.05)
    assert found(key)[SIDE // 2 + 2 :].any(axis=1).all()
    assert not found(key)[: SIDE // 2 - 1].any()


def blended(items, order, glow=0.0, opacity=0.5, fog=0.0, key=None):
    light = np.zeros((SIDE, SIDE, 2), np.int64)
    items = np.ascontiguousarray(np.array(items, np.float32)[order])
    n = len(items)
    raster.blend_capsules(
        light, empty() if key is None else key, camera(), np.array([0, 1, fog], np.float32),
        np.zeros((SIDE, SIDE, 3), np.float32), items, np.ascontiguousarray(items + np.float32(0.01)),
        np.full(n, 0.3, np.float32), np.full(n, opacity, np.float32), np.zeros(n, np.float32),
        np.ones((1, 3), np.float32), 1.0, 0, glow, 4096.0,
    )  # fmt: skip
    return light


def test_blended_light_does_not_depend_on_the_order() -> None:
    items = np.random.default_rng(1).normal(size=(400, 3)) * 0.7
    forward, backward = (blended(items, order) for order in (slice(None), slice(None, None, -1)))
    assert (forward == backward).all()
    assert forward.any()


def test_opacity_is_what_one_item_hides() -> None:
    light = blended([[0, 0, 0]], slice(None), opacity=0.6)
    optical = (light[SIDE // 2, SIDE // 2, 1] & 0xFFFFFFFF) / 4096.0
    assert 1 - np.exp(-optical) == pytest.approx(0.6, abs=1e-3)


def test_glow_hides_nothing() -> None:
    light = blended([[0, 0, 0]], slice(None), glow=1.0)
    assert ((light[..., 1] & 0xFFFFFFFF) == 0).all()
    assert (light[..., 0] >> 32).max() > 0


def test_blended_items_stay_behind_what_is_nearer() -> None:
    wall = triangles([[-9, -9, 1], [9, -9, 1], [0, 30, 1]], [[0, 1, 2]])
    assert not blended([[0, 0, 0]], slice(None), key=wall).any()
    assert blended([[0, 0, 2]], slice(None), key=wall).any()


def test_posed_shapes_turn_and_scale() -> None:
    half_turn_about_y = np.array([[0, 1, 0, 0]], np.float32)
    out = np.empty((2, 3), np.float32)
    shape = np.array([[0, 0, 0.5], [0.1, 0, 0]], np.float32)
    raster.pose_shapes(
        out, np.array([[1, 2, 3]], np.float32), half_turn_about_y, np.array([2], np.float32), shape,
        np.zeros_like(shape), 0.0,
    )  # fmt: skip
    np.testing.assert_allclose(out, [[1, 2, 2], [0.8, 2, 3]], atol=1e-6)
