"""The camera frames the action, follows it smoothly, and looks straight on a plan."""

import numpy as np
import pytest
from view_scenes import Film, cloud, cube, flock, strand

from tianim.frame import Frame, Points
from tianim.view import layout
from tianim.view.look import Look
from tianim.view.painter import Painter
from tianim.view.survey import survey

WIDTH, HEIGHT = 320, 180
# Second difference of the camera's place from frame to frame, over its distance: a jump of a
# thousandth is a tenth of a pixel.
JITTER = 1e-4


def path(film, **camera):
    return Painter(film, Look.model_validate({"width": WIDTH, "height": HEIGHT, "camera": camera})).path


def projected(camera, points):
    """Screen positions of world points, as the kernels project them."""
    seen = (np.asarray(points, float) - camera[:3]) @ camera[3:12].reshape(3, 3).T
    w = seen[:, 2] if camera[layout.PERSPECTIVE] else np.ones(len(seen))
    return np.stack(
        [
            0.5 * WIDTH + camera[layout.FOCAL] * seen[:, 0] / w,
            0.5 * HEIGHT - camera[layout.FOCAL] * seen[:, 1] / w,
        ],
        1,
    )


def extent(camera, points):
    """Share of height and of width that the middle 96 % of the points take."""
    low, high = np.percentile(projected(camera, points), [2, 98], axis=0)
    return (high - low) / (WIDTH, HEIGHT), (high + low) / 2 / (WIDTH, HEIGHT)


@pytest.mark.parametrize("scale", [1e-3, 1.0, 1e4])
@pytest.mark.parametrize("count", [50, 3000])
def test_the_action_fills_its_share_and_lies_in_the_middle(scale, count) -> None:
    points = cloud(count) * np.float32(scale) + np.float32(30 * scale)
    film = Film(5, lambda index, time: (Points("cloud", points),))
    size, middle = extent(path(film).at(2, 0.1).camera, points)
    assert 0.4 < size[1] < 0.7
    np.testing.assert_allclose(middle, 0.5, atol=0.06)


def test_a_wide_action_fits_the_width() -> None:
    points = cloud(500) * np.array([9, 0.3, 9], np.float32)
    film = Film(3, lambda index, time: (Points("cloud", points),))
    size, _ = extent(path(film).at(1, 0.0).camera, points)
    assert 0.5 < size[0] < 0.9


def test_strays_do_not_move_the_camera() -> None:
    points = cloud(400)
    strayed = points.copy()
    strayed[:3] = 1e4
    cameras = [
        path(Film(3, lambda index, time, p=p: (Points("cloud", p),))).at(1, 0.0).camera
        for p in (points, strayed)
    ]
    assert np.abs(cameras[0][:3] - cameras[1][:3]).max() < 1.0


def test_a_moving_flock_stays_in_the_picture_to_the_end() -> None:
    film = Film(200, flock(300, drift=(15, 0, -4)))
    for index in (0, 60, 199):
        view = path(film).at(index, film[index].time)
        size, middle = extent(view.camera, film[index].parts[0].position)
        np.testing.assert_allclose(middle, 0.5, atol=0.1)
        assert 0.35 < size[1] < 0.75


def test_the_camera_does_not_jitter() -> None:
    rng = np.random.default_rng(3)
    noise = rng.normal(size=(120, 3)).astype(np.float32)  # the whole flock jumps about by half its radius

    def make(index, time):
        return (Points("cloud", cloud(300) + noise[index] + np.float32(time)),)

    film = Film(120, make)
    along = path(film)
    views = [along.at(index, index / 30) for index in range(120)]
    eyes = np.array([view.camera[:3] for view in views], float)
    assert np.abs(np.diff(eyes, n=2, axis=0)).max() < JITTER * 20 * views[0].distance


def test_the_camera_goes_round_by_the_orbit_asked_for() -> None:
    film = Film(61, flock(300))
    along = path(film, orbit=90.0)
    backs = [-along.at(index, 0.0).camera[9:12][[0, 2]] for index in (0, 60)]
    angle = np.degrees(np.arccos(backs[0] @ backs[1] / np.prod([np.linalg.norm(b) for b in backs])))
    assert angle == pytest.approx(90, abs=0.5)


def test_the_horizon_is_level() -> None:
    camera = path(Film(3, flock(100))).at(1, 0.0).camera
    assert camera[4] == pytest.approx(0, abs=1e-6)  # `right` has no height
    assert camera[7] > 0


@pytest.mark.parametrize(("axis", "right", "up"), [(2, (1, 0, 0), (0, 1, 0)), (1, (1, 0, 0), (0, 0, -1))])
def test_a_flat_scene_gets_a_plan_that_stands_still(axis, right, up) -> None:
    def make(index, time):
        return (Points("cloud", cloud(200, flat=axis) + np.float32(index * 0.01) * (1 - np.eye(3)[axis])),)

    film = Film(50, lambda index, time: (Points("c", make(index, time)[0].position.astype(np.float32)),))
    along = path(film)
    first, last = along.at(0, 0.0).camera, along.at(49, 1.6).camera
    assert first[layout.PERSPECTIVE] == 0
    np.testing.assert_allclose(first[3:6], right, atol=1e-6)
    np.testing.assert_allclose(first[6:9], up, atol=1e-6)
    np.testing.assert_allclose(first, last)
    everything = np.concatenate([film[k].parts[0].position for k in range(50)])
    corners = projected(first, everything)
    assert (corners >= 0).all()
    assert (corners <= (WIDTH, HEIGHT)).all()


def test_a_fixed_camera_is_where_it_was_put() -> None:
    along = path(Film(9, flock(100)), position=(3.0, 4.0, 5.0), target=(0.0, 1.0, 0.0))
    camera = along.at(4, 0.1).camera
    np.testing.assert_allclose(camera[:3], [3, 4, 5], rtol=1e-6)
    np.testing.assert_allclose(projected(camera, [[0, 1, 0]]), [[WIDTH / 2, HEIGHT / 2]], atol=1e-3)


def test_a_keyframed_camera_moves() -> None:
    keys = {"keys": [[0.0, [0.0, 0.0, 10.0]], [1.0, [0.0, 0.0, 20.0]]]}
    along = path(Film(31, flock(100)), position=keys, target=(0.0, 0.0, 0.0))
    assert along.at(15, 0.5).camera[2] == pytest.approx(15)


@pytest.mark.parametrize("target", [None, (0.0, 0.0, 0.0)])
def test_a_camera_that_passes_through_its_target_sees_something(target) -> None:
    keys = {"keys": [[0.0, [0.0, 0.0, 0.0]], [1.0, [0.0, 0.0, 5.0]]]}
    film = Film(2, lambda index, time: (Points("pair", np.array([[1, 0, 0], [-1, 0, 0]], np.float32)),))
    camera = path(film, position=keys, **({} if target is None else {"target": target})).at(0, 0.0).camera
    axes = camera[3:12].reshape(3, 3)
    np.testing.assert_allclose(axes @ axes.T, np.eye(3), atol=1e-6)


def test_an_orthographic_camera_shows_the_same_at_any_depth() -> None:
    camera = path(Film(3, flock(300)), projection="orthographic").at(1, 0.0).camera
    at, far = projected(camera, [[1, 0, 0], np.array([1, 0, 0]) + 3 * camera[9:12]])
    np.testing.assert_allclose(at, far, atol=1e-2)


def test_an_orthographic_camera_has_nothing_behind_it() -> None:
    points = cloud(500) * np.array([1, 1, 9], np.float32)
    film = Film(3, lambda index, time: (Points("cloud", points),))
    camera = path(film, projection="orthographic", azimuth=0.0, elevation=0.0, orbit=0.0).at(1, 0.0).camera
    assert ((points - camera[:3]) @ camera[9:12]).min() > camera[layout.NEAR]


def test_one_large_ball_is_framed_whole() -> None:
    film = Film(1, lambda index, time: (Points("ball", np.zeros((1, 3), np.float32)),))
    look = {"width": WIDTH, "height": HEIGHT, "parts": {"ball": {"kind": "spheres", "size": 4.0}}}
    view = Painter(film, Look.model_validate(look)).path.at(0, 0.0)
    shown = 2.0 * view.camera[layout.FOCAL] / view.distance / HEIGHT * 2  # its diameter, of the height
    assert 0.4 < shown < 0.9


def test_meshes_alone_are_framed_whole() -> None:
    film = Film(2, lambda index, time: (cube(2.0),))
    shown = projected(path(film).at(0, 0.0).camera, cube(2.0).position)
    assert (shown > 0).all()
    assert (shown < (WIDTH, HEIGHT)).all()


def test_bodies_do_not_draw_the_camera_away_from_the_flock() -> None:
    points = cloud(300)
    films = [
        Film(2, lambda index, time, more=more: (Points("boids", points), *more))
        for more in ((), (cube(500.0),))
    ]
    near, also = (path(film).at(0, 0.0).distance for film in films)
    assert near == pytest.approx(also)


@pytest.mark.parametrize(
    "parts", [(), (Points("none", np.zeros((0, 3), np.float32)),)], ids=["bare", "empty"]
)
def test_films_of_nothing_have_a_camera(parts) -> None:
    for count in (0, 1, 3):
        view = path(Film(count, lambda index, time: parts)).at(0, 0.0)
        assert np.isfinite(view.camera).all()
        assert view.distance > 0


def test_coincident_points_have_a_camera() -> None:
    film = Film(2, lambda index, time: (Points("same", np.ones((9, 3), np.float32)),))
    assert np.isfinite(path(film).at(0, 0.0).camera).all()


def test_the_survey_reads_few_frames() -> None:
    film = Film(5000, flock(50))
    found = survey(film)
    assert film.asked < 60
    assert (found.indices[0], found.indices[-1]) == (0, 4999)


def test_the_survey_keeps_the_same_particles() -> None:
    film = Film(10, flock(9000))
    found = survey(film)
    ids = [frame.parts[0].data["id"] for frame in found.frames]
    assert len(ids[0]) <= 3000
    assert all((each == ids[0]).all() for each in ids)


def test_spacing_is_that_of_neighbours_and_segments() -> None:
    grid = np.stack(np.meshgrid(*[np.arange(6.0)] * 3), -1).reshape(-1, 3).astype(np.float32) * 0.5
    frame = Frame(0, 0.0, (Points("grid", grid), strand(5)))
    spacing = survey([frame]).spacing
    assert spacing["grid"] == pytest.approx(0.5)
    assert spacing["rope"] == pytest.approx(0.5)


def test_the_lowest_thing_makes_the_floor() -> None:
    frame = Frame(0, 0.0, (Points("cloud", cloud(50)), cube(2.0, (0, -5, 0))))
    assert survey([frame]).lowest == pytest.approx(-6)


def test_the_elevation_may_be_keyframed() -> None:
    film = Film(31, lambda index, time: (Points("cloud", cloud(300)),))
    tilting = path(film, orbit=0.0, elevation={"keys": [[0.0, 80.0], [1.0, 10.0]], "interpolation": "linear"})
    angles = [np.degrees(np.arcsin(-tilting.at(k, k / 30).camera[10])) for k in (0, 15, 30)]
    np.testing.assert_allclose(angles, [80.0, 45.0, 10.0], atol=0.5)
