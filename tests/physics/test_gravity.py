"""Gravity: the cases of `tianim validate gravity`, external potentials, steps, and what a frame reports."""

import logging
from typing import Any

import numpy as np
import pytest
from checks import as_tests, assert_passes
from numpy.typing import NDArray
from scipy.integrate import quad

from tianim.systems.gravity.diagnostics import disk_profile, lagrangian_radii
from tianim.systems.gravity.stars import Stars
from tianim.systems.gravity.timestep import Block, allowed
from tianim.validate import CASES, Case
from tianim.validate.build import built
from tianim.validate.gravity import PERIOD, binary, bodies, cluster, run, simulated

Floats = NDArray[np.float64]

# Central differences of a potential, step 1e-5 of a length: errors of 1e-10, and rounding over the step.
DIFFERENCES = 1e-8
# Float64 sums of some hundred terms.
ROUNDING = 1e-12

EXTERNALS: dict[str, dict[str, Any]] = {
    "point": {"kind": "point", "mass": 3.0, "softening": 0.2},
    "nfw": {"kind": "nfw", "mass": 5.0, "scale_radius": 1.5, "concentration": 8.0},
    "logarithmic": {"kind": "logarithmic", "speed": 1.3, "core": 0.4, "flattening": 0.8},
    "miyamoto_nagai": {"kind": "miyamoto_nagai", "mass": 2.0, "scale_length": 1.0, "height": 0.3},
}
CENTRE = np.array([0.3, -0.2, 0.1])


@pytest.mark.parametrize("case", as_tests(CASES["gravity"]))
def test_case(case: Case) -> None:
    assert_passes(case)


def lonely(places: Floats, potential: dict[str, Any]) -> Any:
    """Test particles at rest that feel one external potential, G = 2."""
    component = {
        "kind": "bodies",
        "bodies": [{"massless": True, "position": list(map(float, place))} for place in places],
    }
    return simulated(
        {"probes": component}, external=({**potential, "centre": CENTRE.tolist()},),
        gravitational_constant=2.0, time_step={"kind": "fixed", "length": 0.01},
        diagnostics={"potential": True},
    )  # fmt: skip


def by_hand(kind: str, d: Floats) -> float:
    """The potential at `d` from the centre, from its definition; G = 2."""
    given = EXTERNALS[kind]
    r, flat = float(np.linalg.norm(d)), float(np.hypot(d[0], d[2]))
    if kind == "point":
        return -2.0 * given["mass"] / float(np.sqrt(r**2 + given["softening"] ** 2))
    if kind == "logarithmic":
        inside = given["core"] ** 2 + flat**2 + (d[1] / given["flattening"]) ** 2
        return 0.5 * given["speed"] ** 2 * float(np.log(inside))
    if kind == "miyamoto_nagai":
        up = given["scale_length"] + float(np.hypot(d[1], given["height"]))
        return -2.0 * given["mass"] / float(np.hypot(flat, up))
    # NFW from its density, by quadrature: inside pulls as a point, each shell outside is even.
    a, c = given["scale_radius"], given["concentration"]
    whole = quad(lambda u: u / (1 + u) ** 2, 0.0, c)[0]
    inner = quad(lambda u: u / (1 + u) ** 2, 0.0, r / a)[0]
    return float(-2.0 * given["mass"] / whole * (inner / r + 1.0 / (1.0 + r / a) / a))


@pytest.mark.parametrize("kind", EXTERNALS)
def test_an_external_potential_is_its_law(kind: str) -> None:
    """The potential by its definition, the pull as its slope, near the centre, off the plane and far out."""
    places = CENTRE + np.array([[0.01, 0.02, -0.01], [1.0, 0.5, -0.3], [-4.0, 3.0, 2.0], [0.0, 2.0, 0.001]])
    system = lonely(places, EXTERNALS[kind])
    shown = system.snapshot()[0].data["potential"]
    step = 1e-5
    for k, place in enumerate(places):
        d = place - CENTRE
        wanted = by_hand(kind, d)
        assert shown[k] == pytest.approx(wanted, rel=1e-6)  # frames are float32
        slope = [
            (by_hand(kind, d + step * axis) - by_hand(kind, d - step * axis)) / (2 * step)
            for axis in np.eye(3)
        ]
        scale = float(np.abs(slope).max())
        np.testing.assert_allclose(
            system.read("acceleration")[k], np.negative(slope), atol=DIFFERENCES * scale
        )


@pytest.mark.parametrize("r", [1e-4, 1e-3, 1.49e-3, 1.51e-3, 1e-2])
def test_the_middle_of_a_halo_pulls_by_its_mass(r: float) -> None:
    """Where the logarithms cancel a series takes over, at a thousandth of the scale radius."""
    given = EXTERNALS["nfw"]
    a, c = given["scale_radius"], given["concentration"]
    share, whole = (quad(lambda u: u / (1 + u) ** 2, 0.0, end, epsabs=0.0)[0] for end in (r / a, c))
    pull = lonely(CENTRE + np.array([[r, 0.0, 0.0]]), given).read("acceleration")[0]
    np.testing.assert_allclose(pull, [-2.0 * given["mass"] * share / whole / r**2, 0.0, 0.0], rtol=1e-7)


def test_the_energy_of_external_potentials_is_kept() -> None:
    """A heavy star in a halo: kinetic and external energy change into each other."""
    halo = {"kind": "nfw", "mass": 10.0, "scale_radius": 1.0}
    system = simulated(
        bodies((0.5, np.array([2.0, 0.3, 0.0]), np.array([0.0, 0.0, 0.8]))), external=(halo,),
        integrator="forest_ruth", time_step={"kind": "fixed", "length": 0.02},
    )  # fmt: skip
    before = system.diagnostics()
    after = run(system, 100, 0.02).diagnostics()
    assert abs(after["kinetic_energy"] - before["kinetic_energy"]) > 0.01
    assert abs(after["energy_drift"]) < 1e-5


def test_the_scene_time_is_scaled() -> None:
    """Half a unit of time a second: two seconds are one unit."""
    slow = simulated(binary(), time_scale=0.5, time_step={"kind": "fixed", "length": 0.01})
    plain = simulated(binary(), time_step={"kind": "fixed", "length": 0.01})
    assert slow.max_step() == pytest.approx(0.02)
    run(slow, 100, 0.02)
    run(plain, 100, 0.01)
    np.testing.assert_array_equal(slow.read("position"), plain.read("position"))


@pytest.mark.parametrize(
    ("units", "place", "speed", "mass"),
    [("galactic", 8.0, 220.0, 8.0 * 220.0**2 / 43007.1), ("solar", 1.0, 2 * np.pi, 1.0),
     ("si", 1.495978707e11, 29784.7, 1.98841e30)],
)  # fmt: skip
def test_units_give_the_known_orbits(units: str, place: float, speed: float, mass: float) -> None:
    """A circular speed in the units of each preset: v^2 = G M / r."""
    system = simulated(
        bodies((mass, np.zeros(3), np.zeros(3))) | {
            "probe": {"kind": "bodies", "bodies": [
                {"massless": True, "position": [place, 0.0, 0.0], "velocity": [0.0, 0.0, -speed]}]},
        },
        units=units,
    )  # fmt: skip
    pull = float(np.linalg.norm(system.read("acceleration")[1]))
    assert pull == pytest.approx(speed**2 / place, rel=1e-5)


def test_adaptive_steps_follow_the_orbit() -> None:
    """Steps are fine at the pericentre and coarse at the apocentre, and no star asked for less."""
    system = simulated(binary(), time_step={"kind": "adaptive", "eta": 0.05})
    steps = []
    for frame in range(24):
        system.step(frame * PERIOD / 24, PERIOD / 24)
        steps.append(system.mover.steps)
        assert PERIOD / 24 / steps[-1] < 2.0 * allowed(system.stars, 0.05)
    assert max(steps[10:14]) >= 4 * steps[0]
    assert all(count & (count - 1) == 0 for count in (steps[0], steps[-1]))


def test_block_steps_give_each_star_its_own() -> None:
    """Rungs follow the accelerations, and the energy is kept as with the finest step for all."""
    step = {"kind": "block", "eta": 0.1, "largest": 0.25, "levels": 6}
    system = simulated(cluster(400), softening={"length": 0.05}, time_step=step)
    run(system, 8, 0.25)
    mover = system.mover
    assert isinstance(mover, Block)
    rung, pull = mover.rungs(), np.linalg.norm(system.read("acceleration"), axis=1)
    assert len(np.unique(rung)) > 2
    assert pull[rung == rung.max()].mean() > 3.0 * pull[rung == rung.min()].mean()
    assert abs(system.diagnostics()["energy_drift"]) < 2e-4


@pytest.mark.parametrize("kind", ["direct", "tree"])
def test_block_steps_find_only_the_forces_they_need(kind: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """The same motion as where all forces are found each time, whatever pulls."""
    step = {"kind": "block", "eta": 0.1, "largest": 0.25, "levels": 6}

    def moved() -> Floats:
        system = simulated(
            cluster(2000), softening={"length": 0.05}, time_step=step, solver={"kind": kind},
            external=(EXTERNALS["logarithmic"],),
        )  # fmt: skip
        system.add_force(lambda time, position, velocity: -0.1 * velocity)
        # The net force of a tree is taken away in the end alone: it is no part of this.
        system.stars._balance = lambda: None
        run(system, 2, 0.25)
        assert len(np.unique(system.mover.rungs())) > 2
        return np.asarray(system.read("velocity"))

    some = moved()
    accelerate = Stars.accelerate
    monkeypatch.setattr(Stars, "accelerate", lambda stars, time, active=None: accelerate(stars, time))
    assert (some == moved()).all()


def test_massless_stars_feel_and_do_not_pull() -> None:
    heavy = binary()
    probes = {
        "kind": "bodies",
        "bodies": [{"massless": True, "position": [0.1 * k, 1.0, 0.0]} for k in range(5)],
    }
    alone = simulated(heavy, time_step={"kind": "fixed", "length": 0.01})
    joined = simulated({**heavy, "probes": probes}, time_step={"kind": "fixed", "length": 0.01})
    run(alone, 50, 0.01)
    run(joined, 50, 0.01)
    np.testing.assert_allclose(joined.read("position")[:2], alone.read("position"), atol=ROUNDING)
    assert (np.linalg.norm(joined.read("acceleration")[2:], axis=1) > 0.1).all()


def test_totals_by_numpy() -> None:
    """Energies, momenta, virial and radii of a small cluster, each by its definition."""
    system = simulated(cluster(200), softening={"length": 0.1}, time_step={"kind": "fixed", "length": 0.1})
    run(system, 3, 0.1)
    x, v, m = (system.read(name) for name in ("position", "velocity", "mass"))
    d = x[None] - x[:, None]
    s = np.sqrt((d**2).sum(axis=2) + 0.01)
    np.fill_diagonal(s, np.inf)
    a = ((m / s**3)[..., None] * d).sum(axis=1)
    now = system.diagnostics()
    wanted = {
        "kinetic_energy": 0.5 * m @ (v**2).sum(axis=1),
        "potential_energy": -0.5 * m @ (m / s).sum(axis=1),
        "virial_ratio": (m @ (v**2).sum(axis=1)) / abs(m @ (x * a).sum(axis=1)),
        "momentum_x": (m @ v)[0],
        "angular_momentum_y": (m @ np.cross(x, v))[1],
        "centre_z": (m @ x)[2],
        "radius_50": np.sort(np.linalg.norm(x - m @ x, axis=1))[99],
    }
    for name, value in wanted.items():
        assert now[name] == pytest.approx(value, rel=1e-9, abs=1e-12), name
    assert now["total_energy"] == pytest.approx(now["kinetic_energy"] + now["potential_energy"])


def test_lagrangian_radii_weigh_by_mass() -> None:
    x = np.array([[0.0, 0, 0], [1.0, 0, 0], [2.0, 0, 0], [3.0, 0, 0]])
    radii = lagrangian_radii(x, np.array([1.0, 1.0, 6.0, 2.0]), (0.1, 0.2, 0.8, 1.0), np.zeros(3))
    np.testing.assert_array_equal(radii, [0.0, 1.0, 2.0, 3.0])
    np.testing.assert_array_equal(lagrangian_radii(x, np.zeros(4), (0.5,)), [0.0])


def test_the_profile_of_a_disk() -> None:
    """A tilted, moving disk in a harmonic pull: what went in comes out."""
    rng = np.random.default_rng(3)
    count, omega, sigma = 40_000, 2.0, 0.1
    radius, angle = np.sqrt(rng.uniform(1.0, 9.0, count)), rng.uniform(0.0, 2.0 * np.pi, count)
    outward = np.stack([np.cos(angle), np.zeros(count), -np.sin(angle)], axis=1)
    around = np.stack([-np.sin(angle), np.zeros(count), -np.cos(angle)], axis=1)
    x = radius[:, None] * outward
    v = omega * radius[:, None] * around + rng.normal(0.4, sigma, (count, 1)) * outward  # it expands, too
    turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    if np.linalg.det(turn) < 0:
        turn[:, 0] *= -1
    edges = np.array([1.2, 1.8, 2.4, 2.8])
    profile = disk_profile(
        x @ turn.T + 5.0, v @ turn.T - 3.0, np.full(count, 2.0 / count), -(omega**2) * x @ turn.T, edges, 1.0
    )
    density = 2.0 / (8.0 * np.pi)
    np.testing.assert_allclose(profile.rotation, omega * profile.radius, rtol=0.02)
    np.testing.assert_allclose(profile.circular, omega * profile.radius, rtol=0.02)
    np.testing.assert_allclose(profile.surface_density, density, rtol=0.03)
    # kappa = 2 omega in a harmonic pull.
    np.testing.assert_allclose(profile.toomre_q, sigma * 2 * omega / (3.36 * density), rtol=0.03)


def test_what_is_asked_for_is_reported() -> None:
    components = {
        "disk": {"kind": "exponential_disk", "count": 600, "mass": 0.5},
        "halo": {"kind": "hernquist", "count": 300, "mass": 2.0, "scale_length": 3.0},
    }
    rings = ({"component": "disk", "edges": (0.5, 1.0, 2.0), "quantities": ("rotation_curve", "toomre_q")},)
    system = simulated(
        components, softening={"length": 0.1}, diagnostics={"lagrangian": (0.25,), "rings": rings},
        solver={"kind": "tree", "check_every": 2},
    )  # fmt: skip
    now = system.diagnostics()
    assert {"disk_rotation_curve_0.75", "disk_rotation_curve_1.5", "disk_toomre_q_1.5", "radius_25"} <= set(
        now
    )
    assert now["disk_rotation_curve_1.5"] > 0.3
    assert "radius_50" not in now
    assert 0.0 < now["force_error_median"] < now["force_error_p99"] < 0.01
    assert [part.name for part in system.snapshot()] == ["flock_disk", "flock_halo"]


def test_the_force_error_is_sampled_each_so_many_frames(caplog: pytest.LogCaptureFixture) -> None:
    """A tree that may err by 1e-6 and cannot is warned of, in the metrics and in one line."""
    system = simulated(
        cluster(3000), softening={"length": 0.01}, time_step={"kind": "fixed", "length": 0.1},
        solver={"kind": "tree", "accuracy": 1e-3, "check_every": 2},
    )  # fmt: skip
    seen = []
    for frame in range(4):
        seen.append(system.diagnostics()["force_error_p99"])
        assert system.diagnostics()["force_error_p99"] == seen[-1], "nothing moved: no new sample"
        system.step(0.1 * frame, 0.1)
    assert seen[0] == seen[1] != seen[2] == seen[3]
    assert not caplog.records
    # The sample compares with the law: forces of another softening are wrong.
    system.stars.solver.law = type(system.law)(1.0, 0.3)
    with caplog.at_level(logging.WARNING, "tianim"):
        assert system.diagnostics()["force_error_warning"] == 1.0
    assert len(caplog.records) == 1
    assert "\n" not in caplog.records[0].getMessage()


def test_a_script_may_push_and_set() -> None:
    """A force of one's own acts; setting places starts the energy drift anew."""
    system = simulated(bodies((1.0, np.zeros(3), np.zeros(3))), time_step={"kind": "fixed", "length": 0.1})
    system.add_force(lambda time, position, velocity: np.array([[0.0, 2.0, 0.0]]))
    run(system, 10, 0.1)
    np.testing.assert_allclose(system.read("position"), [[0.0, 1.0, 0.0]], atol=ROUNDING)
    pair = run(simulated(binary(), time_step={"kind": "fixed", "length": 0.1}), 20, 0.1)
    assert pair.diagnostics()["energy_drift"] != 0.0
    pair.write("velocity", 1.1 * pair.read("velocity"))
    assert pair.diagnostics()["energy_drift"] == 0.0


def test_forces_follow_what_is_set() -> None:
    """Twice the distance, a quarter of the pull; twice the masses, twice the pull."""
    system = simulated(binary())
    pull = system.read("acceleration")
    system.write("position", 2.0 * system.read("position"))
    np.testing.assert_allclose(system.read("acceleration"), pull / 4.0, rtol=ROUNDING)
    system.write("mass", 2.0 * system.read("mass"))
    np.testing.assert_allclose(system.read("acceleration"), pull / 2.0, rtol=ROUNDING)


def test_a_restored_run_reports_the_same() -> None:
    """Drift since the start, the last sample of the force error and when the next is due are saved too."""
    fields: dict[str, Any] = {
        "softening": {"length": 0.05}, "time_step": {"kind": "fixed", "length": 0.1},
        "solver": {"kind": "tree", "check_every": 3},
    }  # fmt: skip
    one, other = (simulated(cluster(2000), seed=seed, **fields) for seed in (1, 2))
    other.world = one.world  # the seed of the samples
    other.report.seed = one.report.seed
    for step in range(2):
        one.diagnostics()
        one.step(0.1 * step, 0.1)
    other.restore({name: np.array(array) for name, array in one.state().items()})
    for step in range(2, 6):
        assert other.diagnostics() == one.diagnostics()
        for system in (one, other):
            system.step(0.1 * step, 0.1)


def test_diagnostics_do_not_change_the_run() -> None:
    watched, alone = (
        simulated(cluster(3000), softening={"length": 0.05}, time_step={"kind": "fixed", "length": 0.1},
                  solver={"kind": "tree", "check_every": 1})
        for _ in range(2)
    )  # fmt: skip
    for step in range(5):
        watched.diagnostics()
        watched.snapshot()
        for system in (watched, alone):
            system.step(0.1 * step, 0.1)
    np.testing.assert_array_equal(watched.read("position"), alone.read("position"))


def test_ids_of_components_follow_the_scene() -> None:
    first = {"kind": "plummer", "count": 30, "mass": 1.0}
    galaxy = {"components": {"stars": {"kind": "plummer", "count": 20, "mass": 1.0}},
              "place": {"position": (9.0, 0.0, 0.0)}}  # fmt: skip
    system = built("gravity", components={"near": first}, galaxies={"far": galaxy})
    near, far = system.snapshot()
    assert (near.name, far.name) == ("flock_near", "flock_far_stars")
    np.testing.assert_array_equal(far.data["id"], np.arange(30, 50))
    assert set(far.data["component"]) == {1}
    assert far.position[:, 0].mean() - near.position[:, 0].mean() == pytest.approx(9.0, abs=1.5)
