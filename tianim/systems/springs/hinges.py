"""Angular springs: two triangles that share an edge keep the angle between them.

    theta = atan2((n1 x n2) . e, n1 . n2),   torque -k (theta - theta_0) - c dtheta/dt
    f_i = torque dtheta/dx_i

a, b are the ends of the edge, c and d the corners beside it, n1 and n2 the normals of a b c and b a d, 0
where all is flat. The four gradients add up to nothing, and so do their moments: no hinge moves or turns the
whole (Bridson et al. 2003, doi:10.2312/SCA03/028-036).

Limits: of networks, a few of them, in explicit steps; sheets bend by `bend`, which is the same for small
angles.
"""

from typing import Any

import numpy as np

from tianim.lang import f32_2d, f64_1d, f64_2d, i32_2d, ti
from tianim.systems.springs.arrays import constant
from tianim.systems.springs.built import Floats, Hinges, Ints


@ti.func
def _place(x: ti.template(), i):
    return ti.Vector([x[i, 0], x[i, 1], x[i, 2]])


@ti.func
def opening(xa, xb, xc, xd):
    """Angle of a hinge and its slopes by the places of its points."""
    edge = xb - xa
    length = ti.max(edge.norm(), 1e-30)
    e = edge / length
    n1, n2 = edge.cross(xc - xa), (xd - xb).cross(edge)
    theta = ti.atan2(n1.cross(n2).dot(e), n1.dot(n2))
    u1, u2 = n1 / ti.max(n1.norm_sqr(), 1e-30), n2 / ti.max(n2.norm_sqr(), 1e-30)
    ga = -(xc - xb).dot(e) * u1 - (xd - xb).dot(e) * u2
    gb = -(xa - xc).dot(e) * u1 - (xa - xd).dot(e) * u2
    return theta, ga, gb, -length * u1, -length * u2


@ti.func
def turned_by(angle, before):
    """From one angle to another, the shorter way round."""
    by = angle - before
    return by - 2.0 * ti.math.pi * ti.floor(by / (2.0 * ti.math.pi) + 0.5)


@ti.kernel
def turn(count: ti.i32, points: i32_2d, given: f32_2d, inverse_mass: f64_1d, x: f64_2d, v: f64_2d, a: f64_2d):
    """Add to the accelerations what the hinges do, one after the other: they share points."""
    ti.loop_config(serialize=True)
    for h in range(count):
        pa, pb, pc, pd = points[h, 0], points[h, 1], points[h, 2], points[h, 3]
        theta, ga, gb, gc, gd = opening(_place(x, pa), _place(x, pb), _place(x, pc), _place(x, pd))
        rate = ga.dot(_place(v, pa)) + gb.dot(_place(v, pb)) + gc.dot(_place(v, pc)) + gd.dot(_place(v, pd))
        off = turned_by(theta, given[h, 1])
        torque = -given[h, 0] * off - given[h, 2] * rate
        for k in ti.static(range(3)):
            a[pa, k] += inverse_mass[pa] * torque * ga[k]
            a[pb, k] += inverse_mass[pb] * torque * gb[k]
            a[pc, k] += inverse_mass[pc] * torque * gc[k]
            a[pd, k] += inverse_mass[pd] * torque * gd[k]


class HingeForces:
    """The hinges of a system as kernels see them."""

    def __init__(self, hinges: Hinges) -> None:
        self.count = len(hinges.points)
        if self.count:
            self._points = constant(hinges.points)
            self._given = constant(np.stack([hinges.stiffness, hinges.angle, hinges.damping], axis=1))

    def add(self, inverse_mass: Any, x: Any, v: Any, a: Any) -> None:
        """Add their accelerations to `a`."""
        if self.count:
            turn(self.count, self._points, self._given, inverse_mass, x, v, a)


def hinge_angles(x: Floats, points: Ints) -> Floats:
    """Angle of each hinge [rad], 0 where flat; `points` (h, 4): ends of the edge, corners beside it."""
    a, b, c, d = (x[points[:, k]] for k in range(4))
    n1, n2 = np.cross(b - a, c - a), np.cross(a - b, d - b)
    e = (b - a) / np.linalg.norm(b - a, axis=1)[:, None]
    sine = np.einsum("ij,ij->i", np.cross(n1, n2), e)
    return np.asarray(np.arctan2(sine, np.einsum("ij,ij->i", n1, n2)))


def hinge_gradients(x: Floats, points: Ints) -> Floats:
    """Slope of each angle by the places of its points, (h, 4, 3) [rad/m]."""
    a, b, c, d = (x[points[:, k]] for k in range(4))
    n1, n2 = np.cross(b - a, c - a), np.cross(a - b, d - b)
    u1 = n1 / np.einsum("ij,ij->i", n1, n1)[:, None]
    u2 = n2 / np.einsum("ij,ij->i", n2, n2)[:, None]
    length = np.linalg.norm(b - a, axis=1)[:, None]
    e = (b - a) / length

    def along(p: Floats) -> Floats:
        return np.asarray(np.einsum("ij,ij->i", p, e)[:, None])

    return np.stack(
        [
            -along(c - b) * u1 - along(d - b) * u2,
            -along(a - c) * u1 - along(a - d) * u2,
            -length * u1,
            -length * u2,
        ],
        axis=1,
    )
