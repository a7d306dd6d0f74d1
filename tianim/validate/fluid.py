"""Fluids, the ground they stand on: the smoothing kernel as compiled, and sums over a lattice.

Larger cases: `fluid_columns` (water at rest), `fluid_dam_break`, `fluid_flows` (vortices, waves, channels),
`fluid_drops` (momentum, falling, surface tension), `fluid_bodies` (buoyancy, shaken tanks, two liquids).
"""

from functools import lru_cache, partial

import numpy as np

from tianim.lang import f32_1d, ti
from tianim.math.smoothing import spline, spline_scale, spline_slope
from tianim.system import Bounds
from tianim.validate.case import Case
from tianim.validate.fluid_tanks import NONE, Floats, box, water

# Midpoints of q in (0, 1): the sum's own error is 1e-8.
SAMPLES = 4096
PERIODIC = Bounds("periodic", (0.0,) * 3, (1.0,) * 3)


@ti.kernel
def _evaluate(dimension: ti.template(), q: f32_1d, w: f32_1d, slope: f32_1d):
    for k in range(q.shape[0]):
        w[k] = spline(dimension, q[k])
        slope[k] = spline_slope(dimension, q[k])


@lru_cache(maxsize=2)
def compiled(dimension: int) -> tuple[Floats, Floats, Floats]:
    """q, w(q) and w'(q) at the midpoints of SAMPLES pieces."""
    arrays = [ti.ndarray(ti.f32, SAMPLES) for _ in range(3)]
    arrays[0].from_numpy(((np.arange(SAMPLES) + 0.5) / SAMPLES).astype(np.float32))
    _evaluate(dimension, *arrays)
    q, w, slope = (array.to_numpy().astype(np.float64) for array in arrays)
    return q, w, slope


def integral(dimension: int) -> float:
    """Of W over its support, h = 1."""
    q, w, _ = compiled(dimension)
    shell = 2.0 * np.pi * q if dimension == 2 else 4.0 * np.pi * q**2
    return float(spline_scale(1.0, dimension) * (shell * w).mean())


def slope_integral(dimension: int) -> float:
    """Of -r dW/dr over the support and by the dimension, h = 1: what a field's gradient is weighted with."""
    q, _, slope = compiled(dimension)
    shell = 2.0 * np.pi * q if dimension == 2 else 4.0 * np.pi * q**2
    return float(-spline_scale(1.0, dimension) * (shell * q * slope).mean() / dimension)


def slope_error(dimension: int) -> float:
    """Largest difference of w' from central differences of w."""
    q, w, slope = compiled(dimension)
    return float(np.abs((w[2:] - w[:-2]) / (q[2:] - q[:-2]) - slope[1:-1]).max())


def lattice_error(dimension: int) -> float:
    """Largest error of the relative density of water that fills a periodic box as it starts."""
    across = 20 if dimension == 2 else 10
    system = water(
        1.0 / across, {"all": box((0.0,) * dimension, (1.0,) * dimension)}, PERIODIC, gravity=NONE,
        dimension=dimension,
    )  # fmt: skip
    system.step(0.0, 1e-6)
    return float(np.abs(system.read("density") - 1.0).max())


CASES: tuple[Case, ...] = (
    *(
        Case("fluid", f"{name}, {dimension}D", partial(run, dimension), 1.0, "exact: the definition",
             tolerance=1e-6)
        for name, run in (
            ("integral of the smoothing kernel", integral), ("first moment of its gradient", slope_integral),
        )
        for dimension in (2, 3)
    ),
    *(
        Case(
            # Differences of float32 numbers over two samples: 1e-7 by 5e-4.
            "fluid", f"slope of the smoothing kernel against differences, {dimension}D",
            partial(slope_error, dimension), 1e-3, "exact: w'(q)", comparison="below",
        )
        for dimension in (2, 3)
    ),
    *(
        Case("fluid", f"a lattice of particles, {dimension}D: error of the density",
             partial(lattice_error, dimension), 1e-4, "exact: as much water as it stands for",
             comparison="below")
        for dimension in (2, 3)
    ),
)  # fmt: skip
