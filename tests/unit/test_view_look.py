"""The look: what it takes, what it refuses, and what the styles make of it."""

import numpy as np
import pytest
from pydantic import ValidationError
from view_scenes import Film, cube, flock, strand

from tianim.frame import Frame, Points
from tianim.view.backdrop import PRESETS
from tianim.view.colormap import ENTRIES, table, to_linear, to_srgb
from tianim.view.look import ColorBy, Look, PartStyle
from tianim.view.shapes import FAR_SHAPES, NEAR_SHAPES, SHAPES, forward_of, heading_quaternion
from tianim.view.styles import ROWS, Styles
from tianim.view.survey import survey
from tianim.view.values import values_of


def styles(frames, preset="night", pixel=0.01, **fields):
    return Styles(Look.model_validate(fields), PRESETS[preset], survey(frames), pixel)


def style_of(part, **fields):
    return styles([Frame(0, 0.0, (part,))], **fields).of(part)


def points(count=50, **data):
    return Points("boids", flock(count)(0, 0.0)[0].position, data)


def test_every_field_is_described() -> None:
    for model in (Look, PartStyle, ColorBy, type(Look().camera)):
        for name, field in model.model_fields.items():
            assert field.description, f"{model.__name__}.{name}"


def test_a_look_survives_a_round_trip_through_json() -> None:
    look = Look.model_validate(
        {
            "background": ["#000000", "#ffffff"],
            "parts": {"a": {"color": "speed", "trail": 3}},
            "camera": {"orbit": 5.0},
        }
    )
    assert Look.model_validate_json(look.model_dump_json()) == look


def test_a_colour_may_be_said_in_one_word() -> None:
    assert PartStyle.model_validate({"color": "#336699"}).color.by == "#336699"
    assert PartStyle.model_validate({"color": "speed"}).color.by == "speed"


@pytest.mark.parametrize(
    "wrong",
    [
        {"width": 1281},
        {"height": 8},
        {"samples": 4},
        {"background": "dawn"},
        {"background": ["#000000"]},
        {"background": ["#00000g", "#ffffff"]},
        {"exposure": 0.0},
        {"fog": 1.5},
        {"sheet": 0},
        {"film_frames": 0},
        {"renderer": "vulkan"},
        {"camera": {"field_of_view": 180.0}},
        {"camera": {"elevation": 90.0}},
        {"camera": {"position": [0.0, 0.0, 0.0], "target": [0.0, 0.0, 0.0]}},
        {"camera": {"position": [0.0, float("nan"), 0.0]}},
        {"parts": {"a": {"kind": "cubes"}}},
        {"parts": {"a": {"size": 0.0}}},
        {"parts": {"a": {"opacity": 0.0}}},
        {"parts": {"a": {"trail": -1}}},
        {"parts": {"a": {"color": "#12345"}}},
        {"parts": {"a": {"color": {"by": "speed", "map": "jet"}}}},
        {"parts": {"a": {"color": {"by": "speed", "range": [2.0, 1.0]}}}},
        {"parts": {"a": {"color": {"by": "kind", "palette": []}}}},
        {"unknown": 1},
    ],
    ids=str,
)
def test_what_makes_no_picture_is_refused(wrong) -> None:
    with pytest.raises(ValidationError):
        Look.model_validate(wrong)


@pytest.mark.parametrize(
    ("data", "flat", "preset", "kind"),
    [
        ({"velocity": True}, None, "dusk", "birds"),
        ({"velocity": True}, None, "water", "fish"),
        ({"velocity": True}, None, "night", "darts"),
        ({"velocity": True}, 2, "paper", "arrows"),
        ({}, None, "dusk", "spheres"),
    ],
)
def test_points_are_drawn_as_what_suits_them(data, flat, preset, kind) -> None:
    part = flock(30, flat=flat)(0, 0.0)[0]
    part = Points("boids", part.position, part.data if data else {})
    assert style_of(part, preset=preset).kind == kind


def test_a_rare_part_is_drawn_larger_and_in_another_colour() -> None:
    flock_part = flock(500)(0, 0.0)[0]
    hunter = Points("hunter", flock_part.position[:2], {"velocity": flock_part.data["velocity"][:2]})
    found = styles([Frame(0, 0.0, (hunter, flock_part))], preset="dusk")
    common, rare = found.of(flock_part), found.of(hunter)
    assert rare.size == pytest.approx(3 * common.size)
    assert (found.colors[rare.first_row] != found.colors[common.first_row]).any()


def test_sizes_follow_the_spacing_within_limits() -> None:
    sizes = {}
    for scale in (1e-4, 1.0, 1e4):
        part = flock(200)(0, 0.0)[0]
        sizes[scale] = style_of(Points("boids", part.position * np.float32(scale), part.data)).size
    assert sizes[1e-4] == pytest.approx(0.055)  # 5.5 pixels of 0.01 m
    assert sizes[1e4] == pytest.approx(0.44)
    assert sizes[1e-4] < sizes[1.0] < sizes[1e4]


def test_the_range_is_fixed_over_the_whole_film() -> None:
    def make(index, time):
        return (points(100, heat=np.full(100, float(index), np.float32)),)

    style = styles(Film(101, make), parts={"boids": {"color": "heat"}}).of(make(0, 0.0)[0])
    assert style.low == pytest.approx(2, abs=2)
    assert style.high == pytest.approx(98, abs=2)


def test_a_constant_is_one_colour_not_noise() -> None:
    heat = np.full(50, 7.0, np.float32) + np.random.default_rng(0).normal(size=50).astype(np.float32) * 1e-6
    part = points(heat=heat)
    found = styles([Frame(0, 0.0, (part,))], parts={"boids": {"color": "heat"}})
    tones = found.tones(part, found.of(part))
    assert np.ptp(tones) < 2
    assert tones.mean() == pytest.approx(ENTRIES / 2, abs=4)


def test_a_logarithm_spreads_decades_evenly() -> None:
    part = points(3, heat=np.array([1, 10, 100], np.float32))
    color = {"by": "heat", "range": [1.0, 100.0], "log": True}
    found = styles([Frame(0, 0.0, (part,))], parts={"boids": {"color": color}})
    tones = found.tones(part, found.of(part))
    assert tones[1] - tones[0] == pytest.approx(tones[2] - tones[1], abs=1e-3)


def test_a_palette_gives_each_whole_number_its_colour() -> None:
    part = points(4, kind=np.array([0, 1, 2, 3], np.int32))
    color = {"by": "kind", "palette": ["#ff0000", "#00ff00", "#0000ff"]}
    found = styles([Frame(0, 0.0, (part,))], parts={"boids": {"color": color}})
    rows = found.tones(part, found.of(part)).astype(int)
    np.testing.assert_allclose(found.colors[rows], [[1, 0, 0], [0, 1, 0], [0, 0, 1], [1, 0, 0]], atol=1e-6)


def test_every_part_has_its_own_rows_of_colours() -> None:
    parts = (flock(20)(0, 0.0)[0], cube(), strand())
    found = styles([Frame(0, 0.0, parts)])
    assert len(found.colors) == 3 * ROWS
    assert sorted(found.of(part).first_row for part in parts) == [0, ROWS, 2 * ROWS]


def test_values_not_finite_have_a_colour() -> None:
    part = points(4, heat=np.array([np.nan, np.inf, -np.inf, 1], np.float32))
    found = styles([Frame(0, 0.0, (part,))], parts={"boids": {"color": "heat"}})
    tones = found.tones(part, found.of(part))
    assert ((tones >= 0) & (tones < ENTRIES)).all()


def test_headings_go_round_the_compass() -> None:
    velocity = np.array([[1, 0, 0], [0, 1, 0], [-1, 0, 0], [0, -1, 0]], np.float32)
    part = points(4, velocity=velocity)
    np.testing.assert_allclose(values_of(part, "heading", flat=2), [0, 0.25, 0.5, 0.75], atol=1e-6)


@pytest.mark.parametrize("name", ["viridis", "magma", "inferno", "plasma", "cividis", "twilight", "turbo"])
def test_colour_maps_are_those_of_matplotlib(name) -> None:
    import matplotlib

    ours = 255 * to_srgb(table(name))
    theirs = 255 * matplotlib.colormaps[name](np.linspace(0, 1, ENTRIES))[:, :3]
    assert np.abs(ours - theirs).max() < 7  # steps of 255: ours are straight lines between 17 to 25 colours


def test_cyclic_maps_close_and_phase_is_even_in_lightness() -> None:
    for name in ("phase", "twilight"):
        colors = to_srgb(table(name))
        assert np.abs(colors[0] - colors[-1]).max() < 0.05
    luminance = table("phase") @ np.array([0.2126, 0.7152, 0.0722])
    assert luminance.max() / luminance.min() < 1.5


def test_encoding_and_decoding_are_inverse() -> None:
    values = np.linspace(0, 1, 256, dtype=np.float32)
    np.testing.assert_allclose(to_srgb(to_linear(values)), values, atol=1e-5)


def test_quaternions_turn_the_nose_to_the_heading() -> None:
    forward = np.random.default_rng(0).normal(size=(200, 3)).astype(np.float32)
    forward[0], forward[1], forward[2] = (0, 1, 0), (0, 0, 0), (0, 0, -1)
    turn = heading_quaternion(forward)
    np.testing.assert_allclose(np.linalg.norm(turn, axis=1), 1, atol=1e-5)
    nose = forward_of(turn)
    expected = forward / np.maximum(np.linalg.norm(forward, axis=1, keepdims=True), 1e-12)
    expected[1] = (0, 0, 1)
    np.testing.assert_allclose(nose, expected, atol=2e-5)


@pytest.mark.parametrize("shape", [*SHAPES.values(), *FAR_SHAPES.values(), *NEAR_SHAPES.values()])
def test_shapes_are_one_unit_long_and_symmetric(shape) -> None:
    assert np.ptp(shape.vertices[:, 2]) == pytest.approx(1.0, abs=0.06)
    assert shape.triangles.max() < len(shape.vertices)
    assert shape.vertices[:, 0].max() == pytest.approx(-shape.vertices[:, 0].min(), abs=1e-6)
    assert (shape.tint > 0).all()
