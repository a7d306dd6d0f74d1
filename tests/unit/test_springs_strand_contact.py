"""Strands that touch: they hold each other, pass through nothing, keep momentum and thickness, and stick."""

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from tianim.lang import ti
from tianim.systems.springs.strand_pairs import PIECES, StrandPairs
from tianim.validate.build import built

Floats = NDArray[np.float64]
STEP = 1.0 / 120.0
THICK = 0.02


def ropes(pieces: dict[str, Any], bodies: Any = None, friction: float = 0.3, **fields: Any) -> Any:
    """Ropes of a thickness that touch each other."""
    contact = {
        "self_collision": True,
        "self_thickness": THICK,
        "thickness": 0.5 * THICK,
        "friction": friction,
    }
    given = {name: {"kind": "rope", "density": 0.3, **piece} for name, piece in pieces.items()}
    fields.setdefault("air", {"density": 0.0})
    return built("springs", bodies=bodies, pieces=given, contact=contact, solver="strands", **fields)


def steps(system: Any, count: int, first: int = 0) -> Any:
    """The places before and after each step."""
    for k in range(first, first + count):
        before = system.read("position")
        system.world.bodies.move(k * STEP, STEP)
        system.step(k * STEP, STEP)
        yield before, system.read("position")


def pairs_of(system: Any, apart: int) -> NDArray[np.int64]:
    """All pairs of segments (m, 2) by their first points, but those of a rope nearer than `apart`."""
    first, rope = [], []
    for k, (name, piece) in enumerate(system.whole.pieces.items()):
        first += [system.whole.first[name] + i for i in range(len(piece.mass) - 1)]
        rope += [k] * (len(piece.mass) - 1)
    a, b = np.triu_indices(len(first), 1)
    at, of = np.array(first), np.array(rope)
    far = (of[a] != of[b]) | (b - a >= apart)
    return np.stack([at[a[far]], at[b[far]]], axis=1)


def nearest(pairs: NDArray[np.int64], x: Floats) -> Floats:
    """Distances of pairs: the least over a fine net of places of one, each to the other segment."""
    a, u = x[pairs[:, 0]], x[pairs[:, 0] + 1] - x[pairs[:, 0]]
    c, v = x[pairs[:, 1]], x[pairs[:, 1] + 1] - x[pairs[:, 1]]
    least = np.full(len(pairs), np.inf)
    for s in np.linspace(0.0, 1.0, 41):
        p = a + s * u - c
        t = np.clip((p * v).sum(axis=1) / (v * v).sum(axis=1), 0.0, 1.0)
        least = np.minimum(least, np.linalg.norm(p - t[:, None] * v, axis=1))
    return least


def volumes(x: Floats) -> Floats:
    """Six times the volume that four points (..., 4, 3) span."""
    u, v, w = (x[..., k, :] - x[..., 0, :] for k in (1, 2, 3))
    return np.asarray((u * np.cross(v, w)).sum(axis=-1))


def crossings(pairs: NDArray[np.int64], before: Floats, after: Floats) -> int:
    """Pairs whose segments pass through each other on the way: where four points lie in a plane, and meet."""
    way = after - before
    corners = np.stack([pairs[:, 0], pairs[:, 0] + 1, pairs[:, 1], pairs[:, 1] + 1], axis=1)
    boxes = [np.minimum(before, after)[corners], np.maximum(before, after)[corners]]
    low, high = boxes[0].reshape(-1, 2, 2, 3).min(axis=2), boxes[1].reshape(-1, 2, 2, 3).max(axis=2)
    corners = corners[((low[:, 0] <= high[:, 1]) & (low[:, 1] <= high[:, 0])).all(axis=1)]
    times = np.linspace(0.0, 1.0, 33)
    sampled = np.stack([volumes(before[corners] + t * way[corners]) for t in times])
    k, n = np.nonzero(sampled[:-1] * sampled[1:] < 0.0)
    x, p, a, b, sign = before[corners[n]], way[corners[n]], times[k], times[k + 1], sampled[k, n]
    for _ in range(40):
        middle = 0.5 * (a + b)
        same = volumes(x + middle[:, None, None] * p) * sign > 0.0
        a, b = np.where(same, middle, a), np.where(same, b, middle)
    found = 0
    for at in x + a[:, None, None] * p:
        st = np.linalg.lstsq(np.stack([at[1] - at[0], at[2] - at[3]], axis=1), at[2] - at[0], rcond=None)[0]
        found += bool(((st > 0.0) & (st < 1.0)).all())
    return found


def crossed(speed: float = 0.0) -> Any:
    """A rope on two pins, and one across it above that falls on it."""
    system = ropes(
        {
            "held": {"points": [(-0.4, 0, 0), (0.4, 0, 0)], "segments": 16, "length": 0.84},
            "free": {"points": [(0.03, 0.1, -0.4), (0.03, 0.1, 0.4)], "segments": 16},
        },
        pins={"ends": {"piece": "held", "points": "ends"}},
    )
    v = np.zeros((system.count, 3))
    v[17:, 1] = -speed
    system.write("velocity", v)
    return system


@pytest.mark.parametrize("speed", [0.0, 60.0, 120.0])
def test_a_rope_that_falls_across_another_is_held(speed: float) -> None:
    """Thrown at 60 m/s, 25 thicknesses a step; at 120, what is pushed off meets another."""
    system, touched = crossed(speed), 0
    pairs = pairs_of(system, 5)
    count = 0
    for before, after in steps(system, 120 if speed == 0.0 else 12):
        count += crossings(pairs, before, after)
        touched += system.diagnostics()["self_contacts"] > 0
    assert count == 0
    assert touched > 0
    if speed == 0.0:
        x = system.read("position")
        assert touched > 80
        assert x[17:, 1].max() > x[:17, 1].min()  # it hangs on it
        assert nearest(pairs, x).min() > 0.9 * THICK


def test_the_checker_sees_what_passes() -> None:
    before = np.array([[-1.0, 0, 0], [1, 0, 0], [0, 0.5, -1], [0, 0.5, 1]])
    after = before - [[0, 0, 0], [0, 0, 0], [0, 1.1, 0], [0, 1.1, 0]]
    assert crossings(np.array([[0, 2]]), before, after) == 1
    aside = np.array([[5.0, 0, 0], [5, 0, 0], [0, 0, 0], [0, 0, 0]])
    assert crossings(np.array([[0, 2]]), before + aside, after + aside) == 0
    assert nearest(np.array([[0, 2]]), before)[0] == pytest.approx(0.5)


def test_momenta_are_kept_when_ropes_meet() -> None:
    """Two free ropes without weight that fly into each other: only they push each other."""
    system = ropes(
        {
            "one": {"points": [(-0.3, 0, 0), (0.3, 0, 0)], "segments": 12},
            "other": {"points": [(0.1, 0.05, -0.3), (0.0, 0.06, 0.3)], "segments": 12, "density": 0.1},
        },
        gravity=(0.0, 0.0, 0.0),
    )
    v = np.zeros((system.count, 3))
    v[13:] = (0.5, -2.0, 0.3)
    system.write("velocity", v)
    mass = system.read("mass")
    start = mass @ v
    touched, slowest = 0.0, 2.0
    for _, _ in steps(system, 40):
        touched += system.diagnostics()["self_contacts"]
        v = system.read("velocity")
        slowest = min(slowest, -float(v[13:, 1].mean()))
        np.testing.assert_allclose(mass @ v, start, atol=1e-9 * mass.sum())
    assert touched > 0
    assert slowest < 1.8


@pytest.mark.parametrize(("friction", "holds"), [(0.35, True), (0.03, False)])
def test_friction_holds_a_rope_over_another(friction: float, holds: bool) -> None:
    """Half a turn about a taut one: it holds while one side is no heavier than e^(pi mu) times the other."""
    system = ropes(
        {
            "bar": {"points": [(-0.2, 0, 0), (0.2, 0, 0)], "segments": 8, "density": 5.0},
            "hung": {
                "points": [(0.01, -0.26, -0.021), (0.01, 0.004, -0.021), (0.01, 0.021, 0.0),
                           (0.01, 0.004, 0.021), (0.01, -0.34, 0.021)],
                "segments": 60, "bend": 1e-6,
            },
        },
        pins={"bar": {"piece": "bar", "points": "all"}}, friction=friction,
    )  # fmt: skip
    start = system.read("position")
    for _ in steps(system, 120):
        pass
    slid = start[-1, 1] - system.read("position")[-1, 1]
    assert (slid < 0.02) if holds else (slid > 0.2)


def test_a_rope_that_coils_on_the_floor_keeps_its_thickness() -> None:
    system = ropes(
        {"p": {"points": [(0, 0.05, 0), (0.004, 0.7, 0.002)], "segments": 65, "bend": 3e-4}},
        {"floor": {"kind": "plane"}},
        friction=0.4,
    )
    pairs = pairs_of(system, 5)
    least, count, touched = np.inf, 0, 0.0
    for k, (before, after) in enumerate(steps(system, 150)):
        touched += system.diagnostics()["self_contacts"]
        if k % 3 == 0:
            least = min(least, float(nearest(pairs, after).min()))
        count += crossings(pairs, before, after)
    assert count == 0
    assert touched > 500
    assert least > 0.8 * THICK
    assert after[:, 1].max() < 0.3


def test_the_grid_finds_every_pair_that_comes_near() -> None:
    """Random chains, one off far and one from afar: all pairs near at some time of the step, each once."""
    rng = np.random.default_rng(2)
    chains = [np.arange(12 * k, 12 * k + 12, dtype=np.int32) for k in range(20)]
    start = np.concatenate([rng.uniform(-0.3, 0.3, 3) + np.cumsum(rng.normal(size=(12, 3)), axis=0) * 0.05
                            for _ in chains])  # fmt: skip
    end = start + 0.03 * rng.normal(size=start.shape)
    end[:12] += [3.0, -1.0, 0.5]
    end[12:24] = end[24:36] + 0.01
    start[12:24] += [-0.5, 3.0, 1.0]
    pairs = StrandPairs(chains, [0.05] * 20, 0.02)
    arrays = [ti.ndarray(ti.f64, start.shape) for _ in range(2)]
    for array, values in zip(arrays, (start, end), strict=True):
        array.from_numpy(values)
    count = pairs.find(arrays[0], arrays[1], 0.02)
    used = np.arange(pairs.room) < pairs.count.to_numpy()[:PIECES, None]
    found = [tuple(sorted(one)) for one in pairs.pair.to_numpy()[used.ravel()].tolist()]
    assert len(found) == count == len(set(found))
    first = np.concatenate([chain[:-1] for chain in chains])
    a, b = np.triu_indices(len(first), 1)
    both = np.stack([first[a], first[b]], axis=1)
    both = both[(both[:, 0] // 12 != both[:, 1] // 12) | (both[:, 1] - both[:, 0] >= 2)]
    near = np.min([nearest(both, start + t * (end - start)) for t in np.linspace(0, 1, 33)], axis=0) < 0.02
    wanted = {tuple(pair) for pair in both[near].tolist()}
    assert len(wanted) > 100
    assert wanted <= set(found)
    assert count < 20 * len(wanted)


def test_what_touches_nothing_is_left_alone() -> None:
    """A rope beside another, at 1.23 thicknesses, and one that flies off it: both are looked at."""

    def fallen(touching: bool) -> tuple[Floats, Floats]:
        places = {"a": (0.0, 0.0, 0.0), "b": (0.0, 0.0, 1.23 * THICK), "c": (1.1 * THICK, -1.1 * THICK, 0.0)}
        pieces = {
            name: {"kind": "rope", "points": [(x, y, z), (x + 0.7, y + 0.7, z)], "segments": 20}
            for name, (x, y, z) in places.items()
        }
        pieces["c"]["velocity"] = (4.0, -4.0, 0.0)
        pins = {name: {"piece": name, "points": "first"} for name in "ab"}
        contact = {"self_collision": touching, "self_thickness": THICK}
        system = built("springs", pieces=pieces, pins=pins, contact=contact, solver="strands")
        for _ in steps(system, 20):
            if touching:
                assert system.folds._pairs.count.to_numpy()[:PIECES].sum() > 0
                assert system.diagnostics()["self_contacts"] == 0
        return np.array(system.read("position")), np.array(system.read("velocity"))

    assert np.array_equal(fallen(False), fallen(True))
