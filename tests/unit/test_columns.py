"""Columns: arrays that are sorted together come back in id order; checkpoints hold storage order."""

import numpy as np
import pytest
from numpy.typing import NDArray

from tianim.errors import SceneError
from tianim.lang import ti
from tianim.spatial.columns import PAGE, STAGGER, Columns, staggered

WIDTHS = {"position": 3, "velocity": 3, "heat": 1, "kind": -1, "pair": -2}
# Capacities of a page and around it; a thousand is beside no boundary.
COUNTS = [0, 1, 2, 1000, PAGE - 1, PAGE, PAGE + 1]


def filled(count: int) -> tuple[Columns, dict[str, NDArray[np.generic]]]:
    """Columns with random values, and the values."""
    rng = np.random.default_rng(count)
    columns = Columns(count, WIDTHS)
    values: dict[str, NDArray[np.generic]] = {}
    for name, width in WIDTHS.items():
        shape = columns.shape(name)
        values[name] = (
            rng.random(shape, np.float32) if width > 0 else rng.integers(-9, 9, shape).astype(np.int32)
        )
        columns.write(name, values[name])
    return columns, values


def moved(columns: Columns, order: NDArray[np.int32]) -> None:
    """Move particle i to order[i]."""
    destination = ti.ndarray(ti.i32, columns.capacity)
    padded = np.zeros(columns.capacity, np.int32)
    padded[: columns.count] = order
    destination.from_numpy(padded)
    columns.permute(destination)


def assert_holds(columns: Columns, values: dict[str, NDArray[np.generic]]) -> None:
    for name, value in values.items():
        got = columns.read(name)
        assert got.dtype == columns.dtype(name)
        np.testing.assert_array_equal(got, value)


@pytest.mark.parametrize("count", COUNTS)
def test_what_was_written_is_read_through_any_sorts(count: int) -> None:
    columns, values = filled(count)
    rng = np.random.default_rng(1)
    np.testing.assert_array_equal(columns.read("id"), np.arange(count))
    for _ in range(3):
        moved(columns, rng.permutation(count).astype(np.int32))
        assert_holds(columns, values)
        np.testing.assert_array_equal(columns.read("id"), np.arange(count))


def test_what_is_written_after_a_sort_is_read() -> None:
    columns, _ = filled(1000)
    moved(columns, np.random.default_rng(5).permutation(1000).astype(np.int32))
    values = filled(1000)[1]
    values = {name: value[::-1].copy() for name, value in values.items()}
    for name, value in values.items():
        columns.write(name, value)
    assert_holds(columns, values)


@pytest.mark.parametrize("count", [1, 1000])
def test_the_permutation_is_the_one_asked_for(count: int) -> None:
    columns, values = filled(count)
    order = np.random.default_rng(2).permutation(count).astype(np.int32)
    moved(columns, order)
    stored = columns.state()
    np.testing.assert_array_equal(stored["id"][0][order], np.arange(count))
    np.testing.assert_array_equal(stored["position"][:, order].T, values["position"])


@pytest.mark.parametrize("count", COUNTS)
def test_a_checkpoint_holds_the_storage_order(count: int) -> None:
    columns, values = filled(count)
    moved(columns, np.random.default_rng(3).permutation(count).astype(np.int32))
    saved = columns.state()
    again = Columns(count, WIDTHS)
    again.restore(saved)
    assert_holds(again, values)
    for name, array in again.state().items():
        assert array.shape == (abs(columns.widths[name]), count)
        assert array.tobytes() == saved[name].tobytes()


def test_a_state_is_a_copy() -> None:
    columns, values = filled(10)
    saved = columns.state()
    saved["position"][:] = 7.0
    assert_holds(columns, values)


def test_values_in_id_order_are_scattered_into_storage_order() -> None:
    columns, values = filled(50)
    moved(columns, np.random.default_rng(4).permutation(50).astype(np.int32))
    target = ti.ndarray(ti.f32, (3, columns.capacity))
    columns.scatter(np.asarray(values["velocity"], np.float32), target)
    np.testing.assert_array_equal(target.to_numpy()[:, :50], columns.state()["velocity"])


@pytest.mark.parametrize("count", [0, 1, PAGE - STAGGER, PAGE, 10_000, 1_000_000])
def test_rows_do_not_start_on_the_same_cache_sets(count: int) -> None:
    """Rows lie whole pages plus STAGGER floats apart."""
    capacity = staggered(count)
    assert capacity >= count
    assert capacity % PAGE == STAGGER


def test_bytes_of_a_particle_are_those_of_its_arrays() -> None:
    columns = Columns(100_000, WIDTHS)
    held = sum(array.nbytes for array in columns.state().values())
    assert columns.bytes_per_particle() * 100_000 == 2 * held


class Twin:
    """What columns must hold, as a dictionary from id to values."""

    def __init__(self) -> None:
        self.rng = np.random.default_rng(6)
        self.columns = Columns(0, WIDTHS, room=400)
        self.values: dict[int, dict[str, NDArray[np.generic]]] = {}
        self.issued = 0

    def append(self, count: int) -> None:
        new = {
            name: self.rng.integers(-99, 99, (count, abs(width))).astype(self.columns.dtype(name))
            for name, width in WIDTHS.items()
        }
        self.columns.append(count, new)
        for k in range(count):
            self.values[self.issued + k] = {name: value[k] for name, value in new.items()}
        self.issued += count

    def remove(self, share: float) -> None:
        keep = (self.rng.random(self.columns.count) > share).astype(np.int32)
        ids = self.columns.state()["id"][0]
        assert self.columns.remove(keep) == len(keep) - keep.sum()
        for k in ids[keep == 0]:
            del self.values[int(k)]
        np.testing.assert_array_equal(self.columns.state()["id"][0], ids[keep == 1])

    def sort(self) -> None:
        moved(self.columns, self.rng.permutation(self.columns.count).astype(np.int32))

    def check(self, columns: Columns) -> None:
        ids = sorted(self.values)
        assert columns.count == len(ids)
        np.testing.assert_array_equal(columns.read("id"), np.array(ids, np.int32))
        for name in WIDTHS:
            wanted = [self.values[k][name] for k in ids]
            np.testing.assert_array_equal(
                columns.read(name), np.reshape(wanted, columns.shape(name)).astype(columns.dtype(name))
            )


def test_particles_come_and_go() -> None:
    """Through any order of sorts, arrivals and departures each id keeps its values, and none comes twice."""
    twin = Twin()
    for count, share in ((0, 0.0), (120, 0.0), (30, 0.5), (60, 0.1), (1, 1.0), (5, 0.0), (250, 0.3)):
        twin.append(count)
        twin.check(twin.columns)
        twin.sort()
        twin.check(twin.columns)
        twin.remove(share)
        twin.check(twin.columns)
    assert twin.columns.issued == twin.issued == 466


def test_what_is_written_and_scattered_goes_by_ids_that_have_gaps() -> None:
    twin = Twin()
    twin.append(50)
    twin.sort()
    twin.remove(0.4)
    columns = twin.columns
    heat = np.arange(columns.count, dtype=np.float32)
    columns.write("heat", heat)
    np.testing.assert_array_equal(columns.read("heat"), heat)
    target = ti.ndarray(ti.f32, (1, columns.capacity))
    columns.scatter(heat[:, None], target)
    np.testing.assert_array_equal(target.to_numpy()[:, : columns.count], columns.state()["heat"])


def test_a_checkpoint_restores_another_number_of_particles() -> None:
    """Also the ids that were given: a particle that is gone must not come back as another."""
    twin = Twin()
    twin.append(90)
    twin.sort()
    twin.remove(0.5)
    saved = twin.columns.state()
    again = Columns(10, WIDTHS, room=400)
    again.restore(saved)
    twin.check(again)
    again.append(3, {})
    np.testing.assert_array_equal(again.read("id")[-3:], [90, 91, 92])
    np.testing.assert_array_equal(again.read("heat")[-3:], 0.0)
    with pytest.raises(SceneError, match="there is room for 20"):
        Columns(0, WIDTHS, room=20).restore(saved)


def test_columns_without_room_keep_their_number() -> None:
    columns, _ = filled(10)
    assert set(columns.state()) == set(columns.widths)
    with pytest.raises(ValueError, match="room for 10"):
        columns.append(1, {})
    for other in (9, 11):
        with pytest.raises(SceneError, match=f"of {other} particles; there is room for 10"):
            columns.restore(filled(other)[0].state())


def test_changes_tell_of_arrivals_and_departures_alone() -> None:
    twin = Twin()
    seen = []
    for action in (
        lambda: twin.append(0), lambda: twin.append(5), twin.sort, lambda: twin.remove(0.0),
        lambda: twin.remove(1.0),
    ):  # fmt: skip
        action()
        seen.append(twin.columns.changes)
    assert seen == [0, 1, 1, 1, 2]
