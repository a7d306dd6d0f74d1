"""What becomes of the parts of a frame: trails, headings, wing beats, sizes, and the ground behind them."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from view_scenes import Film, cloud, cube, flock

from tianim.errors import SceneError
from tianim.frame import Frame, Lines, Points
from tianim.view import layout
from tianim.view.backdrop import Backdrop, preset_of
from tianim.view.camera import camera_array
from tianim.view.look import Look
from tianim.view.painter import Painter
from tianim.view.shapes import SHAPES, forward_of, heading_quaternion

SMALL = {"width": 160, "height": 90}


def painter_of(film, **fields):
    return Painter(film, Look.model_validate({**SMALL, **fields}))


def geometry(film, index=0, earlier=(), **fields):
    return painter_of(film, **fields).draft.geometry(film[index], [film[k] for k in earlier])


def test_trails_fade_and_thin_out() -> None:
    film = Film(5, flock(30))
    blends = geometry(film, 4, range(4), parts={"boids": {"kind": "spheres", "size": 0.3, "trail": 4}}).blends
    assert len(blends) == 4
    for values in ([b.opacity[0] for b in blends], [b.radius[0] for b in blends]):
        assert (np.diff(values) < 0).all()
        assert values[-1] < 0.5 * values[0]
    np.testing.assert_array_equal(blends[0].head, film[4].parts[0].position)
    np.testing.assert_array_equal(blends[0].tail, film[3].parts[0].position)


def test_a_trail_does_not_cross_a_periodic_box() -> None:
    rest = cloud(9)

    def make(index, time):
        position = rest + np.float32(0.05 * index)
        position[0, 0] += 10 if index == 1 else -10
        return (Points("dots", position),)

    blends = geometry(Film(2, make), 1, [0], parts={"dots": {"trail": 1, "size": 0.1}}).blends
    assert len(blends[0].tail) == 8
    assert np.linalg.norm(blends[0].head - blends[0].tail, axis=1).max() < 0.1


def chain(index, time):
    position = np.array([[0, 0, 0], [1, 0, 0], [2, 0.1 * index, 0]], np.float32)
    tension = np.array([0.0, 4.0 * index], np.float32)
    segments = np.array([[0, 1], [1, 2]], np.int32)
    return (Lines("chain", position, segments, cell_data={"tension": tension}),)


def test_lines_have_beads_that_leave_trails_where_asked() -> None:
    film = Film(4, chain)
    shown = geometry(film, 3, range(3), parts={"chain": {"size": 0.1, "beads": 0.4, "trail": 3}})
    np.testing.assert_allclose(shown.spheres.radius, [0.2, 0.2, 0.2])
    np.testing.assert_array_equal(shown.spheres.position, film[3].parts[0].position)
    assert len(shown.blends) == 3
    bare = geometry(film, 3, range(3), parts={"chain": {"size": 0.1, "trail": 3}})
    assert not len(bare.spheres.position)
    assert not bare.blends


def test_only_lines_have_beads() -> None:
    with pytest.raises(SceneError, match="only lines have them"):
        geometry(Film(2, flock(5)), parts={"boids": {"beads": 0.4}})


def test_lines_are_coloured_by_the_data_of_their_segments() -> None:
    film, color = Film(3, chain), {"by": "tension", "range": [0, 8]}
    tone = geometry(film, 2, parts={"chain": {"size": 0.1, "color": color}}).sticks.tone
    assert tone[1] - tone[0] == pytest.approx(4.0 / 8.0 * 255, abs=1)


def noses(shown):
    """Direction from the middle to the first vertex, the nose, of each dart."""
    vertices = shown.triangles.position.reshape(-1, len(SHAPES["darts"].vertices), 3)
    nose = vertices[:, 0] - vertices[:, 1:3].mean(axis=1)
    return nose / np.linalg.norm(nose, axis=1, keepdims=True)


def quaternions(count):
    turn = np.random.default_rng(5).normal(size=(count, 4))
    return (turn / np.linalg.norm(turn, axis=1, keepdims=True)).astype(np.float32)


def test_darts_point_where_their_orientation_says_before_their_velocity() -> None:
    points, turn = flock(20)(0, 0.0)[0], quaternions(20)
    style = {"boids": {"kind": "darts", "size": 0.5}}
    both = Points("boids", points.position, {**points.data, "orientation": turn})
    for part, ahead in ((points, points.data["velocity"]), (both, forward_of(turn))):
        shown = geometry(Film(1, lambda index, time, part=part: (part,)), background="night", parts=style)
        expected = ahead / np.linalg.norm(ahead, axis=1, keepdims=True)
        assert (
            np.einsum("nk,nk->n", noses(shown), expected) > 0.98
        ).all()  # a dart leans a little on its keel


def test_arrows_lie_flat_in_a_plan_however_they_are_banked() -> None:
    points = flock(20, flat=2)(0, 0.0)[0]
    heading = Rotation.from_quat(heading_quaternion(points.data["velocity"], (0.0, 0.0, 1.0)))
    banked = (heading * Rotation.from_euler("z", 90, degrees=True)).as_quat().astype(np.float32)
    for data in (points.data, {"orientation": banked}):
        part = Points("boids", points.position, data)
        style = {"boids": {"kind": "arrows", "size": 0.5}}
        shown = geometry(Film(1, lambda index, time, part=part: (part,)), parts=style)
        assert len(shown.triangles.position) == 20 * len(SHAPES["arrows"].vertices)
        assert np.ptp(shown.triangles.position[:, 2]) < 1e-5


@pytest.mark.parametrize(
    ("kind", "beats"), [("birds", True), ("fish", True), ("bees", True), ("darts", False)]
)
def test_wings_and_tails_beat(kind, beats) -> None:
    points = flock(20)(0, 0.0)[0]
    painter = painter_of(Film(1, lambda index, time: (points,)), parts={"boids": {"kind": kind, "size": 0.5}})
    first, second = (
        painter.draft.geometry(Frame(0, time, (points,))).triangles.position for time in (0.0, 0.13)
    )
    assert (np.abs(first - second).max() > 0.01) == beats


def test_a_hunter_follows_the_size_given_to_the_flock() -> None:
    points = flock(500)(0, 0.0)[0]
    hunter = Points("hunter", points.position[:2], {"velocity": points.data["velocity"][:2]})
    film = Film(1, lambda index, time: (hunter, points))
    styles = painter_of(film, background="dusk", parts={"boids": {"size": 0.07}}).draft._styles
    assert styles.of(hunter).size == pytest.approx(3 * 0.07)


def test_a_picture_does_not_depend_on_where_the_scene_is() -> None:
    pictures = [
        painter_of(Film(1, lambda index, time, y=y: (cube(1, (0, y, 0)),)), background="studio").picture(0)
        for y in (0.0, -8.0)
    ]
    difference = np.abs(pictures[0].astype(int) - pictures[1])
    assert (difference > 3).mean() < 1e-3  # the floor goes with the scene; edges may round otherwise


def view(pitch=0.0, azimuth=0.0):
    p, a = np.radians([pitch, azimuth])
    forward = np.array([np.sin(a) * np.cos(p), np.sin(p), np.cos(a) * np.cos(p)])
    return camera_array(np.zeros(3), forward, 160, 90, 0.3, True)


def test_the_sky_follows_the_camera() -> None:
    backdrop = Backdrop(preset_of("dusk"), 160, 90)
    level, up, aside = (backdrop.picture(view(p, a), 0.0).copy() for p, a in ((0, 0), (10, 0), (0, 30)))
    horizon = 45 + view()[layout.FOCAL] * np.tan(np.radians(10))
    land = [np.nonzero(shown[:, 80, 0] < 0.2)[0].min() for shown in (level, up)]
    assert land[1] - land[0] == pytest.approx(horizon - 45, abs=2)
    assert np.abs(level - up)[:20].max() > 0.01
    assert np.abs(level - aside)[40:].max() > 0.1
    np.testing.assert_allclose(level[:20], aside[:20], atol=1e-6)  # the sky itself is the same all round
    np.testing.assert_array_equal(backdrop.picture(view(), 0.0), level)


def test_light_plays_in_the_water() -> None:
    backdrop = Backdrop(preset_of("water"), 160, 90)
    still, later = (backdrop.picture(view(), time) for time in (0.0, 1.0))
    assert 0.001 < np.abs(still - later).max() < 0.2
