"""What the shading kernels make of light: highlights, rims, folds, corners, soft shadows, fine steps."""

import numpy as np
import pytest
from view_scenes import Film, cube, strand

from tianim.frame import Lines, Mesh, Points
from tianim.lang import f32_1d, f32_2d, ti
from tianim.view import layout, shade
from tianim.view.backdrop import Backdrop, preset_of
from tianim.view.camera import camera_array
from tianim.view.canvas import Blend, Canvas, Geometry, Light
from tianim.view.look import Look
from tianim.view.painter import Painter

SMALL = {"width": 160, "height": 90}
ALBEDO = 0.4


def picture(*parts, **fields):
    film = Film(1, lambda index, time: parts)
    return Painter(film, Look.model_validate({**SMALL, **fields})).picture(0).astype(float)


@ti.kernel
def light_of(out: f32_2d, stage: f32_1d, normal: f32_2d, lit: ti.f32, open_share: ti.f32):
    """Light that a grey surface sends to an eye at +z."""
    for n in range(out.shape[0]):
        facing = ti.Vector([normal[n, c] for c in ti.static(range(3))])
        grey, eye = ti.Vector([ALBEDO] * 3), ti.Vector([0.0, 0.0, 1.0])
        color = shade.lit_color(stage, grey, facing, eye, lit, open_share)
        for c in ti.static(range(3)):
            out[n, c] = color[c]


def red_light(lit=1.0, open_share=1.0, **stage):
    """Red light of surfaces that face the eye, look aside and look up, under a sun behind the eye."""
    values = np.zeros(layout.STAGE_SIZE, np.float32)
    values[2] = 1.0
    places = {"key": 3, "above": 6, "below": 9, "shine": layout.SHINE, "rim": layout.RIM}
    for name, value in stage.items():
        values[places[name]] = value
    out = np.empty((3, 3), np.float32)
    light_of(out, values, np.array([[0, 0, 1], [1, 0, 0], [0, 1, 0]], np.float32), lit, open_share)
    return out[:, 0]


def test_light_is_the_sum_of_its_terms() -> None:
    grazing = 0.15 / 1.15  # the terminator lies behind 90 degrees
    np.testing.assert_allclose(red_light(key=2.0), 2 * ALBEDO * np.array([1, grazing, grazing]), rtol=1e-5)
    np.testing.assert_allclose(red_light(key=2.0, lit=0.0), 0, atol=1e-6)
    np.testing.assert_allclose(red_light(above=1.0), ALBEDO * np.array([0.5, 0.5, 1]), rtol=1e-5)
    np.testing.assert_allclose(
        red_light(below=1.0, open_share=0.5), ALBEDO * np.array([1, 1, 0]) / 4, rtol=1e-5
    )
    shine = red_light(key=1.0, shine=0.5) - red_light(key=1.0)
    np.testing.assert_allclose(shine, [0.5, 0, 0], atol=1e-6)
    rim = red_light(above=1.0, rim=0.5) - red_light(above=1.0)
    np.testing.assert_allclose(rim, [0, 0.5, 0.5], atol=1e-6)


def test_both_sides_of_a_sheet_are_lit_alike() -> None:
    corners = np.array([[-1, -1, 0], [1, -1, 0], [0, 1, 0]], np.float32)
    sheet = Mesh("sheet", corners, np.array([[0, 1, 2]], np.int32))
    front, back = (
        picture(
            sheet, parts={"sheet": {"color": "#999999"}}, background="paper",
            camera={"position": [0, 0, z], "target": [0, 0, 0]},
        )[45, 80]
        for z in (4, -4)
    )  # fmt: skip
    np.testing.assert_allclose(front, back, atol=1)


def folded(angle):
    """Brightness along a row over a ridge whose sides turn from each other by `angle` degrees."""
    half = np.radians(angle / 2)
    x, z = np.array([-1, 0, 1]) * np.cos(half), -np.array([1, 0, 1]) * np.sin(half)
    position = np.array([[x[k], y, z[k]] for y in (-1, 1) for k in range(3)], np.float32)
    triangles = np.array([[0, 1, 4], [0, 4, 3], [1, 2, 5], [1, 5, 4]], np.int32)
    fields = {"background": "paper", "samples": 1, "camera": {"position": [0, 0, 5], "target": [0, 0, 0]}}
    shown = picture(Mesh("ridge", position, triangles), parts={"ridge": {"color": "#999999"}}, **fields)
    seen = int(25 * np.cos(half))  # columns to each side; the sides reach 28 where they lie flat
    return shown[45, 80 - seen : 80 + seen, 0]


def test_a_gentle_fold_is_smooth_and_a_sharp_one_is_not() -> None:
    gentle, sharp = folded(60), folded(120)
    assert np.ptp(gentle) > 10
    assert np.abs(np.diff(gentle)).max() < 0.25 * np.ptp(gentle)
    assert np.abs(np.diff(sharp)).max() > 0.8 * np.ptp(sharp)


def test_a_rope_is_round_and_lit_from_the_left() -> None:
    fields = {"background": "studio", "shadows": False, "camera": {"azimuth": 0, "elevation": 0}}
    shown = picture(strand(), parts={"rope": {"size": 0.6, "color": "#808080"}}, **fields)[45]
    bare = picture(**fields)[45]
    columns = np.nonzero(np.abs(shown - bare).max(axis=1) > 6)[0]
    left, right = np.array_split(shown[columns[1:-1]].mean(axis=1), 2)  # without the smooth edges
    assert left.mean() > 1.2 * right.mean()


def test_lines_of_two_parts_keep_their_colours() -> None:
    other = strand()
    other = Lines("hair", other.position + np.array([1, 0, 0], np.float32), other.segments)
    parts = {"rope": {"size": 0.4, "color": "#ff0000"}, "hair": {"size": 0.4, "color": "#00ff00"}}
    fields = {"background": ("#000000", "#000000"), "camera": {"azimuth": 0, "elevation": 0}, "fog": 0.0}
    shown = picture(strand(), other, parts=parts, **fields)
    red, green = (np.nonzero(shown[45, :, k] > 2 * shown[45, :, 1 - k] + 20)[0] for k in (0, 1))
    assert len(red) == pytest.approx(len(green), abs=1)
    assert len(red) > 5
    assert red.max() < green.min()


@pytest.mark.parametrize("preset", ["night", "water"])
def test_corners_are_dark_where_things_meet(preset) -> None:
    parts = (cube(1, (0, 0.5, 0)), cube(4, (0, -2, 0), "slab"))
    fields = {"background": preset, "camera": {"position": [0, 2, 5], "target": [0, 0, 0]}}
    darker = picture(*parts, shadows=False, **fields) - picture(*parts, **fields)
    darker = darker.mean(axis=2)
    assert darker.max() > 5
    assert (np.abs(darker) < 1).mean() > 0.6


def test_a_shadow_is_softer_the_farther_its_caster() -> None:
    camera = {"position": [0, 7, 9], "target": [0, 0, 0]}
    fields = {"background": "studio", "camera": camera, "width": 320, "height": 180}
    edges = []
    for height in (0.5, 2.5):
        parts = (cube(8, (0, -4, 0), "slab"), cube(1, (0.5, height, 0.5)))
        dark = picture(*parts, shadows=False, **fields) - picture(*parts, **fields)
        dark = dark.mean(axis=2)
        full = np.percentile(dark[dark > 20], 90)
        edges.append(((dark > 0.25 * full) & (dark < 0.75 * full)).sum())
    assert edges[1] > 1.25 * edges[0]  # 1.02 where all edges are equally sharp


def test_where_nothing_is_solid_no_shadow_is_left_from_the_frame_before() -> None:
    nothing = Points("boids", np.zeros((0, 3), np.float32))
    film = Film(2, lambda index, time: (cube(), nothing) if index == 0 else (nothing,))
    look = Look.model_validate({**SMALL, "background": "studio", "camera": {"orbit": 0.0}})
    painter = Painter(film, look)
    painter.picture(0)
    fresh = Painter(film, look.model_copy(update={"shadows": False})).picture(1)
    assert (painter.picture(1) == fresh).all()


def test_exposure_lights_things_up() -> None:
    dark, bright = (
        picture(cube(), background="studio", shadows=False, exposure=e)[45, 80] for e in (0.5, 1.0)
    )
    assert (bright > 1.2 * dark).all()


def test_steps_of_a_byte_are_dithered() -> None:
    camera = camera_array(np.array([0.0, 0.0, 9.0]), np.zeros(3), 160, 90, 0.3, True)
    stage, fog = np.zeros(layout.STAGE_SIZE, np.float32), np.array([0, 1, 0], np.float32)
    column = Backdrop(preset_of(("#404040", "#424242")), 160, 90).picture(camera, 0.0)[:, 80:81]
    background = np.ascontiguousarray(column.repeat(160, axis=1))
    shown = Canvas(160, 90, 1).draw(
        Geometry(np.zeros((1, 3), np.float32)), camera, Light(stage, fog), background
    )
    mixed = [len(np.unique(row)) == 2 for row in shown]
    assert np.mean(mixed) > 0.5
    assert all(np.ptp(row) <= 1 for row in shown)


def test_light_of_very_many_items_does_not_overflow() -> None:
    count = 1_000_000  # at 4096 steps a unit, red would pass 2^31
    here, one = np.zeros((count, 3), np.float32), np.ones(count, np.float32)
    glow = Blend(here, here, 0.4 * one, one, 0 * one, glow=1.0)
    camera = camera_array(np.array([0.0, 0.0, 9.0]), np.zeros(3), 32, 18, 0.3, True)
    flat = Light(np.zeros(layout.STAGE_SIZE, np.float32), np.array([0, 1, 0], np.float32))
    geometry = Geometry(np.ones((1, 3), np.float32), blends=(glow,))
    shown = Canvas(32, 18, 1).draw(geometry, camera, flat, np.zeros((18, 32, 3), np.float32))
    assert (shown[9, 16] > 250).all()
    assert (shown[0] == 0).all()
