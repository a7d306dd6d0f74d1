"""The three rules of the flock in float64, every boid against every other: slow, and apart from the kernels.

    separation  w_s sum -d / |d|^2,   alignment  w_a (mean v_j - v_i),   cohesion  w_c mean d

over the neighbours j nearer than the rule's radius and within its field of view; with topological
neighbours over those among the k nearest. Sums and means are weighted by the interaction table.
"""

import math
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from tianim.system import Bounds
from tianim.systems.boids.params import BoidsParams, Interaction, Rule, Topological

Floats = NDArray[np.float64]


def displacements(position: Floats, bounds: Bounds, dimension: int) -> Floats:
    """d[i, j] = x_j - x_i to the nearest image [m], shape (n, n, 3)."""
    d = position[None, :, :] - position[:, None, :]
    if bounds.lower is not None and bounds.upper is not None and bounds.kind == "periodic":
        length = np.subtract(bounds.upper, bounds.lower)
        for axis in range(dimension):
            d[..., axis] -= length[axis] * np.round(d[..., axis] / length[axis])
    return np.asarray(d)


class Flock:
    """A flock at one moment: `acceleration` is what the three rules ask for within the budget.

    position, velocity (n, 3) [m], [m/s], in id order; species by id, as the parameters list them.
    """

    def __init__(self, params: BoidsParams, position: Floats, velocity: Floats, bounds: Bounds) -> None:
        self.params = params
        self.velocity = np.asarray(velocity, np.float64)
        self.d = displacements(np.asarray(position, np.float64), bounds, params.dimension)
        self.distance = np.linalg.norm(self.d, axis=2)
        species = params.all_species()
        self.names = list(species)
        self.kind = np.repeat(np.arange(len(species)), [one.boid_count() for one in species.values()])
        self.near = self._nearest()

    def _nearest(self) -> NDArray[np.bool_]:
        """Who may count at all: everyone else, or the k nearest of them within the largest radius."""
        others = ~np.eye(len(self.distance), dtype=bool)
        if not isinstance(self.params.neighbourhood, Topological):
            return others
        distance = np.where(others, self.distance, np.inf)
        rank = np.argsort(np.argsort(distance, axis=1), axis=1)
        return rank < self.params.neighbourhood.k

    def seen(self, rule: Rule) -> NDArray[np.bool_]:
        """[i, j]: i minds j by this rule."""
        speed = np.linalg.norm(self.velocity, axis=1)[:, None]
        heading = self.velocity / np.where(speed > 0.0, speed, 1.0)
        ahead = np.einsum("ijk,ik->ij", self.d, heading)
        cone = math.cos(math.radians(rule.field_of_view) / 2)
        in_view = (ahead >= cone * self.distance) | (rule.field_of_view >= 360.0)
        return self.near & (self.distance < rule.radius) & in_view

    def factors(self, rule: str) -> Floats:
        """[i, j]: how strongly i minds the species of j in this rule."""
        table = np.empty((len(self.names),) * 2)
        for a, who in enumerate(self.names):
            for b, other in enumerate(self.names):
                given = getattr(self.params.interactions.get(who, {}).get(other, Interaction()), rule)
                table[a, b] = (who == other) if given is None else given
        return table[self.kind[:, None], self.kind[None, :]]

    def wishes(self) -> tuple[Floats, Floats, Floats]:
        """Accelerations (n, 3) [m/s2] that separation, alignment and cohesion ask for, unlimited."""
        total = np.zeros((3, *self.velocity.shape))
        for index, species in enumerate(self.params.all_species().values()):
            rows = self.kind == index
            s, a, c = (
                self.seen(getattr(species, rule)) * self.factors(rule)
                for rule in ("separation", "alignment", "cohesion")
            )
            square = np.maximum(self.distance**2, 1e-12)
            total[0, rows] = -species.separation.weight * np.einsum("ij,ijk->ik", s / square, self.d)[rows]
            mean, any_one = self._mean(a, np.broadcast_to(self.velocity[None], self.d.shape))
            total[1, rows] = species.alignment.weight * (any_one * (mean - self.velocity))[rows]
            total[2, rows] = species.cohesion.weight * self._mean(c, self.d)[0][rows]
        return total[0], total[1], total[2]

    @staticmethod
    def _mean(weight: Floats, values: Floats) -> tuple[Floats, NDArray[np.bool_]]:
        """Weighted mean over j, zero where there is nobody, and whether there is somebody."""
        total = weight.sum(axis=1, keepdims=True)
        mean = np.einsum("ij,ijk->ik", weight, values) / np.where(total > 0.0, total, 1.0)
        return mean, total > 0.0

    def acceleration(self) -> Floats:
        """What is asked for within each species' limit (n, 3) [m/s2]."""
        asked = self.wishes()
        result = np.empty_like(self.velocity)
        for i, steps in enumerate(zip(*asked, strict=True)):
            limits = self.params.all_species()[self.names[self.kind[i]]].limits
            if limits.allocation == "prioritised":
                result[i] = sum(_within(steps, limits.max_acceleration))
            else:
                total = np.sum(steps, axis=0)
                size = float(np.linalg.norm(total))
                result[i] = total * min(1.0, limits.max_acceleration / max(size, 1e-30))
        return result

    def scale(self) -> Floats:
        """Size of the sums' terms at each boid (n,) [m/s2], against which float32 rounds."""
        return np.sum([np.linalg.norm(one, axis=1) for one in self.wishes()], axis=0) + np.linalg.norm(
            self.velocity, axis=1
        )


def _within(steps: tuple[Floats, ...], budget: float) -> Iterator[Floats]:
    """The wishes in order, as far as the sum of their sizes stays within the budget."""
    left = budget
    for step in steps:
        size = float(np.linalg.norm(step))
        part = min(1.0, left / max(size, 1e-30))
        yield part * step
        left = max(left - part * size, 0.0)
