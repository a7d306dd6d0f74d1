"""Stars: their light adds up, none is lost, the stretch keeps colours, and the film does not flicker."""

import numpy as np
import pytest

from tianim.frame import Frame, Points
from tianim.view import starlight
from tianim.view.camera import camera_array
from tianim.view.look import CameraLook, Look
from tianim.view.painter import Painter
from tianim.view.starlight import STEPS, Starlight, Stars, gather_light, mean_mass, stars_of

WIDTH, HEIGHT = 320, 180
COLORS = np.array([[1.0, 0.5, 0.25], [0.2, 0.4, 0.8]], np.float32)
# Each share of a star's light is cut to whole steps: 4 pixels of a star lose at most so much a colour.
ROUNDING = 4.0 / STEPS
# A float32 blur keeps the sum of light that is far from the borders to this share.
BLUR = 2e-3


def camera() -> np.ndarray:
    """From z = 10 towards the origin, 2 m wide half height."""
    eye = np.array([0.0, 0.0, 10.0])
    return camera_array(eye, np.zeros(3), WIDTH, HEIGHT, 0.2, True)


def cluster(count: int, seed: int = 0) -> Stars:
    random = np.random.default_rng(seed)
    position = (0.3 * random.normal(size=(count, 3))).astype(np.float32)
    return Stars(
        position, random.uniform(0.5, 2.0, count).astype(np.float32), np.full(count, 0.5, np.float32)
    )


def gathered(stars: Stars) -> np.ndarray:
    total = np.zeros((HEIGHT, WIDTH, 3), np.int64)
    gather_light(total, camera(), stars.position, stars.light, stars.tone, COLORS)
    return total


def test_no_light_is_lost_nor_made() -> None:
    stars = cluster(500)
    found = gathered(stars).sum(axis=(0, 1)) / STEPS
    expected = stars.light.sum(dtype=np.float64) * COLORS[0]
    assert np.abs(found - expected).max() <= 500 * ROUNDING + 1e-5 * expected.max()


def test_light_lands_where_the_star_is() -> None:
    # Right of the middle by a quarter of the picture's height and above it by an eighth.
    star = Stars(np.array([[1.0, 0.5, 0.0]], np.float32), np.ones(1, np.float32), np.zeros(1, np.float32))
    light = gathered(star)[..., 0]
    row, column = np.mgrid[0:HEIGHT, 0:WIDTH] + 0.5
    assert (light * column).sum() / light.sum() == pytest.approx(WIDTH / 2 + HEIGHT / 4, abs=1e-3)
    assert (light * row).sum() / light.sum() == pytest.approx(HEIGHT / 2 - HEIGHT / 8, abs=1e-3)


def test_stars_outside_or_behind_add_nothing() -> None:
    away = np.array([[50.0, 0, 0], [0, -50.0, 0], [0, 0, 11.0]], np.float32)
    assert not gathered(Stars(away, np.ones(3, np.float32), np.zeros(3, np.float32))).any()


def test_the_order_of_stars_does_not_matter() -> None:
    stars = cluster(2000)
    turned = Stars(stars.position[::-1].copy(), stars.light[::-1].copy(), stars.tone)
    assert (gathered(stars) == gathered(turned)).all()


def test_a_star_shines_as_its_mass_and_one_without_as_the_mean() -> None:
    part = Points("s", np.zeros((4, 3), np.float32), {"mass": np.array([1.0, 2.0, 3.0, 0.0])})
    bare = Points("t", np.zeros((1, 3), np.float32))
    mean = mean_mass([part, bare])
    assert mean == 2.0
    np.testing.assert_allclose(stars_of(part, np.zeros(4), 0.5, mean).light, [0.25, 0.5, 0.75, 0.5])
    np.testing.assert_allclose(stars_of(bare, np.zeros(1), 1.0, mean).light, [1.0])


def test_stars_that_are_not_finite_are_left_out() -> None:
    position = np.array([[0, 0, 0], [np.nan, 0, 0], [np.inf, 0, 0]], np.float32)
    assert len(stars_of(Points("s", position), np.zeros(3, np.float32), 1.0, 0.0).position) == 1


def test_the_point_spread_keeps_the_light() -> None:
    stars = cluster(300)
    light = Starlight(WIDTH, HEIGHT, 1.0)._light([stars], camera(), COLORS)
    expected = stars.light.sum(dtype=np.float64) * COLORS[0]
    np.testing.assert_allclose(light.sum(axis=(0, 1)), expected, rtol=BLUR)


def test_the_stretch_keeps_colours_and_shows_the_faint_and_the_bright() -> None:
    drawn = Starlight(WIDTH, HEIGHT, 1.0)
    stars = cluster(20_000)
    drawn.expose([([stars], camera())], COLORS)
    nothing = np.zeros((HEIGHT, WIDTH, 3), np.float32)
    light = drawn._light([stars], camera(), COLORS)
    picture = drawn.picture([stars], camera(), COLORS, nothing).copy()
    lit = light.mean(axis=2) > 0.01
    np.testing.assert_allclose(picture[lit][:, 1] / picture[lit][:, 0], 0.5, rtol=1e-3)
    order = np.argsort(light[..., 0][lit])
    assert (np.diff(picture[..., 0][lit][order]) >= -1e-6).all()
    # As the formula says.
    mean = light.mean(axis=2, keepdims=True)[lit]
    stretch = np.arcsinh(mean / drawn._faint) / np.arcsinh(drawn._bright / drawn._faint)
    np.testing.assert_allclose(picture[lit], light[lit] * stretch / mean, rtol=2e-3)
    # Between the brightest and the faint light lies far more than the picture's eight bits could hold.
    shown = picture.mean(axis=2)
    assert np.percentile(shown[lit], 99.9) > 0.9
    assert shown[lit].min() * 3 > mean.min() / mean.max()


def test_no_stars_leave_the_background_as_it_is() -> None:
    background = np.random.default_rng(0).random((HEIGHT, WIDTH, 3)).astype(np.float32)
    drawn = Starlight(WIDTH, HEIGHT, 1.0)
    drawn.expose([], COLORS)
    np.testing.assert_allclose(drawn.picture([], camera(), COLORS, background), background)


def film(counts: list[int]) -> list[Frame]:
    random = np.random.default_rng(1)
    most = random.normal(size=(max(counts), 3)).astype(np.float32)
    halo = 100 * random.normal(size=(50, 3)).astype(np.float32)
    return [
        Frame(k, k / 24, (Points("disk", most[:count]), Points("halo", halo)))
        for k, count in enumerate(counts)
    ]


def look(**halo: object) -> Look:
    parts = {"disk": {"kind": "stars"}, "halo": {"kind": "stars", **halo}}
    return Look.model_validate({"width": WIDTH, "height": HEIGHT, "parts": parts, "camera": {"orbit": 0}})


def test_one_exposure_holds_for_the_film() -> None:
    frames = film([4000, 4000, 200, 4000])
    still = look(kind="hidden").model_copy(
        update={"camera": CameraLook(position=(0.0, 0.0, 9.0), target=(0.0, 0.0, 0.0))}
    )
    painter = Painter(frames, still)
    bright, few = painter.picture(1), painter.picture(2)
    assert bright.mean() > few.mean() + 0.5
    assert (painter.picture(3) == bright).all()


def test_a_part_that_is_not_framed_does_not_move_the_camera() -> None:
    frames = film([500, 500])
    framed = Painter(frames, look()).path.at(0, 0.0).distance
    left_out = Painter(frames, look(framed=False)).path.at(0, 0.0).distance
    hidden = Painter(frames, look(kind="hidden")).path.at(0, 0.0).distance
    assert framed > 20 * left_out
    assert hidden == left_out


def test_stars_stand_behind_what_is_solid() -> None:
    ball = Points("ball", np.zeros((1, 3), np.float32))
    shell = np.random.default_rng(2).normal(size=(30_000, 3)).astype(np.float32)
    frame = Frame(0, 0.0, (ball, Points("stars", shell)))
    parts = {"ball": {"kind": "spheres", "size": 1.0, "color": "#000000"}, "stars": {"kind": "stars"}}
    size = {"width": WIDTH, "height": HEIGHT}
    with_ball = Painter([frame], Look.model_validate({**size, "parts": parts})).picture(0)
    parts["ball"] = {"kind": "hidden"}
    without = Painter([frame], Look.model_validate({**size, "parts": parts})).picture(0)
    middle = (slice(HEIGHT // 2 - 3, HEIGHT // 2 + 3), slice(WIDTH // 2 - 3, WIDTH // 2 + 3))
    assert with_ball[middle].mean() < 0.5 * without[middle].mean()


def test_the_faint_level_shows_the_middle_as_it_should() -> None:
    faint = starlight._faint_for(2.0, 500.0)
    shown = np.arcsinh(2.0 / faint) / np.arcsinh(500.0 / faint)
    assert shown == pytest.approx(starlight.FAINT_SHOWN, rel=1e-3)
