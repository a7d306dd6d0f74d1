"""What a start of stars is held to: errors in one line, and warnings for what is odd but possible."""

import logging

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from tianim.errors import SceneError
from tianim.systems.gravity.diagnostics import Totals
from tianim.systems.gravity.solver import Law

Floats = NDArray[np.float64]

# Without a handler of the caller's, Python prints these as single lines on standard error.
LOG = logging.getLogger("tianim")
# Without softening, close encounters of more stars than this ruin any step that can be afforded.
MANY = 200
# Share of the pull's energy by which the whole must be unbound to be worth a line: a parabola is none.
CLEARLY = 0.01


def check_start(name: str, position: Floats, velocity: Floats, mass: Floats, law: Law) -> None:
    """SceneError names the first star whose numbers are wrong, or the softening that does not fit."""
    _check_finite(position, velocity, mass)
    if len(mass) < 2:
        return
    if law.softening == 0.0:
        _check_apart(position, mass)
        if np.count_nonzero(mass) > MANY:
            LOG.warning(
                "%s: %d stars without softening: close pairs need very short steps; give softening.length",
                name, np.count_nonzero(mass),
            )  # fmt: skip
    else:
        radius = float(np.linalg.norm(position - position.mean(axis=0), axis=1).max())
        if law.softening > radius:
            raise SceneError(
                f"softening.length: {law.softening:g} is larger than the whole system, "
                f"whose radius is {radius:g}"
            )


def _check_finite(position: Floats, velocity: Floats, mass: Floats) -> None:
    for what, values in (("position", position), ("velocity", velocity), ("mass", mass[:, None])):
        wrong = np.flatnonzero(~np.isfinite(values).all(axis=1))
        if len(wrong):
            more = f" (and {len(wrong) - 1} more)" if len(wrong) > 1 else ""
            raise SceneError(f"star {wrong[0]}{more}: {what} is not a finite number: {values[wrong[0]]}")
    wrong = np.flatnonzero(mass < 0.0)
    if len(wrong):
        raise SceneError(f"star {wrong[0]}: mass {mass[wrong[0]]:g} must not be negative")


def _check_apart(position: Floats, mass: Floats) -> None:
    """Stars at one place pull with infinite force, unless neither has a mass."""
    massive = np.flatnonzero(mass > 0.0)
    if not len(massive):
        return
    distance, nearest = cKDTree(position).query(position[massive], k=2)
    for star, pair in zip(massive[distance[:, 1] == 0.0], nearest[distance[:, 1] == 0.0], strict=True):
        other = next((int(k) for k in pair if k != star), int(pair[0]))
        one, two = sorted((int(star), other))
        raise SceneError(
            f"stars {one} and {two} are at one place, {position[one].tolist()}, and nothing softens their "
            "force: move one, or give softening.length"
        )


def warn_of_start(name: str, now: Totals, alone: bool) -> None:
    """A line where stars that only feel one another (`alone`) are not bound."""
    if alone and now.energy > CLEARLY * abs(now.own):
        LOG.warning(
            "%s: the stars are not bound (kinetic energy %.3g, potential %.3g): they will fly apart",
            name, now.kinetic, now.own,
        )  # fmt: skip
