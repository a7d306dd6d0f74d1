"""The particles of a fluid: what every pressure solver and every force reads and writes.

    position [m], velocity [m/s]    (3, capacity), in storage order, sorted by cell
    warm     pressures [Pa] that the next solves start from: of the density and of the divergence
    phase    index into `rest_density` [kg/m^3]
    viscous  change of the velocity by viscosity in the last step [m/s]; only where the viscosity is implicit

All particles have the same `volume` V [m^dim], whatever their phase: d^dim over the sum of the kernel on
the cubic lattice, so that a resting lattice has the relative density delta = sum_j V W_ij = 1.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from tianim.lang import ti
from tianim.math.smoothing import lattice_sum, spline_scale
from tianim.spatial.columns import Columns

WIDTHS = {"position": 3, "velocity": 3, "warm": 2, "phase": -1}
CHANGE = "viscous"


class Particles:
    """State in `columns`, and what each step finds anew, in storage order.

    lightest      the least rest density of its phases [kg/m3]
    density       delta of each particle, walls included, (capacity,)
    moment        how delta grows with compression, 1 but for the disorder of the neighbours, (capacity,)
    pressure      what the methods solve for [Pa], (capacity,); moment times pressure is the fluid's
    acceleration  of all but pressure [m/s2], (3, capacity)
    """

    def __init__(
        self,
        room: int,
        dimension: int,
        spacing: float,
        support: float,
        rest_density: NDArray[np.float32],
        viscous: bool = False,
    ) -> None:
        """Room for so many particles, of which there are none yet; `viscous`: with that column."""
        self.dimension, self.spacing, self.h = dimension, spacing, support * spacing
        self.columns = Columns(0, {**WIDTHS, CHANGE: 3} if viscous else WIDTHS, room=room)
        capacity = self.columns.capacity
        self.scale = spline_scale(self.h, dimension)
        self.volume = spacing**dimension / lattice_sum(support, dimension)
        self.rest_density: Any = ti.ndarray(ti.f32, len(rest_density))
        self.rest_density.from_numpy(rest_density)
        self.lightest = float(rest_density.min())
        self.density: Any = ti.ndarray(ti.f32, capacity)
        self.moment: Any = ti.ndarray(ti.f32, capacity)
        self.pressure: Any = ti.ndarray(ti.f32, capacity)
        self.acceleration: Any = ti.ndarray(ti.f32, (3, capacity))
        for array in (self.density, self.moment, self.pressure, self.acceleration):
            array.fill(0.0)

    @property
    def count(self) -> int:
        """Live particles."""
        return self.columns.count

    def shown_pressure(self) -> NDArray[np.float32]:
        """The fluid's pressure [Pa], (n,), in storage order."""
        n = self.count
        return np.asarray(self.pressure.to_numpy()[:n] * self.moment.to_numpy()[:n])

    def in_id_order(self, values: NDArray[np.float32]) -> NDArray[np.float32]:
        """Values of a step, (n,), from storage order."""
        return np.asarray(values[np.argsort(self.columns["id"].to_numpy()[0, : self.count])])

    def __getitem__(self, name: str) -> Any:
        return self.columns[name]
