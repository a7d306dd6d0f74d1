"""The pressure solve of DFSPH: against a complementarity problem in float64, and what it must keep.

On a jittered block in a corner of a tank the matrix A is built in float64 from the stored gradients; the
solver's pressures must fulfil P >= 0, r <= 0, P r = 0 with it, and its accelerations be those of P.
"""

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from tianim.spatial.bodies import Bodies
from tianim.spatial.crew import Crew
from tianim.system import Bounds
from tianim.systems.fluid.pairs import Pairs
from tianim.systems.fluid.params import Walls as WallParams
from tianim.systems.fluid.particles import Particles
from tianim.systems.fluid.pressure import DRIFT, MOTION, PressureSolver
from tianim.systems.fluid.pressure_passes import CLOSING, GAP
from tianim.systems.fluid.walls import Walls

D, DT = 0.1, 0.004
SIDE = 8
TANK = Bounds("contained", (0.0, 0.0, 0.0), (2.0, 2.0, 2.0))
DENSITIES = np.array([1000.0, 400.0], np.float32)
# Mean of |r| dt^2 that is asked for; float32 sums of thirty terms keep it to a tenth.
TOLERANCE = 1e-6
# Sum of all forces over the sum of their sizes: float32 rounding of a few thousand pairs.
MOMENTUM = 1e-6
ROUNDING = 1e-5

Floats = NDArray[np.float64]


class Block:
    """A block of two phases in the corner of a tank, with random velocities, at the start of a solve."""

    def __init__(self, seed: int = 1, walled: bool = True) -> None:
        rng = np.random.default_rng(seed)
        axis = (np.arange(SIDE) + 0.5) * D
        x = np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), axis=-1).reshape(-1, 3)
        x += rng.uniform(-0.15, 0.15, x.shape) * D
        n = len(x)
        self.particles = Particles(n, 3, D, 2.0, DENSITIES)
        self.particles.columns.append(
            n,
            {
                "position": x,
                "velocity": rng.normal(0.0, 1.0, x.shape),
                "phase": rng.integers(0, 2, n),
                "warm": np.zeros((n, 2)),
            },
        )
        bounds = TANK if walled else Bounds()
        self.pairs = Pairs(self.particles, bounds)
        self.walls = Walls(Bodies({}), bounds, self.particles, WallParams())
        self.pairs.build()
        self.walls.measure(n, self.particles["position"], self.particles.density)
        self.solver = PressureSolver(self.particles, self.pairs, self.walls)
        self.n = n

    def array(self, of: Any) -> Floats:
        """The first n of an array of a step, in storage order, in float64."""
        return np.asarray(of.to_numpy()[..., : self.n], np.float64)

    def matrices(self) -> tuple[Floats, Floats]:
        """`rate` (n, 3 n): velocities to rates of delta; `push` (3 n, n): pressures to accelerations."""
        n = self.n
        rate = np.zeros((n, n, 3))
        begin, end = self.pairs.begin.to_numpy(), self.pairs.end.to_numpy()
        neighbour, gradient = self.pairs.neighbour.to_numpy(), self.pairs.gradient.to_numpy().astype(float)
        for i in range(n):
            row = slice(begin[i], end[i])
            rate[i, neighbour[row]] -= gradient[:, row].T
            rate[i, i] += gradient[:, row].sum(axis=1)
        rate[np.arange(n), np.arange(n)] += self.array(self.walls.gradient).T
        flat = rate.reshape(n, 3 * n)
        rho = DENSITIES.astype(float)[self.particles["phase"].to_numpy()[0, :n]]
        return flat, -flat.T / np.repeat(rho, 3)[:, None]

    def source(self, stage: int) -> Floats:
        """B of a stage, by its definition."""
        rate, _ = self.matrices()
        v = self.array(self.particles["velocity"]).T.reshape(-1)
        change = rate @ v / DT
        delta = self.array(self.particles.density)
        if stage == DRIFT:
            return change + (delta - 1.0) / DT**2
        gap = np.maximum(1.0 - delta, 0.0)
        return change - np.maximum(gap - GAP, 0.0) / DT**2 - gap / (DT * CLOSING)


@pytest.fixture(name="block")
def _block() -> Block:
    return Block()


@pytest.mark.parametrize("stage", [MOTION, DRIFT])
def test_pressures_solve_the_complementarity_problem(block: Block, stage: int) -> None:
    if stage == DRIFT:
        block.solver.solve(MOTION, DT, TOLERANCE, 2, 400)
    b = block.source(stage)
    rate, push = block.matrices()
    solved = block.solver.solve(stage, DT, TOLERANCE, 0, 400)
    assert 1 < solved.iterations < 400
    p = block.array(block.particles["warm"])[stage]
    assert p.min() == 0.0 < p.max()
    r = b + rate @ (push @ p)
    left = np.where(p > 0.0, np.abs(r), np.maximum(r, 0.0)).mean() * DT**2
    without = np.maximum(b, 0.0).mean() * DT**2
    assert left < 3.0 * TOLERANCE  # one more relaxation than the last that was measured
    assert without > 1000.0 * TOLERANCE


def test_accelerations_and_velocities_are_those_of_the_pressures(block: Block) -> None:
    before = block.array(block.particles["velocity"])
    block.solver.solve(MOTION, DT, TOLERANCE, 2, 400)
    _, push = block.matrices()
    after = block.array(block.particles["velocity"])
    expected = (push @ block.array(block.particles["warm"])[MOTION]).reshape(-1, 3).T
    largest = np.abs(expected).max()
    # The velocities have the push of the last but one relaxation, which differs by what was left.
    np.testing.assert_allclose((after - before) / DT, expected, atol=2e-3 * largest)
    np.testing.assert_allclose(
        block.array(block.particles.pressure),
        block.array(block.particles["warm"])[MOTION],
        rtol=0.05,
        atol=50.0,
    )


def test_pressure_moves_no_centre_of_mass() -> None:
    block = Block(walled=False)
    rho = DENSITIES.astype(float)[block.particles["phase"].to_numpy()[0, : block.n]]
    before = block.array(block.particles["velocity"])
    block.solver.solve(MOTION, DT, 1e-4, 2, 100)
    change = (block.array(block.particles["velocity"]) - before) * rho
    assert np.abs(change.sum(axis=1)).max() < MOMENTUM * np.abs(change).sum()
    assert np.abs(change).max() > 1.0


def test_pressures_of_the_step_before_spare_iterations(block: Block) -> None:
    v = block.particles.columns.read("velocity")
    first = block.solver.solve(MOTION, DT, 1e-5, 2, 400)
    block.particles.columns.write("velocity", v)
    again = block.solver.solve(MOTION, DT, 1e-5, 2, 400)
    assert again.iterations < 0.5 * first.iterations


def test_too_much_pressure_is_taken_back(block: Block) -> None:
    """Pressure left over from before would become velocity: it counts as an error too."""
    warm = block.particles.columns.read("warm")
    warm[:, MOTION] = 2e5
    block.particles.columns.write("velocity", np.zeros((block.n, 3)))
    block.particles.columns.write("warm", warm)
    solved = block.solver.solve(MOTION, DT, TOLERANCE, 1, 400)
    assert solved.iterations > 3
    assert np.abs(block.array(block.particles["velocity"])).max() < 0.02


@pytest.fixture(name="by_passes")
def _by_passes(monkeypatch: pytest.MonkeyPatch) -> None:
    made = Crew.__init__

    def init(self: Crew, capacity: int) -> None:
        made(self, capacity)
        self.works = False

    monkeypatch.setattr(Crew, "__init__", init)


def test_a_crew_gives_what_single_passes_give(request: pytest.FixtureRequest) -> None:
    together = Block()
    solved = [together.solver.solve(stage, DT, 1e-5, 2, 100) for stage in (MOTION, DRIFT)]
    request.getfixturevalue("by_passes")
    apart = Block()
    again = [apart.solver.solve(stage, DT, 1e-5, 2, 100) for stage in (MOTION, DRIFT)]
    assert [one.iterations for one in solved] == [one.iterations for one in again]
    # Another kernel rounds otherwise in the last place.
    for name in ("velocity", "warm"):
        expected = together.array(together.particles[name])
        tolerance = ROUNDING * np.abs(expected).max()
        np.testing.assert_allclose(apart.array(apart.particles[name]), expected, atol=tolerance, rtol=0)


@pytest.mark.parametrize("tasks", [1, 2])
def test_the_number_of_tasks_changes_no_byte(tasks: int, monkeypatch: pytest.MonkeyPatch) -> None:
    expected = Block()
    expected.solver.solve(MOTION, DT, 1e-5, 2, 100)
    monkeypatch.setattr(Crew, "tasks_for", lambda self, n: tasks)
    block = Block()
    block.solver.solve(MOTION, DT, 1e-5, 2, 100)
    np.testing.assert_array_equal(
        block.array(block.particles["velocity"]), expected.array(expected.particles["velocity"])
    )


def test_a_lone_particle_has_no_pressure() -> None:
    particles = Particles(1, 3, D, 2.0, DENSITIES)
    particles.columns.append(1, {"position": np.ones((1, 3)), "velocity": np.full((1, 3), 3.0)})
    pairs = Pairs(particles, TANK)
    walls = Walls(Bodies({}), TANK, particles, WallParams())
    pairs.build()
    walls.measure(1, particles["position"], particles.density)
    solver = PressureSolver(particles, pairs, walls)
    for stage in (MOTION, DRIFT):
        solver.solve(stage, DT, 1e-4, 2, 10)
    np.testing.assert_array_equal(particles.columns.read("velocity"), np.full((1, 3), 3.0))
    assert particles.pressure.to_numpy()[0] == 0.0
