"""Mass profiles: how much is inside a radius, what pulls there, and where stars are.

Everything that starts in equilibrium asks a `Profile` two things: the mass M(<r) that the
spherical average of its pull belongs to, and the square of the circular speed in its plane. A
`Sphere` is besides a density on a table of radii, from which stars are drawn.

Spheres of infinite extent are cut off: beyond the truncation t the density goes on as
(r/t)^k exp(-(r - t)/d) with d = t/5 and k chosen for an unbroken slope (Springel and White, MNRAS
307 (1999), DOI 10.1046/j.1365-8711.1999.02613.x). A much shorter d would have no isotropic equilibrium.
King spheres end by themselves: I. King, AJ 71 (1966), DOI 10.1086/109857.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import integrate, interpolate, special

Floats = NDArray[np.float64]

# Radii of a table, from this many scale lengths on: the mass within is 1e-9 in the steepest cusp.
ROWS = 1024
INNERMOST = 3e-5
# Length of the exponential cut-off in truncation radii, and where the table ends in those lengths
# beyond the truncation: less than 1e-9 of the mass is farther out.
DECAY = 0.2
LAST = 25.0
# Truncation in scale lengths where none is given: Plummer's inner 99 % of the mass; a Hernquist
# sphere's inner 91 %; an NFW halo's usual concentration.
PLUMMER_CUT, HERNQUIST_CUT, NFW_CUT = 12.2, 20.0, 10.0
# Directions over which a flat potential is averaged (Gauss-Legendre in the cosine).
DIRECTIONS = 48


class Profile(Protocol):
    """Something that pulls towards the origin of a group."""

    def enclosed_mass(self, radius: ArrayLike) -> Floats:
        """Mass [mass] that gives the spherical average of the pull at `radius` [length]."""

    def speed_squared(self, radius: ArrayLike, G: float) -> Floats:
        """Square of the circular speed in the plane [velocity^2]."""


class Round:
    """A profile that is the same in every direction."""

    def enclosed_mass(self, radius: ArrayLike) -> Floats:
        """Mass inside `radius`."""
        raise NotImplementedError

    def speed_squared(self, radius: ArrayLike, G: float) -> Floats:
        """G M(<r) / r."""
        radius = np.asarray(radius, np.float64)
        return np.asarray(G * self.enclosed_mass(radius) / radius)


@dataclass(frozen=True)
class Sphere:
    """A sphere on a table of rising radii [length]; `density`, its gradient and `inside` for mass 1.

    `mass` is what pulls, 0 for test particles; `inside` is the part of the stars within each radius.
    """

    radius: Floats
    density: Floats
    gradient: Floats
    inside: Floats
    mass: float = 0.0

    def part_inside(self, radius: ArrayLike) -> Floats:
        """Part of the stars within `radius`."""
        radius = np.maximum(np.asarray(radius, np.float64), 1e-300)
        table = np.exp(np.interp(np.log(radius), np.log(self.radius), np.log(self.inside)))
        # Below the table the density is even enough for a power law through its first row.
        power = 4.0 * np.pi * self.radius[0] ** 3 * self.density[0] / self.inside[0]
        within = self.inside[0] * np.minimum(radius / self.radius[0], 1.0) ** power
        return np.asarray(np.where(radius < self.radius[0], within, table))

    def radius_of(self, part: ArrayLike) -> Floats:
        """Radius that has `part` of the stars inside, the inverse of `part_inside`."""
        part = np.maximum(np.asarray(part, np.float64), 1e-300)
        table = np.exp(np.interp(np.log(part), np.log(self.inside), np.log(self.radius)))
        power = 4.0 * np.pi * self.radius[0] ** 3 * self.density[0] / self.inside[0]
        within = self.radius[0] * np.minimum(part / self.inside[0], 1.0) ** (1.0 / power)
        return np.asarray(np.where(part < self.inside[0], within, table))


# Density (to a factor) and its logarithmic slope at x = r / scale length.
Shape = Callable[[Floats], tuple[Floats, Floats]]


def plummer_shape(x: Floats) -> tuple[Floats, Floats]:
    """Plummer's density."""
    return (1.0 + x * x) ** -2.5, -5.0 * x * x / (1.0 + x * x)


def hernquist_shape(x: Floats) -> tuple[Floats, Floats]:
    """Hernquist's density."""
    return 1.0 / (x * (1.0 + x) ** 3), -1.0 - 3.0 * x / (1.0 + x)


def nfw_shape(x: Floats) -> tuple[Floats, Floats]:
    """The density of Navarro, Frenk and White."""
    return 1.0 / (x * (1.0 + x) ** 2), -1.0 - 2.0 * x / (1.0 + x)


def cut_sphere(shape: Shape, scale: float, truncation: float, mass: float = 0.0) -> Sphere:
    """A sphere of this shape that falls exponentially beyond `truncation` [length]."""
    t = truncation / scale
    d = DECAY * t
    x = np.geomspace(INNERMOST * min(1.0, t), t + LAST * d, ROWS)
    density, slope = shape(np.minimum(x, t))
    power = slope[-1] + t / d
    beyond = x > t
    y = np.where(beyond, x, t)
    density = density * np.exp(power * np.log(y / t) - (y - t) / d)
    slope = np.where(beyond, power - x / d, slope)
    mass_rows = np.log(x)
    inside = 4.0 * np.pi * x[0] ** 3 * density[0] / (3.0 + slope[0]) + integrate.cumulative_simpson(
        4.0 * np.pi * x**3 * density, x=mass_rows, initial=0.0
    )
    unit = inside[-1]
    return Sphere(
        scale * x,
        density / (unit * scale**3),
        slope * density / x / (unit * scale**4),
        np.minimum(inside / unit, 1.0),
        mass,
    )


def king_sphere(w0: float, core_radius: float, mass: float = 0.0) -> Sphere:
    """A King sphere: W'' + 2 W'/x + 9 rho(W)/rho(W0) = 0 with W(0) = W0, x = r / r_0, up to W = 0."""
    middle = king_density(w0)

    def slope(log_x: float, y: Floats) -> list[float]:
        # y = (W, x^2 dW/dx); in log x the core costs no steps.
        x = np.exp(log_x)
        return [y[1] / x, -9.0 * x**3 * king_density(max(y[0], 0.0)) / middle]

    def edge(log_x: float, y: Floats) -> float:
        return float(y[0])

    edge.terminal = True  # type: ignore[attr-defined]
    first = INNERMOST
    start = [w0 - 1.5 * first**2, -3.0 * first**3]
    found = integrate.solve_ivp(
        slope, (np.log(first), 25.0), start, "DOP853", events=edge, dense_output=True, rtol=1e-10, atol=1e-13
    )
    last = float(np.exp(found.t_events[0][0]))
    # Finer towards the edge, where the density falls like the 5/2 power of the distance from it.
    x = np.union1d(np.geomspace(first, last, ROWS), last * (1.0 - np.geomspace(1e-4, 0.1, ROWS // 8)))
    x = np.delete(x, np.flatnonzero(np.diff(x) < 1e-9 * last))
    w, flux = found.sol(np.log(x))
    w = np.maximum(w, 0.0)
    w[-1], total = 0.0, -flux[-1]
    # rho / rho_0 in units where 4 pi rho_0 r_0^3 = 9: the mass inside x is then -x^2 W'.
    unit = 9.0 / (4.0 * np.pi * middle * total * core_radius**3)
    gradient = unit * king_density_slope(w) * flux / x**2 / core_radius
    return Sphere(core_radius * x, unit * king_density(w), gradient, np.minimum(-flux / total, 1.0), mass)


def king_density(w: ArrayLike) -> Floats:
    """rho(W) = e^W erf(sqrt W) - sqrt(4 W / pi) (1 + 2 W / 3), to a factor."""
    w = np.asarray(w, np.float64)
    root = np.sqrt(w)
    exact = np.exp(w) * special.erf(root) - 2.0 / np.sqrt(np.pi) * root * (1.0 + 2.0 * w / 3.0)
    # The terms cancel near the edge; the series' first terms are right to 1e-7 there.
    series = 8.0 / (15.0 * np.sqrt(np.pi)) * w**2.5 * (1.0 + 2.0 * w / 7.0 + 4.0 * w * w / 63.0)
    return np.asarray(np.where(w < 0.02, series, exact))


def king_density_slope(w: ArrayLike) -> Floats:
    """Slope d rho / dW = rho(W) + (4 / 3) W^(3/2) / sqrt(pi)."""
    w = np.asarray(w, np.float64)
    return king_density(w) + 4.0 / (3.0 * np.sqrt(np.pi)) * w**1.5


class SoftSphere(Round):
    """The pull of a sphere whose stars are softened by Plummer's law, `softening` [length].

    A shell of radius s and mass m pulls at r as the mass m (2 r / (A + B) - r / 2s ((r + s)/A - (r - s)/B)),
    with A, B = sqrt((r +- s)^2 + softening^2); without softening this is m outside and 0 inside.
    """

    def __init__(self, sphere: Sphere, softening: float) -> None:
        r, mass = sphere.radius, sphere.inside
        if softening > 0.0:
            # Shells between the rows, so that without softening each row has all below it inside.
            s = np.concatenate([[0.75 * r[0]], np.sqrt(r[1:] * r[:-1])])
            more, less = r[:, None] + s, r[:, None] - s
            a, b = np.sqrt(more**2 + softening**2), np.sqrt(less**2 + softening**2)
            pull = 2.0 * r[:, None] / (a + b) - 0.5 * (r[:, None] / s) * (more / a - less / b)
            mass = np.maximum(pull @ np.diff(sphere.inside, prepend=0.0), 1e-300)
        self._mass, self._first, self._last = sphere.mass, r[0], r[-1]
        # Smooth, as epicycles ask for its slope.
        self._curve = interpolate.CubicSpline(np.log(r), np.log(mass))

    def enclosed_mass(self, radius: ArrayLike) -> Floats:
        """Mass that pulls at `radius`."""
        r = np.asarray(radius, np.float64)
        within = np.exp(self._curve(np.log(np.clip(r, self._first, self._last))))
        return np.asarray(self._mass * within * np.minimum(r / self._first, 1.0) ** 3)


@dataclass(frozen=True)
class Ball(Round):
    """A ball of even density."""

    mass: float
    radius: float

    def enclosed_mass(self, radius: ArrayLike) -> Floats:
        """Mass inside `radius`."""
        return np.asarray(self.mass * np.minimum(np.asarray(radius, np.float64) / self.radius, 1.0) ** 3)


class Shells(Round):
    """Bodies at given distances, each smeared over its shell; nearer than the softening: a soft point."""

    def __init__(self, distance: ArrayLike, mass: ArrayLike, softening: float) -> None:
        distance, mass = np.asarray(distance, np.float64), np.asarray(mass, np.float64)
        near = distance <= softening
        self._soft, self._softening = float(mass[near].sum()), softening
        order = np.argsort(distance[~near])
        self._distance = distance[~near][order]
        self._inside = np.concatenate([[0.0], np.cumsum(mass[~near][order])])

    def enclosed_mass(self, radius: ArrayLike) -> Floats:
        """Mass inside `radius`."""
        r = np.asarray(radius, np.float64)
        soft = self._soft * (r * r / (r * r + self._softening**2)) ** 1.5
        return soft + self._inside[np.searchsorted(self._distance, r, side="right")]


@dataclass(frozen=True)
class Point(Round):
    """A softened point mass."""

    mass: float
    softening: float = 0.0

    def enclosed_mass(self, radius: ArrayLike) -> Floats:
        """Mass that pulls at `radius`."""
        r = np.asarray(radius, np.float64)
        return np.asarray(self.mass * (r * r / (r * r + self.softening**2)) ** 1.5)


@dataclass(frozen=True)
class Halo(Round):
    """An NFW halo without an end: `mass` is that within one scale length times 1 / (ln 2 - 1/2)."""

    mass: float
    scale_length: float

    def enclosed_mass(self, radius: ArrayLike) -> Floats:
        """Mass inside `radius`: mass (ln(1 + x) - x / (1 + x))."""
        x = np.asarray(radius, np.float64) / self.scale_length
        return np.asarray(self.mass * (np.log1p(x) - x / (1.0 + x)))


@dataclass(frozen=True)
class Logarithmic(Round):
    """The potential (v^2 / 2) ln(r^2 + c^2), with a flat rotation curve `speed` [velocity] outside."""

    speed: float
    core_radius: float
    G: float

    def enclosed_mass(self, radius: ArrayLike) -> Floats:
        """v^2 r^3 / (G (r^2 + c^2))."""
        r = np.asarray(radius, np.float64)
        return np.asarray(self.speed**2 * r**3 / (self.G * (r * r + self.core_radius**2)))


@dataclass(frozen=True)
class MiyamotoNagai:
    """The disk -G M / sqrt(R^2 + (a + sqrt(y^2 + b^2))^2), its axis along Y."""

    mass: float
    scale_length: float
    height: float

    def enclosed_mass(self, radius: ArrayLike) -> Floats:
        """The mean over all directions of r^2 / G times the pull towards the origin."""
        r = np.asarray(radius, np.float64)[..., None]
        cosine, weight = np.polynomial.legendre.leggauss(DIRECTIONS)
        y, flat = r * cosine, r * np.sqrt(1.0 - cosine**2)
        soft = np.sqrt(y * y + self.height**2)
        top = self.scale_length + soft
        cubed = (flat * flat + top * top) ** 1.5
        pull = (flat * flat + y * y * top / soft) / (cubed * r)
        return np.asarray(0.5 * self.mass * r[..., 0] ** 2 * (pull @ weight))

    def speed_squared(self, radius: ArrayLike, G: float) -> Floats:
        """Square of the circular speed in the plane."""
        r = np.asarray(radius, np.float64)
        return np.asarray(G * self.mass * r * r / (r * r + (self.scale_length + self.height) ** 2) ** 1.5)


@dataclass(frozen=True)
class ThinDisk:
    """A thin exponential disk; K. Freeman, ApJ 160 (1970), DOI 10.1086/150474."""

    mass: float
    scale_length: float

    def enclosed_mass(self, radius: ArrayLike) -> Floats:
        """Its mass inside the sphere of `radius`."""
        x = np.asarray(radius, np.float64) / self.scale_length
        return np.asarray(-self.mass * (np.expm1(-x) + x * np.exp(-x)))

    def speed_squared(self, radius: ArrayLike, G: float) -> Floats:
        """4 pi G Sigma_0 R_d y^2 (I0 K0 - I1 K1) at y = R / (2 R_d)."""
        y = np.asarray(radius, np.float64) / (2.0 * self.scale_length)
        bessel = special.i0e(y) * special.k0e(y) - special.i1e(y) * special.k1e(y)
        return np.asarray(2.0 * G * self.mass / self.scale_length * y * y * bessel)


@dataclass(frozen=True)
class Total:
    """All that pulls in a group."""

    profiles: Sequence[Profile]

    def enclosed_mass(self, radius: ArrayLike) -> Floats:
        """Sum of the masses inside `radius`."""
        radius = np.asarray(radius, np.float64)
        return sum((one.enclosed_mass(radius) for one in self.profiles), np.zeros_like(radius))

    def speed_squared(self, radius: ArrayLike, G: float) -> Floats:
        """Sum of the squares of the circular speeds."""
        radius = np.asarray(radius, np.float64)
        return sum((one.speed_squared(radius, G) for one in self.profiles), np.zeros_like(radius))
