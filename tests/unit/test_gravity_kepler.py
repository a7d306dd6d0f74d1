"""Kepler orbits: elements there and back, the axes, belts, and two galaxies on their orbit."""

import numpy as np
import pytest
from gravity_starts import Floats, assert_distributed, start
from scipy import integrate
from scipy.spatial.transform import Rotation

from tianim.systems.gravity import kepler
from tianim.systems.gravity.kepler import Elements

# Rounding of a round trip through some twenty operations, with eccentricities up to 0.95.
ROUND_TRIP = 1e-12
# The integrator's tolerance, after up to two passages.
PATH = 1e-8


def some_elements(count: int, least: float = 0.01, most: float = 0.95) -> Elements:
    rng = np.random.default_rng(8)
    angles = 2.0 * np.pi * rng.random((3, count))
    return Elements(
        rng.uniform(0.1, 30.0, count),
        rng.uniform(least, most, count),
        np.pi * rng.uniform(0.01, 0.99, count),
        *angles,
    )


def test_elements_there_and_back() -> None:
    elements = some_elements(1000)
    back = kepler.elements_of(*kepler.state(elements, 3.0), 3.0)
    np.testing.assert_allclose(back.semi_major_axis, elements.semi_major_axis, rtol=ROUND_TRIP)
    np.testing.assert_allclose(back.eccentricity, elements.eccentricity, atol=ROUND_TRIP)
    np.testing.assert_allclose(back.inclination, elements.inclination, atol=ROUND_TRIP)
    for name in ("node", "argument", "anomaly"):
        turn = getattr(back, name) - getattr(elements, name)
        # the phase of an orbit of e = 0.01 or i = 0.01 is known 100 times less well than the place
        np.testing.assert_allclose(np.sin(0.5 * turn), 0.0, atol=100.0 * ROUND_TRIP, err_msg=name)


@pytest.mark.parametrize("inclination", [0.0, 1.0])
def test_circles_and_flat_orbits_come_back_to_the_same_place(inclination: float) -> None:
    elements = some_elements(50)._replace(eccentricity=np.zeros(50), inclination=np.full(50, inclination))
    position, velocity = kepler.state(elements, 2.0)
    again = kepler.state(kepler.elements_of(position, velocity, 2.0), 2.0)
    np.testing.assert_allclose(again[0], position, rtol=ROUND_TRIP, atol=30.0 * ROUND_TRIP)
    np.testing.assert_allclose(again[1], velocity, rtol=ROUND_TRIP, atol=30.0 * ROUND_TRIP)


def test_keplers_equation_is_solved_to_rounding() -> None:
    mean, e = np.meshgrid(np.linspace(-20.0, 20.0, 401), [0.0, 0.1, 0.7, 0.99, 0.999999])
    solved = kepler.eccentric_anomaly(mean, e)
    np.testing.assert_allclose(solved - e * np.sin(solved), mean, atol=1e-14, rtol=1e-14)


def test_an_orbit_without_inclination_turns_along_y() -> None:
    made = start(
        {
            "planets": {
                "kind": "orbits",
                "central_mass": 1.0,
                "orbits": [{"massless": True, "semi_major_axis": 2.0}],
            }
        },
        recentre=False,
    )
    np.testing.assert_allclose(made.position[0], (2.0, 0.0, 0.0), atol=1e-15)
    np.testing.assert_allclose(
        np.cross(made.position, made.velocity)[0], (0.0, np.sqrt(2.0), 0.0), atol=1e-15
    )


def test_an_orbit_rises_at_its_node() -> None:
    planet = {"mass": 0.5, "semi_major_axis": 1.0, "inclination": 90.0, "node": 90.0}
    made = start(
        {"planets": {"kind": "orbits", "central_mass": 3.5, "orbits": [planet]}}, G=2.0, recentre=False
    )
    # longitude 90 degrees is -Z; the speed is that of both masses
    np.testing.assert_allclose(made.position[0], (0.0, 0.0, -1.0), atol=1e-15)
    np.testing.assert_allclose(made.velocity[0], (0.0, np.sqrt(8.0), 0.0), atol=1e-15)


def test_a_period_leads_back() -> None:
    elements = some_elements(1, 0.5, 0.5)
    position, velocity = kepler.state(elements, 2.0)
    period = float(2.0 * np.pi * np.sqrt(elements.semi_major_axis[0] ** 3 / 2.0))
    end = relative_path(position[0], velocity[0], 2.0, period).y[:, -1]
    np.testing.assert_allclose(end[:3], position[0], atol=1e-6 * elements.semi_major_axis[0])


def relative_path(x: Floats, v: Floats, mu: float, time: float) -> integrate._ivp.ivp.OdeResult:
    def slope(t: float, y: Floats) -> Floats:
        return np.concatenate([y[3:], -mu * y[:3] / np.linalg.norm(y[:3]) ** 3])

    def nearest(t: float, y: Floats) -> float:
        return float(y[:3] @ y[3:])

    nearest.direction = 1.0  # type: ignore[attr-defined]
    return integrate.solve_ivp(
        slope, (0.0, time), np.concatenate([x, v]), "DOP853", events=nearest, rtol=1e-12, atol=1e-12
    )


def test_a_belt_fills_its_limits() -> None:
    belt = {
        "kind": "belt", "count": 20_000, "central_mass": 4.0, "semi_major_axis": [2.0, 3.0],
        "eccentricity": [0.1, 0.3], "inclination": [5.0, 20.0],
    }  # fmt: skip
    made = start({"belt": belt}, G=0.5, recentre=False)
    assert (made.mass == 0.0).all()
    found = kepler.elements_of(made.position, made.velocity, 2.0)
    for values, low, high in (
        (found.semi_major_axis, 2.0, 3.0),
        (found.eccentricity, 0.1, 0.3),
        (np.degrees(found.inclination), 5.0, 20.0),
        (found.node, 0.0, 2.0 * np.pi),
        (found.argument, 0.0, 2.0 * np.pi),
        (found.anomaly, 0.0, 2.0 * np.pi),
    ):
        assert_distributed(values, lambda x, low=low, high=high: (x - low) / (high - low))  # type: ignore[misc]


def point(mass: float) -> dict[str, object]:
    return {"middle": {"kind": "bodies", "bodies": [{"mass": mass}]}}


@pytest.mark.parametrize(("eccentricity", "separation"), [(0.0, 2.0), (0.5, 5.0), (1.0, 20.0), (3.0, 20.0)])
def test_two_galaxies_reach_the_pericentre_asked_for(eccentricity: float, separation: float) -> None:
    orbit = {
        "around": "south", "pericentre": 2.0, "eccentricity": eccentricity, "separation": separation,
        "inclination": 30.0, "node": 200.0, "argument": 70.0,
    }  # fmt: skip
    made = start(
        {}, {"south": {"components": point(3.0)}, "north": {"components": point(1.0), "orbit": orbit}}, G=2.0
    )
    assert made.names == ("south_middle", "north_middle")
    apart, relative = made.position[1] - made.position[0], made.velocity[1] - made.velocity[0]
    assert np.linalg.norm(apart) == pytest.approx(separation, rel=1e-12)
    np.testing.assert_allclose(made.mass @ made.position, 0.0, atol=1e-12)
    np.testing.assert_allclose(made.mass @ made.velocity, 0.0, atol=1e-12)
    # energy and angular momentum of the orbit
    mu, h = 8.0, np.cross(apart, relative)
    assert h @ h == pytest.approx(mu * 2.0 * (1.0 + eccentricity), rel=1e-12)
    energy = 0.5 * relative @ relative - mu / separation
    assert energy == pytest.approx(-0.5 * mu * (1.0 - eccentricity) / 2.0, abs=1e-12)
    normal = h / np.linalg.norm(h)
    assert normal[1] == pytest.approx(np.cos(np.radians(30.0)), rel=1e-12)
    if eccentricity > 0.0:
        assert apart @ relative < 0.0  # they near each other
        found = relative_path(apart, relative, mu, 40.0)
        nearest = found.y_events[0][0][:3]
        assert np.linalg.norm(nearest) == pytest.approx(2.0, rel=PATH)
        expected = Rotation.from_euler("YXY", [200.0, 30.0, 70.0], degrees=True).apply([2.0, 0.0, 0.0])
        np.testing.assert_allclose(nearest, expected, atol=PATH)


DISK = {"kind": "exponential_disk", "count": 4000, "mass": 1.0, "toomre_q": 0.0, "height": 0.0}


@pytest.mark.parametrize(
    ("inclination", "argument"), [(0.0, 0.0), (60.0, -30.0), (15.0, 270.0), (-70.0, -15.0)]
)
@pytest.mark.parametrize("galaxy", ["north", "south"])
def test_disks_lie_as_toomre_and_toomre_have_them(galaxy: str, inclination: float, argument: float) -> None:
    if argument == 270.0:
        argument = -90.0
    orbit = {
        "around": "south", "pericentre": 2.0, "eccentricity": 0.6, "separation": 6.0,
        "inclination": 40.0, "node": 10.0, "argument": 100.0,
    }  # fmt: skip
    galaxies: dict[str, dict[str, object]] = {
        "south": {"components": {"disk": DISK}},
        "north": {"components": {"disk": DISK}, "orbit": orbit},
    }
    galaxies[galaxy] |= {"inclination": inclination, "argument": argument}
    made = start({}, galaxies)
    states = {}
    for index, name in enumerate(("south", "north")):
        mine = made.component == index
        states[name] = (made.position[mine], made.velocity[mine], made.mass[mine])
    centre = {name: (m @ x / m.sum(), m @ v / m.sum()) for name, (x, v, m) in states.items()}
    x, v, m = states[galaxy]
    spin = m @ np.cross(x - centre[galaxy][0], v - centre[galaxy][1])
    other = "south" if galaxy == "north" else "north"
    apart, relative = centre[other][0] - centre[galaxy][0], centre[other][1] - centre[galaxy][1]
    # the orbit of the companion as seen by one who takes the disk for the plane of reference
    upright = Rotation.align_vectors([[0.0, 1.0, 0.0]], [spin])[0]
    seen = kepler.elements_of(upright.apply(apart)[None], upright.apply(relative)[None], 2.0)
    assert np.degrees(seen.inclination[0]) == pytest.approx(abs(inclination), abs=1e-5)
    if inclination:
        # a negative inclination is a positive one whose line of nodes is turned round
        expected = argument if inclination > 0.0 else argument + 180.0
        turn = seen.argument[0] - np.radians(expected)
        assert np.sin(0.5 * turn) == pytest.approx(0.0, abs=1e-6)


@pytest.mark.parametrize(("eccentricity", "separation"), [(0.5, 6.0), (1.0, 20.0)])
def test_a_start_that_is_left_out(eccentricity: float, separation: float) -> None:
    orbit = {"around": "south", "pericentre": 2.0, "eccentricity": eccentricity}
    galaxies = {"south": {"components": point(1.0)}, "north": {"components": point(1.0), "orbit": orbit}}
    made = start({}, galaxies)
    assert np.linalg.norm(made.position[1] - made.position[0]) == pytest.approx(separation, rel=1e-12)


def test_prograde_and_retrograde() -> None:
    for inclination, sign in ((0.0, 1.0), (180.0, -1.0)):
        made = start(
            {},
            {
                "south": {"components": point(1.0)},
                "north": {
                    "components": {"disk": DISK},
                    "inclination": inclination,
                    "orbit": {"around": "south", "pericentre": 2.0, "separation": 10.0},
                },
            },
        )
        mine = made.component == 1
        x, v = made.position[mine], made.velocity[mine]
        spin = np.cross(x - x.mean(axis=0), v - v.mean(axis=0)).mean(axis=0)
        orbit = np.cross(x.mean(axis=0), v.mean(axis=0))
        assert spin @ orbit / np.linalg.norm(spin) / np.linalg.norm(orbit) == pytest.approx(sign, abs=1e-5)
