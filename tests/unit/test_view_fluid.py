"""Fluids in pictures: particles that read as a body, torn water, foam, the tank and the floor."""

import numpy as np
import pytest
from view_scenes import Film, cube

from tianim.errors import SceneError
from tianim.frame import Frame, Points
from tianim.view import layout
from tianim.view.colormap import table
from tianim.view.look import Look
from tianim.view.painter import Painter, check_look
from tianim.view.tank import TANK, add_edges, laid_on_walls, tank_of, with_tank
from tianim.view.wet import torn

SMALL = {"width": 160, "height": 90}


def look(**fields):
    return Look.model_validate({**SMALL, **fields})


def painter(*parts, **fields):
    return Painter(Film(1, lambda index, time: parts), look(**fields))


def picture(*parts, **fields):
    return painter(*parts, **fields).picture(0).astype(float)


def fluid(position, spacing=0.1, **data):
    return Points("water", np.asarray(position, np.float32), data, spacing=spacing)


def lattice(n=8, spacing=0.1):
    axis = (np.arange(n) + 0.5) * spacing
    return np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), axis=-1).reshape(-1, 3).astype(np.float32)


def test_only_a_mesh_has_a_material() -> None:
    frame = Frame(0, 0.0, (fluid(lattice(2)),))
    with pytest.raises(SceneError, match=r"view\.parts\.water\.material: .*no mesh"):
        check_look(frame, look(parts={"water": {"material": "water"}}))


def test_particles_of_a_fluid_are_balls_that_close_up_coloured_by_speed() -> None:
    velocity = np.zeros((512, 3), np.float32)
    velocity[:, 0] = np.linspace(0, 2, 512)
    part = fluid(lattice(), velocity=velocity)
    made = painter(part)
    assert made.background == "studio"
    style = made.draft._styles.of(part)
    assert style.kind == "spheres"
    assert 1.1 < style.size / 0.1 < 1.3
    tone = made.draft._styles.tones(part, style)
    assert tone[0] < 5
    assert tone[-1] > 250


def test_a_flat_fluid_has_no_gaps_and_a_dark_ground_for_its_white() -> None:
    part = fluid(lattice(10) * np.array([1, 1, 0], np.float32), velocity=np.zeros((1000, 3), np.float32))
    made = painter(part)
    assert made.background == "night"
    shown = made.picture(0).astype(float)
    bare = picture(part, parts={"water": {"kind": "hidden"}}, background="night")
    rows = np.nonzero((np.abs(shown - bare).max(axis=2) > 6).sum(axis=1) > 20)[0]
    middle = shown[rows[5] : rows[-5], 70:90, 2]
    assert middle.min() > 0.4 * middle.mean()


def test_torn_water_is_white_and_what_has_no_density_yet_is_not() -> None:
    density = np.array([1.0, 0.7, 0.35, 0.0], np.float32)
    part = fluid(lattice(2)[:4], velocity=np.zeros((4, 3), np.float32), density=density)
    share = torn(part)
    assert share is not None
    np.testing.assert_allclose(share, [0, 0, 1, 0])
    style = painter(part).draft._styles
    tone = style.tones(part, style.of(part))
    assert tone[2] == pytest.approx(255.5)
    assert tone[0] == tone[1] == tone[3]
    assert torn(Points("boids", lattice(2), {"density": np.zeros(8, np.float32)})) is None


def test_the_map_of_water_climbs_evenly_from_deep_blue_to_white() -> None:
    colors = table("water").astype(float)
    cone = np.cbrt(
        colors @ np.array([[0.4122, 0.2119, 0.0883], [0.5363, 0.6807, 0.2817], [0.0514, 0.1074, 0.6300]])
    )
    lightness = cone @ np.array([0.2105, 0.7936, -0.0041])
    steps = np.diff(lightness)
    assert steps.min() > 0
    assert steps.max() < 1.5 * np.median(steps)
    assert colors[0, 2] > 3 * colors[0, 0]
    assert colors[-1].min() > 0.9


def test_foam_is_small_soft_and_white() -> None:
    place = np.array([[0.4, 1.2, 0.4]], np.float32)
    data = {"kind": np.zeros(1, np.int32), "age": np.zeros(1, np.float32)}
    foam = Points("water_foam", place, data)
    made = painter(fluid(lattice()), foam)
    style = made.draft._styles.of(foam)
    assert style.kind == "foam"
    assert style.size < 0.05
    assert style.opacity < 1
    np.testing.assert_array_equal(made.draft.colors[style.first_row], 1.0)


BOX = {"kind": "contained", "lower": (0.0, 0.0, 0.0), "upper": (2.0, 1.5, 1.0)}


def test_contained_bounds_of_a_fluid_are_a_tank_and_others_are_not() -> None:
    frame = Frame(0, 0.0, (fluid(lattice()),))
    edges = tank_of(frame, BOX)
    assert edges is not None
    assert len(edges.segments) == 12
    np.testing.assert_allclose(np.ptp(edges.position, axis=0), [2, 1.5, 1])
    assert np.isclose(np.ptp(edges.position[edges.segments], axis=1), 0).sum() == 24  # along one axis each
    assert tank_of(frame, {"kind": "open", "lower": None, "upper": None}) is None
    assert tank_of(Frame(0, 0.0, (Points("boids", lattice()),)), BOX) is None
    assert add_edges(frame, None) is frame
    flat = lattice() * np.array([1, 1, 0], np.float32)
    plane = tank_of(Frame(0, 0.0, (fluid(flat),)), BOX)
    assert plane is not None
    assert len(plane.segments) == 4
    assert np.ptp(plane.position[:, 2]) == 0
    assert np.isclose(np.ptp(plane.position[plane.segments], axis=1), 0).sum() == 8


def test_the_camera_keeps_the_whole_tank_and_stands_still() -> None:
    def make(index, time):
        return (fluid(lattice() + np.array([0.1 * index, 0, 0], np.float32)),)

    film = with_tank(Film(6, make), BOX)
    assert len(film) == 6
    made = Painter(film, look(camera={"orbit": 0}))
    views = [made.path.at(k, k / 30) for k in (0, 5)]
    np.testing.assert_allclose(views[0].camera, views[1].camera, atol=1e-5)
    camera = views[0].camera.astype(float)
    corners = film[0].part(TANK).position - camera[:3]
    right, up, ahead = (corners @ camera[k : k + 3] for k in (3, 6, 9))
    column = camera[layout.FOCAL] * right / ahead / 80
    row = camera[layout.FOCAL] * up / ahead / 45
    assert np.abs(column).max() < 0.95
    assert 0.6 < np.abs(row).max() < 0.95


def test_a_surface_meets_the_walls_of_its_tank() -> None:
    frame = Frame(0, 0.0, (fluid(lattice(), spacing=0.05),))
    framed = add_edges(frame, tank_of(frame, BOX))
    surface = np.array([[0.02, 0.7, 0.5], [1.99, 0.01, 0.5], [1.0, 0.7, 0.5], [0.1, 0.7, 0.5]], np.float32)
    fitted = laid_on_walls(surface, framed)
    np.testing.assert_allclose(fitted[:2], [[0, 0.7, 0.5], [2, 0, 0.5]], atol=1e-6)
    np.testing.assert_array_equal(fitted[2:], surface[2:])
    assert laid_on_walls(surface, frame) is surface


def test_a_floor_can_be_asked_for_and_lies_under_a_fluid_in_the_dark() -> None:
    part = fluid(lattice())
    lit, dark = (picture(part, background="night", floor=f) for f in (None, False))
    assert lit[80:].mean() > dark[80:].mean() + 10
    np.testing.assert_array_equal(lit, picture(part, background="night", floor=True))
    bare = cube()
    assert (picture(bare, background="night") == picture(bare, background="night", floor=False)).all()
