"""Small made-up films for the tests of pictures."""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from tianim.frame import Frame, Lines, Mesh, Part, Points

Float = NDArray[np.float32]


class Film:
    """Frames made when asked for; `asked` counts how often."""

    def __init__(self, count: int, make: Callable[[int, float], tuple[Part, ...]], fps: float = 30.0) -> None:
        self._count, self._make, self._fps, self.asked = count, make, fps, 0

    def __len__(self) -> int:
        return self._count

    def __getitem__(self, index: int) -> Frame:
        if not 0 <= index < self._count:
            raise IndexError(index)
        self.asked += 1
        return Frame(index, index / self._fps, self._make(index, index / self._fps))


def cloud(count: int, seed: int = 0, flat: int | None = None) -> Float:
    """Points of a ball of radius about 2 m, flattened along an axis if asked."""
    points = np.random.default_rng(seed).normal(size=(count, 3)).astype(np.float32)
    if flat is not None:
        points[:, flat] = 0.0
    return points


def flock(
    count: int = 300, drift: tuple[float, float, float] = (0, 0, 0), flat: int | None = None
) -> Callable[[int, float], tuple[Part, ...]]:
    """A ball of points that turns and drifts [m/s], with velocity and id."""
    rest = cloud(count, flat=flat)

    def make(index: int, time: float) -> tuple[Part, ...]:
        velocity = np.zeros_like(rest)
        if flat == 2:
            velocity[:, 0], velocity[:, 1] = -rest[:, 1], rest[:, 0]
        else:
            velocity[:, 0], velocity[:, 2] = -rest[:, 2], rest[:, 0]
        position = (rest + np.float32(0.1 * time) * velocity + np.float32(time) * np.array(drift)).astype(
            np.float32
        )
        data = {"velocity": velocity + np.array(drift, np.float32), "id": np.arange(count, dtype=np.int32)}
        return (Points("boids", position, data, {"velocity": "m/s"}),)

    return make


def cube(size: float = 1.0, center: tuple[float, float, float] = (0, 0, 0), name: str = "cube") -> Mesh:
    """A closed cube whose triangles face outwards."""
    corners = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], np.float32)
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    triangles = [t for a, b, c, d in quads for t in ((a, b, c), (a, c, d))]
    position = (0.5 * size * corners + np.array(center)).astype(np.float32)
    return Mesh(name, position, np.array(triangles, np.int32))


def strand(points: int = 5) -> Lines:
    """A rope that hangs along y."""
    position = np.zeros((points, 3), np.float32)
    position[:, 1] = np.linspace(0, 2, points)
    first = np.arange(points - 1, dtype=np.int32)
    return Lines("rope", position, np.stack([first, first + 1], axis=1))
