"""Kepler orbits: elements to places and velocities and back, and the orbit of two galaxies.

    M = E - e sin E,  r = a (1 - e cos E),  p = a (1 - e^2) = h^2 / mu

The reference plane is x-z with the normal +Y; longitudes count from +X, and an orbit of inclination
0 turns along +Y (by the right-hand rule). In an astronomer's axes (X, Y, Z) these are (X, Z, -Y).
Source: C. Murray and S. Dermott, Solar System Dynamics, 1999, chapter 2.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

Floats = NDArray[np.float64]

# Newton from Danby's start needs 3 to 5 steps; nearest to a parabola some more.
NEWTON_STEPS = 50
NORMAL = np.array([0.0, 1.0, 0.0])


class Elements(NamedTuple):
    """Elements of ellipses, each (n,): a [length], e, then angles [rad]; `anomaly` is the mean one."""

    semi_major_axis: Floats
    eccentricity: Floats
    inclination: Floats
    node: Floats
    argument: Floats
    anomaly: Floats


def eccentric_anomaly(mean: ArrayLike, eccentricity: ArrayLike) -> Floats:
    """E of Kepler's equation M = E - e sin E [rad], for e < 1, to rounding."""
    mean, e = np.broadcast_arrays(np.asarray(mean, np.float64), np.asarray(eccentricity, np.float64))
    turns = np.round(mean / (2.0 * np.pi))
    m = mean - 2.0 * np.pi * turns
    x = m + 0.85 * e * np.sign(m)
    for _ in range(NEWTON_STEPS):
        f, slope = x - e * np.sin(x) - m, 1.0 - e * np.cos(x)
        # Halley's step does not overshoot where the slope is small (e near 1 at the pericentre).
        step = f / (slope - 0.5 * f * e * np.sin(x) / slope)
        x = x - step
        if np.all(np.abs(step) <= 4.0 * np.finfo(np.float64).eps * np.maximum(np.abs(x), 1.0)):
            break
    return np.asarray(x + 2.0 * np.pi * turns)


def _axes(inclination: ArrayLike, node: ArrayLike, argument: ArrayLike) -> tuple[Floats, Floats]:
    """Unit vectors (n, 3) to the pericentre and, in the orbit, a right angle on."""
    ci, si = np.cos(inclination), np.sin(inclination)
    cn, sn = np.cos(node), np.sin(node)
    cw, sw = np.cos(argument), np.sin(argument)
    towards = np.stack([cn * cw - sn * sw * ci, sw * si, -(sn * cw + cn * sw * ci)], axis=-1)
    onwards = np.stack([-cn * sw - sn * cw * ci, cw * si, -(-sn * sw + cn * cw * ci)], axis=-1)
    return towards, onwards


def state(elements: Elements, mu: ArrayLike) -> tuple[Floats, Floats]:
    """Position [length] and velocity [velocity], (n, 3), round a centre of `mu` = G (M + m)."""
    a, e = elements.semi_major_axis[:, None], elements.eccentricity[:, None]
    towards, onwards = _axes(elements.inclination, elements.node, elements.argument)
    anomaly = eccentric_anomaly(elements.anomaly, elements.eccentricity)[:, None]
    c, s, flat = np.cos(anomaly), np.sin(anomaly), np.sqrt((1.0 - e) * (1.0 + e))
    position = a * ((c - e) * towards + flat * s * onwards)
    rate = np.sqrt(np.asarray(mu, np.float64).reshape(-1, 1) / a) / (1.0 - e * c)
    return position, rate * (flat * c * onwards - s * towards)


def elements_of(position: ArrayLike, velocity: ArrayLike, mu: ArrayLike) -> Elements:
    """Elements of the ellipses through position and velocity (n, 3); angles in [0, 2 pi).

    A circle counts its phase from the node, an orbit in the x-z plane its node from +X.
    """
    x, v = np.asarray(position, np.float64), np.asarray(velocity, np.float64)
    mu = np.broadcast_to(np.asarray(mu, np.float64), len(x))
    h, r = np.cross(x, v), np.linalg.norm(x, axis=1)
    a = 1.0 / (2.0 / r - np.sum(v * v, axis=1) / mu)
    ecc = np.cross(v, h) / mu[:, None] - x / r[:, None]
    e = np.linalg.norm(ecc, axis=1)
    normal = h / np.linalg.norm(h, axis=1, keepdims=True)
    node = np.cross(NORMAL, normal)
    tilt = np.linalg.norm(node, axis=1, keepdims=True)
    inclination = np.arctan2(tilt[:, 0], normal[:, 1])
    node = np.where(tilt > 0.0, node / np.where(tilt > 0.0, tilt, 1.0), (1.0, 0.0, 0.0))
    longitude = np.arctan2(-node[:, 2], node[:, 0])
    across = np.cross(normal, node)
    pericentre = np.where(e[:, None] > 0.0, ecc / np.where(e > 0.0, e, 1.0)[:, None], node)
    argument = np.arctan2(np.sum(pericentre * across, axis=1), np.sum(pericentre * node, axis=1))
    # e cos E = 1 - r / a and e sin E = x.v / sqrt(mu a) lose digits for e near 0: from the place instead.
    along = np.sum(x * pericentre, axis=1)
    aside = np.sum(x * np.cross(normal, pericentre), axis=1)
    eccentric = np.arctan2(aside / np.sqrt((1.0 - e) * (1.0 + e)), along + a * e)
    angles = (longitude, argument, eccentric - e * np.sin(eccentric))
    longitude, argument, anomaly = (np.mod(angle, 2.0 * np.pi) for angle in angles)
    return Elements(a, e, inclination, longitude, argument, anomaly)


def encounter_state(
    pericentre: float, eccentricity: float, separation: float, mu: float,
    inclination: float = 0.0, node: float = 0.0, argument: float = 0.0,
) -> tuple[Floats, Floats]:  # fmt: skip
    """Relative position and velocity (3,) of two point masses that near each other, `separation` apart.

    `mu` = G (M1 + M2); any eccentricity; angles [rad].
    """
    semi_latus = pericentre * (1.0 + eccentricity)
    cosine = 1.0
    if eccentricity > 0.0:
        cosine = min(max((semi_latus / separation - 1.0) / eccentricity, -1.0), 1.0)
    sine = -np.sqrt((1.0 - cosine) * (1.0 + cosine))
    towards, onwards = _axes(inclination, node, argument)
    rate = np.sqrt(mu / semi_latus)
    position = separation * (cosine * towards + sine * onwards)
    return position, rate * ((eccentricity + cosine) * onwards - sine * towards)


def orbit_axes(inclination: float, node: float, argument: float) -> tuple[Floats, Floats]:
    """Unit vectors (3,): to the pericentre, and the normal along which the orbit turns; angles [rad]."""
    towards, onwards = _axes(inclination, node, argument)
    return towards, np.cross(towards, onwards)
