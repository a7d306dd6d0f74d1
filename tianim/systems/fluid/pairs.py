"""Pairs: every two particles nearer than the support radius, with the gradient of their kernel.

    G_ij = V grad_i W(x_i - x_j)   [1/m],      delta_i = sum_j V W_ij, itself included

One walk over the grid's tubes lists the neighbours of a particle and, while their places are at hand, the
gradients and the sum of the kernels: an iteration of a pressure solver then reads 16 bytes a pair and
computes no kernel. Each piece of the walk appends to a segment of its own, so that nothing is counted
beforehand; where a segment is too short the walk says so, all of them grow, and it is done again.

Along with them the moment m_i = - sum_j G_ij . x_ij / dimension, by which delta grows when all is pressed
together: the stress in the fluid is the mean of m P, and that is the pressure that is shown.

    row of particle i:  neighbour[begin[i] .. end[i]),   gradient[:, begin[i] .. end[i])

Each pair stands in both rows, a particle is not its own neighbour. The order within a row depends on the
order of storage alone, not on the number of threads; where a row lies does not matter to anybody.
"""

from typing import Any

import numpy as np

from tianim.errors import SceneError
from tianim.lang import f32_1d, f32_2d, i32_1d, i32_2d, ti
from tianim.math.smoothing import spline, spline_slope
from tianim.spatial.columns import staggered
from tianim.spatial.grid import NeighborGrid
from tianim.spatial.neighbor_lists import list_run, number_places
from tianim.spatial.tubes import (
    NX,
    PIECES,
    PLACES,
    STRIDE,
    TASKS,
    TURN,
    first_row,
    gather_tube,
    pieces,
    slice_of,
    take_turn,
)
from tianim.system import Bounds
from tianim.systems.fluid.particles import Particles

# Room of a segment over what it held last, and the least.
HEADROOM = 1.3
LEAST_ROOM = 1024
# Neighbours that a line of a task has room for at first; it grows to what is found.
LINE = 240
# A periodic box with so much of its volume in particles has no surface.
FULL = 0.97
MOST_PAIRS = (1 << 31) - 1
TINY = 1e-12  # [in h^2] keeps the direction of two particles in one place finite


@ti.kernel
def list_pairs(
    dimension: ti.template(),
    h: ti.f32,
    reach: ti.f32,
    scale: ti.f32,
    room: ti.i32,
    shape: i32_1d,
    geometry: f32_1d,
    start: i32_1d,
    x: f32_2d,
    place: i32_2d,
    scratch: f32_2d,
    tube: i32_2d,
    line: i32_2d,
    needed: i32_2d,
    begin: i32_1d,
    end: i32_1d,
    neighbour: i32_1d,
    gradient: f32_2d,
    density: f32_1d,
    moment: f32_1d,
):
    """Rows, gradients, densities and moments of all particles. `scale` is V s.

    needed[0, piece]: pairs of the piece; needed[1, piece]: its longest row. Nothing is written beyond
    `room` pairs a piece or the length of a line.
    """
    nx = shape[NX]
    shape[TURN] = 0
    for block in range(shape[TASKS] * shape[STRIDE]):
        if block % shape[STRIDE] == 0:
            task = block // shape[STRIDE]
            piece = take_turn(shape)
            while piece < pieces(shape):
                m, longest = 0, 0
                for row in range(first_row(piece, shape, start), first_row(piece + 1, shape, start)):
                    if start[row * nx + nx] == start[row * nx]:
                        continue
                    gather_tube(
                        dimension, PLACES, task, row, shape, geometry, start, x, x, place, scratch, tube
                    )
                    for column in range(nx):
                        cell, s = row * nx + column, slice_of(column, nx)
                        first, last = tube[task, s - 1], tube[task, s + 2]
                        for i in range(start[cell], start[cell + 1]):
                            me = tube[task, s] + i - start[cell]
                            near = 0
                            fits = last - first < line.shape[1]
                            if fits:
                                near = list_run(dimension, reach, scratch, me, first, last, task, line)
                            else:
                                near = last - first
                            longest = ti.max(longest, last - first)
                            at = piece * room + m
                            m += near
                            begin[i], end[i] = at, at
                            if fits and m <= room:
                                end[i] = at + near
                                total, stretched = spline(dimension, 0.0), 0.0
                                for k in range(near):
                                    j = line[task, k]
                                    neighbour[at + k] = ti.cast(scratch[6, j], ti.i32)
                                    dx, dy = (
                                        scratch[0, me] - scratch[0, j],
                                        scratch[1, me] - scratch[1, j],
                                    )
                                    dz = 0.0
                                    if ti.static(dimension == 3):
                                        dz = scratch[2, me] - scratch[2, j]
                                    r2 = dx * dx + dy * dy + dz * dz + TINY * h * h
                                    r = ti.sqrt(r2)
                                    total += spline(dimension, r / h)
                                    g = scale * spline_slope(dimension, r / h) / (h * r)
                                    gradient[0, at + k] = g * dx
                                    gradient[1, at + k] = g * dy
                                    gradient[2, at + k] = g * dz
                                    stretched += g * r2
                                density[i] = scale * total
                                moment[i] = -stretched / dimension
                needed[0, piece] = m
                needed[1, piece] = longest
                piece = take_turn(shape)


class Pairs:
    """Rows of neighbours of `particles`, for kernels: begin, end, neighbour, gradient.

    length     of the periodic box by axis [m], 0 where there is none, for `nearest_image`; lower: its corner
    """

    def __init__(self, particles: Particles, bounds: Bounds) -> None:
        self.particles = particles
        capacity = particles.columns.capacity
        self.grid = NeighborGrid(
            particles.columns.room, particles.dimension, bounds, particles.h, tagged=True
        )
        self.begin: Any = ti.ndarray(ti.i32, capacity)
        self.end: Any = ti.ndarray(ti.i32, capacity)
        self._place: Any = ti.ndarray(ti.i32, (1, capacity))
        number_places(capacity, self._place)
        self.length: Any = ti.ndarray(ti.f32, 3)
        self.lower: Any = ti.ndarray(ti.f32, 3)
        self._set_box(bounds)
        self._needed: Any = ti.ndarray(ti.i32, (2, self.grid.tasks * PIECES))
        self._line: Any = ti.ndarray(ti.i32, (self.grid.tasks, staggered(LINE)))
        self._reserve(LEAST_ROOM)

    def _set_box(self, bounds: Bounds) -> None:
        lower, length = np.zeros(3, np.float32), np.zeros(3, np.float32)
        if bounds.kind == "periodic" and bounds.lower is not None and bounds.upper is not None:
            length[:] = np.subtract(bounds.upper, bounds.lower)
            length[self.particles.dimension :] = 0.0
            lower[:] = bounds.lower
        self._space = float(np.prod(length[: self.particles.dimension], dtype=np.float64))
        self.lower.from_numpy(lower)
        self.length.from_numpy(length)

    def _reserve(self, room: int) -> None:
        """Segments of so many pairs."""
        total = room * self._needed.shape[1]
        if total > MOST_PAIRS:
            raise SceneError(f"fluid: {total:,} places for pairs of neighbours, at most {MOST_PAIRS:,}")
        self._room = room
        self.neighbour: Any = ti.ndarray(ti.i32, staggered(total))
        self.gradient: Any = ti.ndarray(ti.f32, (3, staggered(total)))

    @property
    def is_full(self) -> bool:
        """Whether space is periodic along all axes and full of fluid, so that there is no surface."""
        particles = self.particles
        filled = particles.count * particles.spacing**particles.dimension
        return 0.0 < FULL * self._space <= filled

    def build(self) -> None:
        """Put the particles into cell order and list their neighbours."""
        particles = self.particles
        self.grid.sort(particles.columns)
        while not self._list():
            pass

    def _list(self) -> bool:
        """One walk; False where there was not room enough, and now is."""
        particles, grid = self.particles, self.grid
        reach = particles.h**2
        list_pairs(
            particles.dimension, particles.h, reach, particles.volume * particles.scale,
            self._room, grid.shape, grid.geometry, grid.start, particles["position"], self._place,
            grid.scratch, grid.offset, self._line, self._needed, self.begin, self.end, self.neighbour,
            self.gradient, particles.density, particles.moment,
        )  # fmt: skip
        pairs, longest = (int(value) for value in self._needed.to_numpy().max(axis=1))
        enough = True
        if longest >= self._line.shape[1]:
            self._line = ti.ndarray(ti.i32, (grid.tasks, staggered(2 * longest)))
            enough = False
        if pairs > self._room:
            self._reserve(int(HEADROOM * pairs))
            enough = False
        return enough

    def memory_bytes(self) -> int:
        """Bytes of rows and grid."""
        return 4 * (self.neighbour.shape[0] + 3 * self.gradient.shape[1] + 4 * self.begin.shape[0]) + (
            self.grid.memory_bytes()
        )
