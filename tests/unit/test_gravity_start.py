"""The start as a whole: groups and places, barycentre, seeds, names, and wrong scenes in one line each."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from gravity_starts import start

from tianim.errors import SceneError
from tianim.scene import scene_from
from tianim.systems.gravity.start import Made

PLUMMER = {"kind": "plummer", "count": 50, "mass": 2.0}
DISK = {"kind": "exponential_disk", "count": 60, "mass": 1.0}
RING = {"kind": "ring", "count": 7, "radius": 2.0}
SUN = {"kind": "bodies", "bodies": [{"mass": 1.0}]}
# Sums of some 100 numbers of order 1.
ROUNDING = 1e-12


def of(made: Made, name: str) -> tuple[np.ndarray, np.ndarray]:
    mine = made.component == made.names.index(name)
    return made.position[mine], made.velocity[mine]


def test_components_follow_each_other_in_the_order_of_the_scene() -> None:
    made = start({"b": PLUMMER, "a": RING}, {"north": {"components": {"disk": DISK}}})
    assert made.names == ("b", "a", "north_disk")
    np.testing.assert_array_equal(made.component, np.repeat([0, 1, 2], [50, 7, 60]))
    assert made.component.dtype == np.int32
    assert made.position.shape == made.velocity.shape == (117, 3)
    np.testing.assert_allclose(made.mass, np.repeat([2.0 / 50, 0.0, 1.0 / 60], [50, 7, 60]))


def test_the_barycentre_rests_at_the_origin() -> None:
    bodies = {
        "kind": "bodies",
        "bodies": [{"mass": 3.0, "position": [1, 2, 3], "velocity": [0, 0, 1]}, {"mass": 1.0}],
    }
    made = start({"pair": bodies, "stars": PLUMMER})
    for vectors in (made.position, made.velocity):
        np.testing.assert_allclose(made.mass @ vectors, 0.0, atol=ROUNDING)
    # it is moved as a whole
    np.testing.assert_allclose(made.position[0] - made.position[1], (1.0, 2.0, 3.0))


@pytest.mark.parametrize("how", ["asked", "external", "massless"])
def test_the_barycentre_stays_where_it_must(how: str) -> None:
    body = {"massless": True} if how == "massless" else {"mass": 3.0}
    bodies = {"kind": "bodies", "bodies": [{**body, "position": [1, 2, 3]}]}
    external = ({"kind": "point", "mass": 1.0},) if how == "external" else ()
    made = start({"one": bodies}, external=external, recentre=how != "asked")
    np.testing.assert_array_equal(made.position, [(1.0, 2.0, 3.0)])


def test_a_galaxy_is_moved_and_turned_as_a_whole() -> None:
    place = {"position": [5, 0, 0], "velocity": [0, 2, 0], "rotation": [90, 0, 0]}
    plain = start({}, {"north": {"components": {"disk": DISK}}}, recentre=False)
    made = start({}, {"north": {"components": {"disk": DISK}, "place": place}}, recentre=False)
    # a quarter turn about x: (x, y, z) becomes (x, -z, y)
    turn = np.array([[1, 0, 0], [0, 0, 1], [0, -1, 0]])
    np.testing.assert_allclose(made.position, plain.position @ turn + (5, 0, 0), atol=ROUNDING)
    np.testing.assert_allclose(made.velocity, plain.velocity @ turn + (0, 2, 0), atol=ROUNDING)
    np.testing.assert_allclose(made.mass @ made.position / made.mass.sum(), (5, 0, 0), atol=ROUNDING)


def test_galaxies_do_not_feel_each_other_in_their_balance() -> None:
    alone = start({}, {"north": {"components": {"disk": DISK}}}, recentre=False)
    two = start(
        {},
        {
            "north": {"components": {"disk": DISK}},
            "south": {"components": {"sun": SUN}, "place": {"position": [9, 0, 0]}},
        },
        recentre=False,
    )
    np.testing.assert_array_equal(of(two, "north_disk")[1], alone.velocity)


def test_the_same_seed_gives_the_same_bytes_and_another_others() -> None:
    scene = {"stars": PLUMMER, "disk": DISK}
    first, again, other = (start(scene, seed=seed) for seed in (4, 4, 5))
    assert first.position.tobytes() == again.position.tobytes()
    assert first.velocity.tobytes() == again.velocity.tobytes()
    assert not np.isclose(first.position, other.position).any()


@pytest.mark.parametrize(
    "change",
    [{"tracers": {**PLUMMER, "count": 9}}, {"tracers": DISK}, {"new": RING}],
    ids=["count", "kind", "one more"],
)
def test_a_component_does_not_change_anothers_places(change: Mapping[str, Any]) -> None:
    before = {"tracers": PLUMMER, "stars": PLUMMER, "disk": DISK}
    first = start(before, recentre=False)
    second = start(
        {**change, **{name: one for name, one in before.items() if name not in change}}, recentre=False
    )
    for name in ("stars", "disk"):
        np.testing.assert_array_equal(of(first, name)[0], of(second, name)[0])


def test_equal_components_of_two_galaxies_differ() -> None:
    made = start(
        {}, {"north": {"components": {"disk": DISK}}, "south": {"components": {"disk": DISK}}}, recentre=False
    )
    assert not np.isclose(of(made, "north_disk")[0], of(made, "south_disk")[0]).any()


@pytest.mark.parametrize(
    ("external", "expected"),
    [
        ({"kind": "point", "mass": 3.0, "softening": 0.5}, 3.0 * 4.0 / 4.25**1.5),
        ({"kind": "logarithmic", "speed": 2.0, "core": 1.0}, 4.0 * 4.0 / 5.0),
        ({"kind": "miyamoto_nagai", "mass": 3.0, "scale_length": 1.0, "height": 0.5}, 3.0 * 4.0 / 6.25**1.5),
        (
            {"kind": "nfw", "mass": 3.0, "scale_radius": 4.0, "concentration": 5.0},
            3.0 * (np.log(1.5) - 1 / 3) / (np.log(6.0) - 5 / 6) / 2.0,
        ),
    ],
    ids=["point", "logarithmic", "miyamoto_nagai", "nfw"],
)
def test_an_external_potential_counts_for_the_balance(external: Mapping[str, Any], expected: float) -> None:
    made = start({"ring": RING}, external=(external,))
    np.testing.assert_allclose(np.sum(made.velocity**2, axis=1), expected, rtol=1e-12)
    # one that is elsewhere does not
    with pytest.raises(SceneError, match="nothing pulls on it"):
        start({"ring": RING}, external=({**external, "centre": (1, 0, 0)},))


@pytest.mark.parametrize("kind", ["ring", "plummer", "exponential_disk"])
def test_massless_stars_need_something_that_pulls(kind: str) -> None:
    component = {"kind": kind, "count": 5, **({} if kind == "ring" else {"massless": True})}
    with pytest.raises(SceneError, match=r"^component 'south_test': nothing pulls on it; [^\n]*$"):
        start({}, {"south": {"components": {"test": component}}})


def test_a_start_of_nothing_is_refused() -> None:
    with pytest.raises(SceneError, match="no components and no galaxies"):
        start()


def test_names_that_run_into_each_other_are_refused() -> None:
    with pytest.raises(SceneError, match="two components have one full name"):
        start({"north_disk": PLUMMER}, {"north": {"components": {"disk": DISK}}})


def test_two_galaxies_without_mass_have_no_orbit() -> None:
    dust = {"kind": "bodies", "bodies": [{"massless": True}]}
    orbit = {"around": "south", "pericentre": 1.0, "separation": 2.0}
    galaxies = {
        "south": {"components": {"dust": dust}},
        "north": {"components": {"dust": dust}, "orbit": orbit},
    }
    with pytest.raises(SceneError, match=r"^galaxies.north.orbit: neither it nor 'south' has a mass$"):
        start({}, galaxies)


def plummer(**more: Any) -> dict[str, Any]:
    return {"components": {"a": {**PLUMMER, **more}}}


def one(kind: str, **more: Any) -> dict[str, Any]:
    return {"components": {"a": {"kind": kind, **more}}}


def two(orbit: Mapping[str, Any], **more: Any) -> dict[str, Any]:
    group = {"components": {"a": PLUMMER}}
    whole = {"around": "south", "pericentre": 1.0, "separation": 3.0, **orbit}
    return {"galaxies": {"north": {**group, "orbit": whole, **more}, "south": group}}


NOT_POSITIVE = r"must be greater than 0 \(test particles that pull on nothing: massless: true\)"
BAD = {
    "mass zero": (plummer(mass=0), f"components.a: mass 0: {NOT_POSITIVE}"),
    "mass negative": (plummer(mass=-1), f"components.a: mass -1: {NOT_POSITIVE}"),
    "mass nan": (plummer(mass=float("nan")), "components.a.mass = nan: must be a finite number"),
    "no mass": (one("hernquist", count=5), "components.a: mass: must be given"),
    "mass of the massless": (plummer(massless=True), "mass 2: massless is true; leave one of the two out"),
    "no stars": (plummer(count=0), "count = 0: must be greater than or equal to 1"),
    "scale length": (plummer(scale_length=0), "scale_length = 0: must be greater than 0"),
    "truncation": (one("nfw", count=5, mass=1, truncation=-2), "truncation = -2: must be greater than 0"),
    "w0": (one("king", count=5, mass=1, w0=20), "w0 = 20: must be less than or equal to 12"),
    "virial ratio": (one("uniform_sphere", count=5, mass=1, virial_ratio=-1), "virial_ratio = -1"),
    "toomre_q": (one("exponential_disk", count=5, mass=1, toomre_q=-1), "toomre_q = -1"),
    "kind": (one("plumer", count=5), "unknown kind; did you mean 'plummer'"),
    "other kind's key": (plummer(w0=3), "unknown key 'w0' for kind 'plummer'"),
    "body": (one("bodies", bodies=[{"mass": 1}, {"mass": 0}]), f"a.bodies.1: mass 0: {NOT_POSITIVE}"),
    "no bodies": (one("bodies", bodies=[]), "bodies = .*: must hold at least 1 entry"),
    "place of a body": (one("bodies", bodies=[{"mass": 1, "position": [0, 0]}]), "bodies.0.position"),
    "orbit's mass": (
        one("orbits", central_mass=1, orbits=[{"mass": -1, "semi_major_axis": 1}]),
        "orbits.0: mass -1: must be greater than 0",
    ),
    "hyperbola": (
        one("orbits", central_mass=1, orbits=[{"mass": 1, "semi_major_axis": 1, "eccentricity": 1}]),
        "orbits.0.eccentricity = 1: must be less than or equal to 0.999999",
    ),
    "central mass": (one("belt", count=5, central_mass=0, semi_major_axis=[1, 2]), "central_mass = 0"),
    "belt's limits": (
        one("belt", count=5, central_mass=1, semi_major_axis=[3, 2]),
        "semi_major_axis: the first must not exceed the second: 3 > 2",
    ),
    "more rings than stars": (
        one("rings", count=3, radii=[1, 2]),
        "count 3: must be at least the number of rings, 5",
    ),
    "rings' radii": (one("rings", count=30, radii=[0, 2]), "radii.0 = 0: must be greater than 0"),
    "no file": (one("file", path="nowhere.hdf5"), "no such file: .*nowhere.hdf5"),
    "partner": (two({"around": "east"}), "galaxies.north.orbit.around: no galaxy 'east'; there are south"),
    "circle": (two({"around": "north"}), "north goes round north; one must have a place"),
    "separation": (two({"separation": 0.5}), "separation 0.5: must be at least the pericentre, 1"),
    "apocentre": (two({"eccentricity": 0.2}), "an orbit of eccentricity 0.2 reaches 1.5 at most"),
    "pericentre": (two({"pericentre": 0}), "pericentre = 0: must be greater than 0"),
    "place and orbit": (two({}, place={}), "place and orbit: a galaxy has one of the two"),
    "inclination": (two({}, inclination=500), "inclination = 500: must be less than or equal to 180"),
    "empty galaxy": (
        {"galaxies": {"north": {"components": {}}}},
        "components = {}: must hold at least 1 entry",
    ),
}


@pytest.mark.parametrize("name", BAD)
def test_a_wrong_scene_is_one_line(name: str) -> None:
    fields, message = BAD[name]
    with pytest.raises(SceneError, match=message) as caught:
        scene_from({"tianim": 1, "systems": {"stars": {"kind": "gravity", **fields}}})
    assert "\n" not in str(caught.value)


def test_a_bad_snapshot_is_found_when_the_scene_is_read(tmp_path: Path) -> None:
    np.savez(tmp_path / "stars.npz", position=np.zeros((3, 3)), mass=np.ones(3))
    with pytest.raises(
        SceneError, match=r"components.a: .*stars\.npz: holds no array called velocity"
    ) as caught:
        scene_from(
            {"tianim": 1, "systems": {"stars": {"kind": "gravity", **one("file", path="stars.npz")}}},
            tmp_path,
        )
    assert "\n" not in str(caught.value)


def test_the_example_of_the_issue_is_in_order() -> None:
    """Every kind, as a scene file has it."""
    scene: dict[str, Any] = {
        "components": {
            "sun": SUN,
            "planets": {
                "kind": "orbits",
                "central_mass": 1.0,
                "orbits": [{"mass": 1e-3, "semi_major_axis": 5.2}],
            },
            "belt": {"kind": "belt", "count": 10, "central_mass": 1.0, "semi_major_axis": [2.1, 3.3]},
        },
        "galaxies": {
            "north": {
                "components": {
                    "disk": {**DISK, "toomre_q": 1.5},
                    "bulge": {"kind": "hernquist", "count": 20, "mass": 0.2, "scale_length": 0.2},
                    "halo": {
                        "kind": "nfw",
                        "count": 20,
                        "mass": 9.0,
                        "scale_length": 5.0,
                        "truncation": 50.0,
                    },
                    "rings": {"kind": "rings", "count": 40, "radii": [1.0, 3.0]},
                },
                "inclination": 60,
                "argument": -30,
                "orbit": {"around": "south", "pericentre": 2.0, "eccentricity": 0.5, "separation": 5.0},
            },
            "south": {
                "components": {
                    "cluster": {"kind": "king", "count": 30, "mass": 1.0},
                    "cloud": {"kind": "uniform_sphere", "count": 5, "mass": 0.1},
                }
            },
        },
    }
    scene_from({"tianim": 1, "systems": {"stars": {"kind": "gravity", **scene}}})
    made = start(scene["components"], scene["galaxies"])
    assert np.isfinite(made.position).all()
    assert np.isfinite(made.velocity).all()
    assert len(made.mass) == 1 + 1 + 10 + 60 + 20 + 20 + 40 + 30 + 5
