"""Mesh bodies: which distance grids are in the sample array, and which two keys are blended."""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tianim.lang import f32_1d, ti
from tianim.spatial.body_params import MeshSequence, TriangleMesh, check_surface, sequence_files
from tianim.spatial.body_shapes import Surface
from tianim.spatial.distance_grid import Grid, grid_about, sample_distance
from tianim.spatial.mesh_files import TriangleData, read_key

# Grids start at multiples of this many samples, so that a float32 names any start to 2^30.
BLOCK = 64


class Keys(NamedTuple):
    """First blocks of the grids before and after, share of the one after, keys a second [1/s]."""

    first: int
    second: int
    blend: float
    rate: float


@ti.kernel
def _store(samples: f32_1d, start: ti.i32, values: f32_1d):
    for i in range(values.shape[0]):
        samples[start + i] = values[i]


class MeshGrid:
    """The distance grids of one mesh body, from block `start` of the samples on.

    A mesh has one slot for a grid. A sequence has two, whatever its length: key n is in slot
    n % 2, and is read and measured when the time comes near it.
    """

    def __init__(self, body: TriangleMesh | MeshSequence, start: int) -> None:
        """Read the mesh, or all meshes of a sequence once. SceneError where one cannot be used."""
        self._body = body
        self._start = start
        self._files = (body.file,) if isinstance(body, TriangleMesh) else sequence_files(body.files)
        lower, upper = self._bounds()
        self.grid: Grid = grid_about(lower * body.scale, (upper - lower) * body.scale, body.resolution)
        self._slots: list[int | None] = [None] * min(len(self._files), 2)
        self._slot_blocks = -(-self.grid.count // BLOCK)
        self._place = (0, 0, 0.0, 0.0)

    @property
    def blocks(self) -> int:
        """Blocks of samples in use."""
        return len(self._slots) * self._slot_blocks

    def load(self, samples: Any, time: float) -> Keys:
        """Put the grids that `time` [s] needs into `samples`."""
        before, blend, rate = self._key(time)
        after = min(before + 1, len(self._files) - 1)
        self._place = (before, after, blend, rate)
        return Keys(self._slot(samples, before), self._slot(samples, after), blend, rate)

    def shape(self) -> Surface:
        """The triangles at the time last loaded, in the body's own axes, moving by the sequence."""
        before, after, blend, rate = self._place
        start = self._mesh(before)
        change = self._mesh(after).vertices - start.vertices
        scale = self._body.scale
        return Surface(scale * (start.vertices + blend * change), start.triangles, scale * rate * change)

    def _slot(self, samples: Any, key: int) -> int:
        slot = key % len(self._slots)
        block = self._start + slot * self._slot_blocks
        if self._slots[slot] != key:
            values = sample_distance(
                self._mesh(key), self.grid, self._body.scale, self._body.thickness == 0.0
            )
            _store(samples, block * BLOCK, values)
            self._slots[slot] = key
        return block

    def _key(self, time: float) -> tuple[int, float, float]:
        """Key at or before `time`, share of the next one, keys a second."""
        body, last = self._body, len(self._files) - 1
        if isinstance(body, TriangleMesh):
            return 0, 0.0, 0.0
        turns, phase = divmod(max(time, 0.0) * body.fps, last)
        rate = body.fps
        if body.repeat == "none" and turns > 0:
            return last, 0.0, 0.0
        if body.repeat == "pingpong" and turns % 2 == 1:
            phase, rate = last - phase, -body.fps
        before = min(int(phase), last - 1)
        return before, phase - before, rate

    def _mesh(self, key: int) -> TriangleData:
        return read_key(self._files[key], self._files[0])

    def _bounds(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Corners of the box that holds every key, in the files' unit."""
        check_surface(self._files[0], self._body)
        meshes = (self._mesh(key) for key in range(len(self._files)))
        lower, upper = np.array([(mesh.lower, mesh.lower + mesh.extent) for mesh in meshes]).transpose(
            1, 0, 2
        )
        return lower.min(axis=0), upper.max(axis=0)
