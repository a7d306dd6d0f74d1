"""Forces between stars, on the very particles that the peers' script makes: seconds and errors.

A Plummer sphere and a galaxy (exponential disk in a Hernquist halo), G = 1, Plummer softening 0.01, the
solver that `auto` takes for a median error of 1e-3; up to LARGEST_DIRECT stars the direct sum too.
Errors are relative, of 1,000 stars against float64 sums with the same softening; the peer pytreegrav has
the spline (h = 2.8 eps) and is compared with that.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from tianim import runtime
from tianim.bench.cases import Task
from tianim.bench.lines import Round
from tianim.bench.measuring import PassClock, array_bytes, timed_round
from tianim.lang import ti
from tianim.spatial.columns import staggered
from tianim.systems.gravity.solver import DirectSum, Law, Solver, TreeSum, make_solver

LAW = Law(1.0, 0.01)
ACCURACY = 1e-3
SEED = 42
LARGEST_DIRECT = 32_768
# A round does about so many stars' evaluations, within limits.
STARS, FEWEST, MOST = 500_000, 3, 20

Floats = NDArray[np.float64]


def plummer(n: int, rng: np.random.Generator) -> tuple[Floats, Floats]:
    """Scale length 1, mass 1, the inner 99 % of the mass."""
    enclosed = rng.uniform(0, 0.99, n)
    return _on_spheres(1 / np.sqrt(enclosed ** (-2 / 3) - 1), rng), np.full(n, 1.0 / n)


def galaxy(n: int, rng: np.random.Generator) -> tuple[Floats, Floats]:
    """40 % of the stars: disk of scale length 1, mass 0.2; the others: Hernquist halo, a = 5, mass 0.8."""
    disk = int(0.4 * n)
    halo = n - disk
    drawn = rng.gamma(2.0, 1.0, 4 * disk)
    radius = drawn[drawn < 8][:disk]
    angle = rng.uniform(0, 2 * np.pi, disk)
    height = 0.1 * np.arctanh(rng.uniform(-0.9999, 0.9999, disk))
    share = np.sqrt(rng.uniform(0, (60 / 65) ** 2, halo))
    flat = np.c_[radius * np.cos(angle), radius * np.sin(angle), height]
    round_ = _on_spheres(5.0 * share / (1 - share), rng)
    return np.r_[flat, round_], np.r_[np.full(disk, 0.2 / max(disk, 1)), np.full(halo, 0.8 / max(halo, 1))]


def _on_spheres(radius: Floats, rng: np.random.Generator) -> Floats:
    z = rng.uniform(-1, 1, len(radius))
    angle = rng.uniform(0, 2 * np.pi, len(radius))
    s = np.sqrt(1 - z * z)
    return np.c_[radius * s * np.cos(angle), radius * s * np.sin(angle), radius * z]


SETS = {"plummer": plummer, "galaxy": galaxy}


def stars(name: str, n: int) -> tuple[Floats, Floats]:
    """Positions (n, 3) and masses (n,), in the peers' order."""
    rng = np.random.default_rng(SEED)
    position, mass = SETS[name](n, rng)
    order = rng.permutation(n)
    return position[order], mass[order]


class _Evaluation:
    """One set of stars with one solver."""

    def __init__(self, x: Any, mass: Any, a: Any, solver: Solver) -> None:
        self._x, self._mass, self._a, self.solver = x, mass, a, solver
        is_tree = isinstance(solver, TreeSum)
        self._clock = PassClock(solver, {"build": "build", "walk": "walk"}) if is_tree else None
        self._evaluate(0)
        median, most = solver.sample_error(x, mass, a, rng_seed=SEED)
        self._error = {"median": median, "p99": most}

    def _evaluate(self, _: int) -> None:
        self.solver.evaluate(self._x, self._mass, self._a)

    def round(self) -> Round:
        """Some evaluations, one after another."""
        repeats = min(max(STARS // self.solver.count, FEWEST), MOST)
        one = timed_round(self._evaluate, repeats, self._clock)
        return Round(one.steps, one.mean_ms, one.least_ms, one.split_ms, self._error)


class Forces:
    """Both sets of stars, evaluated anew each time from the same places."""

    def __init__(self, task: Task) -> None:
        runtime.start(threads=task.threads)
        self.n, self.dim = task.n, task.dim
        self._variants: dict[str, _Evaluation] = {}
        capacity = staggered(task.n)
        a = ti.ndarray(ti.f64, (3, capacity))
        for name in SETS:
            position, mass = stars(name, task.n)
            x, m = ti.ndarray(ti.f64, (3, capacity)), ti.ndarray(ti.f64, capacity)
            x.from_numpy(np.pad(position.T, ((0, 0), (0, capacity - task.n))))
            m.from_numpy(np.pad(mass, (0, capacity - task.n)))
            self._variants[name] = _Evaluation(x, m, a, make_solver(task.n, LAW, ACCURACY))
            self._bytes = array_bytes([x, m, a, self._variants[name].solver])
            if task.n <= LARGEST_DIRECT:
                direct = _Evaluation(x, m, a, DirectSum(task.n, LAW, "single"))
                self._variants[f"{name}, direct sum"] = direct

    def round(self) -> dict[str, Round]:
        """Each set, with each solver."""
        names = sorted(self._variants, key=lambda name: "direct" in name)
        return {name: self._variants[name].round() for name in names}

    def bytes_per_item(self) -> float:
        """Places, masses and accelerations of one set, and what its solver holds."""
        return self._bytes / self.n
