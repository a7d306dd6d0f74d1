"""What is bent at rest: meshes whose file is no plane.

    E = w/2 (|S x| - r)^2 = w/2 |S x|^2 - w r |S x| + const,     r = |S x| at rest

The square is in Q like all bending. The rest pushes along S x, with the constant strength w r: it keeps the
size of a bend, not its direction (Bouaziz et al. 2014, doi:10.1145/2601097.2601116, section 3.4).

Limits: the direction is that of the start of a step.
"""

from typing import Any

import numpy as np

from tianim.lang import f32_1d, f32_2d, f64_1d, f64_2d, i32_1d, i32_2d, ti
from tianim.systems.springs.arrays import constant
from tianim.systems.springs.assembly import Assembly
from tianim.systems.springs.points import Points


@ti.kernel
def find_bends(points: i32_2d, coefficient: f32_2d, strength: f32_1d, x: f64_2d, bend: f32_2d):
    """Write w r S x / |S x| of each difference [N]."""
    for s in range(points.shape[0]):
        d = ti.Vector([0.0, 0.0, 0.0], ti.f64)
        for p in range(points.shape[1]):
            i = points[s, p]
            d += coefficient[s, p] * ti.Vector([x[i, 0], x[i, 1], x[i, 2]])
        f = ti.cast(d, ti.f32)
        f *= strength[s] / ti.max(f.norm(), 1e-30)
        for c in ti.static(range(3)):
            bend[s, c] = f[c]


@ti.kernel
def keep_bent(
    n: ti.i32, start: i32_1d, which: i32_1d, coefficient: f32_1d, bend: f32_2d, inverse_mass: f64_1d,
    external: f64_2d,
):  # fmt: skip
    """Onto the points, as accelerations."""
    for i in range(n):
        f = ti.Vector([0.0, 0.0, 0.0])
        for e in range(start[i], start[i + 1]):
            s = which[e]
            f += coefficient[e] * ti.Vector([bend[s, 0], bend[s, 1], bend[s, 2]])
        for c in ti.static(range(3)):
            external[i, c] += inverse_mass[i] * f[c]


class Curvature:
    """All differences that are not zero at rest."""

    def __init__(self, whole: Assembly) -> None:
        found = [
            (whole.first[name], piece.curved)
            for name, piece in whole.pieces.items()
            if piece.curved is not None
        ]
        self.count = sum(len(curved.weight) for _, curved in found)
        if not self.count:
            return
        points = np.concatenate([curved.points + first for first, curved in found]).astype(np.int32)
        coefficient = np.concatenate([curved.coefficient for _, curved in found])
        strength = np.concatenate([curved.weight * curved.length for _, curved in found])
        order = np.argsort(points.ravel(), kind="stable")
        start = np.searchsorted(points.ravel()[order], np.arange(whole.count + 1))
        self._points, self._start = constant(points), constant(start)
        self._which = constant(order // points.shape[1])
        self._coefficient, self._strength = constant(coefficient), constant(strength)
        self._own = constant(coefficient.ravel()[order])
        self._bend: Any = ti.ndarray(ti.f32, (self.count, 3))

    def push(self, points: Points) -> None:
        """Add what keeps meshes bent to the accelerations of `points`."""
        if self.count:
            find_bends(self._points, self._coefficient, self._strength, points.x, self._bend)
            keep_bent(
                points.count, self._start, self._which, self._own, self._bend, points.inverse_mass,
                points.external,
            )  # fmt: skip
