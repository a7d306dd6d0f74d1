"""The neighbour search finds what SciPy's k-d tree finds, no pair more and no pair less.

The stored lists walk the same tubes as every other kernel, with the same test of the distance,
so that their rows show what a walk sees.
"""

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from tianim.errors import SceneError
from tianim.spatial import grid as grid_module
from tianim.spatial.columns import Columns
from tianim.spatial.grid import NeighborGrid
from tianim.spatial.neighbor_lists import NeighborLists
from tianim.system import Bounds

Positions = NDArray[np.float32]
Pairs = NDArray[np.int64]

# A pair this far from the radius, relative to it, must be told right.
EDGE = 1e-6
# Nearer than this to the radius, float32 may decide either way (three roundings of 6e-8 each).
UNDECIDED = 2.5e-7
# So many are sorted by all cores, fewer by one.
MANY = 40_000
OPEN = Bounds()


def box(kind: str, lower: float, upper: float) -> Bounds:
    return Bounds(kind, (lower,) * 3, (upper,) * 3)


def columns_of(position: Positions) -> Columns:
    columns = Columns(len(position), {"position": 3})
    columns.write("position", position)
    return columns


def columns_with_room(position: Positions) -> Columns:
    columns = Columns(0, {"position": 3}, room=50)
    columns.append(len(position), {"position": position})
    return columns


def pairs_of(lists: NeighborLists, columns: Columns) -> Pairs:
    """Ordered pairs of ids in the rows, (m, 2), sorted; fails where a row holds a pair twice."""
    offset = lists.offset.to_numpy()
    assert offset[0] == 0
    assert offset[-1] == lists.pairs
    place = columns.state()["id"][0]
    owner = np.repeat(np.arange(lists.count), np.diff(offset))
    pairs = np.stack([place[owner], place[rows_of(lists)]], axis=1).astype(np.int64)
    unique = in_order(pairs, lists.count)
    assert len(unique) == len(pairs)
    return unique


def rows_of(lists: NeighborLists) -> NDArray[np.int32]:
    return lists.neighbour.to_numpy()[: lists.pairs]


def in_order(pairs: Pairs, count: int) -> Pairs:
    """Sorted pairs of numbers below `count`, each once."""
    return np.stack(np.divmod(np.unique(pairs[:, 0] * count + pairs[:, 1]), max(count, 1)), axis=1)


def found(position: Positions, radius: float, bounds: Bounds, dimension: int, skin: float = 0.0) -> Pairs:
    columns = columns_of(position)
    lists = NeighborLists(len(position), dimension, bounds, radius, skin)
    lists.build(columns)
    return pairs_of(lists, columns)


def tree(position: Positions, bounds: Bounds, dimension: int) -> tuple[cKDTree, NDArray[np.float64]]:
    """The k-d tree of the very float32 positions, in the box between the corners that float32 holds."""
    points = position[:, :dimension].astype(np.float64)
    if bounds.kind != "periodic":
        return cKDTree(points), points
    corners = np.array([bounds.lower, bounds.upper], np.float32)[:, :dimension].astype(np.float64)
    lower, length = corners[0], corners[1] - corners[0]
    points = points - lower
    points[points >= length] = 0.0
    return cKDTree(points, boxsize=length), points


def expected(position: Positions, radius: float, bounds: Bounds, dimension: int) -> Pairs:
    pairs = tree(position, bounds, dimension)[0].query_pairs(radius, output_type="ndarray")
    return in_order(np.concatenate([pairs, pairs[:, ::-1]]).astype(np.int64), len(position))


def assert_same_pairs(position: Positions, radius: float, bounds: Bounds, dimension: int) -> None:
    ours, theirs = found(position, radius, bounds, dimension), expected(position, radius, bounds, dimension)
    np.testing.assert_array_equal(ours, theirs)


def scattered(count: int, lower: float, upper: float, dimension: int, seed: int = 1) -> Positions:
    position = np.random.default_rng(seed).uniform(lower, upper, (count, 3)).astype(np.float32)
    position[:, dimension:] = 0.0
    return np.minimum(position, np.nextafter(np.float32(upper), np.float32(-np.inf)))


@pytest.mark.parametrize("dimension", [2, 3])
@pytest.mark.parametrize("kind", ["open", "contained", "periodic"])
@pytest.mark.parametrize("count", [0, 1, 2, 1000, 30_000, MANY])
def test_pairs_equal_the_tree(count: int, kind: str, dimension: int) -> None:
    side = 2.0 * max(count, 100) ** (1 / dimension)
    bounds = OPEN if kind == "open" else box(kind, 0.0, side)
    assert_same_pairs(scattered(count, 0.0, side, dimension), 3.0, bounds, dimension)


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["open", "periodic"])
def test_pairs_of_a_million_equal_the_tree(kind: str) -> None:
    """Among some four million pairs a few lie so near the radius that float32 may decide either way."""
    bounds = OPEN if kind == "open" else box(kind, -50.0, 50.0)
    position = scattered(1_000_000, -50.0, 50.0, 3)
    ours, theirs = (
        {(i, j) for i, j in pairs.tolist() if i < j}
        for pairs in (found(position, 1.0, bounds, 3), expected(position, 1.0, bounds, 3))
    )
    assert len(theirs) > 1_000_000
    for i, j in ours ^ theirs:
        way = position[i].astype(np.float64) - position[j]
        if kind == "periodic":
            way -= 100.0 * np.round(way / 100.0)
        assert abs(np.linalg.norm(way) - 1.0) < UNDECIDED


@pytest.mark.parametrize("dimension", [2, 3])
@pytest.mark.parametrize(
    ("lower", "upper"), [(0.0, 10.0), (-5.0, 5.0), (0.0, 7.3), (-1.1, 2.3), (100.0, 109.7)]
)
def test_pairs_across_the_seam(lower: float, upper: float, dimension: int) -> None:
    """Boxes that start at zero, are centred, have a length that float32 cannot hold, lie far out."""
    position = scattered(2000, lower, upper, dimension)
    radius = 0.32 * (upper - lower)
    assert_same_pairs(position[:300], radius, box("periodic", lower, upper), dimension)
    assert_same_pairs(position, 0.3 * radius, box("periodic", lower, upper), dimension)


def with_partners(
    places: NDArray[np.float64], radius: float, dimension: int, seed: int
) -> NDArray[np.float64]:
    """The places, and for each a partner at r (1 - 1e-6) and one at r (1 + 1e-6), any direction."""
    rng = np.random.default_rng(seed)
    way = rng.normal(size=places.shape)
    # Along an axis too, where a partner sits in the next cell or on its face.
    way[: len(way) // 2] = np.eye(3)[rng.integers(0, dimension, len(way) // 2)] * rng.choice(
        [-1, 1], (len(way) // 2, 1)
    )
    way[:, dimension:] = 0.0
    way /= np.linalg.norm(way, axis=1, keepdims=True)
    near, far = radius * (1.0 - EDGE), radius * (1.0 + EDGE)
    return np.concatenate([places, places + near * way, places + far * way])


def assert_edges_are_told(position: Positions, radius: float, bounds: Bounds, dimension: int) -> None:
    """Both sides of the radius are told right, and there are many such pairs."""
    kd, points = tree(position, bounds, dimension)
    # Far out, float32 places partners this coarsely; where they fall they must be told all the same.
    window = 3.0 * EDGE + 1e-7 * float(np.abs(position).max()) / radius
    close = kd.query_pairs(radius * (1.0 + window), output_type="ndarray")
    way = points[close[:, 0]] - points[close[:, 1]]
    if bounds.kind == "periodic":
        length = np.asarray(kd.boxsize)
        way -= length * np.round(way / length)
    off = np.linalg.norm(way, axis=1) / radius - 1.0
    assert np.count_nonzero((off < -UNDECIDED) & (off > -window)) > len(position) // 10
    assert np.count_nonzero((off > UNDECIDED) & (off < window)) > len(position) // 10
    ours = {tuple(pair) for pair in found(position, radius, bounds, dimension)}
    wrong = [
        (tuple(pair), value)
        for pair, value in zip(close.tolist(), off, strict=True)
        if abs(value) > UNDECIDED and (tuple(pair) in ours) != (value < 0.0)
    ]
    assert not wrong


@pytest.mark.parametrize("dimension", [2, 3])
@pytest.mark.parametrize("radius", [1.0, 0.37, 2.5e-3, 4000.0])
@pytest.mark.parametrize("kind", ["open", "contained"])
def test_pairs_at_the_radius_round_the_origin(radius: float, kind: str, dimension: int) -> None:
    """Positive and negative coordinates, the origin itself, and the faces of cells round it."""
    rng = np.random.default_rng(3)
    places = radius * rng.uniform(-1.0, 1.0, (120, 3))
    places[:40] = radius * grid_module.CELL_MARGIN * rng.integers(-1, 2, (40, 3))
    places[:, dimension:] = 0.0
    bounds = OPEN if kind == "open" else box(kind, -10.0 * radius, 10.0 * radius)
    position = with_partners(places, radius, dimension, 4).astype(np.float32)
    assert_edges_are_told(position, radius, bounds, dimension)


@pytest.mark.parametrize("dimension", [2, 3])
@pytest.mark.parametrize(
    ("lower", "upper", "radius"),
    [
        (0.0, 4.0, 1.0),
        (-4.0, 4.0, 1.0),
        (0.0, 7.3, 0.7),
        (-3.65, 3.65, 0.7),
        (-1.1, 2.3, 0.5),
        (0.0, 0.5, 0.01),
        (-128.0, 128.0, 1.0),
        (-33.3, 33.3, 0.9),
        (-0.5, 255.5, 1.0),
    ],
)
def test_pairs_at_the_radius_across_the_seam(
    lower: float, upper: float, radius: float, dimension: int
) -> None:
    """Places on and near the faces, edges and corners of a periodic box."""
    rng = np.random.default_rng(5)
    length = upper - lower
    places = rng.uniform(lower, upper, (120, 3))
    side = rng.integers(0, 3, places.shape)
    places = np.where(
        side == 0, lower + radius * rng.random(places.shape) * (rng.random(places.shape) < 0.7), places
    )
    places = np.where(side == 1, upper - radius * rng.random(places.shape), places)
    wrapped = lower + np.mod(with_partners(places, radius, dimension, 6) - lower, length)
    position = wrapped.astype(np.float32)
    position[(position >= np.float32(upper)) | (position < np.float32(lower))] = lower
    position[:, dimension:] = 0.0
    assert_edges_are_told(position, radius, box("periodic", lower, upper), dimension)


@pytest.mark.parametrize("dimension", [2, 3])
@pytest.mark.parametrize("kind", ["open", "contained", "periodic"])
def test_coincident_points_are_neighbours(kind: str, dimension: int) -> None:
    """Many in one place, on a corner of cells and inside one; each sees all the others once."""
    position = np.repeat(scattered(20, 0.0, 8.0, dimension), 15, axis=0)
    position[:15] = 0.0
    assert_same_pairs(position, 2.0, OPEN if kind == "open" else box(kind, 0.0, 8.0), dimension)


@pytest.mark.parametrize("dimension", [2, 3])
@pytest.mark.parametrize("kind", ["open", "contained", "periodic"])
def test_all_in_one_cell_and_one_far_away(kind: str, dimension: int) -> None:
    position = scattered(400, 0.1, 0.9, dimension)
    position[-1, :dimension] = 63.0
    assert_same_pairs(position, 1.0, OPEN if kind == "open" else box(kind, 0.0, 64.0), dimension)


@pytest.mark.parametrize("dimension", [2, 3])
def test_lopsided_cells(dimension: int) -> None:
    """Density falls over four decades along an axis."""
    position = scattered(1500, 0.0, 8.0, dimension)
    position[:, 0] = 200.0 * (position[:, 0] / 8.0) ** 6
    assert_same_pairs(position, 0.5, OPEN, dimension)
    assert_same_pairs(position, 0.5, box("contained", 0.0, 200.0), dimension)
    assert_same_pairs(np.minimum(position, np.float32(199.99)), 0.5, box("periodic", 0.0, 200.0), dimension)


@pytest.mark.parametrize("dimension", [2, 3])
def test_open_space_far_larger_than_the_table_of_cells(dimension: int) -> None:
    """Far apart places share a cell: clumps that meet in the table are no neighbours."""
    count = 400
    table = NeighborGrid(count, dimension, OPEN, 1.0).cells[0] * grid_module.CELL_MARGIN
    rng = np.random.default_rng(8)
    clump = rng.integers(-40, 41, (count, 3)) * (rng.random((count, 1)) < 0.9)
    position = (clump * table + rng.uniform(0.0, 3.0, (count, 3))).astype(np.float32)
    position[:, dimension:] = 0.0
    assert len(expected(position, 1.0, OPEN, dimension)) > 20
    assert_same_pairs(position, 1.0, OPEN, dimension)


def test_pairs_far_from_the_corner() -> None:
    """Partners just a radius apart along x, hundreds of thousands of cells from an odd corner."""
    radius, rng = 0.0744, np.random.default_rng(9)
    position = np.zeros((2000, 3), np.float32)
    position[:1000, 0] = rng.uniform(0.0, 24700.0, 1000)
    position[1000:, 0] = position[:1000, 0] + radius * rng.uniform(0.99, 1.0, 1000)
    assert_same_pairs(position, radius, box("contained", -38486.6, 24700.1), 3)


def test_pairs_on_the_lattice_of_cells() -> None:
    """Every particle on a corner where eight cells meet; partners one cell on, just inside the radius."""
    side = np.float32(grid_module.CELL_MARGIN)
    steps = np.arange(-4, 5)
    position = np.stack(np.meshgrid(steps, steps, steps), axis=-1).reshape(-1, 3).astype(np.float32) * side
    assert_same_pairs(position, 1.0, OPEN, 3)
    assert_same_pairs(position, float(side) * (1.0 + EDGE), OPEN, 3)
    assert_same_pairs(position, float(side) * 1.42, box("contained", -5.0, 5.0), 3)


def test_a_narrow_periodic_box_is_refused() -> None:
    with pytest.raises(SceneError, match=r"axis x is less than 3\.003 times"):
        NeighborGrid(10, 3, box("periodic", 0.0, 2.9), 1.0)


@pytest.mark.parametrize("kind", ["contained", "periodic"])
def test_a_large_box_costs_memory_for_particles_not_for_space(kind: str) -> None:
    """A thousand particles in a box of a billion radii cubed."""
    grid = NeighborGrid(1000, 3, box(kind, 0.0, 1000.0), 1.0)
    assert grid.memory_bytes() < 4_000_000
    position = scattered(1000, 0.0, 1000.0, 3)
    position[:300] = scattered(300, 0.0, 5.0, 3)
    assert_same_pairs(position, 1.0, box(kind, 0.0, 1000.0), 3)


def cells_of(grid: NeighborGrid) -> NDArray[np.int64]:
    """The cell of each place in storage."""
    start = grid.start.to_numpy()[: int(np.prod(grid.cells)) + 1]
    return np.repeat(np.arange(len(start) - 1), np.diff(start))


@pytest.mark.parametrize("count", [5000, MANY])
def test_the_sort_is_stable_from_the_order_before(count: int) -> None:
    columns, bounds = columns_of(scattered(count, 0.0, 10.0, 3)), box("contained", 0.0, 10.0)
    grid = NeighborGrid(count, 3, bounds, 1.0)
    rank = np.arange(count)
    for seed in (1, 2):
        position = scattered(count, 0.0, 10.0, 3, seed)
        columns.write("position", position)
        grid.sort(columns)
        ids, cells = columns.state()["id"][0], cells_of(grid)
        np.testing.assert_array_equal(np.sort(ids), np.arange(count))
        np.testing.assert_array_equal(columns.read("position"), position)
        same_cell = cells[1:] == cells[:-1]
        assert np.all(rank[ids][1:][same_cell] > rank[ids][:-1][same_cell])
        rank[ids] = np.arange(count)


@pytest.mark.parametrize("count", [3000, MANY])
@pytest.mark.parametrize("kind", ["open", "periodic"])
def test_the_number_of_tasks_changes_no_byte(kind: str, count: int, monkeypatch: pytest.MonkeyPatch) -> None:
    side = 0.6 * count ** (1 / 3)
    position = scattered(count, 0.0, side, 3)
    position[: count // 3] *= 0.2  # so that tasks are not alike
    results = []
    for tasks in (1, 2, 7):
        monkeypatch.setattr(grid_module, "workers", lambda tasks=tasks: (tasks, 512))
        columns = columns_of(position)
        lists = NeighborLists(count, 3, OPEN if kind == "open" else box(kind, 0.0, side), 0.5, 0.1)
        assert lists.grid.tasks == tasks
        lists.build(columns)
        results.append(
            (columns.state()["id"].tobytes(), lists.offset.to_numpy().tobytes(), rows_of(lists).tobytes())
        )
    assert results[0] == results[1] == results[2]


def test_permuting_the_input_permutes_the_result() -> None:
    position = scattered(2000, 0.0, 10.0, 3)
    shuffled = np.random.default_rng(2).permutation(2000)
    ours = found(position, 1.0, box("periodic", 0.0, 10.0), 3)
    again = found(position[shuffled], 1.0, box("periodic", 0.0, 10.0), 3)
    np.testing.assert_array_equal(ours, in_order(shuffled[again], 2000))


@pytest.mark.parametrize("dimension", [2, 3])
@pytest.mark.parametrize("kind", ["open", "contained", "periodic"])
def test_lists_with_a_skin_stay_complete_until_half_of_it_is_crossed(kind: str, dimension: int) -> None:
    radius, skin, count = 1.0, 0.2, 1500
    bounds = OPEN if kind == "open" else box(kind, -6.0, 6.0)
    position = scattered(count, -6.0, 6.0, dimension)
    columns = columns_of(position)
    lists = NeighborLists(count, dimension, bounds, radius, skin)
    assert lists.needs_rebuild(columns)
    assert lists.update(columns)
    np.testing.assert_array_equal(
        pairs_of(lists, columns), expected(position, radius + skin, bounds, dimension)
    )
    order = columns.state()["id"].copy()

    way = np.random.default_rng(3).normal(size=(count, 3))
    way[:, dimension:] = 0.0
    way *= 0.49 * skin / np.linalg.norm(way, axis=1, keepdims=True)
    moved = position + way.astype(np.float32)
    if kind == "periodic":
        moved[:, :dimension] = (np.mod(moved[:, :dimension] + 6.0, 12.0) - 6.0).astype(np.float32)
    columns.write("position", moved)
    assert not lists.update(columns)
    np.testing.assert_array_equal(columns.state()["id"], order)
    listed = {tuple(pair) for pair in pairs_of(lists, columns)}
    assert {tuple(pair) for pair in expected(moved, radius, bounds, dimension)} <= listed

    moved[7] = position[7]
    moved[7, :2] = position[7, :2] + np.array([0.51 * skin, 0.0], np.float32)
    columns.write("position", moved)
    assert lists.needs_rebuild(columns)
    assert lists.update(columns)
    np.testing.assert_array_equal(pairs_of(lists, columns), expected(moved, radius + skin, bounds, dimension))


def test_lists_grow_when_particles_crowd() -> None:
    """From no neighbours to everyone in one place: nothing is cut off."""
    count = 600
    columns = columns_of(scattered(count, 0.0, 1000.0, 3))
    lists = NeighborLists(count, 3, OPEN, 1.0, 0.1)
    lists.build(columns)
    assert lists.pairs < 10
    columns.write("position", scattered(count, 0.0, 0.4, 3))
    lists.build(columns)
    assert lists.pairs == count * (count - 1)


def test_restored_lists_are_those_that_were_in_use() -> None:
    """A run that resumes sums over the same rows, though the particles have moved since the build."""
    position = scattered(1000, 0.0, 8.0, 3)
    columns = columns_of(position)
    lists = NeighborLists(1000, 3, OPEN, 1.0, 0.4)
    lists.build(columns)
    columns.write("position", position + np.float32(0.1))
    saved, kept = lists.state(), columns.state()

    again, resumed = columns_of(position), NeighborLists(1000, 3, OPEN, 1.0, 0.4)
    again.restore(kept)
    resumed.restore(saved)
    np.testing.assert_array_equal(again.state()["id"], kept["id"])
    assert resumed.offset.to_numpy().tobytes() == lists.offset.to_numpy().tobytes()
    assert rows_of(resumed).tobytes() == rows_of(lists).tobytes()
    assert not resumed.needs_rebuild(again)


def test_lists_that_were_never_built_are_restored_as_such() -> None:
    lists = NeighborLists(5, 3, OPEN, 1.0, 0.4)
    lists.restore(NeighborLists(5, 3, OPEN, 1.0, 0.4).state())
    assert lists.needs_rebuild(columns_of(scattered(5, 0.0, 1.0, 3)))


@pytest.mark.parametrize("kind", ["open", "contained", "periodic"])
def test_pairs_follow_particles_that_come_and_go(kind: str) -> None:
    """Lists with room for more find the pairs of those that there are, and notice each change."""
    bounds = OPEN if kind == "open" else box(kind, 0.0, 12.0)
    columns = Columns(0, {"position": 3}, room=6000)
    lists = NeighborLists(6000, 3, bounds, 1.0, 0.1)
    rng = np.random.default_rng(4)
    for coming, share in ((0, 0.0), (2000, 0.0), (500, 0.4), (1, 0.99), (5000, 0.01)):
        columns.append(coming, {"position": rng.uniform(0.0, 12.0, (coming, 3)).astype(np.float32)})
        assert lists.update(columns) or coming == 0
        assert not lists.update(columns)
        columns.remove((rng.random(columns.count) >= share).astype(np.int32))
        assert lists.update(columns) == (share > 0.0)
        assert lists.count == lists.grid.count == columns.count
        ids = columns.state()["id"][0]
        rank = np.empty(columns.issued, np.int64)
        rank[np.sort(ids)] = np.arange(columns.count)
        owner = np.repeat(np.arange(columns.count), np.diff(lists.offset.to_numpy()[: columns.count + 1]))
        found_now = np.stack([rank[ids[owner]], rank[ids[rows_of(lists)]]], axis=1)
        np.testing.assert_array_equal(
            in_order(found_now, columns.count), expected(columns.read("position"), 1.1, bounds, 3)
        )


def test_lists_notice_an_exchange_of_particles() -> None:
    """One gone and another come in its place: neither number nor places tell."""
    columns = columns_with_room(scattered(40, 0.0, 3.0, 3))
    lists = NeighborLists(50, 3, OPEN, 1.0, 0.1)
    lists.build(columns)
    last = columns.state()["position"][:, -1]
    columns.remove(np.array([1] * 39 + [0], np.int32))
    columns.append(1, {"position": last[None]})
    assert lists.needs_rebuild(columns)


def test_a_grid_refuses_more_than_it_has_room_for() -> None:
    columns = columns_with_room(scattered(11, 0.0, 3.0, 3))
    with pytest.raises(ValueError, match="11 particles in a grid for 10"):
        NeighborGrid(10, 3, OPEN, 1.0).sort(columns)
