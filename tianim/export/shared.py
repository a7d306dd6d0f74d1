"""Frames in memory that two processes share: copied in by one, seen in place by the other.

A frame travels as its skeleton, in which a `Place` in the shared memory stands for each array.
The memory has no name (memfd, or a deleted file where there is none): it goes when the last
process that has it goes, however that ends.
"""

import mmap
import os
import tempfile
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import cast

import numpy as np

from tianim.export.files import os_errors
from tianim.export.parts import map_arrays
from tianim.frame import Array, Frame

# Arrays start on cache lines.
ALIGNMENT = 64


@dataclass(frozen=True)
class Place:
    """Where an array lies in shared memory."""

    offset: int
    shape: tuple[int, ...]
    dtype: str


def new_memory(size: int) -> int:
    """A descriptor of `size` bytes of memory to share; OutputError where there is not so much."""
    with os_errors(Path("buffers for frames")):
        if hasattr(os, "memfd_create"):
            descriptor = os.memfd_create("tianim-frame")
        else:
            with tempfile.TemporaryFile() as file:
                descriptor = os.dup(file.fileno())
        os.ftruncate(descriptor, size)
        if hasattr(os, "posix_fallocate"):
            # Now, so that a lack of memory is an error here and not a fatal signal while copying.
            os.posix_fallocate(descriptor, 0, size)
    return descriptor


def size_of(frame: Frame) -> int:
    """Bytes of shared memory that `pack` needs."""
    end = 0

    def add(values: Array) -> Array:
        nonlocal end
        end = _aligned(end) + values.nbytes
        return values

    _map_frame(frame, add)
    return max(end, 1)


def pack(frame: Frame, memory: mmap.mmap) -> Frame:
    """Copy the arrays of `frame` into `memory`; gives the skeleton to send."""
    end = 0

    def place(values: Array) -> Array:
        nonlocal end
        where = Place(_aligned(end), values.shape, values.dtype.str)
        np.copyto(_view(memory, where), values)
        end = where.offset + values.nbytes
        return cast(Array, where)

    return _map_frame(frame, place)


def unpack(skeleton: Frame, memory: mmap.mmap) -> Frame:
    """The frame whose arrays lie in `memory`: valid until the next `pack` into it."""
    return _map_frame(skeleton, lambda where: _view(memory, cast(Place, where)))


def _aligned(offset: int) -> int:
    return -(-offset // ALIGNMENT) * ALIGNMENT


def _view(memory: mmap.mmap, where: Place) -> Array:
    count = int(np.prod(where.shape))
    return np.frombuffer(memory, where.dtype, count, where.offset if count else 0).reshape(where.shape)


def _map_frame(frame: Frame, function: Callable[[Array], Array]) -> Frame:
    return replace(frame, parts=tuple(map_arrays(part, function) for part in frame.parts))
