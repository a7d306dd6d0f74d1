"""Elastic solids of tetrahedra: stable neo-Hookean, with a viscous part that leaves rigid motion alone.

    Psi = mu/2 (I_C - 3) + lambda/2 (J - a)^2 - mu/2 log(I_C + 1),      a = 1 + 3 mu / (4 lambda)
    P = mu (1 - 1 / (I_C + 1)) F + lambda (J - a) dJ/dF + tau F (2 mu_0 E' + lambda_0 tr(E') I)
    f_a = -V P grad N_a,    F = sum_a x_a grad N_a,    E' = sym(F^T F')

Smith, De Goes and Kim 2018 (doi:10.1145/3180491): mu = 4/3 mu_0 and lambda = lambda_0 + 5/6 mu_0 of Lame's
constants give the small strains of linear elasticity, and what is turned inside out comes back. A quarter of
the mass of a tetrahedron is at each of its corners.

Limits: explicit steps. Tetrahedra of linear shape are too stiff in bending: the fewer cells in the thickness
of a beam, the more.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tianim.lang import f32_2d, f64_1d, f64_2d, i32_1d, i32_2d, ti
from tianim.systems.springs.arrays import constant
from tianim.systems.springs.built import Tetrahedra

Floats = NDArray[np.float64]
Ints = NDArray[np.int32]

# Columns of a tetrahedron's numbers behind grad N of its corners 1, 2, 3 [1/m]: volume [m3], mu, lambda [Pa]
# and damping [s].
VOLUME, MU, LAMBDA, TAU = 9, 10, 11, 12


@dataclass(frozen=True)
class Elements:
    """Tetrahedra with their gradients at rest: corners (t, 4), gradient (t, 4, 3) [1/m], volume (t,) [m3]."""

    corners: Ints
    gradient: Floats
    volume: Floats
    mu: Floats
    lame: Floats
    damping: Floats


def elements_of(x: Floats, solid: Tetrahedra) -> Elements:
    """The tetrahedra of a piece, its points at rest at `x` (n, 3)."""
    p = x[solid.corners]
    edges = p[:, 1:] - p[:, :1]  # rows are edges
    volume = np.linalg.det(edges) / 6.0
    inner = np.linalg.inv(edges).transpose(0, 2, 1)  # rows are gradients of N_1, N_2, N_3
    gradient = np.concatenate([-inner.sum(axis=1, keepdims=True), inner], axis=1)
    E, nu = solid.stiffness, solid.poisson
    count = len(solid.corners)
    mu = np.full(count, E / (2.0 * (1.0 + nu)))
    lame = np.full(count, E * nu / ((1.0 + nu) * (1.0 - 2.0 * nu)))
    return Elements(solid.corners, gradient, volume, mu, lame, np.full(count, solid.damping))


def energies(x: Floats, elements: Elements) -> Floats:
    """Elastic energy of each tetrahedron [J], 0 at rest."""
    mu, lam = 4.0 / 3.0 * elements.mu, elements.lame + 5.0 / 6.0 * elements.mu
    a = 1.0 + 0.75 * mu / lam
    F = np.einsum("tai,taj->tij", x[elements.corners], elements.gradient)
    squares, J = np.einsum("tij,tij->t", F, F), np.linalg.det(F)
    at_rest = 0.5 * lam * (1.0 - a) ** 2 - 0.5 * mu * np.log(4.0)
    density = 0.5 * mu * (squares - 3.0) + 0.5 * lam * (J - a) ** 2 - 0.5 * mu * np.log(squares + 1.0)
    return np.asarray(elements.volume * (density - at_rest))


def stretches(x: Floats, elements: Elements) -> Floats:
    """Principal strain of each tetrahedron that is largest in size, length over length at rest less 1."""
    F = np.einsum("tai,taj->tij", x[elements.corners], elements.gradient)
    principal = np.linalg.svd(F, compute_uv=False) - 1.0
    return np.asarray(np.take_along_axis(principal, np.abs(principal).argmax(axis=1)[:, None], axis=1)[:, 0])


def largest_omega2(elements: Elements, mass: Floats) -> Floats:
    """Upper bound of omega^2 of each point [1/s2], by the rows of the stiffness matrix at rest."""
    size = np.linalg.norm(elements.gradient, axis=2)
    each = (elements.volume * (elements.lame + 2.0 * elements.mu))[:, None] * size * size.sum(axis=1)[:, None]
    return np.asarray(np.bincount(elements.corners.ravel(), each.ravel(), len(mass)) / mass)


@ti.kernel
def find_stress(corners: i32_2d, given: f32_2d, x: f64_2d, v: f64_2d, force: f32_2d):
    """Forces on corners 1, 2, 3 of each tetrahedron [N]; corner 0 gets the opposite of their sum."""
    for t in range(corners.shape[0]):
        o = corners[t, 0]
        F = ti.Matrix([[0.0, 0.0, 0.0], [0.0, 0.0, 0.0], [0.0, 0.0, 0.0]])
        rate = ti.Matrix([[0.0, 0.0, 0.0], [0.0, 0.0, 0.0], [0.0, 0.0, 0.0]])
        for k in ti.static(range(3)):
            i = corners[t, k + 1]
            for c in ti.static(range(3)):
                d = ti.cast(x[i, c] - x[o, c], ti.f32)
                u = ti.cast(v[i, c] - v[o, c], ti.f32)
                for e in ti.static(range(3)):
                    F[c, e] += d * given[t, 3 * k + e]
                    rate[c, e] += u * given[t, 3 * k + e]
        mu, lam, tau = given[t, MU], given[t, LAMBDA], given[t, TAU]
        stiff, bulk = 4.0 / 3.0 * mu, lam + 5.0 / 6.0 * mu
        a, b, c = (
            F @ ti.Vector([1.0, 0.0, 0.0]),
            F @ ti.Vector([0.0, 1.0, 0.0]),
            F @ ti.Vector([0.0, 0.0, 1.0]),
        )
        bc, ca, ab = b.cross(c), c.cross(a), a.cross(b)
        J = a.dot(bc)
        squares = a.norm_sqr() + b.norm_sqr() + c.norm_sqr()
        P = stiff * (1.0 - 1.0 / (squares + 1.0)) * F
        pressure = bulk * (J - 1.0 - 0.75 * stiff / bulk)
        for k in ti.static(range(3)):
            P[k, 0] += pressure * bc[k]
            P[k, 1] += pressure * ca[k]
            P[k, 2] += pressure * ab[k]
        if tau > 0.0:
            strain = F.transpose() @ rate
            strain = 0.5 * (strain + strain.transpose())
            S = 2.0 * mu * strain
            for k in ti.static(range(3)):
                S[k, k] += lam * (strain[0, 0] + strain[1, 1] + strain[2, 2])
            P += tau * F @ S
        for k in ti.static(range(3)):
            for c in ti.static(range(3)):
                f = 0.0
                for e in ti.static(range(3)):
                    f -= P[c, e] * given[t, 3 * k + e]
                force[t, 3 * k + c] = given[t, VOLUME] * f


@ti.kernel
def add_stress(n: ti.i32, start: i32_1d, which: i32_1d, force: f32_2d, inverse_mass: f64_1d, a: f64_2d):
    """Onto the points, as accelerations; `which` is 4 t + corner."""
    for i in range(n):
        f = ti.Vector([0.0, 0.0, 0.0])
        for e in range(start[i], start[i + 1]):
            t, corner = which[e] // 4, which[e] % 4
            if corner > 0:
                f += ti.Vector([force[t, 3 * corner - 3], force[t, 3 * corner - 2], force[t, 3 * corner - 1]])
            else:
                for k in ti.static(range(3)):
                    f -= ti.Vector([force[t, 3 * k], force[t, 3 * k + 1], force[t, 3 * k + 2]])
        for c in ti.static(range(3)):
            a[i, c] += inverse_mass[i] * f[c]


class SolidForces:
    """The tetrahedra of a system as kernels see them."""

    def __init__(self, elements: Elements | None, count: int) -> None:
        self.count = 0 if elements is None else len(elements.corners)
        if elements is None or not self.count:
            return
        given = np.concatenate(
            [
                elements.gradient[:, 1:].reshape(-1, 9),
                np.stack([elements.volume, elements.mu, elements.lame, elements.damping], axis=1),
            ],
            axis=1,
        )
        order = np.argsort(elements.corners.ravel(), kind="stable")
        start = np.searchsorted(elements.corners.ravel()[order], np.arange(count + 1))
        self._corners, self._start = constant(elements.corners), constant(start)
        self._which, self._given = constant(order), constant(given)
        self._force: Any = ti.ndarray(ti.f32, (self.count, 9))

    def add(self, n: int, inverse_mass: Any, x: Any, v: Any, a: Any) -> None:
        """Add their accelerations to `a`."""
        if self.count:
            find_stress(self._corners, self._given, x, v, self._force)
            add_stress(n, self._start, self._which, self._force, inverse_mass, a)
