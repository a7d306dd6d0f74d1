"""A frame on its way to another process: its arrays stay where they are and are seen from there.

A frame travels as its skeleton, in which a `Place` stands for each array, and the buffers that
these lie in (`tianim.buffers`). Arrays that lie elsewhere are copied into a buffer of their own.
"""

import mmap
import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from tianim.buffers import SMALLEST, Buffer, buffer_of, new_array
from tianim.export.parts import map_arrays
from tianim.frame import Array, Frame

# Arrays start on cache lines.
ALIGNMENT = 64


@dataclass(frozen=True)
class Place:
    """Where an array lies: which of the parcel's buffers, and where in it [bytes]."""

    buffer: int
    offset: int
    shape: tuple[int, ...]
    dtype: str


@dataclass(frozen=True)
class Parcel:
    """A packed frame: its skeleton and buffers. While it is held, the buffers keep their contents."""

    skeleton: Frame
    buffers: tuple[Buffer, ...]
    contents: tuple[Array, ...]


def pack(frame: Frame) -> Parcel:
    """Pack `frame`: arrays that can be shared become read-only, the others are copied.

    What is small in all, or finds no shared memory, travels within the skeleton.
    """
    room = new_array((_unshared_bytes(frame),), np.uint8)
    end = 0
    buffers: list[Buffer] = []
    contents: list[Array] = []

    def place(values: Array) -> Array:
        nonlocal end
        if not _shared(values):
            if buffer_of(room) is None:
                return values
            copied = room[end : end + values.nbytes].view(values.dtype).reshape(values.shape)
            np.copyto(copied, values)
            end += _padded(values.nbytes)
            values = copied
        values.flags.writeable = False
        buffer, offset = cast(tuple[Buffer, int], buffer_of(values))
        if buffer not in buffers:
            buffers.append(buffer)
        contents.append(values)
        return cast(Array, Place(buffers.index(buffer), offset, values.shape, values.dtype.str))

    return Parcel(_map_frame(frame, place), tuple(buffers), tuple(contents))


def unpack(skeleton: Frame, memories: Sequence[mmap.mmap]) -> Frame:
    """The frame whose arrays lie in `memories`: valid while the parcel is held."""

    def view(where: Any) -> Array:
        if not isinstance(where, Place):
            return cast(Array, where)
        count = int(np.prod(where.shape))
        values: NDArray[Any] = np.frombuffer(memories[where.buffer], where.dtype, count, where.offset)
        return values.reshape(where.shape)

    return _map_frame(skeleton, view)


def map_memory(descriptor: int) -> mmap.mmap:
    """The memory behind a descriptor, for reading; the descriptor is closed."""
    try:
        return mmap.mmap(descriptor, 0, access=mmap.ACCESS_READ)
    finally:
        os.close(descriptor)


def _shared(values: Array) -> bool:
    return values.nbytes >= SMALLEST and values.flags.c_contiguous and buffer_of(values) is not None


def _unshared_bytes(frame: Frame) -> int:
    total = 0

    def add(values: Array) -> Array:
        nonlocal total
        total += 0 if _shared(values) else _padded(values.nbytes)
        return values

    _map_frame(frame, add)
    return total


def _padded(size: int) -> int:
    return -(-size // ALIGNMENT) * ALIGNMENT


def _map_frame(frame: Frame, function: Callable[[Array], Array]) -> Frame:
    return replace(frame, parts=tuple(map_arrays(part, function) for part in frame.parts))
