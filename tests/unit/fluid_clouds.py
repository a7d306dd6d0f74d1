"""Particles of fluids made up for tests: jittered lattices in balls and boxes."""

import numpy as np
from numpy.typing import NDArray

from tianim.frame import Points

Float = NDArray[np.float32]


def lattice(lower: tuple[float, ...], upper: tuple[float, ...], spacing: float, jitter: float = 0.2) -> Float:
    """Particles that fill a box, each moved by up to `jitter` spacings on each axis."""
    axes = [np.arange(low + spacing / 2, high, spacing) for low, high in zip(lower, upper, strict=True)]
    points = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, len(axes))
    shifts = np.random.default_rng(7).uniform(-jitter, jitter, points.shape)
    return (points + spacing * shifts).astype(np.float32)


def ball(radius: float, spacing: float, jitter: float = 0.2) -> Float:
    """Particles that fill a ball around the origin."""
    points = lattice((-1.2 * radius,) * 3, (1.2 * radius,) * 3, spacing, jitter)
    return points[np.linalg.norm(points, axis=1) < radius]


def water(position: Float, spacing: float, velocity: Float | None = None, name: str = "water") -> Points:
    """A part as a fluid gives it."""
    data = {
        "id": np.arange(len(position), dtype=np.int32),
        "velocity": np.zeros_like(position) if velocity is None else velocity.astype(np.float32),
    }
    return Points(name, position, data, {"velocity": "m/s"}, spacing)
