"""Spheres: where their stars are, how fast, and that they are in balance, alone and together."""

from typing import Any

import numpy as np
import pytest
from gravity_starts import Floats, assert_distributed, energies, start
from scipy import integrate, special
from scipy.spatial.distance import cdist

from tianim.errors import SceneError
from tianim.systems.gravity.profiles import (
    MiyamotoNagai,
    SoftSphere,
    ThinDisk,
    cut_sphere,
    hernquist_shape,
    king_sphere,
    nfw_shape,
    plummer_shape,
)

MANY = 20_000
# An infinite sphere but for 1e-4 of its mass.
FAR = 200.0
# The table's radii are joined by straight lines in the logarithms.
TABLE = 2e-4
# 2,000 stars: the virial ratio scatters by 0.024 at most (16 samples of each sphere); the mean of four by
# half as much. 3 sigma.
VIRIAL = 0.036
# The same for the energy of a Plummer sphere of 3,000 stars, which scatters by 0.028.
ENERGY = 0.042

SPHERES: dict[str, dict[str, Any]] = {
    "plummer": {"kind": "plummer"},
    "hernquist": {"kind": "hernquist"},
    "nfw": {"kind": "nfw"},
    "flat king": {"kind": "king", "w0": 2.0},
    "deep king": {"kind": "king", "w0": 9.0},
}


def sphere(kind: str, count: int = MANY, **more: Any) -> dict[str, Any]:
    return {"sphere": {"kind": kind, "count": count, "mass": 1.0, **more}}


def plummer_mass(r: Floats) -> Floats:
    return (1.0 + r**-2.0) ** -1.5


def hernquist_mass(r: Floats) -> Floats:
    return r**2 / (1.0 + r) ** 2


def nfw_mass(r: Floats) -> Floats:
    return np.log1p(r) - r / (1.0 + r)


@pytest.mark.parametrize(
    ("kind", "mass"), [("plummer", plummer_mass), ("hernquist", hernquist_mass), ("nfw", nfw_mass)]
)
@pytest.mark.parametrize("truncation", [5.0, 12.2])
def test_radii_follow_the_profile_up_to_the_truncation(kind: str, mass: Any, truncation: float) -> None:
    made = start(sphere(kind, truncation=truncation), recentre=False)
    radius = np.linalg.norm(made.position, axis=1)
    inside = radius[radius < truncation]
    assert_distributed(inside, lambda r: mass(r) / mass(np.float64(truncation)))
    assert made.mass.sum() == pytest.approx(1.0, rel=1e-12)


@pytest.mark.parametrize(
    ("shape", "mass"),
    [(plummer_shape, plummer_mass), (hernquist_shape, hernquist_mass), (nfw_shape, nfw_mass)],
)
def test_the_table_holds_the_analytic_mass(shape: Any, mass: Any) -> None:
    table = cut_sphere(shape, 3.0, 30.0)
    r = np.geomspace(1e-5, 10.0, 50)
    share = table.part_inside(3.0 * r) / mass(r)
    np.testing.assert_allclose(share, share[-1], rtol=TABLE)
    np.testing.assert_allclose(table.radius_of(table.part_inside(3.0 * r)), 3.0 * r, rtol=1e-9)


def test_the_cut_off_is_as_stated() -> None:
    table = cut_sphere(nfw_shape, 1.0, 10.0)
    beyond = table.radius > 10.0
    r = table.radius[beyond]
    at = table.density[~beyond][-1] / (
        1.0 / (table.radius[~beyond][-1] * (1.0 + table.radius[~beyond][-1]) ** 2)
    )
    edge = at / (10.0 * 11.0**2)
    power = -1.0 - 2.0 * 10.0 / 11.0 + 5.0
    np.testing.assert_allclose(table.density[beyond], edge * (r / 10.0) ** power * np.exp(-(r - 10.0) / 2.0))


@pytest.mark.parametrize("kind", ["plummer", "hernquist", "nfw"])
def test_a_truncation_may_be_out_of_sight(kind: str) -> None:
    # The potential at the table's end is 1e-20 of that in the middle.
    made = start(sphere(kind, count=1000, truncation=1e20), recentre=False)
    radius, speed = np.linalg.norm(made.position, axis=1), np.linalg.norm(made.velocity, axis=1)
    # Nobody is faster than what escapes from a point of the whole mass.
    assert (speed**2 < 2.0 / radius).all()


def test_a_plummer_spheres_default_holds_its_inner_99_percent() -> None:
    radius = np.linalg.norm(start(sphere("plummer"), recentre=False).position, axis=1)
    # beyond 12.2 b the cut-off leaves 0.4 % of the stars; 3 sigma of 20,000
    assert np.mean(radius < 12.2) == pytest.approx(0.996, abs=0.0014)
    expected = [(q ** (-2 / 3) - 1.0) ** -0.5 for q in (0.1, 0.5)]
    np.testing.assert_allclose(np.quantile(radius, (0.1, 0.5)), expected, rtol=0.03)


@pytest.mark.parametrize(("w0", "concentration"), [(3.0, 0.67), (6.0, 1.26), (9.0, 2.12), (12.0, 2.74)])
def test_a_king_sphere_ends_where_binney_and_tremaine_say(w0: float, concentration: float) -> None:
    # figure 4.9 and the text of section 4.3.3c, printed to two digits
    assert np.log10(king_sphere(w0, 1.0).radius[-1]) == pytest.approx(concentration, abs=0.0101)


@pytest.mark.parametrize("w0", [1.0, 5.0])
def test_a_king_sphere_solves_its_equation(w0: float) -> None:
    def density(w: float) -> float:
        # the integral of v^2 (e^(w - v^2/2) - 1), not its closed form
        return integrate.quad(lambda v: v * v * np.expm1(w - 0.5 * v * v), 0.0, np.sqrt(2.0 * max(w, 0.0)))[0]

    middle = density(w0)

    def slope(x: float, y: Floats) -> list[float]:
        return [y[1], -9.0 * density(y[0]) / middle - 2.0 * y[1] / x]

    found = integrate.solve_ivp(slope, (1e-3, 1.0), [w0 - 1.5e-6, -3e-3], rtol=1e-8, dense_output=True)
    x = np.linspace(0.1, 1.0, 7)
    w, rate = found.sol(x)
    table = king_sphere(w0, 2.0)
    inside = table.part_inside(2.0 * x)
    np.testing.assert_allclose(inside / inside[-1], x**2 * rate / rate[-1], rtol=TABLE)
    rho = np.interp(2.0 * x, table.radius, table.density)
    np.testing.assert_allclose(rho / rho[0], [density(one) / density(w[0]) for one in w], rtol=2.0 * TABLE)


def test_a_king_spheres_radii_follow_its_table() -> None:
    table = king_sphere(6.0, 1.0)
    made = start(sphere("king"), recentre=False)
    radius = np.linalg.norm(made.position, axis=1)
    assert radius.max() <= table.radius[-1] * (1.0 + 1e-12)
    # an integral of the density of its own, not the sampled column
    mass = integrate.cumulative_trapezoid(
        4.0 * np.pi * table.radius**2 * table.density, table.radius, initial=0.0
    )
    assert_distributed(radius, lambda r: np.interp(r, table.radius, mass / mass[-1]))


def test_a_uniform_sphere_is_even_and_has_its_virial_ratio() -> None:
    made = start(sphere("uniform_sphere", count=2000, radius=2.0, virial_ratio=0.5), recentre=False)
    radius = np.linalg.norm(made.position, axis=1)
    assert_distributed(radius, lambda r: (r / 2.0) ** 3)
    kinetic, potential = energies(made)
    assert kinetic == pytest.approx(0.25 * 0.6 / 2.0, rel=1e-12)
    assert potential == pytest.approx(-0.6 / 2.0, rel=0.02)  # scatters by 0.6 % at 2,000 stars
    assert (start(sphere("uniform_sphere", count=100)).velocity == 0.0).all()


@pytest.mark.parametrize("name", SPHERES)
def test_directions_have_no_preference(name: str) -> None:
    made = start(sphere(**SPHERES[name]), recentre=False)
    axes = []
    for vectors in (made.position, made.velocity):
        unit = vectors / np.linalg.norm(vectors, axis=1, keepdims=True)
        axes.append(unit)
        for axis in range(3):
            assert_distributed(unit[:, axis], lambda c: 0.5 * (1.0 + c))
    # the angle between place and velocity: isotropic
    assert_distributed(np.sum(axes[0] * axes[1], axis=1), lambda c: 0.5 * (1.0 + c))


def test_plummer_speeds_follow_the_closed_form() -> None:
    made = start(sphere("plummer", truncation=FAR), recentre=False)
    radius, speed = (np.linalg.norm(a, axis=1) for a in (made.position, made.velocity))
    q = speed / (np.sqrt(2.0) * (1.0 + radius**2) ** -0.25)
    # q^2 (1 - q^2)^(7/2): q^2 is beta-distributed with 3/2 and 9/2
    assert_distributed(q, lambda q: special.betainc(1.5, 4.5, np.minimum(q, 1.0) ** 2))


def hernquist_dispersion(r: Floats) -> Floats:
    """Hernquist 1990, equation 10, a = G = M = 1."""
    polynomial = 25.0 + 52.0 * r + 42.0 * r**2 + 12.0 * r**3
    return (12.0 * r * (1.0 + r) ** 3 * np.log((1.0 + r) / r) - r / (1.0 + r) * polynomial) / 12.0


def test_hernquist_dispersion_is_the_published_one() -> None:
    made = start(sphere("hernquist", truncation=FAR, count=2 * MANY), recentre=False)
    radius, square = np.linalg.norm(made.position, axis=1), np.sum(made.velocity**2, axis=1) / 3.0
    for low, high in ((0.05, 0.1), (0.3, 0.5), (1.0, 1.5), (3.0, 5.0)):
        mine = (radius > low) & (radius < high)
        ratio = np.mean(square[mine] / hernquist_dispersion(radius[mine]))
        # v^2 of three normal components scatters by sqrt(2/3); 4 sigma
        assert ratio == pytest.approx(1.0, abs=4.0 * np.sqrt(2.0 / 3.0 / mine.sum()))


def test_the_energy_of_a_plummer_sphere() -> None:
    runs = [start(sphere("plummer", count=3000, truncation=FAR), seed=seed) for seed in range(4)]
    total = np.mean([sum(energies(made)) for made in runs])
    assert total == pytest.approx(-3.0 * np.pi / 64.0, rel=ENERGY)


@pytest.mark.parametrize(
    ("name", "softening"), [*((name, 0.0) for name in SPHERES), ("hernquist", 0.1), ("plummer", 0.3)]
)
def test_spheres_are_in_balance(name: str, softening: float) -> None:
    ratios = []
    for seed in range(4):
        made = start(sphere(count=2000, **SPHERES[name]), softening=softening, seed=seed, recentre=False)
        if softening == 0.0:
            kinetic, potential = energies(made)
            ratios.append(-2.0 * kinetic / potential)
        else:
            ratios.append(clausius(made.position, made.velocity, softening))
    assert np.mean(ratios) == pytest.approx(1.0, abs=VIRIAL)


def clausius(x: Floats, v: Floats, softening: float) -> float:
    """2 K over the sum of -x.a of all pairs, which softening does not spoil; equal masses."""
    virial = 0.0
    for first in range(0, len(x), 500):
        square = cdist(x[first : first + 500], x, "sqeuclidean")
        virial += 0.5 * float(np.sum(square / (square + softening**2) ** 1.5)) / len(x)
    return float(np.sum(v**2)) / virial


def jeans(r: float, density: Any, mass: Any) -> float:
    """The square of an isotropic dispersion: 1/rho int_r rho G M / s^2 ds."""
    return integrate.quad(lambda s: density(s) * mass(s) / s**2, r, 60.0, limit=200)[0] / density(r)


def test_a_bulge_feels_the_disk_and_the_halo() -> None:
    made = start(
        {
            "bulge": {
                "kind": "hernquist",
                "count": 2 * MANY,
                "mass": 0.2,
                "scale_length": 0.3,
                "truncation": 30.0,
            },
            "disk": {"kind": "exponential_disk", "count": 10, "mass": 1.0, "scale_length": 1.0},
            "halo": {"kind": "plummer", "count": 10, "mass": 8.0, "scale_length": 3.0, "truncation": 300.0},
        },
        recentre=False,
    )
    mine = made.component == 0
    radius = np.linalg.norm(made.position[mine], axis=1)
    square = np.sum(made.velocity[mine] ** 2, axis=1) / 3.0

    def mass(r: float) -> float:
        x = r / 3.0
        disk = (1.0 - (1.0 + r) * np.exp(-r)) / (1.0 - 9.0 * np.exp(-8.0))
        return 0.2 * r**2 / (r + 0.3) ** 2 + disk + 8.0 * x**3 / (1.0 + x * x) ** 1.5

    for r in (0.1, 0.5, 2.0):
        near = np.abs(np.log(radius / r)) < 0.1
        expected = jeans(r, lambda s: 1.0 / (s * (s + 0.3) ** 3), mass)
        # 4 sigma, and 1 % for the width of the bin
        assert square[near].mean() / expected == pytest.approx(
            1.0, abs=4.0 * np.sqrt(2 / 3 / near.sum()) + 0.01
        )


def test_massless_stars_move_in_what_is_there() -> None:
    made = start(
        {"tracers": {"kind": "plummer", "count": MANY, "massless": True, "truncation": 50.0}},
        external=({"kind": "logarithmic", "speed": 2.0, "core": 1.0},),
    )
    assert (made.mass == 0.0).all()
    radius, square = np.linalg.norm(made.position, axis=1), np.sum(made.velocity**2, axis=1) / 3.0
    near = np.abs(np.log(radius)) < 0.1
    expected = jeans(1.0, lambda s: (1.0 + s * s) ** -2.5, lambda s: 4.0 * s**3 / (1.0 + s * s))
    assert square[near].mean() / expected == pytest.approx(1.0, abs=4.0 * np.sqrt(2 / 3 / near.sum()) + 0.01)


@pytest.mark.parametrize("softening", [0.05, 0.5])
def test_the_softened_pull_of_a_sphere_is_that_of_its_stars(softening: float) -> None:
    made = start(sphere("plummer", count=200_000, truncation=FAR), recentre=False)
    table = SoftSphere(cut_sphere(plummer_shape, 1.0, FAR, 1.0), softening)
    for r in (0.3, 1.0, 4.0):
        at = r * np.array([[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]], np.float64)
        found = []
        for place in at:
            apart = made.position - place
            cubed = (np.sum(apart**2, axis=1) + softening**2) ** 1.5
            found.append(-(place / r) @ (made.mass / cubed @ apart))
        # near stars make the sum noisy: 3 % at a softening of 0.05
        assert np.mean(found) == pytest.approx(float(table.enclosed_mass(r)) / r**2, rel=0.04)


def test_softening_of_nothing_changes_nothing() -> None:
    table = cut_sphere(hernquist_shape, 1.0, 10.0, 2.0)
    r = np.geomspace(1e-3, 20.0, 30)
    np.testing.assert_allclose(
        SoftSphere(table, 1e-9).enclosed_mass(r), 2.0 * table.part_inside(r), rtol=TABLE
    )


def test_a_sphere_that_cannot_be_in_balance_is_refused() -> None:
    # an even core round a mass that outweighs it by far
    parts = {
        "heavy": {"kind": "bodies", "bodies": [{"mass": 50.0}]},
        "loose": {"kind": "plummer", "count": 10, "mass": 1e-3, "truncation": 0.2},
    }
    with pytest.raises(
        SceneError, match=r"component 'loose': has no isotropic equilibrium .* amiss"
    ) as caught:
        start(parts, softening=0.001)
    assert "\n" not in str(caught.value)


def test_the_thin_disk_inside_a_sphere() -> None:
    disk = ThinDisk(2.0, 3.0)
    expected = integrate.quad(lambda R: 2.0 / 9.0 * R * np.exp(-R / 3.0), 0.0, 4.0)[0]
    assert float(disk.enclosed_mass(4.0)) == pytest.approx(expected, rel=1e-12)


def test_the_mean_pull_of_a_miyamoto_nagai_disk() -> None:
    disk = MiyamotoNagai(2.0, 3.0, 0.5)

    def density(y: float, R: float) -> float:
        # Miyamoto and Nagai 1975, equation 5
        z = np.hypot(y, 0.5)
        top = 3.0 * R * R + (3.0 + 3.0 * z) * (3.0 + z) ** 2
        return 2.0 * 0.25 / (4.0 * np.pi) * top / ((R * R + (3.0 + z) ** 2) ** 2.5 * z**3)

    r = 4.0
    inside = integrate.dblquad(
        lambda y, R: 4.0 * np.pi * R * density(y, R), 0.0, r, 0.0, lambda R: np.sqrt(r * r - R * R)
    )[0]
    # Gauss: the mean over the sphere of the pull is that of the mass inside
    assert float(disk.enclosed_mass(r)) == pytest.approx(inside, rel=1e-3)
