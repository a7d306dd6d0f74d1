"""A fluid of particles that one method steps, without a scene; and its pairs in float64."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from tianim.math.smoothing import SUPPORT, spline_slopes, spline_values
from tianim.spatial.bodies import Bodies
from tianim.system import Bounds
from tianim.systems.fluid.forces import Forces
from tianim.systems.fluid.params import FluidParams
from tianim.systems.fluid.particles import Particles
from tianim.systems.fluid.walls import Walls

Floats = NDArray[np.float64]
OPEN = Bounds()
DENSITIES = (1000.0, 400.0)


def cube(side: int, spacing: float, jitter: float = 0.0, dimension: int = 3, seed: int = 1) -> Floats:
    """A cube (square) of particles from the origin on, each moved by up to `jitter` spacings an axis."""
    axis = np.arange(side) + 0.5
    x = np.zeros((side**dimension, 3))
    x[:, :dimension] = np.stack(np.meshgrid(*[axis] * dimension, indexing="ij"), -1).reshape(-1, dimension)
    x[:, :dimension] += np.random.default_rng(seed).uniform(-jitter, jitter, (len(x), dimension))
    return x * spacing


class Flow:
    """Particles of two phases, stepped by `method`; `more` are fields of FluidParams."""

    def __init__(
        self, kind: Any, x: NDArray[Any], v: NDArray[Any] | None = None, phase: NDArray[Any] | None = None,
        spacing: float = 0.1, dimension: int = 3, bounds: Bounds = OPEN, **more: Any,
    ) -> None:  # fmt: skip
        n = len(x)
        data: dict[str, Any] = {
            "kind": "fluid", "dimension": dimension, "spacing": spacing, "density": DENSITIES[0],
            "viscosity": 0.0, "artificial_viscosity": 0.0,
            "phases": {"light": {"density": DENSITIES[1], "viscosity": 0.0}},
            "blocks": {"unused": {"kind": "box", "lower": (0.0, 0.0, 0.0), "upper": (1.0, 1.0, 1.0)}},
        }  # fmt: skip
        self.params = FluidParams.model_validate(data | more)
        self.particles = Particles(n, dimension, spacing, SUPPORT[dimension], np.array(DENSITIES, np.float32))
        self.particles.columns.append(
            n,
            {
                "position": x.astype(np.float32),
                "velocity": np.zeros((n, 3), np.float32) if v is None else v.astype(np.float32),
                "phase": np.zeros(n, np.int32) if phase is None else phase.astype(np.int32),
            },
        )
        self.pairs = kind.pairs_for(self.params, self.particles, bounds)
        self.walls = Walls(Bodies({}), bounds, self.particles, self.params.walls)
        self.forces = Forces(self.params, self.particles, self.pairs, self.walls)
        self.method = kind(self.params, self.particles, self.pairs, self.walls, self.forces)
        self.time = 0.0

    @property
    def n(self) -> int:
        return self.particles.count

    def run(self, steps: int, dt: float | None = None) -> int:
        """Steps of dt, or as long as the limits allow; how many particles had to be put back."""
        clamped = 0
        for _ in range(steps):
            step = dt or self.forces.largest_step()
            self.method.step(self.time, step)
            self.time += step
            clamped += self.method.clamped
        return clamped

    def stored(self, name: str) -> Floats:
        """A column in storage order, (n, 3) or (n, rows)."""
        return np.asarray(self.particles[name].to_numpy()[:, : self.n].T, np.float64)

    def array(self, of: Any) -> Floats:
        """An array of a step in storage order, (n,) or (3, n)."""
        return np.asarray(of.to_numpy()[..., : self.n], np.float64)

    def rho(self) -> Floats:
        return np.array(DENSITIES)[self.particles["phase"].to_numpy()[0, : self.n]]

    def momentum(self) -> tuple[Floats, float]:
        """The sum of all momenta, and of their sizes, over V."""
        each = self.rho()[:, None] * self.stored("velocity")
        return each.sum(axis=0), float(np.linalg.norm(each, axis=1).sum())

    def differences(self, x: Floats) -> tuple[Floats, Floats]:
        """x_ij, (n, n, 3), and its length with 1 on the diagonal, (n, n)."""
        d = x[:, None] - x[None]
        return d, np.linalg.norm(d, axis=2) + np.eye(len(x))

    def densities(self, x: Floats) -> Floats:
        """Delta without walls, in float64."""
        p = self.particles
        _, r = self.differences(x)
        w = p.volume * p.scale * spline_values(r / p.h, p.dimension)
        np.fill_diagonal(w, p.volume * p.scale * spline_values(0.0, p.dimension))
        return np.asarray(w.sum(axis=1))

    def gradients(self, x: Floats) -> Floats:
        """G_ij, (n, n, 3), in float64."""
        p = self.particles
        d, r = self.differences(x)
        slope = p.volume * p.scale * spline_slopes(r / p.h, p.dimension) * (r < p.h) / (p.h * r)
        np.fill_diagonal(slope, 0.0)
        return np.asarray(slope[:, :, None] * d)
