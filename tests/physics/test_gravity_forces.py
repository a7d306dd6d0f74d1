"""Forces of gravity: the direct sum and the tree against float64 sums in NumPy."""

import hashlib
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from tianim.lang import ti
from tianim.spatial.columns import staggered
from tianim.spatial.morton import LATTICE
from tianim.systems.gravity.solver import DirectSum, Law, Solver, TreeSum, make_solver

Floats = NDArray[np.float64]
G = 43.0
EPS = 0.02
# Double: round-off of a sum of some 1,000 terms. Single: float32 pairs; close pairs in a line or in far
# clusters are a few thousand lattice steps apart.
DOUBLE_ERROR = 1e-12
SINGLE_MEDIAN, SINGLE_99 = 3e-7, 1e-5
WIDE_SINGLE_MEDIAN, WIDE_SINGLE_99 = 1e-4, 1e-2
# Of the potential, of its largest value.
SINGLE_POTENTIAL = 1e-5
ACCURACY = 1e-3
# Even spacing in a line is the worst case: pulls from both sides cancel, what the cubes leave out does not.
LINE = 10
# Stars in one place are a group without extent, which has no margin: all are as wrong as the worst of others.
CROWD = 0.1
# Sum of m a over the sum of |m a|: exact antisymmetry but for rounding.
DOUBLE_MOMENTUM, SINGLE_MOMENTUM = 1e-15, 1e-8


def sphere(r: Floats, rng: np.random.Generator) -> Floats:
    direction = rng.normal(size=(len(r), 3))
    return r[:, None] * direction / np.linalg.norm(direction, axis=1)[:, None]


def plummer(n: int) -> tuple[Floats, Floats]:
    rng = np.random.default_rng(1)
    return sphere(1 / np.sqrt(rng.uniform(0, 0.99, n) ** (-2 / 3) - 1), rng), np.full(n, 1 / n)


def galaxy(n: int) -> tuple[Floats, Floats]:
    rng = np.random.default_rng(2)
    disk, halo = 2 * n // 5, n - 2 * n // 5
    r, angle = rng.gamma(2.0, 1.0, disk), rng.uniform(0, 2 * np.pi, disk)
    flat = np.c_[r * np.cos(angle), r * np.sin(angle), 0.1 * np.arctanh(rng.uniform(-0.999, 0.999, disk))]
    s = np.sqrt(rng.uniform(0, 0.85, halo))
    return np.r_[flat, sphere(5 * s / (1 - s), rng)], np.r_[
        np.full(disk, 0.2 / disk), np.full(halo, 0.8 / halo)
    ]


def far_clusters(n: int) -> tuple[Floats, Floats]:
    one, mass = plummer(n // 2)
    return np.r_[one, one[::-1] * 0.9 + [2e4, -1e4, 0.0]], np.r_[mass, 2 * mass]


def line(n: int) -> tuple[Floats, Floats]:
    return (np.linspace(0.1, 1, n)[:, None] ** 2) * np.array([[1.0, -2.0, 0.7]]), np.ones(n)


def coincident(n: int) -> tuple[Floats, Floats]:
    rng = np.random.default_rng(3)
    return rng.normal(size=(5, 3))[np.arange(n) % 5], rng.uniform(0.5, 1, n)


def with_massless(n: int) -> tuple[Floats, Floats]:
    position, mass = plummer(n)
    return position, np.where(np.arange(n) % 3 == 0, mass, 0.0)


SETS = {
    "plummer": plummer,
    "galaxy": galaxy,
    "two far clusters": far_clusters,
    "in one line": line,
    "coincident": coincident,
    "massless": with_massless,
}
FEW = {
    "one": (np.array([[5.0, -3.0, 2.0]]), np.array([2.0])),
    "two": (np.array([[1.0, 0.0, 0.0], [-1.0, 0.5, 0.0]]), np.array([2.0, 3.0])),
    "two, metres": (np.array([[1e20, 0.0, 0.0], [-1e20, 1e19, 0.0]]), np.array([2e30, 3e30])),
    "two in one place": (np.array([[1.0, 2.0, 3.0]] * 2), np.array([2.0, 3.0])),
    "zero": (np.zeros((0, 3)), np.zeros(0)),
    "no mass": (np.eye(3), np.zeros(3)),
}


def arrays(position: Floats, mass: Floats) -> tuple[Any, Any]:
    n, capacity = len(mass), staggered(len(mass))
    x, m = ti.ndarray(ti.f64, (3, capacity)), ti.ndarray(ti.f64, capacity)
    x.from_numpy(np.pad(position.T, ((0, 0), (0, capacity - n))))
    m.from_numpy(np.pad(mass, (0, capacity - n)))
    return x, m


def evaluate(solver: Solver, position: Floats, mass: Floats) -> tuple[Floats, Floats]:
    """Accelerations (n, 3) and potentials (n,)."""
    n, (x, m) = len(mass), arrays(position, mass)
    a, phi = ti.ndarray(ti.f64, (3, staggered(n))), ti.ndarray(ti.f64, staggered(n))
    a.fill(np.nan)
    phi.fill(np.nan)
    solver.evaluate(x, m, a, phi)
    return a.to_numpy()[:, :n].T, phi.to_numpy()[:n]


def spline(u: Floats, h: float) -> tuple[Floats, Floats]:
    """Springel et al. 2001, eq. 70 and 71: g(r)/r and -phi of a unit mass, u = r/h < 1."""
    with np.errstate(divide="ignore", invalid="ignore"):
        outer = 64 / 3 - 48 * u + 192 / 5 * u**2 - 32 / 3 * u**3 - 1 / (15 * u**3)
        rim = 3.2 - 1 / (15 * u) - 32 / 3 * u**2 + 16 * u**3 - 48 / 5 * u**4 + 32 / 15 * u**5
    inner = 32 / 3 - 192 / 5 * u**2 + 32 * u**3
    deep = 14 / 5 - 16 / 3 * u**2 + 48 / 5 * u**4 - 32 / 5 * u**5
    return np.where(u < 0.5, inner, outer) / h**3, np.where(u < 0.5, deep, rim) / h


def exact(position: Floats, mass: Floats, law: Law) -> tuple[Floats, Floats]:
    """The same in NumPy, float64, pair by pair."""
    d = position[None] - position[:, None]
    r = np.linalg.norm(d, axis=2)
    eps = law.softening
    with np.errstate(divide="ignore", invalid="ignore"):
        if law.kind == "plummer" or eps == 0:
            pull, depth = (r**2 + eps**2) ** -1.5, (r**2 + eps**2) ** -0.5
        else:
            h = 2.8 * eps
            near = spline(r / h, h)
            pull, depth = np.where(r < h, near[0], r**-3.0), np.where(r < h, near[1], 1 / r)
    if eps == 0:
        pull[r == 0], depth[r == 0] = 0.0, 0.0
    np.fill_diagonal(depth, 0.0)
    g = law.gravitational_constant
    return g * np.einsum("ijk,ij,j->ik", d, pull, mass), -g * depth @ mass


def errors(found: Floats, wanted: Floats) -> tuple[float, float]:
    """Median and 99 % of the relative error."""
    error = np.linalg.norm(found - wanted, axis=1) / np.linalg.norm(wanted, axis=1)
    return float(np.median(error)), float(np.quantile(error, 0.99))


@pytest.fixture(params=["plummer", "spline"])
def kind(request: pytest.FixtureRequest) -> str:
    return str(request.param)


@pytest.mark.parametrize("eps", [0.0, EPS])
@pytest.mark.parametrize("name", SETS)
def test_direct_sum_against_numpy(name: str, kind: Any, eps: float) -> None:
    position, mass = SETS[name](600)
    law = Law(G, eps, kind)
    wanted, potential = exact(position, mass, law)
    wide = name in ("two far clusters", "in one line")
    for precision, median, most in (
        ("double", DOUBLE_ERROR, DOUBLE_ERROR),
        ("single", WIDE_SINGLE_MEDIAN if wide else SINGLE_MEDIAN, WIDE_SINGLE_99 if wide else SINGLE_99),
    ):
        a, phi = evaluate(DirectSum(len(mass), law, precision), position, mass)  # type: ignore[arg-type]
        found = errors(a, wanted)
        assert found[0] <= median
        assert found[1] <= most
        allowed = DOUBLE_ERROR if precision == "double" else WIDE_SINGLE_99 if wide else SINGLE_POTENTIAL
        assert np.abs(phi - potential).max() <= allowed * np.abs(potential).max()


@pytest.mark.parametrize("eps", [0.0, EPS])
@pytest.mark.parametrize("name", SETS)
def test_tree_against_numpy(name: str, kind: Any, eps: float) -> None:
    position, mass = SETS[name](2000)
    law = Law(G, eps, kind)
    wanted, potential = exact(position, mass, law)
    a, phi = evaluate(TreeSum(len(mass), law, ACCURACY), position, mass)
    median, most = errors(a, wanted)
    allowed = LINE * ACCURACY if name == "in one line" else ACCURACY
    assert median <= allowed
    assert most <= 10 * allowed
    assert np.median(np.abs(phi / potential - 1)) <= ACCURACY


@pytest.mark.parametrize("name", ["plummer", "galaxy"])
def test_accuracy_is_what_was_asked_for(name: str) -> None:
    position, mass = SETS[name](20_000)
    x, m = arrays(position, mass)
    a = ti.ndarray(ti.f64, (3, staggered(len(mass))))
    for accuracy in (1e-2, 1e-3, 1e-4):
        solver = TreeSum(len(mass), Law(G, EPS), accuracy)
        solver.evaluate(x, m, a)
        median, most = solver.sample_error(x, m, a, rng_seed=1)
        assert accuracy / 10 <= median <= accuracy  # no worse, and not paid for in vain
        assert most <= 10 * accuracy


@pytest.mark.parametrize("eps", [0.0, EPS])
@pytest.mark.parametrize("name", FEW)
def test_few_stars(name: str, kind: Any, eps: float) -> None:
    position, mass = FEW[name]
    law = Law(G, eps, kind)
    wanted, potential = exact(position, mass, law)
    for solver in (
        DirectSum(len(mass), law, "double"),
        DirectSum(len(mass), law, "single"),
        TreeSum(len(mass), law),
    ):
        a, phi = evaluate(solver, position, mass)
        assert a == pytest.approx(wanted, rel=1e-6, abs=0.0)
        assert phi == pytest.approx(potential, rel=1e-6, abs=0.0)


def test_more_stars_in_one_place_than_a_list_holds(kind: Any) -> None:
    position, _ = plummer(4000)
    for place in (0.3, 1.0):
        crowded, weights = np.r_[position, np.full((5000, 3), place)], np.full(9000, 1 / 9000)
        law = Law(G, EPS, kind)
        wanted, potential = evaluate(DirectSum(9000, law), crowded, weights)
        a, phi = evaluate(TreeSum(9000, law, ACCURACY), crowded, weights)
        assert errors(a[:4000], wanted[:4000])[1] <= 10 * ACCURACY
        assert (np.linalg.norm(a - wanted, axis=1) <= CROWD * np.linalg.norm(wanted, axis=1)).all()
        assert np.abs(phi / potential - 1).max() <= ACCURACY


def test_crowds_a_few_lattice_steps_apart(kind: Any) -> None:
    # On either side of a cut of the tree: neither is part of the other's cube, and 1/d^5 is beyond float32.
    step = 2 / LATTICE
    corners = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
    middle = 512.5 * step
    position = np.r_[[[-1.0, -1, -1], [1, 1, 1]], np.repeat(middle + 3 * step * corners, 200, axis=0)]
    a, phi = evaluate(TreeSum(1602, Law(G, 0.0, kind)), position, np.ones(1602))
    assert np.isfinite(a).all()
    assert np.isfinite(phi).all()


@pytest.mark.parametrize("scale", [1e-20, 1e-10, 1e12, 1e25])
@pytest.mark.parametrize("make", [DirectSum, TreeSum])
def test_forces_scale_with_the_scene(make: Any, scale: float, kind: Any) -> None:
    position, mass = galaxy(3000)
    a, phi = evaluate(make(3000, Law(G, EPS, kind)), position, mass)
    scaled, deep = evaluate(make(3000, Law(G, EPS * scale, kind)), position * scale, mass)
    # Places may fall on the next lattice step, and a cube then be opened that was not.
    assert errors(scaled * scale**2, a)[0] <= SINGLE_MEDIAN
    assert errors(scaled * scale**2, a)[1] <= 10 * ACCURACY
    assert np.abs(deep * scale / phi - 1).max() <= ACCURACY


@pytest.mark.parametrize("with_phi", [True, False])
@pytest.mark.parametrize("make", [DirectSum, TreeSum])
def test_active_stars_alone_get_the_same_bytes(make: Any, with_phi: bool, kind: Any) -> None:
    position, mass = galaxy(5000)
    (x, m), solver = arrays(position, mass), make(5000, Law(G, EPS, kind))
    near = np.linalg.norm(position, axis=1) < 1.5
    for chosen in (near, np.arange(5000) == 4321, np.zeros(5000, bool), np.ones(5000, bool)):
        active = ti.ndarray(ti.i32, staggered(5000))
        active.from_numpy(np.pad(chosen, (0, staggered(5000) - 5000)).astype(np.int32))
        found = []
        for who in (None, active):
            a, phi = ti.ndarray(ti.f64, (3, staggered(5000))), ti.ndarray(ti.f64, staggered(5000))
            a.fill(-1.0)
            phi.fill(-1.0)
            solver.evaluate(x, m, a, phi if with_phi else None, who)
            found.append(np.r_[a.to_numpy(), phi.to_numpy()[None]][:, :5000])
        assert found[1][:, chosen].tobytes() == found[0][:, chosen].tobytes()
        assert (found[1][:, ~chosen] == -1.0).all()


@pytest.mark.parametrize(("precision", "allowed"), [("double", DOUBLE_MOMENTUM), ("single", SINGLE_MOMENTUM)])
def test_direct_sum_keeps_momentum(precision: Any, allowed: float, kind: Any) -> None:
    position, mass = galaxy(3000)
    a, _ = evaluate(DirectSum(3000, Law(G, EPS, kind), precision), position, mass)
    force = mass[:, None] * a
    assert np.abs(force.sum(axis=0)).max() <= allowed * np.abs(force).sum()


def test_massless_stars_do_not_pull_and_feel_as_others_do() -> None:
    position, mass = galaxy(3000)
    kept = np.arange(3000) % 4 == 0
    mass = np.where(kept, mass, 0.0)
    law = Law(G, EPS)
    alone, _ = evaluate(DirectSum(int(kept.sum()), law, "double"), position[kept], mass[kept])
    among, _ = evaluate(DirectSum(3000, law, "double"), position, mass)
    assert (among[kept] == alone).all()
    tree, _ = evaluate(TreeSum(3000, law, ACCURACY), position, mass)
    assert errors(tree, among)[0] <= ACCURACY


@pytest.mark.parametrize("make", [DirectSum, TreeSum])
def test_forces_depend_on_the_places_alone(make: Any) -> None:
    position, mass = galaxy(5000)
    solver = make(5000, Law(G, EPS))
    first, phi = evaluate(solver, position, mass)
    evaluate(solver, position[::-1] * 3, mass)
    again, phi_again = evaluate(solver, position, mass)
    assert first.tobytes() == again.tobytes()
    assert phi.tobytes() == phi_again.tobytes()
    without = ti.ndarray(ti.f64, (3, staggered(5000)))
    solver.evaluate(*arrays(position, mass), without)
    assert errors(without.to_numpy()[:, :5000].T, first)[1] <= SINGLE_99


def test_forces_turn_and_move_with_the_stars() -> None:
    position, mass = galaxy(4000)
    law = Law(G, EPS)
    turn = np.linalg.qr(np.random.default_rng(4).normal(size=(3, 3)))[0]
    a, _ = evaluate(TreeSum(4000, law), position, mass)
    turned, _ = evaluate(TreeSum(4000, law), position @ turn.T + [100.0, -50.0, 3.0], mass)
    assert errors(turned @ turn, a)[0] <= 2 * ACCURACY


def fingerprint() -> str:
    """Of both solvers' results, for the process that runs with another number of threads."""
    digest = hashlib.sha256()
    position, mass = galaxy(40_000)
    for solver in (TreeSum(40_000, Law(G, EPS)), DirectSum(3000, Law(G, EPS, "spline"))):
        for array in evaluate(solver, position[: solver.count], mass[: solver.count]):
            digest.update(np.ascontiguousarray(array).tobytes())
    return digest.hexdigest()


def test_one_thread_gives_the_same_bytes() -> None:
    here, root = Path(__file__).parent, Path(__file__).parents[2]
    code = (
        "from tianim import runtime; runtime.start(threads=1);"
        "from test_gravity_forces import fingerprint; print(fingerprint())"
    )
    done = subprocess.run(
        [sys.executable, "-c", code],
        capture_output=True,
        text=True,
        check=False,
        cwd=root,
        env={**os.environ, "PYTHONPATH": f"{here}{os.pathsep}{root}"},
    )
    assert done.stdout.strip() == fingerprint(), done.stderr


@pytest.mark.parametrize(
    ("count", "massive", "accuracy", "wanted", "precision"),
    [
        (3, None, 1e-3, DirectSum, "double"),
        (2000, None, 1e-3, DirectSum, "single"),
        (6000, None, 1e-4, DirectSum, "single"),
        (100_000, 5, 1e-3, DirectSum, "double"),
        (100_000, None, 1e-3, TreeSum, None),
        (1_000_000, 200_000, 1e-2, TreeSum, None),
    ],
)
def test_the_solver_is_chosen_by_cost(
    count: int, massive: int | None, accuracy: float, wanted: type, precision: str | None
) -> None:
    solver = make_solver(count, Law(G, EPS), accuracy, massive=massive)
    assert type(solver) is wanted
    assert getattr(solver, "precision", None) == precision
    assert isinstance(make_solver(count, Law(G, EPS), accuracy, kind="tree"), TreeSum)
    assert isinstance(make_solver(count, Law(G, EPS), accuracy, kind="direct"), DirectSum)


def test_sampled_error_finds_a_wrong_force() -> None:
    position, mass = plummer(2000)
    x, m = arrays(position, mass)
    a = ti.ndarray(ti.f64, (3, staggered(2000)))
    solver = DirectSum(2000, Law(G, EPS), "double")
    solver.evaluate(x, m, a)
    assert max(solver.sample_error(x, m, a, rng_seed=0)) < DOUBLE_ERROR
    right = a.to_numpy()
    wrong = np.where(np.arange(right.shape[1]) % 20, 1.01, 1.5)
    a.from_numpy(right * wrong)
    median, most = solver.sample_error(x, m, a, rng_seed=0)
    assert median == pytest.approx(0.01, rel=1e-9)
    assert most == pytest.approx(0.5, rel=1e-9)  # of one in twenty


@pytest.mark.parametrize("count", [100, 30_000, 300_000])
def test_memory_is_what_the_issue_allows(count: int) -> None:
    # The state takes 88 bytes a star, the whole must stay under 200; small sets have fixed scratch.
    assert TreeSum(count, Law(G, EPS)).memory_bytes() < 112 * count + 4_000_000
