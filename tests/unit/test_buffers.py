"""Arrays in memory to share: where they lie, when their memory is used again, what bounds it."""

import gc
import mmap

import numpy as np
import pytest

from tianim import buffers
from tianim.buffers import SMALLEST, buffer_of, new_array

COUNT = SMALLEST // 12 + 1


@pytest.fixture(autouse=True)
def _nothing_spare() -> None:
    gc.collect()
    while buffers._spare:
        buffers._spare.pop().close()


def test_an_array_is_as_numpy_would_make_it() -> None:
    for shape, dtype in (
        ((COUNT, 3), np.float32),
        ((SMALLEST,), np.int32),
        ((0, 3), np.float64),
        ((5,), "u1"),
    ):
        made = new_array(shape, dtype)
        assert made.shape == shape
        assert made.dtype == dtype
        assert made.flags.c_contiguous
        assert made.flags.writeable
        assert (buffer_of(made) is not None) == (made.nbytes >= SMALLEST)


def test_another_mapping_sees_what_is_written() -> None:
    made = new_array((COUNT, 3), np.float32)
    made[:] = np.arange(COUNT * 3).reshape(COUNT, 3)
    part = made[7:]
    found = buffer_of(part)
    assert found is not None
    buffer, offset = found
    assert offset == 7 * 12
    with mmap.mmap(buffer.descriptor, 0, access=mmap.ACCESS_READ) as seen:
        again = np.frombuffer(seen, np.float32, part.size, offset).reshape(part.shape)
        assert (again == part).all()
        del again


def test_memory_is_used_again_only_when_every_view_is_gone() -> None:
    first = new_array((COUNT, 3), np.float32)
    first[:] = 1.0
    view = first[1:3].reshape(-1)[::2]
    del first
    gc.collect()
    second = new_array((COUNT, 3), np.float32)
    second[:] = 2.0
    assert (view == 1.0).all()
    before = buffer_of(view)
    assert before is not None
    del view
    gc.collect()
    third = new_array((COUNT, 3), np.float32)
    after = buffer_of(third)
    assert after is not None
    assert after[0] is before[0]


def test_a_much_smaller_array_does_not_hold_large_memory() -> None:
    large = new_array((10 * SMALLEST,), np.uint8)
    found = buffer_of(large)
    assert found is not None
    del large
    gc.collect()
    small = buffer_of(new_array((SMALLEST,), np.uint8))
    assert small is not None
    assert small[0] is not found[0]


def test_spare_memory_is_bounded_and_given_back() -> None:
    kept = [new_array((SMALLEST,), np.uint8) for _ in range(buffers.SPARE + 3)]
    held = len(buffers._held)
    kept.clear()
    gc.collect()
    assert len(buffers._held) == held - buffers.SPARE - 3
    assert len(buffers._spare) == buffers.SPARE


def test_whoever_keeps_very_many_arrays_gets_plain_ones(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(buffers, "MOST", len(buffers._held) + 2)
    kept = [new_array((SMALLEST,), np.uint8) for _ in range(4)]
    assert [buffer_of(one) is not None for one in kept] == [True, True, False, False]


def test_without_memory_to_share_arrays_are_plain(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(buffers.os, "posix_fallocate", refuse)
    made = new_array((SMALLEST,), np.uint8)
    assert buffer_of(made) is None
    assert len(made) == SMALLEST
