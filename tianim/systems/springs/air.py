"""What the air does to sheets: drag across and along each triangle, wind with gusts.

    F = rho / 2 A (C_n |u_n| u_n + C_t |u| u_t),    u = wind - velocity of the triangle

A third of it goes to each corner. Gusts are smooth noise: random velocities at the corners of a lattice that
drifts with the wind, joined by cubic steps; `gusts` is their root mean square over the wind's speed.

Limits: the air does not notice the sheet; it is taken at the start of a step, stable while
rho C |u| dt is less than four times the mass per area.
"""

from typing import Any

import numpy as np

from tianim.lang import f32_2d, f64_1d, f64_2d, i32_1d, i32_2d, ti
from tianim.math.random import normal3
from tianim.systems.springs.arrays import constant
from tianim.systems.springs.assembly import Assembly
from tianim.systems.springs.params import Air
from tianim.systems.springs.points import Points

# Steps and draws of the random numbers that are ours.
STREAM = 71
# Joined smoothly, three axes together, the lattice's unit variance falls to (26 / 35)^3 on average.
CALMED = (26.0 / 35.0) ** 1.5


@ti.func
def gust_at(seed, place):
    """Smooth noise at `place` [lattice cells], of unit variance in each component."""
    base = ti.floor(place)
    f = place - base
    f = f * f * (3.0 - 2.0 * f)
    total = ti.Vector([0.0, 0.0, 0.0])
    for corner in range(8):
        i, j, k = corner % 2, corner // 2 % 2, corner // 4
        w = ti.select(i == 1, f.x, 1.0 - f.x)
        w *= ti.select(j == 1, f.y, 1.0 - f.y)
        w *= ti.select(k == 1, f.z, 1.0 - f.z)
        x, y, z = ti.cast(base.x, ti.i32) + i, ti.cast(base.y, ti.i32) + j, ti.cast(base.z, ti.i32) + k
        total += w * normal3(seed, x, y, z * 128 + STREAM)
    return total / CALMED


@ti.kernel
def blow(
    triangles: i32_2d, rho: ti.f32, across: ti.f32, along: ti.f32, wx: ti.f32, wy: ti.f32, wz: ti.f32,
    gusts: ti.f32, cell: ti.f32, time: ti.f32, seed: ti.i32, x: f64_2d, v: f64_2d, force: f32_2d,
):  # fmt: skip
    """A third of the force of the air on each triangle [N]."""
    for t in range(triangles.shape[0]):
        a, b, c = triangles[t, 0], triangles[t, 1], triangles[t, 2]
        p = ti.Vector([x[a, 0], x[a, 1], x[a, 2]])
        e = ti.cast(ti.Vector([x[b, 0], x[b, 1], x[b, 2]]) - p, ti.f32)
        g = ti.cast(ti.Vector([x[c, 0], x[c, 1], x[c, 2]]) - p, ti.f32)
        n = e.cross(g)
        double = n.norm()
        n /= ti.max(double, 1e-20)
        u = ti.Vector([wx, wy, wz])
        if gusts > 0.0:
            drifted = ti.cast(p, ti.f32) - time * u
            u += gusts * u.norm() * gust_at(seed, drifted / cell) / ti.sqrt(3.0)
        for k in ti.static(range(3)):
            u[k] -= ti.cast(v[a, k] + v[b, k] + v[c, k], ti.f32) / 3.0
        un = u.dot(n)
        ut = u - un * n
        f = rho * 0.25 * double / 3.0 * (across * ti.abs(un) * un * n + along * u.norm() * ut)
        for k in ti.static(range(3)):
            force[t, k] = f[k]


@ti.kernel
def gather(n: ti.i32, start: i32_1d, triangle: i32_1d, force: f32_2d, inverse_mass: f64_1d, external: f64_2d):
    """Onto the points, as accelerations."""
    for i in range(n):
        f = ti.Vector([0.0, 0.0, 0.0])
        for e in range(start[i], start[i + 1]):
            t = triangle[e]
            f += ti.Vector([force[t, 0], force[t, 1], force[t, 2]])
        for c in ti.static(range(3)):
            external[i, c] += inverse_mass[i] * f[c]


class Sails:
    """All triangles of sheets and meshes, which the air meets."""

    def __init__(self, whole: Assembly, seed: int) -> None:
        found = [
            piece.triangles + whole.first[name]
            for name, piece in whole.pieces.items()
            if piece.open_to_air and len(piece.triangles)
        ]
        self.count = sum(len(triangles) for triangles in found)
        self._seed = seed
        if not self.count:
            return
        triangles = np.concatenate(found).astype(np.int32)
        corners = triangles.ravel()
        order = np.argsort(corners, kind="stable")
        start = np.searchsorted(corners[order], np.arange(whole.count + 1))
        self._triangles = constant(triangles)
        self._start, self._of_point = constant(start), constant(order // 3)
        self._force: Any = ti.ndarray(ti.f32, (self.count, 3))

    def blow(self, time: float, air: Air, points: Points) -> None:
        """Add what the air does to the accelerations of `points`."""
        if not self.count or air.density == 0.0 or (air.normal == 0.0 and air.tangential == 0.0):
            return
        blow(
            self._triangles, air.density, air.normal, air.tangential, *air.wind, air.gusts, air.gust_size,
            time, self._seed, points.x, points.v, self._force,
        )  # fmt: skip
        gather(points.count, self._start, self._of_point, self._force, points.inverse_mass, points.external)
