"""Isotropic velocities for a sphere in any spherical potential, by Eddington's inversion.

    f(E) = 1 / (sqrt(8) pi^2) d/dE int_0^E (d rho/d psi) d psi / sqrt(E - psi)

psi is the total potential, turned round and zero where the sphere ends. On the table of the
sphere d rho/d psi is taken as linear in psi between rows, which makes every integral exact. Speeds
are drawn by rejection from v^2 f(psi - v^2 / 2). Source: J. Binney and S. Tremaine, Galactic
Dynamics, 2nd edition 2008, section 4.3.1.

Limit: a sphere with a flat core round a dominating mass has no isotropic equilibrium (f would be
negative); this is found and refused.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import integrate

from tianim.errors import SceneError
from tianim.spatial.placement import random_directions
from tianim.systems.gravity.profiles import Profile, Sphere

Floats = NDArray[np.float64]

# Speeds at which the height of a star's distribution is sought, and room above what is found there.
SPEEDS = 128
ROOM = 1.05
# Part of the stars that may be amiss where f had to be cut at zero.
AMISS = 0.02


class Isotropic:
    """Distribution of energies of `sphere`'s stars in the pull of `total`.

    radius   rows of the sphere [length], rising
    psi      potential there [velocity^2], falling to 0 at the last row
    density  f by rows [1 / (length velocity)^3], for a sphere of mass 1
    """

    def __init__(self, name: str, sphere: Sphere, total: Profile, G: float) -> None:
        self.radius, self._log_radius = sphere.radius, np.log(sphere.radius)
        inside = total.enclosed_mass(sphere.radius)
        if not inside[-1] > 0.0:
            raise SceneError(f"component {name!r}: nothing pulls on it; give it a mass, or its group")
        # From the edge inwards: far out psi is small, and a difference of large ones would lose it.
        depth = G * inside / sphere.radius
        self.psi = integrate.cumulative_simpson(depth[::-1], x=-self._log_radius[::-1], initial=0.0)[::-1]
        pull = np.maximum(G * inside / sphere.radius**2, 1e-300)
        self.density = self._invert(-sphere.gradient / pull)
        self._check(name, sphere)
        self._highest = self._heights()

    def _invert(self, slope: Floats) -> Floats:
        """The f of d rho/d psi, row by row; cut at zero."""
        psi, slope = self.psi[::-1], slope[::-1]
        bend = np.diff(slope) / np.diff(psi)
        root = np.sqrt(np.maximum(psi[:, None] - psi[None, :], 0.0))
        f = 2.0 * (root[:, :-1] - root[:, 1:]) @ bend
        return np.maximum(f[::-1] / (np.sqrt(8.0) * np.pi**2), 0.0)

    def density_again(self) -> Floats:
        """The density that f gives, 4 pi int f(E) sqrt(2 (psi - E)) dE, by rows."""
        psi, f = self.psi[::-1], self.density[::-1]
        left, right = psi[:-1], psi[1:]
        top = psi[:, None]
        # f linear in E in each piece: the integral of sqrt(psi - E) times 1 and times E - left.
        a = np.maximum(top - left, 0.0)
        b = np.maximum(top - right, 0.0)
        flat = (a**1.5 - b**1.5) / 1.5
        rising = a * flat - (a**2.5 - b**2.5) / 2.5
        pieces = flat @ f[:-1] + rising @ (np.diff(f) / (right - left))
        return np.asarray(4.0 * np.pi * np.sqrt(2.0) * pieces[::-1])

    def _check(self, name: str, sphere: Sphere) -> None:
        shell = 4.0 * np.pi * sphere.radius**3
        wrong = np.abs(self.density_again() - sphere.density) * shell
        amiss = float(np.trapezoid(wrong, self._log_radius))
        if amiss > AMISS:
            raise SceneError(
                f"component {name!r}: has no isotropic equilibrium in its group, {amiss:.0%} of its stars "
                "would be amiss: too much mass in the middle of so flat a core, or a truncation too near"
            )

    def _heights(self) -> Floats:
        """A bound of q^2 f(psi (1 - q^2)) over all q, by rows."""
        q = np.linspace(0.0, 1.0, SPEEDS + 1)[1:]
        highest = np.max(q * q * self.at(self.psi[:, None] * (1.0 - q * q)), axis=1)
        near = np.maximum(highest, np.maximum(np.roll(highest, 1), np.roll(highest, -1)))
        return np.asarray(ROOM * near)

    def at(self, energy: Floats) -> Floats:
        """The f at energies psi - v^2 / 2 [velocity^2]."""
        return np.interp(energy, self.psi[::-1], self.density[::-1])

    def speeds(self, radius: Floats, rng: np.random.Generator) -> Floats:
        """Speeds (n,) [velocity] of stars at `radius` (n,) [length]."""
        log_radius = np.log(np.maximum(radius, self.radius[0]))
        psi = np.interp(log_radius, self._log_radius, self.psi)
        row = np.clip(np.searchsorted(self._log_radius, log_radius), 1, len(self.psi) - 1)
        highest = np.maximum(self._highest[row - 1], self._highest[row])
        q = np.zeros(len(radius))
        left = np.flatnonzero(highest > 0.0)
        while len(left):
            tried = rng.random(len(left))
            height = tried**2 * self.at(psi[left] * (1.0 - tried**2))
            taken = rng.random(len(left)) * highest[left] < height
            q[left[taken]] = tried[taken]
            left = left[~taken]
        return np.asarray(q * np.sqrt(2.0 * psi))


def directed(length: Floats, rng: np.random.Generator) -> Floats:
    """Vectors (n, 3) of these lengths (n,), every direction alike."""
    return length[:, None] * random_directions(len(length), rng)
