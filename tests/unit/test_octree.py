"""The octree: every star in one leaf, moments and bounds against brute force, any shape of set."""

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from tianim.lang import ti
from tianim.spatial import morton
from tianim.spatial.columns import staggered
from tianim.spatial.nodes import (
    BEGIN,
    CENTRE,
    CHILDREN,
    END,
    LEAST_RADIUS2,
    MASS,
    RADIUS2,
    SECOND,
    SPAN,
)
from tianim.spatial.octree import LEAF, Octree

Floats = NDArray[np.float64]
GROUP = 64
# Moments are float32 sums of up to some thousand terms; measured 3e-6 of a node's size.
MOMENT_TOLERANCE = 3e-5
# A lattice step is 5e-10 of the cube: places are good to half a step, and the centre is rounded too.
STEP_TOLERANCE = 2e-9


def arrays(position: Floats, mass: Floats) -> tuple[Any, Any]:
    """The compiler's arrays x (3, capacity) and mass (capacity,)."""
    n, capacity = len(mass), staggered(len(mass))
    x, m = ti.ndarray(ti.f64, (3, capacity)), ti.ndarray(ti.f64, capacity)
    x.from_numpy(np.pad(position.T, ((0, 0), (0, capacity - n))))
    m.from_numpy(np.pad(mass, (0, capacity - n)))
    return x, m


def shapes() -> dict[str, tuple[Floats, Floats]]:
    rng = np.random.default_rng(3)
    cluster = rng.normal(size=(3000, 3)) * rng.uniform(0, 1, (3000, 1)) ** 3
    weights = rng.uniform(0.1, 2.0, 3000)
    line = np.linspace(0, 1, 2000)[:, None] ** 3 * np.array([1.0, 2.0, -0.5])
    return {
        "cluster": (cluster, weights),
        "two far clusters": (np.r_[cluster, cluster + 1e4], np.r_[weights, weights]),
        "in one line": (line, np.ones(2000)),
        "coincident": (np.repeat(rng.normal(size=(4, 3)), 500, axis=0), np.ones(2000)),
        "all in one place": (np.full((300, 3), 7.0), np.ones(300)),
        # The cluster lies within a few cells of ten levels, and is small enough to be mended in place.
        "one a little far out": (np.r_[cluster[:1500], [[5e3, 0.0, 0.0]]], np.r_[weights[:1500], 1.0]),
        "one far out": (np.r_[cluster, [[1e9, 0.0, 0.0]]], np.r_[weights, 1.0]),
        "massless": (cluster, np.where(np.arange(3000) % 5, 0.0, 1.0)),
        "none with mass": (cluster, np.zeros(3000)),
        "many": (rng.normal(size=(60_000, 3)) * rng.uniform(0, 1, (60_000, 1)), np.ones(60_000)),
        "three": (np.array([[0.0, 0, 0], [1, 0, 0], [0, 2, 0]]), np.array([1.0, 2.0, 3.0])),
        "one": (np.array([[5.0, -3.0, 2.0]]), np.array([2.0])),
    }


class Built:
    """A tree as NumPy arrays, and the stars in its order."""

    def __init__(self, position: Floats, mass: Floats) -> None:
        self.tree = tree = Octree(len(mass), GROUP)
        tree.build(*arrays(position, mass))
        self.link = tree.link.to_numpy()[:, : tree.node_count]
        self.moment = tree.moment.to_numpy()[:, : tree.node_count].astype(float)
        self.groups = tree.groups.to_numpy()[:, : tree.group_count]
        self.order = tree.order.to_numpy()[: len(mass)]
        self.lower, self.side = np.array(tree.cube.lower), tree.side
        self.position = (position[self.order] - self.lower) / self.side
        self.mass = mass[self.order] / tree.mass
        self.centre = self.link[CENTRE : CENTRE + 3].T / morton.LATTICE


@pytest.fixture(scope="module", params=list(shapes()))
def built(request: pytest.FixtureRequest) -> Built:
    return Built(*shapes()[request.param])


def test_order_is_a_permutation_along_the_morton_curve(built: Built) -> None:
    assert sorted(built.order) == list(range(len(built.order)))
    key = built.tree._sorter.key[0].to_numpy()[: len(built.order)]
    upper = key >> morton.HIGH_SHIFT
    assert (np.diff(upper) >= 0).all()
    for run in np.split(key, np.flatnonzero(np.diff(upper)) + 1):
        assert len(run) <= LEAF or (np.diff(run) >= 0).all()
    lattice = built.tree.lattice.to_numpy()[:, : len(built.order)]
    assert np.abs(lattice.T / morton.LATTICE - built.position).max() < STEP_TOLERANCE


def test_every_star_is_in_exactly_one_leaf_and_one_group(built: Built) -> None:
    link, n = built.link, len(built.order)
    leaves = link[CHILDREN] < 0
    for begin, end in ((link[BEGIN, leaves], link[END, leaves]), built.groups[:2]):
        assert (begin < end).all()
        assert np.sort(begin)[0] == 0
        assert (np.sort(begin)[1:] == np.sort(end)[:-1]).all()
        assert end.max() == n
    assert (built.groups[1] - built.groups[0]).max() <= GROUP


def test_children_cut_their_parent(built: Built) -> None:
    link = built.link
    seen = [0]
    for q in np.flatnonzero(link[CHILDREN] >= 0):
        first, number = link[CHILDREN, q] >> 3, (link[CHILDREN, q] & 7) + 1
        children = np.arange(first, first + number)
        seen.extend(children)
        assert number >= 2
        assert link[BEGIN, children[0]] == link[BEGIN, q]
        assert link[END, children[-1]] == link[END, q]
        assert (link[BEGIN, children[1:]] == link[END, children[:-1]]).all()
    assert sorted(seen) == list(range(link.shape[1]))


def test_a_large_leaf_holds_one_place_only(built: Built) -> None:
    link = built.link
    for q in np.flatnonzero((link[CHILDREN] < 0) & (link[END] - link[BEGIN] > LEAF)):
        stars = built.position[link[BEGIN, q] : link[END, q]]
        assert np.ptp(stars, axis=0).max() <= 2.0**-morton.LEVELS


def test_moments_against_brute_force(built: Built) -> None:
    for q in range(built.link.shape[1]):
        own = slice(built.link[BEGIN, q], built.link[END, q])
        x, m = built.position[own], built.mass[own]
        total = m.sum()
        assert built.moment[MASS, q] == pytest.approx(total, rel=MOMENT_TOLERANCE)
        # Without mass any middle will do.
        centre = np.average(x, axis=0, weights=m) if total else np.clip(built.centre[q], x.min(0), x.max(0))
        size = np.ptp(x, axis=0).max() + STEP_TOLERANCE
        assert np.abs(built.centre[q] - centre).max() < MOMENT_TOLERANCE * size + STEP_TOLERANCE
        d = x - built.centre[q]
        second = (m[:, None, None] * d[:, :, None] * d[:, None, :]).sum(0)[np.triu_indices(3)]
        allowed = MOMENT_TOLERANCE * size**2 + STEP_TOLERANCE * size
        assert np.abs(built.moment[SECOND : SECOND + 6, q] - second).max() <= total * allowed
        r = np.linalg.norm(d, axis=1)
        assert np.sqrt(built.moment[RADIUS2, q]) >= r.max() * (1 - MOMENT_TOLERANCE) - STEP_TOLERANCE
        third = (m * r**3).sum()
        assert (
            built.moment[SPAN, q] ** 2.5 >= third * (1 - MOMENT_TOLERANCE) - STEP_TOLERANCE * total * size**2
        )


def test_bounds_are_tight_below_the_top() -> None:
    built = Built(*shapes()["cluster"])
    sizes = built.link[END] - built.link[BEGIN]
    for q in np.flatnonzero(sizes < morton.PARTS):
        own = slice(built.link[BEGIN, q], built.link[END, q])
        r = np.linalg.norm(built.position[own] - built.centre[q], axis=1)
        largest = max(r.max(), np.sqrt(LEAST_RADIUS2))
        assert np.sqrt(built.moment[RADIUS2, q]) <= largest * (1 + MOMENT_TOLERANCE) + STEP_TOLERANCE


def test_more_nodes_than_there_was_room_for() -> None:
    position, mass = shapes()["many"]
    tree = Octree(len(mass), GROUP)
    tree._reserve_nodes(100)
    tree.build(*arrays(position, mass))
    whole = Built(position, mass)
    assert tree.node_count == whole.tree.node_count
    assert tree.node_capacity >= tree.node_count
    assert (tree.groups.to_numpy()[:, : tree.group_count] == whole.groups).all()


def test_a_wide_scene_is_sorted_by_all_digits() -> None:
    position, mass = shapes()["one far out"]
    assert len(mass) > morton.LONGEST_RUN
    built = Built(position, mass)
    assert len(np.unique(built.order)) == len(mass)
    leaves = built.link[CHILDREN] < 0
    # The cluster is 1e-9 of the cube: lattice places coincide, and the leaves are large but whole.
    assert (built.link[END, leaves] - built.link[BEGIN, leaves]).sum() == len(mass)


@settings(max_examples=25, deadline=None)
@given(st.integers(1, 400), st.integers(0, 2**32 - 1), st.floats(0.1, 8.0), st.integers(1, 60))
def test_any_set_is_cut_whole(count: int, seed: int, steepness: float, places: int) -> None:
    rng = np.random.default_rng(seed)
    position = rng.normal(size=(count, 3)) * rng.uniform(0, 1, (count, 1)) ** steepness
    built = Built(position[rng.integers(0, min(places, count), count)], np.ones(count))
    leaves = built.link[CHILDREN] < 0
    assert (built.link[END, leaves] - built.link[BEGIN, leaves]).sum() == count
    assert (np.diff(built.groups[0]) > 0).all()
    assert (built.groups[1][:-1] == built.groups[0][1:]).all()
    assert built.groups[1][-1] == count
