"""The force solvers, chosen by what they will cost at the accuracy asked for.

    solver = make_solver(count, Law(1.0, 0.01), accuracy=1e-3, massive=count)
    solver.evaluate(x, mass, a, phi)       # x (3, n), mass (n,), a (3, n), phi (n,), all float64
    median, p99 = solver.sample_error(x, mass, a, rng_seed=0)

Stars without mass feel and do not pull. No star pulls itself; stars in one place without softening do
not pull each other.
"""

from typing import Any, Literal, Protocol

from tianim.systems.gravity.direct import DirectSum, Precision
from tianim.systems.gravity.softening import Law
from tianim.systems.gravity.tree import TreeSum

__all__ = ["DirectSum", "Law", "Solver", "TreeSum", "make_solver"]

# What a pair costs [ns] on two cores of the machine that the table in tree.py was measured on, and a star's
# walk at an accuracy of 1e-3. Only their ratios decide.
DIRECT_SINGLE, DIRECT_DOUBLE = 0.22, 0.75
TREE_A_STAR, ACCURACY_POWER = 520.0, 0.4
TREE_AT_LEAST = 2e6  # ns; starting a dozen kernels
# `auto` sums so few pairs, or pulls by so few bodies, in float64.
DOUBLE_PAIRS, DOUBLE_BODIES = 1_000_000, 64
# Errors that float32 pairs cannot reach.
SINGLE_ERROR = 3e-6


class Solver(Protocol):
    """Fills accelerations, and potentials where asked."""

    count: int
    law: Law

    def evaluate(self, x: Any, mass: Any, a: Any, phi: Any = None, active: Any = None) -> None:
        """Fill a (3, n) and phi (n,) for stars at x (3, n) with mass (n,); of the `active` alone if given."""

    def sample_error(
        self, x: Any, mass: Any, a: Any, rng_seed: int, sample: int = 1000
    ) -> tuple[float, float]:
        """Median and 99 % relative error of `a` against float64 sums."""

    def memory_bytes(self) -> int:
        """Bytes of the solver's own arrays."""


def tree_cost(count: int, accuracy: float) -> float:
    """Predicted time [ns] of a tree's evaluation."""
    return TREE_AT_LEAST + TREE_A_STAR * count * (1e-3 / accuracy) ** ACCURACY_POWER


def make_solver(
    count: int,
    law: Law,
    accuracy: float = 1e-3,
    kind: Literal["auto", "direct", "tree"] = "auto",
    precision: Literal["auto", "single", "double"] = "auto",
    massive: int | None = None,
) -> Solver:
    """The solver for `count` stars of which `massive` have mass (None: all).

    accuracy   median relative error of a force; 99 % of the stars have at most ten times as much
    kind       auto: the one that is predicted to be faster
    precision  of the direct sum's pairs; auto: double for few bodies
    """
    bodies = count if massive is None else massive
    few = bodies <= DOUBLE_BODIES or count * bodies <= DOUBLE_PAIRS or accuracy < SINGLE_ERROR
    chosen: Precision = ("double" if few else "single") if precision == "auto" else precision
    if kind == "auto":
        pair = DIRECT_DOUBLE if chosen == "double" else DIRECT_SINGLE
        kind = "direct" if pair * count * bodies < tree_cost(count, accuracy) or few else "tree"
    return DirectSum(count, law, chosen) if kind == "direct" else TreeSum(count, law, accuracy)
