"""Whole pictures: light, shadow, fog, colour, determinism and odd frames."""

import os
import subprocess
import sys

import numpy as np
import pytest
from view_scenes import Film, cloud, cube, flock, strand

from tianim.errors import SceneError
from tianim.frame import Frame, Lines, Mesh, Points
from tianim.view import draft
from tianim.view.colormap import encoding_table, hex_to_linear, table, to_linear, to_srgb
from tianim.view.look import Look
from tianim.view.painter import Painter, check_look

SMALL = {"width": 160, "height": 90}
STICK_TOLERANCE = 0.15  # the widths of sticks were measured to two digits, over random directions


def look(**fields):
    return Look.model_validate({**SMALL, **fields})


def one(*parts):
    return Film(1, lambda index, time: parts)


def picture(*parts, **fields):
    return Painter(one(*parts), look(**fields)).picture(0).astype(float)


def background(**fields):
    return picture(**fields)


def subject(shown, **fields):
    """Pixels that differ from the empty background."""
    return np.abs(shown - background(**fields)).max(axis=2) > 6


@pytest.mark.parametrize("preset", ["dusk", "night", "studio", "water", "paper", ("#102030", "#d0e0f0")])
def test_every_background_shows_every_kind_of_part(preset) -> None:
    points, mesh, lines = flock(40)(0, 0.0)[0], cube(0.8), strand()
    for part in (points, mesh, lines):
        shown = Painter(one(part), look(background=preset)).picture(0)
        assert shown.shape == (90, 160, 3)
        assert shown.dtype == np.uint8
        assert np.ptp(shown.astype(int), axis=(0, 1)).max() > 10


@pytest.mark.parametrize("kind", ["spheres", "darts", "birds", "fish", "bees", "arrows", "glow"])
def test_every_kind_of_point_is_seen(kind) -> None:
    points = flock(20)(0, 0.0)[0]
    fields = {"background": "night", "parts": {"boids": {"kind": kind, "size": 0.4, "color": "#ffffff"}}}
    shown = picture(points, **fields)
    assert subject(shown, background="night").sum() > 60


def test_two_draws_are_the_same_bytes() -> None:
    painters = [Painter(Film(4, flock(2000)), look(background="studio")) for _ in range(2)]
    first, second = (painter.picture(2) for painter in painters)
    assert (first == second).all()


@pytest.mark.slow
def test_the_bytes_do_not_depend_on_the_number_of_threads() -> None:
    code = (
        "import hashlib\n"
        "from tianim import runtime; runtime.start(threads={})\n"
        "from view_scenes import Film, cube, flock\n"
        "from tianim.view.look import Look\n"
        "from tianim.view.painter import Painter\n"
        "film = Film(4, lambda index, time: (*flock(20000)(index, time), cube(1.5)))\n"
        "looks = [{{'background': 'studio', 'parts': {{'boids': {{'trail': 3}}}}}}, "
        "{{'parts': {{'boids': {{'kind': 'glow'}}}}}}]\n"
        "for look in map(Look.model_validate, looks):\n"
        "    print(hashlib.sha256(Painter(film, look).picture(3)).hexdigest())"
    )
    path = os.pathsep.join([os.path.dirname(__file__), *filter(None, sys.path)])
    environment = {**os.environ, "PYTHONPATH": path}
    shown = [
        subprocess.run(
            [sys.executable, "-c", code.format(threads)], capture_output=True, env=environment, check=True
        )
        for threads in (1, 2)
    ]
    assert shown[0].stdout == shown[1].stdout
    assert len(shown[0].stdout) > 100


def test_the_order_of_points_does_not_show() -> None:
    points = flock(500)(0, 0.0)[0]
    turned = Points("boids", points.position[::-1].copy(), {"velocity": points.data["velocity"][::-1].copy()})
    style = {"background": "night", "parts": {"boids": {"kind": "spheres", "size": 0.2}}}
    same = (picture(points, **style) == picture(turned, **style)).all(axis=2)
    assert same.mean() > 0.999  # a sample where two spheres cut each other may go either way


def test_empty_frames_show_the_background() -> None:
    nothing = Points("boids", np.zeros((0, 3), np.float32), {"velocity": np.zeros((0, 3), np.float32)})
    no_mesh = Mesh("cloth", np.zeros((0, 3), np.float32), np.zeros((0, 3), np.int32))
    no_lines = Lines("rope", np.zeros((0, 3), np.float32), np.zeros((0, 2), np.int32))
    bare = background(background="night")
    assert (picture(nothing, no_mesh, no_lines, background="night") == bare).all()


def test_a_single_point_is_drawn_in_the_middle() -> None:
    point = Points("one", np.array([[7, 8, 9]], np.float32))
    seen = subject(picture(point, background="night"), background="night")
    rows, columns = np.nonzero(seen)
    assert (abs(rows.mean() - 44.5), abs(columns.mean() - 79.5)) < (2, 2)


def test_points_that_are_not_finite_are_left_out() -> None:
    points = flock(50)(0, 0.0)[0]
    broken = points.position.copy()
    broken[3], broken[4] = np.nan, np.inf
    data = {"velocity": points.data["velocity"]}
    kept = np.delete(np.arange(50), [3, 4])
    without = Points("boids", points.position[kept], {"velocity": data["velocity"][kept]})
    fixed = {"background": "night", "camera": {"position": [0, 0, 9], "target": [0, 0, 0]}}
    style = {"boids": {"kind": "spheres", "size": 0.3, "color": "#ffffff"}}
    shown = picture(Points("boids", broken, data), parts=style, **fixed)
    assert (shown == picture(without, parts=style, **fixed)).all()


def test_light_comes_from_the_upper_left() -> None:
    ball = Points("ball", np.zeros((1, 3), np.float32))
    style = {"ball": {"kind": "spheres", "size": 1, "color": "#808080"}}
    fields = {"background": "studio", "shadows": False, "camera": {"elevation": 0}}
    shown = picture(ball, parts=style, **fields).mean(axis=2)
    upper_left, lower_right = shown[30:42, 60:76].mean(), shown[50:60, 86:96].mean()
    assert upper_left > 1.25 * lower_right


def test_a_cube_throws_a_shadow_on_the_floor_and_only_when_asked() -> None:
    fields = {"background": "studio", "camera": {"elevation": 25, "azimuth": 20}}
    lit, shaded = (picture(cube(1, (0, 0.5, 0)), shadows=on, **fields) for on in (False, True))
    floor = ~subject(lit, background="studio", shadows=False, camera=fields["camera"])
    darker = (lit - shaded).mean(axis=2)
    assert (darker[floor] > 25).sum() > 150
    assert (darker[floor] < 3).mean() > 0.5


@pytest.mark.parametrize("preset", ["dusk", "night", "studio", "water", "paper", ("#102030", "#d0e0f0")])
def test_shadows_can_be_asked_for_on_every_background(preset) -> None:
    parts = (cube(1, (0, 0.5, 0)), cube(4, (0, -2, 0), "slab"))
    camera = {"elevation": 25, "azimuth": 20}
    lit, shaded = (
        picture(*parts, background=preset, camera=camera, shadows=asked).mean(axis=2)
        for asked in (False, True)
    )
    assert (lit - shaded).max() > 4
    assert (shaded - lit).max() <= 1


def test_faces_of_a_cube_catch_the_light_differently() -> None:
    camera = {"elevation": 30, "azimuth": 35}
    fields = {"background": "studio", "shadows": False, "fog": 0.0, "camera": camera}
    shown = picture(cube(), parts={"cube": {"color": "#999999"}}, **fields)[..., 1]
    top, left, right = shown[28, 78], shown[52, 70], shown[52, 96]
    assert top > left + 8 > right + 30


def test_the_back_of_a_mesh_has_its_own_colour() -> None:
    sheet = Mesh(
        "sheet", np.array([[-1, -1, 0], [1, -1, 0], [0, 1, 0]], np.float32), np.array([[0, 1, 2]], np.int32)
    )
    style = {"sheet": {"color": {"by": "#ff0000", "back": "#0000ff"}}}
    front, back = (
        picture(sheet, parts=style, background="studio", camera={"position": [0, 0, z], "target": [0, 0, 0]})
        for z in (4, -4)
    )
    assert front[45, 80, 0] > 2 * front[45, 80, 2]
    assert back[45, 80, 2] > 2 * back[45, 80, 0]


def test_fog_fades_the_far_into_the_background() -> None:
    position = np.array([[-1, 0, 3], [1, 0, -3]], np.float32)
    pair = Points("pair", position)
    style = {"pair": {"kind": "spheres", "size": 1.2, "color": "#ffffff"}}
    fields = {
        "background": ("#203040", "#203040"),
        "camera": {"azimuth": 0, "elevation": 0},
        "shadows": False,
    }
    clear, foggy = (picture(pair, parts=style, fog=fog, **fields) for fog in (0.0, 0.9))
    change = np.abs(clear - foggy).max(axis=2)
    assert change[:, :80].max() < 0.35 * change[:, 80:].max()


def test_colours_follow_the_data_over_a_fixed_range() -> None:
    position = np.array([[-2, 0, 0], [0, 0, 0], [2, 0, 0]], np.float32)
    heat = np.array([0, 5, 10], np.float32)
    style = {"kind": "spheres", "size": 1, "color": {"by": "heat", "map": "viridis", "range": [0, 10]}}
    fields = {
        "background": "night",
        "parts": {"row": style},
        "fog": 0.0,
        "camera": {"azimuth": 0, "elevation": 0},
    }
    shown = picture(Points("row", position, {"heat": heat}), **fields)
    seen = subject(shown, background="night")
    thirds = np.array_split(np.nonzero(seen.any(axis=0))[0], 3)
    hues = [shown[:, columns][seen[:, columns]].mean(axis=0) for columns in thirds]
    for hue, value in zip(hues, (0, 128, 255), strict=True):
        expected = table("viridis")[value]
        assert np.corrcoef(hue, to_srgb(expected))[0, 1] > 0.9


def test_a_whole_number_has_one_colour_all_over_its_shape() -> None:
    """Blended over a triangle in float32, a row's number may fall just short of it."""
    points = flock(300)(0, 0.0)[0]
    data = {"velocity": points.data["velocity"], "kind": np.ones(300, np.int32)}
    color = {"by": "kind", "palette": ["#0000ff", "#ff0000"]}
    style = {"boids": {"kind": "darts", "size": 0.8, "color": color}, "first": {"kind": "hidden"}}
    fields = {"background": ("#000000", "#000000"), "width": 640, "height": 360, "samples": 1}
    shown = picture(cube(name="first"), Points("boids", points.position, data), parts=style, **fields)
    assert (shown[..., 0] > shown[..., 2] + 20).sum() > 5000
    assert not (shown[..., 2] > shown[..., 0] + 20).any()


def test_opacity_lets_the_background_through() -> None:
    ball = Points("ball", np.zeros((1, 3), np.float32))
    style = {"kind": "spheres", "size": 1, "color": "#000000"}
    fields = {"background": ("#808080", "#808080"), "shadows": False, "fog": 0.0}
    shown = [picture(ball, parts={"ball": {**style, "opacity": o}}, **fields)[45, 80] for o in (0.5, 0.9)]
    expected = 255 * to_srgb(hex_to_linear("#808080") * np.array([[0.5], [0.1]]))
    np.testing.assert_allclose(shown, expected, atol=3)


def test_trails_lie_behind_the_points() -> None:
    def make(index, time):
        return (Points("dot", np.array([[index * 0.5, 0, 0]], np.float32)), cube(0.01, (2.5, 0, 0), "mark"))

    style = {
        "dot": {"kind": "spheres", "size": 0.3, "trail": 5, "color": "#ffffff"},
        "mark": {"kind": "hidden"},
    }
    camera = {"position": [2.5, 0, 9], "target": [2.5, 0, 0]}
    film = Film(6, make)
    shown = (
        Painter(film, look(background="night", parts=style, camera=camera))
        .picture(5)
        .astype(float)
        .mean(axis=2)
    )
    bare = Painter(
        film, look(background="night", parts={**style, "dot": {**style["dot"], "trail": 0}}, camera=camera)
    )
    added = (shown - bare.picture(5).astype(float).mean(axis=2))[40:50].max(axis=0)
    columns = np.nonzero(added > 4)[0]
    dot_column = 80 + 2.5 * 45 / (9 * np.tan(np.radians(17.5)))
    assert len(columns) > 20
    assert columns.max() < dot_column + 6


def test_background_is_chosen_from_the_scene() -> None:
    assert Painter(one(cube()), look()).background == "studio"
    assert Painter(Film(2, flock(30)), look()).background == "dusk"
    assert Painter(Film(2, flock(30, flat=2)), look()).background == "paper"


@pytest.mark.parametrize(
    ("fields", "words"),
    [
        ({"parts": {"birds": {}}}, ["birds", "boids"]),
        ({"parts": {"boids": {"color": "sped"}}}, ["sped", "speed", "velocity"]),
        ({"parts": {"boids": {"kind": "mesh"}}}, ["mesh", "points"]),
    ],
)
def test_a_look_that_does_not_fit_the_frame_says_so(fields, words) -> None:
    frame = Frame(0, 0.0, flock(5)(0, 0.0))
    with pytest.raises(SceneError) as caught:
        check_look(frame, look(**fields))
    message = str(caught.value)
    assert "\n" not in message
    assert all(word in message for word in words)


def test_encoding_is_that_of_srgb_and_rises_to_white() -> None:
    values = encoding_table(4096, 1024.0)
    light = (np.arange(4096) / 1024.0) ** 2
    assert (np.diff(values) >= 0).all()
    low = light < 0.8
    np.testing.assert_allclose(values[low], 255 * to_srgb(light[low]), atol=1e-3)
    assert 254 < values[-1] <= 255


@pytest.mark.parametrize("kind", ["darts", "birds", "fish", "bees"])
def test_sticks_hide_as_much_as_the_shapes_that_they_stand_for(kind, monkeypatch) -> None:
    """Darts that are too small or too many are drawn as sticks: a flock must not change its tone by that."""
    rng = np.random.default_rng(0)
    position, velocity = (rng.normal(size=(1500, 3)).astype(np.float32) for _ in range(2))
    points = Points("boids", position, {"velocity": velocity})
    fields = {"background": ("#c0c0c0", "#c0c0c0"), "fog": 0.0, "width": 480, "height": 270}
    fields["parts"] = {"boids": {"kind": kind, "color": "#000000", "size": 0.06}}
    bare = to_linear(background(**{**fields, "parts": {}}) / 255)
    hidden = []
    for limit in (0.0, 1e9):
        monkeypatch.setattr(draft, "STICK_BELOW", limit)
        hidden.append((bare - to_linear(picture(points, **fields) / 255)).mean())
    assert hidden[1] == pytest.approx(hidden[0], rel=STICK_TOLERANCE)


def test_a_cloud_is_not_cut_by_the_picture() -> None:
    shown = picture(Points("cloud", cloud(2000)), background="night")
    seen = subject(shown, background="night")
    rows = np.nonzero(seen.any(axis=1))[0]
    assert 0.4 < np.ptp(np.percentile(np.nonzero(seen)[0], [2, 98])) / 90 < 0.75
    assert rows.min() >= 0
