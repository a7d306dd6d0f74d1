"""Water in pictures: what it mirrors, what it takes from the light, and what shows through it."""

import os
import subprocess
import sys

import numpy as np
import pytest
from pydantic import ValidationError
from view_scenes import Film, cube

from tianim.frame import Frame, Lines, Mesh
from tianim.lang import f32_1d, f32_2d, ti
from tianim.view import layout, liquid, liquid_light
from tianim.view.backdrop import preset_of
from tianim.view.camera import camera_array
from tianim.view.environment import COLUMNS, ROUGHNESS, ROWS, environment, mirrored_light
from tianim.view.look import Look
from tianim.view.material import KINDS, Material, substance
from tianim.view.painter import Painter

SMALL = {"width": 160, "height": 90}
SIDE = 64
WATER = {"material": "water"}
STRAIGHT = {"position": (0.0, 0.0, 12.0), "target": (0.0, 0.0, 0.0), "field_of_view": 16.0}
THICKNESS_TOLERANCE = 1e-4  # of a slab 1 m thick: float32 depths in steps of a millionth
SNELL_TOLERANCE = 2e-6  # float32
BEER_TOLERANCE = 1e-5  # float32 exponentials with fast maths


def look(**fields):
    return Look.model_validate({**SMALL, **fields})


def painter(*parts, **fields):
    return Painter(Film(1, lambda index, time: parts), look(**fields))


def picture(*parts, **fields):
    return painter(*parts, **fields).picture(0).astype(float)


def slab(depth, name="slab", middle=0.0):
    """A cuboid 2 m wide and high, `depth` thick along z."""
    block = cube(1.0, name=name)
    scale = np.array([2.0, 2.0, depth], np.float32)
    return Mesh(name, block.position * scale + np.array([0, 0, middle], np.float32), block.triangles)


@ti.kernel
def optics(out: f32_2d, cosine: f32_1d, row: f32_1d):
    """Share mirrored, and what is left of each colour after a way, by cosine or way."""
    for n in range(out.shape[0]):
        out[n, 0] = liquid_light.fresnel(cosine[n], row[liquid_light.REFRACTION])
        left = liquid_light.left_over(row, cosine[n])
        for c in ti.static(range(3)):
            out[n, 1 + c] = left[c]


@ti.kernel
def bend(out: f32_2d, ahead: f32_2d, ratio: ti.f32):
    """Rays behind a surface whose normal is +y."""
    for n in range(out.shape[0]):
        ray = ti.Vector([ahead[n, c] for c in ti.static(range(3))])
        bent = liquid_light.bent(ray, ti.Vector([0.0, 1.0, 0.0]), ratio)
        for c in ti.static(range(3)):
            out[n, c] = bent[c]


@ti.kernel
def look_up(out: f32_2d, mirror: ti.types.ndarray(), camera: f32_1d, direction: f32_2d, rough: ti.f32):
    """Light of the surroundings by direction."""
    for n in range(out.shape[0]):
        ahead = ti.Vector([direction[n, c] for c in ti.static(range(3))])
        light = mirrored_light(mirror, camera, ahead, rough)
        for c in ti.static(range(3)):
            out[n, c] = light[c]


def row_of(**fields):
    return substance(Material.model_validate(fields), 1.0)


def test_grazing_light_is_mirrored_and_head_on_light_hardly() -> None:
    cosine = np.linspace(0, 1, 50, dtype=np.float32)
    out = np.empty((50, 4), np.float32)
    optics(out, cosine, row_of(like="water", refraction=1.33).row)
    assert out[-1, 0] == pytest.approx((0.33 / 2.33) ** 2, rel=1e-4)
    assert out[0, 0] == pytest.approx(1.0, abs=1e-5)
    assert (np.diff(out[:, 0]) <= 0).all()


def test_light_is_lost_by_the_law_of_beer_and_lambert() -> None:
    made = row_of(like="water", tint="#80c0ff", absorption=2.0)
    way = np.array([0.0, 0.25, 0.5, 1.0], np.float32)
    out = np.empty((4, 4), np.float32)
    optics(out, way, made.row)
    np.testing.assert_allclose(out[:, 1:], np.exp(-made.sigma * way[:, None]), rtol=BEER_TOLERANCE)
    tint = np.array([0.2158605, 0.5271151, 1.0])  # linear light of 0x80, 0xc0, 0xff
    np.testing.assert_allclose(out[2, 1:], tint, rtol=1e-4)


def test_rays_bend_as_snell_says_and_are_mirrored_within() -> None:
    angles = np.radians([0, 20, 40, 60, 80])
    ahead = np.stack([np.sin(angles), -np.cos(angles), 0 * angles], axis=1).astype(np.float32)
    out = np.empty_like(ahead)
    bend(out, ahead, 1 / 1.33)
    np.testing.assert_allclose(out[:, 0], np.sin(angles) / 1.33, atol=SNELL_TOLERANCE)
    assert (out[:, 1] < 0).all()
    bend(out, ahead, 1.33)
    inside = np.sin(angles) * 1.33 < 1
    assert ((out[:, 1] < 0) == inside).all()
    np.testing.assert_allclose(out[~inside, 0], np.sin(angles[~inside]), atol=SNELL_TOLERANCE)


def thickness(*meshes, depth=layout.FAR, distance=6.0):
    """Thickness of meshes together, seen straight from +z."""
    view = camera_array(np.array([0.2, 0.1, distance]), np.array([0.2, 0.1, 0.0]), SIDE, SIDE, 1.5, False)
    first = np.cumsum([0, *(len(m.position) for m in meshes)])
    position = np.concatenate([m.position for m in meshes])
    triangles = np.concatenate([m.triangles + f for m, f in zip(meshes, first, strict=False)]).astype(
        np.int32
    )
    total = np.zeros((SIDE, SIDE), np.int64)
    behind = np.full((SIDE, SIDE), depth, np.float32)
    unit = distance / liquid.STEPS
    liquid.add_faces(total, view, behind, position, triangles, unit)
    front = np.zeros((SIDE, SIDE, liquid.FRONT), np.float32)
    front[..., 0] = total != 0
    front[..., 1] = 5.5
    out = np.empty((SIDE, SIDE), np.float32)
    liquid.find_thickness(out, total, front, behind, unit, 7.0)
    return out[SIDE // 2, SIDE // 2]


def test_thickness_is_that_of_all_layers_before_what_is_solid() -> None:
    assert thickness(slab(1.0)) == pytest.approx(1.0, abs=THICKNESS_TOLERANCE)
    both = (slab(0.5, middle=1.0), slab(0.25, middle=-1.0))
    assert thickness(*both) == pytest.approx(0.75, abs=THICKNESS_TOLERANCE)
    assert thickness(*both[::-1]) == thickness(*both)
    assert thickness(slab(1.0), depth=6.0) == pytest.approx(0.5, abs=THICKNESS_TOLERANCE)
    assert thickness(slab(1.0), depth=2.0) == 0.0


def test_an_open_surface_is_as_thick_as_the_way_to_what_lies_behind() -> None:
    whole = slab(1.0)
    front_only = Mesh(
        "sheet", whole.position, whole.triangles[(whole.position[whole.triangles, 2] > 0).all(1)]
    )
    assert thickness(front_only, depth=8.0) == pytest.approx(2.5, abs=THICKNESS_TOLERANCE)
    assert thickness(front_only) == 7.0


def test_thicker_water_is_darker_and_bluer() -> None:
    fields = {"background": ("#e8e8e8", "#e8e8e8"), "camera": STRAIGHT}
    style = {"slab": {"material": {"like": "water", "absorption": 1.5}}}
    thin, thick = (picture(slab(d), parts=style, **fields)[40:50, 75:85].mean((0, 1)) for d in (0.2, 1.5))
    assert thick.mean() < thin.mean() - 20
    assert thick[2] / thick[0] > 1.5 * thin[2] / thin[0]


@pytest.mark.parametrize(("like", "shows"), [("glass", True), ("water", True), ("lava", False)])
def test_what_is_behind_shows_through_what_is_clear(like, shows) -> None:
    behind, before = cube(0.5, (0, 0, -1.5), "mark"), slab(0.4)
    fields = {"background": "studio", "camera": STRAIGHT, "shadows": False, "floor": False}
    style = {"slab": {"material": like}, "mark": {"color": "#d01010"}}
    pane = picture(before, parts={"slab": style["slab"]}, **fields)
    marked = picture(before, behind, parts=style, **fields)
    difference = np.abs(marked - pane).max(axis=2)[42:48, 76:84]
    assert (difference.min() > 15) if shows else (difference.max() < 6)


def test_what_is_before_the_water_hides_it() -> None:
    ball = cube(0.5, (0, 0, 1.5), "mark")
    fields = {"background": "studio", "camera": STRAIGHT, "shadows": False, "fog": 0.0}
    style = {"slab": WATER, "mark": {"color": "#d01010"}}
    with_water, without = (
        picture(ball, part, parts={**style, **extra}, **fields)[42:48, 76:84]
        for part, extra in ((slab(0.4), {}), (slab(0.4), {"slab": {"kind": "hidden"}}))
    )
    np.testing.assert_array_equal(with_water, without)


def test_lines_and_points_before_and_behind_the_water_are_told_apart() -> None:
    ends = np.array([[-2, 0, 1], [2, 0, 1], [-2, 0.4, -1], [2, 0.4, -1]], np.float32)
    rods = Lines("rods", ends, np.array([[0, 1], [2, 3]], np.int32))
    murky = {"material": {"like": "water", "absorption": 6.0, "cloudiness": 0.8}}
    style = {"slab": murky, "rods": {"size": 0.06, "color": "#000000", "opacity": 0.95}}
    fields = {"background": ("#f0f0f0", "#f0f0f0"), "camera": STRAIGHT, "shadows": False}
    shown = picture(slab(0.4), rods, parts=style, **fields).mean(axis=2)[:, 80]
    bare = picture(slab(0.4), parts={"slab": style["slab"]}, **fields).mean(axis=2)[:, 80]
    change = bare - shown
    rows = np.nonzero(change > 40)[0]
    assert len(rows) > 0
    assert (np.abs(rows - 44.5) < 4).all()  # the one before is black, the one behind hardly shows


def test_two_draws_are_the_same_bytes() -> None:
    parts = (slab(0.5), cube(0.4, (0, 0, -1), "mark"))
    pictures = [picture(*parts, parts={"slab": WATER}, background="studio") for _ in range(2)]
    assert (pictures[0] == pictures[1]).all()


@pytest.mark.slow
def test_the_bytes_do_not_depend_on_the_number_of_threads() -> None:
    code = (
        "import hashlib\n"
        "from tianim import runtime; runtime.start(threads={})\n"
        "from test_view_water import WATER, cube, painter, slab\n"
        "parts = (slab(0.5), cube(0.4, (0, 0, -1), 'mark'))\n"
        "p = painter(*parts, parts={{'slab': WATER}}, background='studio')\n"
        "print(hashlib.sha256(p.picture(0)).hexdigest())"
    )
    path = os.pathsep.join([os.path.dirname(__file__), *filter(None, sys.path)])
    shown = [
        subprocess.run(
            [sys.executable, "-c", code.format(threads)],
            capture_output=True, env={**os.environ, "PYTHONPATH": path}, check=True,
        ).stdout
        for threads in (1, 2)
    ]  # fmt: skip
    assert shown[0] == shown[1]
    assert len(shown[0]) > 60


@pytest.mark.parametrize(
    "preset", ["dusk", "night", "space", "studio", "water", "paper", ("#102030", "#d0e0f0")]
)
def test_water_shows_on_every_background(preset) -> None:
    wet, bare = (
        picture(slab(0.5), parts={"slab": s}, background=preset) for s in (WATER, {"kind": "hidden"})
    )
    assert (np.abs(wet - bare).max(axis=2) > 6).mean() > 0.03


def test_the_shadow_of_water_is_brighter_than_that_of_stone_and_blue() -> None:
    camera = {"position": (1.8, 4.0, 4.6), "target": (0.4, 0.2, 0.0)}
    plate = cube(1.0, name="block")
    place = plate.position * np.array([1.0, 0.2, 1.0], np.float32) + np.array([0, 0.9, 0], np.float32)
    block = Mesh("block", place, plate.triangles)
    ground = cube(0.01, (0, 0.005, 0), "ground")
    fields = {"background": "studio", "camera": camera, "width": 320, "height": 180}
    bare = picture(block, ground, parts={"block": {"kind": "hidden"}}, **fields)
    stone = picture(block, ground, parts={"block": {"color": "#3060a0"}}, **fields)
    water = picture(block, ground, parts={"block": WATER}, **fields)
    only = picture(block, ground, parts={"block": {"color": "#3060a0"}}, **{**fields, "shadows": False})
    floor = (np.abs(only - bare).max(axis=2) < 8) & ((bare - stone).mean(axis=2) > 40)
    assert floor.sum() > 100
    assert water[floor].mean() > stone[floor].mean() + 10
    left = water[floor].mean(axis=0) / bare[floor].mean(axis=0)
    assert left[2] > left[0] + 0.03


def test_a_mirror_shows_the_sun_where_it_stands_and_blurs_it_when_rough() -> None:
    mirror = environment(preset_of("dusk"))
    assert mirror.shape == (len(ROUGHNESS) * ROWS, COLUMNS, 3)
    sun = np.array(preset_of("dusk").sun) / np.linalg.norm(preset_of("dusk").sun)
    camera = camera_array(np.array([3.0, 0.0, 0.0]), np.zeros(3), 160, 90, 0.3, True)
    # The camera stands at +x: its right is -z, the way to it +x.
    direction = np.array([[sun[2], sun[1], -sun[0]], [-sun[2], sun[1], sun[0]]], np.float32)
    out = [np.empty((2, 3), np.float32) for _ in ROUGHNESS]
    for light, rough in zip(out, ROUGHNESS, strict=True):
        look_up(light, mirror, camera, direction, rough)
    assert out[0][0].mean() > 5 * out[0][1].mean()
    brightness = [light[0].mean() for light in out]
    assert (np.diff(brightness) < 0).all()


@pytest.mark.parametrize(
    "wrong",
    [
        "oil",
        {"like": "steam"},
        {"tint": "blue"},
        {"absorption": 0.0},
        {"absorption": float("nan")},
        {"cloudiness": 1.5},
        {"refraction": 0.9},
        {"refraction": 3.5},
        {"roughness": -0.1},
        {"emission": -1.0},
        {"wetness": 1},
    ],
    ids=str,
)
def test_a_material_that_makes_no_sense_is_refused(wrong) -> None:
    with pytest.raises(ValidationError):
        look(parts={"slab": {"material": wrong}})


def test_materials_fill_in_what_is_left_out_and_keep_what_is_said() -> None:
    for name, kind in KINDS.items():
        made = row_of(like=name)
        assert (made.refraction, made.roughness, made.emission) == (
            kind.refraction, kind.roughness, kind.emission,
        )  # fmt: skip
    own = row_of(like="honey", refraction=1.2, roughness=0.0, emission=0.0, cloudiness=0.0)
    assert (own.refraction, own.roughness, own.emission, own.body.max()) == (1.2, 0.0, 0.0, 0.0)
    one, ten = (substance(Material(), radius).sigma * radius for radius in (1.0, 10.0))
    np.testing.assert_allclose(one, ten, rtol=1e-6)  # a model looks as the sea does
    for name, field in Material.model_fields.items():
        assert field.description, name


def test_a_window_that_knows_no_materials_gets_plain_meshes() -> None:
    made = painter(slab(0.5), parts={"slab": WATER})
    frame = Frame(0, 0.0, (slab(0.5),))
    assert len(made.draft.geometry(frame).liquids) == 1
    made.draft.matt = True
    plain = made.draft.geometry(frame)
    assert not plain.liquids
    assert len(plain.triangles.triangles) == 12
    assert plain.colors[int(plain.triangles.tone[0]), 2] > plain.colors[int(plain.triangles.tone[0]), 0]


def test_empty_and_broken_liquids_leave_the_background() -> None:
    nothing = Mesh("slab", np.zeros((0, 3), np.float32), np.zeros((0, 3), np.int32))
    broken = slab(0.5)
    broken.position[:] = np.nan
    fields = {"background": "studio", "camera": {"position": (0, 1, 5), "target": (0, 0, 0)}}
    bare = picture(nothing, parts={"slab": {"kind": "hidden"}}, **fields)
    assert (picture(nothing, parts={"slab": WATER}, **fields) == bare).all()
    assert np.abs(picture(broken, parts={"slab": WATER}, **fields) - bare).max() <= 1
