"""How far the projective solver's iterations go: against the same iterations in float64, and without them."""

from typing import Any

import numpy as np
import pytest
import scipy
from numpy.typing import NDArray

from tianim.systems.springs.assembly import implicit_matrix
from tianim.validate.springs_scenes import projective, springs

Floats = NDArray[np.float64]

DT = 1.0 / 60.0
# Solves are float32: of moves of a few centimetres a millionth and a little.
ROUNDING = 2e-7  # [m]


def crumpled(iterations: int, damping: float = 2e-3) -> Any:
    """A sheet held at a corner whose points were pushed to and fro, and move apart."""
    piece = {"kind": "sheet", "size": (0.5, 0.4), "segments": (10, 8), "stretch": 300.0, "shear": 40.0,
             "bend": 1e-4, "density": 0.2, "damping": damping}  # fmt: skip
    system = springs(
        piece, pins={"a": {"piece": "p", "points": [0]}}, gravity=(0.0, -9.81, 0.0),
        **projective("implicit_euler", iterations=iterations),
    )  # fmt: skip
    rng = np.random.default_rng(3)
    for name, size in (("position", 0.012), ("velocity", 0.8)):
        moved = system.read(name) + size * rng.normal(size=(system.count, 3))
        moved[0] = system.read(name)[0]
        system.write(name, moved)
    return system


class Reference:
    """The step that `system` is about to take, in NumPy."""

    def __init__(self, system: Any) -> None:
        whole = system.whole
        self.base, v = system.read("position"), system.read("velocity")
        self.free = np.arange(system.count) > 0
        self.heavy = np.where(self.free, whole.mass, 0.0)[:, None] / DT**2
        self.y = self.base + DT * v + DT**2 * np.array([0.0, -9.81, 0.0])
        self.guess = self.base + DT * v * self.free[:, None]
        self.springs, self.Q = whole.springs, whole.bending
        self.factor = scipy.sparse.linalg.splu(implicit_matrix(whole, ~self.free, DT))

    def along(self, x: Floats) -> tuple[Floats, Floats]:
        """Ways between the ends of the springs, and their lengths."""
        a, b = self.springs.ends.T
        d = x[b] - x[a]
        return d, np.linalg.norm(d, axis=1)

    def gathered(self, f: Floats) -> Floats:
        """Forces of springs on their first points, and the other way on their second."""
        found = np.zeros_like(self.base)
        np.add.at(found, self.springs.ends[:, 0], f)
        np.add.at(found, self.springs.ends[:, 1], -f)
        return found * self.free[:, None]

    def residual(self, x: Floats) -> Floats:
        d, length = self.along(x)
        before, far = self.along(self.base)
        s = self.springs
        f = (s.stiffness * (1.0 - s.rest_length / length))[:, None] * d
        f += (s.damping * ((d - before) * before).sum(axis=1) / (DT * far**2))[:, None] * before
        return self.gathered(f) + (self.heavy * (self.y - x) - self.Q @ x) * self.free[:, None]

    def energy(self, x: Floats) -> float:
        """Of what is minimised [J], without damping."""
        longer = self.along(x)[1] - self.springs.rest_length
        own = 0.5 * (self.heavy * (self.y - x) ** 2).sum() + 0.5 * (x * (self.Q @ x)).sum()
        return float(own + 0.5 * (self.springs.stiffness * longer**2).sum())

    def curved(self, x: Floats, z: Floats) -> Floats:
        """H z."""
        d, length = self.along(x)
        n = d / length[:, None]
        before, far = self.along(self.base)
        dz, _ = self.along(z)
        s = self.springs
        across = s.stiffness * np.maximum(1.0 - s.rest_length / length, 0.0)
        f = across[:, None] * dz + ((s.stiffness - across) * (n * dz).sum(axis=1))[:, None] * n
        f += (s.damping * (before * dz).sum(axis=1) / (DT * far**2))[:, None] * before
        return -self.gathered(f) + (self.heavy * z + self.Q @ z) * self.free[:, None]

    def solved(self, iterations: int) -> Floats:
        x, p, hp = self.guess.copy(), np.zeros_like(self.base), np.zeros_like(self.base)
        for k in range(iterations):
            r = self.residual(x)
            z = self.factor.solve(r)
            if k == 0:
                x = x + z
                continue
            hz = self.curved(x, z)
            ways = np.array([[(z * hz).sum(), (z * hp).sum()], [(z * hp).sum(), (p * hp).sum()]])
            some = slice(0, 1 if k == 1 else 2)
            a = np.linalg.solve(ways[some, some], np.array([(z * r).sum(), (p * r).sum()])[some])
            p, hp = (sum(a[i] * way for i, way in enumerate(ways[some])) for ways in ((z, p), (hz, hp)))
            x = x + p
        return x


@pytest.mark.parametrize("iterations", [1, 2, 3, 6])
def test_iterations_are_those_of_float64(iterations: int) -> None:
    system = crumpled(iterations)
    expected = Reference(system).solved(iterations)
    system.step(0.0, DT)
    np.testing.assert_allclose(system.read("position"), expected, rtol=0.0, atol=ROUNDING)


def test_the_hessian_is_the_slope_of_the_forces() -> None:
    """Where all springs are stretched nothing is left out of it."""
    reference = Reference(crumpled(1))
    x, z = 1.3 * reference.guess, np.random.default_rng(4).normal(size=reference.base.shape)
    z[0] = 0.0
    assert (reference.along(x)[1] > reference.springs.rest_length).mean() > 0.8
    stretched = reference.along(x)[1] > reference.springs.rest_length
    object.__setattr__(reference.springs, "stiffness", np.where(stretched, reference.springs.stiffness, 0.0))
    slope = (reference.residual(x - 1e-6 * z) - reference.residual(x + 1e-6 * z)) / 2e-6
    np.testing.assert_allclose(reference.curved(x, z), slope, rtol=1e-6, atol=1e-3)


def test_ten_iterations_leave_a_third_of_the_energy_that_the_solve_alone_would() -> None:
    reference = Reference(crumpled(1, 0.0))
    least, alone = reference.energy(reference.solved(400)), reference.guess
    for _ in range(10):
        alone = alone + reference.factor.solve(reference.residual(alone))
    system = crumpled(10, 0.0)
    system.step(0.0, DT)
    left = reference.energy(system.read("position")) - least
    assert 0.0 < left < (reference.energy(alone) - least) / 3.0
