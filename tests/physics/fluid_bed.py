"""A cloud of particles with its pairs, for forces to be put on, and walls that are set by hand.

Lengths are in spacings, densities near 1: what rounding does is the same in any unit.
"""

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from tianim.lang import ti
from tianim.math.smoothing import SUPPORT
from tianim.system import Bounds
from tianim.systems.fluid.pairs import Pairs
from tianim.systems.fluid.particles import Particles
from tianim.systems.fluid.viscosity import Viscosity

Floats = NDArray[np.float64]

# Sums of some forty float32 terms against float64.
SINGLE = 3e-6
# Whole sums that cancel, over the sum of the magnitudes.
CANCELS = 1e-6


@dataclass(frozen=True)
class Liquid:
    """Density and kinematic viscosity of a phase."""

    density: float
    viscosity: float


@dataclass
class StillWalls:
    """What the forces read of walls: here by hand; none where `distance` is left alone."""

    capacity: int
    count: int = 0
    distance: Any = field(init=False)

    def __post_init__(self) -> None:
        for name, shape in (
            ("share", ()),
            ("distance", ()),
            ("gradient", (3,)),
            ("normal", (3,)),
            ("speed", (3,)),
        ):
            array = ti.ndarray(ti.f32, (*shape, self.capacity))
            array.fill(1e9 if name == "distance" else 0.0)
            setattr(self, name, array)
        self.nearest = ti.ndarray(ti.i32, self.capacity)
        self.nearest.fill(-1)
        self.friction = ti.ndarray(ti.f32, 1)
        self.friction.fill(1.0)

    def put(self, name: str, values: Floats) -> None:
        array = getattr(self, name)
        whole = array.to_numpy()
        whole[..., : values.shape[-1]] = values
        array.from_numpy(whole)


class Bed:
    """Particles with their pairs, and what is needed to put forces on them."""

    def __init__(
        self, x: Floats, v: Floats, dimension: int, phases: tuple[Liquid, ...] = (Liquid(1.0, 1.0),),
        phase: NDArray[np.int32] | None = None, bounds: Bounds | None = None,
    ) -> None:  # fmt: skip
        n = len(x)
        self.phases = phases
        rho = np.array([liquid.density for liquid in phases], np.float32)
        self.particles = Particles(n, dimension, 1.0, SUPPORT[dimension], rho)
        given: dict[str, NDArray[Any]] = {
            "position": x,
            "velocity": v,
            "phase": np.zeros(n, np.int32) if phase is None else phase,
        }
        self.particles.columns.append(n, given)
        self.pairs = Pairs(self.particles, bounds or Bounds())
        self.pairs.build()
        self.walls = StillWalls(self.particles.columns.capacity)
        self.pull = ti.ndarray(ti.f32, (3, self.particles.columns.capacity))
        self.pull.fill(0.0)
        self.particles.acceleration.fill(0.0)

    @property
    def n(self) -> int:
        return self.particles.count

    def stored(self, name: str) -> NDArray[Any]:
        """A column in storage order, (n, 3) or (n,)."""
        values = self.particles[name].to_numpy()[:, : self.n].T
        return np.asarray(values[:, 0] if name == "phase" else values.astype(np.float64))

    def acceleration(self) -> Floats:
        return np.asarray(self.particles.acceleration.to_numpy()[:, : self.n].T, np.float64)

    def mass(self) -> Floats:
        return np.array([liquid.density for liquid in self.phases])[self.stored("phase")]

    def viscosity(self) -> Viscosity:
        return Viscosity(self.phases, self.particles, self.pairs, self.walls)

    def pair_list(self) -> tuple[NDArray[np.int64], NDArray[np.int64], Floats, Floats]:
        """Both rows of all pairs nearer than the support: i, j, x_ij, r."""
        x = self.stored("position")
        found = cKDTree(x).query_pairs(SUPPORT[self.particles.dimension], output_type="ndarray")
        i, j = np.r_[found[:, 0], found[:, 1]], np.r_[found[:, 1], found[:, 0]]
        return i, j, x[i] - x[j], np.linalg.norm(x[i] - x[j], axis=1)


def lattice(n: int, dimension: int, jitter: float = 0.0) -> Floats:
    """A cube of n^dimension particles, each moved by up to `jitter` along each axis."""
    rng = np.random.default_rng(7)
    x = np.zeros((n**dimension, 3))
    x[:, :dimension] = np.stack(np.meshgrid(*[np.arange(n) + 0.5] * dimension, indexing="ij"), -1).reshape(
        -1, dimension
    )
    x[:, :dimension] += rng.uniform(-jitter, jitter, (len(x), dimension))
    return x


def stirred(dimension: int, two: bool = False) -> Bed:
    """A disordered cloud at random velocities, of one phase or two."""
    x = lattice(9 if dimension == 3 else 26, dimension, 0.25)
    v = np.zeros_like(x)
    v[:, :dimension] = np.random.default_rng(3).normal(size=(len(x), dimension))
    phase = (x[:, 0] > x[:, 0].mean()).astype(np.int32) if two else None
    return Bed(x, v, dimension, (Liquid(1.0, 1.0), Liquid(5.0, 0.05)) if two else (Liquid(1.0, 1.0),), phase)


def gathered(i: NDArray[np.int64], values: Floats, n: int) -> Floats:
    return np.stack([np.bincount(i, values[:, c], n) for c in range(3)], axis=1)
