"""Constant numbers as kernels see them, rows of arrays as they take them, and copies."""

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from tianim.lang import f64_2d, ti


def constant(values: ArrayLike) -> Any:
    """An array of the compiler: int32 for whole numbers, float32 for others; one row where there is none."""
    given = np.asarray(values)
    whole = np.issubdtype(given.dtype, np.integer)
    array = ti.ndarray(ti.i32 if whole else ti.f32, (max(len(given), 1), *given.shape[1:]))
    if len(given):
        array.from_numpy(np.ascontiguousarray(given, np.int32 if whole else np.float32))
    return array


@ti.kernel
def copy(n: ti.i32, source: f64_2d, target: f64_2d):
    """Copy source into target; either may be NumPy's, ten times as fast as `to_numpy` of the other."""
    for i in range(n):
        for c in ti.static(range(3)):
            target[i, c] = source[i, c]


@ti.func
def triple(x: ti.template(), i):
    """Row i of x (n, 3)."""
    return ti.Vector([x[i, 0], x[i, 1], x[i, 2]])
