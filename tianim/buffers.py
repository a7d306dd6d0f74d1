"""Large arrays in memory that other processes can see, used again when nobody holds them.

The frames of a run are made, handed to the process that writes them, and forgotten. Fresh pages
for each would cost as much as filling them (28 MB: 5 ms), and copying them into shared memory as
much again; an array from here lies in shared memory already, on pages that were used before.

The memory has no name (memfd, or a deleted file where there is none): it goes when the last
process that has it goes, however that ends. An array's memory is used again when the array and
all views of it are gone.
"""

import mmap
import os
import tempfile
import weakref
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import DTypeLike, NDArray

# Smaller arrays are left to the allocator, which keeps its pages by itself.
SMALLEST = 1 << 20
# Room for growth, so that a growing array does not need new memory every frame.
GROWTH = 1.25
# Memory that nobody holds is kept for so many arrays.
SPARE = 12
# Each costs a file descriptor, of which a process may have 1,024: whoever keeps more gets plain arrays.
MOST = 256


@dataclass(eq=False)
class Buffer:
    """Memory that may be sent to another process by its descriptor."""

    descriptor: int
    memory: mmap.mmap

    @property
    def closed(self) -> bool:
        """Whether it was given back."""
        return self.memory.closed

    def close(self) -> None:
        """Give it back to the system."""
        self.memory.close()
        os.close(self.descriptor)


_spare: list[Buffer] = []
_held: dict[int, Buffer] = {}


def new_array(shape: Sequence[int], dtype: DTypeLike) -> NDArray[Any]:
    """An array with any contents, as `np.empty`; a large one lies in memory that can be shared."""
    size = int(np.prod(shape)) * np.dtype(dtype).itemsize
    buffer = _take(size) if size >= SMALLEST else None
    if buffer is None:
        return np.empty(shape, dtype)
    whole = np.frombuffer(buffer.memory, np.uint8)
    _held[id(whole)] = buffer
    weakref.finalize(whole, _give_back, id(whole)).atexit = False
    return whole[:size].view(dtype).reshape(shape)


def buffer_of(array: NDArray[Any]) -> tuple[Buffer, int] | None:
    """Where `array`, or a view of it, lies: the buffer and the offset in bytes; None for a plain one."""
    whole = array.base
    if not isinstance(whole, np.ndarray) or id(whole) not in _held:
        return None
    return _held[id(whole)], _address(array) - _address(whole)


def _address(array: NDArray[Any]) -> int:
    return int(array.__array_interface__["data"][0])


def _take(size: int) -> Buffer | None:
    fitting = [one for one in _spare if size <= len(one.memory) <= 2 * GROWTH * size]
    if fitting:
        best = min(fitting, key=lambda one: len(one.memory))
        _spare.remove(best)
        return best
    if len(_held) >= MOST:
        return None
    try:
        return _new_buffer(int(size * GROWTH))
    except OSError:
        return None  # no memory to share: a plain array may still have room


def _new_buffer(size: int) -> Buffer:
    if hasattr(os, "memfd_create"):
        descriptor = os.memfd_create("tianim-array")
    else:
        with tempfile.TemporaryFile() as file:
            descriptor = os.dup(file.fileno())
    try:
        os.ftruncate(descriptor, size)
        if hasattr(os, "posix_fallocate"):
            # Now, so that a lack of memory is an error here and not a fatal signal later.
            os.posix_fallocate(descriptor, 0, size)
        return Buffer(descriptor, mmap.mmap(descriptor, size))
    except BaseException:
        os.close(descriptor)
        raise


def _give_back(key: int) -> None:
    _spare.append(_held.pop(key))
    if len(_spare) > SPARE:
        _spare.pop(0).close()
