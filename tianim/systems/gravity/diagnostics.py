"""What is measured: sums over all stars in a fixed order, Lagrangian radii, profiles of a disk, faults.

    K = sum m v^2 / 2,   W = sum m phi / 2 + sum m phi_external,   virial ratio = 2 K / |sum m x . a|

The virial is that of Clausius, with places from the centre of mass: with softening, and in external
potentials, it is what a steady system balances, where W is not. Sums are made in float64 over
fixed pieces, the same for any number of threads.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tianim.lang import f64_1d, f64_2d, i32_1d, ti
from tianim.math.bits import INFINITY_BITS, size_bits
from tianim.spatial.tubes import share
from tianim.systems.gravity.external import field_at

Floats = NDArray[np.float64]

PIECES = 64
# Rows of what `sums` adds up.
MASS, MOMENTUM, PLACE, ANGULAR = 0, 1, 4, 7
KINETIC, OWN, EXTERNAL, VIRIAL, PULL, SPEED = 10, 11, 12, 13, 14, 17
SUMS = 18
# Stars fewer than this in a ring say nothing of a dispersion.
FEWEST = 3
# pi G Sigma over sigma kappa at Q = 1 for stars (Toomre 1964).
TOOMRE = 3.36


@ti.kernel
def sums(
    n: ti.i32,
    stride: ti.i32,
    rows: f64_2d,
    count: ti.i32,
    x: f64_2d,
    v: f64_2d,
    mass: f64_1d,
    a: f64_2d,
    phi: f64_1d,
    out: f64_2d,
):
    """Sums over fixed pieces of the stars, as the rows above say."""
    for block in range(PIECES * stride):
        if block % stride == 0:
            piece = block // stride
            total = ti.Vector([0.0] * SUMS, ti.f64)
            for i in range(share(n, piece, PIECES), share(n, piece + 1, PIECES)):
                m = mass[i]
                v2, xa = ti.cast(0, ti.f64), ti.cast(0, ti.f64)
                for c in ti.static(range(3)):
                    total[MOMENTUM + c] += m * v[c, i]
                    total[PLACE + c] += m * x[c, i]
                    total[PULL + c] += m * a[c, i]
                    e, f = ti.static((c + 1) % 3, (c + 2) % 3)
                    total[ANGULAR + c] += m * (x[e, i] * v[f, i] - x[f, i] * v[e, i])
                    v2 += v[c, i] * v[c, i]
                    xa += x[c, i] * a[c, i]
                total[MASS] += m
                total[KINETIC] += 0.5 * m * v2
                total[OWN] += 0.5 * m * phi[i]
                if count > 0:
                    total[EXTERNAL] += m * field_at(rows, count, x[0, i], x[1, i], x[2, i])[3]
                total[VIRIAL] += m * xa
                total[SPEED] += m * ti.sqrt(v2)
            for c in ti.static(range(SUMS)):
                out[piece, c] = total[c]


@ti.kernel
def first_fault(n: ti.i32, bound: ti.f32, x: f64_2d, v: f64_2d, fault: i32_1d):
    """fault[0]: the lowest id that is not finite, fault[1]: that is beyond `bound`; n: none."""
    fault[0] = n
    fault[1] = n
    most = size_bits(bound)
    for i in range(n):
        worst = 0
        for c in ti.static(range(3)):
            worst = ti.max(worst, size_bits(x[c, i]), size_bits(v[c, i]))
        if worst >= INFINITY_BITS:
            ti.atomic_min(fault[0], i)
        elif worst > most:
            ti.atomic_min(fault[1], i)


class Totals(NamedTuple):
    """What the sums say, in own units.

    energies of motion, of the stars' own pull and of external potentials; virial: sum m x . a from the
    centre of mass; speed: sum m |v|.
    """

    mass: float
    centre: Floats
    momentum: Floats
    angular_momentum: Floats
    kinetic: float
    own: float
    external: float
    virial: float
    speed: float

    @property
    def energy(self) -> float:
        """Kinetic and potential."""
        return self.kinetic + self.own + self.external

    @property
    def virial_ratio(self) -> float:
        """2 K / |virial|; 0 where nothing pulls."""
        return 2.0 * self.kinetic / abs(self.virial) if self.virial else 0.0


def totals(pieces: Floats) -> Totals:
    """Of the sums of each piece, (PIECES, SUMS)."""
    total = pieces.sum(axis=0)
    mass = float(total[MASS])
    centre = total[PLACE : PLACE + 3] / (mass or 1.0)
    return Totals(
        mass,
        centre,
        total[MOMENTUM : MOMENTUM + 3],
        total[ANGULAR : ANGULAR + 3],
        float(total[KINETIC]),
        float(total[OWN]),
        float(total[EXTERNAL]),
        float(total[VIRIAL] - centre @ total[PULL : PULL + 3]),
        float(total[SPEED]),
    )


def lagrangian_radii(
    position: Floats, mass: Floats, fractions: Sequence[float], centre: Floats | None = None
) -> Floats:
    """Radii about the centre of mass (or `centre`) that hold these fractions of the mass; (n, 3), (n,)."""
    total = float(mass.sum())
    if not total > 0.0:
        return np.zeros(len(fractions))
    if centre is None:
        centre = mass @ position / total
    radius = np.sqrt(np.square(position - centre).sum(axis=1))
    order = np.argsort(radius, kind="stable")
    inside = np.cumsum(mass[order])
    found = np.searchsorted(inside, np.asarray(fractions) * inside[-1] * (1.0 - 1e-12))
    return np.asarray(radius[order[np.minimum(found, len(order) - 1)]])


class DiskProfile(NamedTuple):
    """A disk in rings, each (m,): middle radius, mean speed round the axis, surface density, Toomre's Q.

    circular is the speed of a circular orbit, from the mean pull inwards.
    """

    radius: Floats
    rotation: Floats
    circular: Floats
    surface_density: Floats
    toomre_q: Floats


def disk_profile(
    position: Floats, velocity: Floats, mass: Floats, acceleration: Floats, edges: Floats, g: float
) -> DiskProfile:
    """Of stars about their centre of mass, in the plane across their angular momentum, in rings.

    Q = sigma_R kappa / (3.36 G Sigma) with kappa^2 = R dOmega^2/dR + 4 Omega^2, Omega from the mean
    pull inwards in each ring. Rings with fewer than FEWEST stars have Q = 0.
    """
    total = mass.sum()
    x = position - mass @ position / total
    v = velocity - mass @ velocity / total
    pull = acceleration - mass @ acceleration / total
    spin = (mass[:, None] * np.cross(x, v)).sum(axis=0)
    size = np.linalg.norm(spin)
    axis = spin / size if size > 0.0 else np.array([0.0, 1.0, 0.0])
    flat = x - np.outer(x @ axis, axis)
    radius = np.linalg.norm(flat, axis=1)
    outward = flat / np.maximum(radius, np.finfo(np.float64).tiny)[:, None]
    around = np.cross(axis, outward)
    ring = np.digitize(radius, edges) - 1
    inside = (ring >= 0) & (ring < len(edges) - 1)
    ring, count = ring[inside], len(edges) - 1
    stars = np.bincount(ring, minlength=count)
    weight = np.bincount(ring, mass[inside], count)
    safe = np.where(weight > 0.0, weight, 1.0)

    def mean(values: Floats) -> Floats:
        return np.asarray(np.bincount(ring, (mass * values)[inside], count) / safe)

    v_out, v_round = np.einsum("ij,ij->i", v, outward), np.einsum("ij,ij->i", v, around)
    inwards = -mean(np.einsum("ij,ij->i", pull, outward))
    middle = 0.5 * (edges[1:] + edges[:-1])
    omega2 = np.maximum(inwards, 0.0) / middle
    slope = np.gradient(omega2, middle) if count > 1 else np.zeros(1)
    kappa = np.sqrt(np.maximum(middle * slope + 4.0 * omega2, 0.0))
    dispersion = np.sqrt(np.maximum(mean(v_out**2) - mean(v_out) ** 2, 0.0))
    sigma = weight / (np.pi * (edges[1:] ** 2 - edges[:-1] ** 2))
    q = np.where(
        (stars >= FEWEST) & (sigma > 0.0),
        dispersion * kappa / (TOOMRE * g * np.where(sigma > 0.0, sigma, 1.0)),
        0.0,
    )
    return DiskProfile(middle, mean(v_round), np.sqrt(middle * np.maximum(inwards, 0.0)), sigma, q)
