"""Self-contact of springs: nearest places, swept tests, impulses, the fail-safe, and what must not change."""

import subprocess
import sys
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.optimize import minimize

from tianim.lang import f64_1d, f64_2d, ti
from tianim.systems.springs.arrays import triple
from tianim.systems.springs.closest import EDGE_EDGE, POINT_TRIANGLE, between, closest, meeting, reach
from tianim.systems.springs.impact_zones import rigid, zones_of
from tianim.systems.springs.intersections import intersections
from tianim.systems.springs.self_kernels import NUMBERS, resolve
from tianim.systems.springs.self_pairs import PIECES, Pairs
from tianim.systems.springs.self_patches import PATCH, beside_of, joints, patched
from tianim.validate import springs_self
from tianim.validate.build import built
from tianim.validate.springs_scenes import places, run, speeds

Floats = NDArray[np.float64]

KINDS = {"point and triangle": POINT_TRIANGLE, "edge and edge": EDGE_EDGE}
XI = 0.01


@ti.kernel
def weights_of(n: ti.i32, kind: ti.i32, x: f64_2d, w: f64_2d):
    for k in range(n):
        found = closest(
            kind, triple(x, 4 * k), triple(x, 4 * k + 1), triple(x, 4 * k + 2), triple(x, 4 * k + 3)
        )
        for c in ti.static(range(4)):
            w[k, c] = found[c]


@ti.kernel
def meetings(n: ti.i32, kind: ti.i32, xi: ti.f64, x: f64_2d, p: f64_2d, out: f64_1d):
    for k in range(n):
        a, b, c, d = triple(x, 4 * k), triple(x, 4 * k + 1), triple(x, 4 * k + 2), triple(x, 4 * k + 3)
        pa, pb, pc, pd = triple(p, 4 * k), triple(p, 4 * k + 1), triple(p, 4 * k + 2), triple(p, 4 * k + 3)
        gap = between(closest(kind, a, b, c, d), a, b, c, d).norm()
        out[k] = meeting(kind, gap, xi, reach(kind, pa, pb, pc, pd), a, b, c, d, pa, pb, pc, pd)


def distances(kind: int, x: Floats) -> Floats:
    """Distances of pairs (n, 4, 3) by the kernel's weights."""
    w = np.zeros((len(x), 4))
    weights_of(len(x), kind, np.ascontiguousarray(x.reshape(-1, 3)), w)
    return np.asarray(np.linalg.norm(np.einsum("nk,nkc->nc", w, x), axis=1))


def least_by_search(kind: int, x: Floats) -> float:
    """The distance of one pair, minimised over its two parameters from several starts."""

    def square(at: Floats) -> float:
        s, t = at
        if kind == EDGE_EDGE:
            d = x[0] + s * (x[1] - x[0]) - x[2] - t * (x[3] - x[2])
        else:
            d = x[0] - x[1] - s * (x[2] - x[1]) - (1.0 - s) * t * (x[3] - x[1])
        return float(d @ d)

    starts = [(0.2, 0.2), (0.8, 0.2), (0.2, 0.8), (0.8, 0.8)]
    bounds = [(0.0, 1.0)] * 2
    return float(np.sqrt(min(minimize(square, s, bounds=bounds, tol=1e-14).fun for s in starts)))


@pytest.mark.parametrize("kind", KINDS.values(), ids=KINDS)
def test_nearest_places_are_those_of_a_search(kind: int) -> None:
    x = np.random.default_rng(3).normal(size=(60, 4, 3))
    found = distances(kind, x)
    for k in range(len(x)):
        assert found[k] == pytest.approx(least_by_search(kind, x[k]), abs=2e-6)


@pytest.mark.parametrize("kind", KINDS.values(), ids=KINDS)
def test_flat_and_parallel_pairs_have_their_distance(kind: int) -> None:
    rng = np.random.default_rng(4)
    x = rng.normal(size=(40, 4, 3)) * [1.0, 1.0, 0.0]  # all in a plane
    x[20:, 3] = x[20:, 2] + (x[20:, 1] - x[20:, 0])  # edges in parallel
    for k, found in enumerate(distances(kind, x)):
        assert found == pytest.approx(least_by_search(kind, x[k]), abs=2e-5)


@pytest.mark.parametrize("kind", KINDS.values(), ids=KINDS)
def test_swept_tests_stop_before_contact_and_only_there(kind: int) -> None:
    """Against a fine sampling of time: no contact is missed, and none is seen that is not near."""
    rng = np.random.default_rng(5)
    n = 2000
    x, p = rng.normal(size=(n, 4, 3)), 2.0 * rng.normal(size=(n, 4, 3))
    start = distances(kind, x)
    some = start > 5.0 * XI
    x, p, n = x[some], p[some], int(some.sum())
    out = np.zeros(n)
    meetings(n, kind, XI, x.reshape(-1, 3).copy(), p.reshape(-1, 3).copy(), out)
    times = np.linspace(0.0, 1.0, 1001)
    sampled = np.stack([distances(kind, x + t * p) for t in times])
    hit = out < 1.0
    assert 0.02 < hit.mean() < 0.98
    # Nearer than XI at a sampled time: found, and not later than that.
    first = np.where((sampled < XI).any(axis=0), times[(sampled < XI).argmax(axis=0)], np.inf)
    assert (out[np.isfinite(first)] <= first[np.isfinite(first)]).all()
    # Where a hit is found the pair is at XI, to the tolerance of the test, but for few that slide along.
    there = distances(kind, x + np.minimum(out, 1.0)[:, None, None] * p)
    assert (there[hit] >= XI).all()
    assert (there[hit] > 1.2 * XI).mean() < 0.05


def test_a_cubic_has_the_same_roots() -> None:
    """A point through the inside of a triangle: the time is that of the coplanarity cubic, nearly."""
    rng = np.random.default_rng(6)
    triangle = np.array([[-1.0, -1.0, 0.0], [2.0, -1.0, 0.0], [-1.0, 2.0, 0.0]])
    for _ in range(20):
        x = np.concatenate([[[*rng.uniform(-0.3, 0.3, 2), rng.uniform(0.5, 1.0)]], triangle])
        p = 0.1 * rng.normal(size=(4, 3)) - [[0.0, 0.0, 2.0], [0] * 3, [0] * 3, [0] * 3]
        t = np.linspace(0.0, 1.0, 4)
        at = x + t[:, None, None] * p
        e = at[:, 1:] - at[:, :1]
        roots = np.polynomial.Polynomial.fit(t, np.linalg.det(e), 3).roots()
        root = min(float(r.real) for r in roots if abs(r.imag) < 1e-9 and 0.0 <= r.real <= 1.0)
        out = np.zeros(1)
        meetings(1, POINT_TRIANGLE, 1e-5, x, p, out)
        assert root - 1e-4 < out[0] <= root


def test_impulses_keep_momentum_and_leave_held_points() -> None:
    rng = np.random.default_rng(7)
    n, contacts = 12, 30
    start, end = rng.normal(size=(n, 3)), rng.normal(size=(n, 3))
    mass = rng.uniform(0.5, 2.0, n)
    corner = np.stack([rng.permutation(n)[:4] for _ in range(contacts)]).astype(np.int32)
    number = np.zeros((contacts, NUMBERS))
    for k in range(contacts):
        s = rng.uniform(size=2)
        number[k, :4] = [1.0 - s[0], s[0], s[1] - 1.0, -s[1]]
        normal = rng.normal(size=3)
        number[k, 4:7] = normal / np.linalg.norm(normal)
        number[k, 7:10] = rng.normal(size=3)
    number[:, 10] = 0.3
    x = end.copy()
    resolve(False, 10, contacts, 0.0, corner, number, 1.0 / mass, x, x)
    assert not np.array_equal(x, end)
    assert mass @ (x - start) == pytest.approx(mass @ (end - start), abs=1e-12)
    inverse = 1.0 / mass
    inverse[0] = 0.0
    x = end.copy()
    resolve(False, 10, contacts, 0.0, corner, number, inverse, x, x)
    assert np.array_equal(x[0], end[0])


def test_zones_are_rigid_and_keep_their_momenta() -> None:
    rng = np.random.default_rng(8)
    start, mass = rng.normal(size=(7, 3)), rng.uniform(0.5, 2.0, 7)
    end = start + 1e-3 * rng.normal(size=(7, 3))
    now = rigid(start, end, mass, np.zeros(7, np.bool_))
    assert np.ptp(
        np.linalg.norm(now[:, None] - now, axis=2) - np.linalg.norm(start[:, None] - start, axis=2)
    ) < (1e-12)
    assert mass @ now == pytest.approx(mass @ end, abs=1e-12)
    centre = mass @ start / mass.sum()
    spin, spun = (
        (mass[:, None] * np.cross(start - centre, x - start)).sum(axis=0) for x in (end, now)
    )  # fmt: skip
    assert spun == pytest.approx(spin, rel=1e-2, abs=1e-5)
    zones = zones_of(10, np.array([[0, 1, 2, 3], [3, 4, 5, 6], [7, 8, 9, 7]], np.int32))
    assert sorted(len(zone) for zone in zones) == [3, 7]


def key(kind: int, a: int, b: int, c: int, d: int) -> tuple[Any, ...]:
    """A pair, whatever the order of its points."""
    if kind == POINT_TRIANGLE:
        return (kind, a, *sorted((b, c, d)))
    return (kind, *sorted([tuple(sorted((a, b))), tuple(sorted((c, d)))]))


def test_the_tree_finds_every_near_pair() -> None:
    """All pairs of a crumpled cloud of triangles that are nearer than a distance, each once."""
    rng = np.random.default_rng(9)
    x = rng.uniform(size=(60, 3))
    triangles = np.stack([rng.permutation(60)[:3] for _ in range(45)]).astype(np.int32)
    pairs = Pairs(x, triangles, np.arange(60, dtype=np.int32), np.arange(60, dtype=np.int32), 0.08)
    places_of = ti.ndarray(ti.f64, (60, 3))
    places_of.from_numpy(x)
    pairs.find(places_of, places_of, 0.05)
    margin = 0.1
    used = np.arange(pairs.room) < pairs.count.to_numpy()[:PIECES, None]
    found = pairs.pair.to_numpy()[used.ravel()]
    keys = [key(*one) for one in found.tolist()]
    assert len(set(keys)) == len(keys)
    edges = np.unique(np.sort(triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1), axis=0)
    points = np.unique(triangles)
    wanted = set()
    for triangle in np.unique(triangles, axis=0):
        for v in points[~np.isin(points, triangle)]:
            if distances(POINT_TRIANGLE, x[None, [v, *triangle]])[0] < margin:
                wanted.add(key(POINT_TRIANGLE, int(v), *triangle.tolist()))
    for i, e in enumerate(edges):
        for f in edges[i + 1 :]:
            if not np.isin(e, f).any() and distances(EDGE_EDGE, x[None, [*e, *f]])[0] < margin:
                wanted.add(key(EDGE_EDGE, *e.tolist(), *f.tolist()))
    assert len(wanted) > 100
    assert wanted <= set(keys)


def test_nothing_that_folds_is_left_out_as_flat() -> None:
    """A sheet folded up: all pairs nearer than a distance that have lost half of what they had at rest."""
    n, far = 25, 0.05
    u, w = np.meshgrid(np.linspace(0.0, 1.0, n), np.linspace(0.0, 0.3, 9), indexing="ij")
    rest = np.stack([u.ravel(), w.ravel(), np.zeros(u.size)], axis=1)
    panel = np.arange(n) // 3  # of three cells each, at 10 degrees to the next
    step = np.deg2rad(np.where(panel[:-1] % 2, 85.0, -85.0))
    along = np.stack([np.cos(step), np.sin(step)]) / (n - 1)
    profile = np.concatenate([np.zeros((2, 1)), np.cumsum(along, axis=1)], axis=1)
    x, z = (np.repeat(part, 9) for part in profile)
    folded_up = np.stack([x, w.ravel(), z], axis=1)
    corner = np.arange(u.size).reshape(u.shape)
    a, b, c, d = corner[:-1, :-1], corner[1:, :-1], corner[1:, 1:], corner[:-1, 1:]
    triangles = np.concatenate([np.stack(t, axis=-1).reshape(-1, 3) for t in ((a, b, c), (a, c, d))])
    same = np.arange(len(rest), dtype=np.int32)
    pairs = Pairs(rest, triangles.astype(np.int32), same, np.zeros_like(same), 0.8 * far)
    flat, folded = (ti.ndarray(ti.f64, rest.shape) for _ in range(2))
    for array, places_of in ((flat, rest), (folded, folded_up)):
        array.from_numpy(places_of)
    pairs.find(flat, flat, 0.5 * far)
    assert pairs.count.to_numpy()[:PIECES].sum() == 0
    pairs.find(folded, folded, 0.5 * far)
    used = np.arange(pairs.room) < pairs.count.to_numpy()[:PIECES, None]
    keys = {key(*one) for one in pairs.pair.to_numpy()[used.ravel()].tolist()}
    wanted = set()
    for triangle in triangles:
        others = same[~np.isin(same, triangle)]
        four = np.stack([np.concatenate([[v], triangle]) for v in others])
        now, then = distances(POINT_TRIANGLE, folded_up[four]), distances(POINT_TRIANGLE, rest[four])
        wanted |= {
            key(POINT_TRIANGLE, *one) for one in four[(now < far) & (now < 0.5 * then)].tolist()
        }  # fmt: skip
    assert len(wanted) > 100
    assert wanted <= keys


def test_patches_hang_together_and_hold_all() -> None:
    rng = np.random.default_rng(10)
    corner = np.arange(25 * 31).reshape(25, 31)
    a, b, c, d = corner[:-1, :-1], corner[1:, :-1], corner[1:, 1:], corner[:-1, 1:]
    triangles = np.concatenate([np.stack(t, axis=-1).reshape(-1, 3) for t in ((a, b, c), (a, c, d))])
    apart = np.concatenate([triangles, triangles + corner.size])[rng.permutation(2 * len(triangles))]
    u, w = np.divmod(np.arange(corner.size), 31)
    x = np.stack([u, w, 0.0 * u], axis=1).astype(float)
    x = np.concatenate([x, x + np.array([0.0, 0.0, 0.1])])  # two sheets, near each other
    order, first = patched(x[apart].mean(axis=1), apart)
    assert sorted(order.tolist()) == list(range(len(apart)))
    for begin, end in pairwise(first.tolist()):
        patch = apart[order[begin:end]]
        assert 1 <= len(patch) <= 4 * PATCH
        assert (patch < corner.size).all() or (patch >= corner.size).all()
        left, right, _ = joints(np.unique(patch, return_inverse=True)[1].reshape(-1, 3))
        linked = {0}
        for _ in range(len(patch)):
            linked |= {j for i, j in zip(left, right, strict=True) if i in linked}
            linked |= {i for i, j in zip(left, right, strict=True) if j in linked}
        assert len(linked) == len(patch)


def test_fans_that_meet_in_a_point_may_meet_elsewhere() -> None:
    """Two triangles that share an edge are beside each other; that share one point of two fans, not."""
    hinge = np.array([[0, 1, 2], [2, 1, 3]])
    start, beside = beside_of(np.array([0, 1, 2], np.int32), hinge)
    assert 1 in beside[start[0] : start[1]]
    tie = np.array([[0, 1, 2], [0, 3, 4]])
    start, beside = beside_of(np.array([0, 1, 2], np.int32), tie)
    assert 1 not in beside[start[0] : start[1]]
    turned_over = np.array([[0, 1, 2], [1, 2, 3]])  # both go along the edge the same way
    start, beside = beside_of(np.array([0, 1, 2], np.int32), turned_over)
    assert 1 not in beside[start[0] : start[1]]


def test_what_touches_nothing_is_left_alone() -> None:
    def fallen(**contact: Any) -> Any:
        piece = springs_self.sheet((1.0, 1.0), (8, 8), origin=(0.0, 1.0, 0.0))
        return run(built("springs", pieces={"p": piece}, solver="projective", contact=contact), 0.2)

    plain, touching = fallen(), fallen(self_collision=True)
    assert np.array_equal(places(plain), places(touching))
    assert np.array_equal(speeds(plain), speeds(touching))


def test_the_checker_sees_what_passes() -> None:
    x = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0.2, 0.2, -1], [0.2, 0.2, 1], [5, 5, 1]])
    triangles = np.array([[0, 1, 2], [3, 4, 5]], np.int32)
    assert intersections(x, triangles) == 2
    x[3:5, :2] = 2.0
    assert intersections(x, triangles) == 0
    # Aimed at a slope that it does not reach, within the box of it.
    x[2] = 0.0, 1.0, 1.0
    x[3:5] = (0.2, 0.6, 0.2), (0.2, 0.6, 0.4)
    assert intersections(x, triangles) == 0
    x[4, 2] = 0.8  # through it, and one of its sides through the other
    assert intersections(x, triangles) == 2


def test_what_is_left_is_resumed_and_counted() -> None:
    """A checkpoint goes on as the run does; contacts are counted."""
    one = springs_self.stacked(2, 6, 0.005)
    run(one, 0.4, frames=12)
    assert one.diagnostics()["self_contacts"] > 0
    other = springs_self.stacked(2, 6, 0.005)
    other.restore(one.state())
    for system in (one, other):
        run(system, 0.05, start=0.4)
    assert np.array_equal(places(one), places(other))


@pytest.mark.slow
@pytest.mark.parametrize("solver", ["xpbd", "explicit"])
def test_other_solvers_keep_surfaces_apart_too(solver: str) -> None:
    """Three sheets that fall on a box, on every frame; no fail-safe, and hardly a strain."""
    one = springs_self.stacked(3, 8, 0.005, solver)
    triangles, same = springs_self.triangles_of(one), np.arange(one.count)
    for frame in range(15):
        run(one, 1.0 / 30.0, start=frame / 30.0)
        assert intersections(places(one), triangles, same) == 0
    found = one.diagnostics()
    assert found["self_contacts"] > 50
    assert found["self_failsafe"] == 0
    assert found["strain_max"] < 0.1


PROGRAM = """
import sys
from tianim import runtime
runtime.start(threads=int(sys.argv[1]))
from tianim.validate import springs_self
from tianim.validate.springs_scenes import places, run
system = springs_self.stacked(3, 10, 0.005)
run(system, 0.35, frames=10)
assert system.diagnostics()["self_contacts"] > 0
import hashlib
print(hashlib.sha256(places(system).tobytes()).hexdigest())
"""


def test_bytes_do_not_depend_on_the_number_of_threads() -> None:
    found = {
        subprocess.run(
            [sys.executable, "-c", PROGRAM, threads], capture_output=True, text=True, check=True
        ).stdout.split()[-1]
        for threads in ("1", "2")
    }  # fmt: skip
    assert len(found) == 1
