"""What the tests of gravity's start share: making one from plain data, sums over pairs, comparisons."""

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydantic import TypeAdapter
from scipy.spatial.distance import cdist

from tianim.systems.gravity.components import Component, Galaxy
from tianim.systems.gravity.external import External
from tianim.systems.gravity.start import Made, make

Floats = NDArray[np.float64]

COMPONENTS: TypeAdapter[Any] = TypeAdapter(Mapping[str, Component])
GALAXIES: TypeAdapter[Any] = TypeAdapter(Mapping[str, Galaxy])
EXTERNAL: TypeAdapter[Any] = TypeAdapter(tuple[External, ...])
# Kolmogorov and Smirnov: sqrt(n) times the largest difference exceeds this in 1 of 3,000 samples.
KS = 2.1


def start(
    components: Mapping[str, Any] | None = None,
    galaxies: Mapping[str, Any] | None = None,
    external: tuple[Any, ...] = (),
    G: float = 1.0,
    softening: float = 0.0,
    seed: int = 1,
    **more: Any,
) -> Made:
    """A start from plain data as a scene has it."""
    return make(
        COMPONENTS.validate_python(components or {}),
        GALAXIES.validate_python(galaxies or {}),
        EXTERNAL.validate_python(external),
        G,
        softening,
        seed,
        **more,
    )


def assert_distributed(values: Floats, cumulative: Callable[[Floats], Floats]) -> None:
    """The values are a sample of the distribution with this cumulative function."""
    values = np.sort(values)
    n = len(values)
    expected = cumulative(values)
    above = np.max(np.arange(1, n + 1) / n - expected)
    below = np.max(expected - np.arange(n) / n)
    assert max(above, below) * np.sqrt(n) < KS


def energies(made: Made, G: float = 1.0, softening: float = 0.0) -> tuple[float, float]:
    """Kinetic and potential energy, by a sum over all pairs in float64."""
    x, m = made.position, made.mass
    kinetic = 0.5 * float(m @ np.sum(made.velocity**2, axis=1))
    potential = 0.0
    for first in range(0, len(m), 500):
        rows = slice(first, first + 500)
        square = cdist(x[rows], x, "sqeuclidean") + softening**2
        square[np.arange(len(square)), np.arange(first, first + len(square))] = np.inf
        potential -= 0.5 * G * float(m[rows] @ (1.0 / np.sqrt(square)) @ m)
    return kinetic, potential


def pull(made: Made, at: Floats, softening: float) -> Floats:
    """Accelerations (k, 3) at places (k, 3) by a sum over all stars, G = 1."""
    weight = made.mass / (cdist(at, made.position, "sqeuclidean") + softening**2) ** 1.5
    return np.asarray(weight @ made.position - weight.sum(axis=1)[:, None] * at)
