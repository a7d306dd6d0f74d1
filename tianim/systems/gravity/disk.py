"""Exponential disks: places, and velocities that balance the pull of the whole group.

    Sigma = M / (2 pi R_d^2) e^(-R/R_d),  rho ~ sech^2(z / z_0)
    sigma_R ~ e^(-R / 2 R_d), from Q = sigma_R kappa / (3.36 G Sigma) at 2.5 R_d
    sigma_phi = sigma_R kappa / (2 Omega)
    v_phi^2 = v_c^2 + sigma_R^2 (1 - kappa^2 / (4 Omega^2) - 2 R / R_d)
    sigma_z^2 = pi G Sigma z_0 + (pi^2 / 12) z_0^2 Omega_rest^2

Omega and kappa are those of the total potential. The disk's own pull is that of a thin disk seen from
the distance sqrt(dz^2 + softening^2), averaged over the heights of its stars: at one scale length a
disk of z_0 = R_d / 10 pulls 10 % less than a thin one, and started on the thin one's circles it would
widen. Softening lowers sigma_z too: |dz|, whose mean is z_0, becomes dz^2 / sqrt(dz^2 + softening^2).
The second term of sigma_z^2 is the height-averaged Jeans equation in the pull of everything else
near the plane; without it a disk in a heavy halo would collapse to half its height. Source: L.
Hernquist, ApJS 86 (1993), DOI 10.1086/191784.

Limit: near the centre, where sigma_R would exceed v_c, the mean rotation is cut at zero.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import integrate, interpolate, special

from tianim.errors import SceneError
from tianim.systems.gravity.components import ExponentialDisk
from tianim.systems.gravity.profiles import Profile, ThinDisk, Total

Floats = NDArray[np.float64]

# Scale lengths that the disk reaches where no truncation is given (99.7 % of the mass), and heights:
# 1e-7 of the stars of a sech^2 layer are higher.
CUT, HIGHEST = 8.0, 8.0
# A disk that is cut farther out has no star there: e^-40 of its mass.
FARTHEST_CUT = 40.0
# Q is that at this many scale lengths; 3.36 is for a disk of stars (gas: pi).
Q_RADIUS, TOOMRE = 2.5, 3.36
ROWS = 2048
INNERMOST = 1e-3
# The table of a thick disk's pull: radii in scale lengths, wave numbers up to where k^-2 <e^-ks> has
# died away, and nodes of the distance in height of two stars, of which none are farther apart than e^-24.
TABLE, TABLE_ROWS = (1e-3, 12.0), 256
LARGEST_K, K_ROWS = 100.0, 2001
PAIRS, FARTHEST = 48, 12.0


class Motion(NamedTuple):
    """Mean rotation and the three dispersions [velocity], circular speed, kappa and Omega, by radius."""

    radius: Floats
    rotation: Floats
    sigma_radial: Floats
    sigma_turning: Floats
    sigma_height: Floats
    circular: Floats
    kappa: Floats
    omega: Floats


@dataclass(frozen=True)
class ThickDisk(ThinDisk):
    """An exponential disk with sech^2 heights and softened stars; its pull averaged over the heights."""

    height: float = 0.0
    softening: float = 0.0

    def speed_squared(self, radius: ArrayLike, G: float) -> Floats:
        """G M R int J1(kR) k (1 + k^2 R_d^2)^(-3/2) <e^(-k s)> dk, s = sqrt(dz^2 + softening^2)."""
        if self.height == 0.0 and self.softening == 0.0:
            return super().speed_squared(radius, G)
        x = np.asarray(radius, np.float64) / self.scale_length
        y = np.clip(x, TABLE[0], TABLE[1])
        pull = self._pull(np.log(y)) * np.minimum(x / TABLE[0], 1.0)
        thin = ThinDisk(1.0, 1.0)
        far = thin.speed_squared(x, 1.0) / thin.speed_squared(y, 1.0)
        return np.asarray(G * self.mass / self.scale_length * x * pull * np.where(x > y, far * y / x, 1.0))

    @cached_property
    def _pull(self) -> interpolate.CubicSpline:
        """The radial pull [G M / R_d^2] by log(R / R_d)."""
        k = np.linspace(0.0, LARGEST_K, K_ROWS)
        apart, weight = self.separations()
        nearness = np.exp(-k[:, None] / self.scale_length * apart) @ weight
        x = np.geomspace(*TABLE, TABLE_ROWS)
        waves = special.j1(x[:, None] * k) * (k * (1.0 + k * k) ** -1.5 * nearness)
        return interpolate.CubicSpline(np.log(x), integrate.simpson(waves, x=k))

    def separations(self) -> tuple[Floats, Floats]:
        """Values of s [length] and their weights, which sum to 1."""
        if self.height == 0.0:
            return np.array([self.softening]), np.array([1.0])
        x, weight = np.polynomial.legendre.leggauss(PAIRS)
        # The distance dz = x z_0 of two stars has the density 2 (x coth x - 1) / sinh^2 x.
        x = 0.5 * FARTHEST * (x + 1.0)
        weight = weight * (x / np.tanh(x) - 1.0) / np.sinh(x) ** 2
        return np.hypot(x * self.height, self.softening), weight / weight.sum()

    def layer(self) -> float:
        """The length that stands for z_0 in pi G Sigma z_0: the mean of dz^2 / s."""
        apart, weight = self.separations()
        square = apart**2 - self.softening**2
        return float(np.divide(square, apart, out=np.zeros_like(apart), where=apart > 0.0) @ weight)


def thick_disk(disk: ExponentialDisk, softening: float) -> ThickDisk:
    """The profile of a disk; its mass is that of an uncut disk, so that the stars' mass is as given."""
    mass = disk.total / float(_part(truncation(disk) / disk.scale_length))
    return ThickDisk(mass, disk.scale_length, disk.height, softening)


def truncation(disk: ExponentialDisk) -> float:
    """The largest radius of a star [length]."""
    if disk.truncation is None:
        return CUT * disk.scale_length
    return min(disk.truncation, FARTHEST_CUT * disk.scale_length)


def _part(x: ArrayLike) -> Floats:
    """Part of an exponential disk within x scale lengths."""
    x = np.asarray(x, np.float64)
    return np.asarray(-(np.expm1(-x) + x * np.exp(-x)))


def surface_density(disk: ExponentialDisk, radius: ArrayLike) -> Floats:
    """Sigma [mass / length^2]."""
    middle = thick_disk(disk, 0.0).mass / (2.0 * np.pi * disk.scale_length**2)
    return np.asarray(middle * np.exp(-np.asarray(radius) / disk.scale_length))


def frequencies(radius: Floats, total: Profile, G: float) -> tuple[Floats, Floats]:
    """Omega and kappa [1/time] at rising radii: kappa^2 = R dOmega^2/dR + 4 Omega^2."""
    squared = total.speed_squared(radius, G)
    slope = np.gradient(squared, np.log(radius), edge_order=2)
    return np.sqrt(squared) / radius, np.sqrt(np.maximum(slope + 2.0 * squared, 0.0)) / radius


def motion(name: str, disk: ExponentialDisk, others: Total, G: float, softening: float = 0.0) -> Motion:
    """Rotation and dispersions of a disk in its own pull and that of `others`."""
    length, far = disk.scale_length, truncation(disk)
    radius = np.geomspace(INNERMOST * min(length, far), far, ROWS)
    own = thick_disk(disk, softening)
    total = Total([*others.profiles, own])
    omega, kappa = frequencies(radius, total, G)
    circular = omega * radius
    if not circular.max() > 0.0:
        raise SceneError(f"component {name!r}: nothing pulls on it; give it a mass, or its group")
    there = float(np.interp(Q_RADIUS * length, radius, kappa))
    density = float(surface_density(disk, Q_RADIUS * length))
    middle = disk.toomre_q * TOOMRE * G * density / there * np.exp(0.5 * Q_RADIUS)
    radial = middle * np.exp(-0.5 * radius / length)
    ratio = kappa / (2.0 * omega)
    rotation = circular**2 + radial**2 * (1.0 - ratio**2 - 2.0 * radius / length)
    rest = others.speed_squared(radius, G) / radius**2
    height = np.pi * G * surface_density(disk, radius) * own.layer()
    height = height + np.pi**2 / 12.0 * disk.height**2 * np.maximum(rest, 0.0)
    return Motion(
        radius,
        np.sqrt(np.maximum(rotation, 0.0)),
        radial,
        radial * ratio,
        np.sqrt(height),
        circular,
        kappa,
        omega,
    )


def sample_disk(
    name: str, disk: ExponentialDisk, others: Total, G: float, softening: float, rng: np.random.Generator
) -> tuple[Floats, Floats]:
    """Positions [length] and velocities [velocity], (count, 3), of a disk that spins along +Y."""
    moves = motion(name, disk, others, G, softening)
    n = disk.count
    radius = disk.scale_length * _radii(rng.random(n), truncation(disk) / disk.scale_length)
    angle = 2.0 * np.pi * rng.random(n)
    height = disk.height * np.arctanh(np.tanh(HIGHEST) * (2.0 * rng.random(n) - 1.0))

    def at(values: Floats) -> Floats:
        return np.interp(radius, moves.radius, values)

    outwards = at(moves.sigma_radial) * rng.standard_normal(n)
    onwards = at(moves.rotation) + at(moves.sigma_turning) * rng.standard_normal(n)
    upwards = at(moves.sigma_height) * rng.standard_normal(n)
    return turned(radius, angle, height), turned_vectors(angle, outwards, onwards, upwards)


def _radii(u: Floats, far: float) -> Floats:
    """Radii in scale lengths: the inverse of `_part`, u uniform, none beyond `far`."""
    # The root of the part is smooth from the centre on, so that few rows do.
    x = np.linspace(0.0, far, 4 * ROWS)
    part = _part(x)
    return np.interp(np.sqrt(u * part[-1]), np.sqrt(part), x)


def turned(radius: Floats, angle: Floats, height: Floats | float) -> Floats:
    """Positions (n, 3) at `angle` [rad] from +X, counted along +Y by the right-hand rule."""
    return np.stack(
        [radius * np.cos(angle), np.broadcast_to(height, angle.shape), -radius * np.sin(angle)], axis=1
    )


def turned_vectors(
    angle: Floats, outwards: Floats | float, onwards: Floats, upwards: Floats | float
) -> Floats:
    """Vectors (n, 3) at `angle` [rad] with these components outwards, in the sense of the spin, and up."""
    c, s = np.cos(angle), np.sin(angle)
    upwards = np.broadcast_to(upwards, angle.shape)
    return np.stack([outwards * c - onwards * s, upwards, -outwards * s - onwards * c], axis=1)
