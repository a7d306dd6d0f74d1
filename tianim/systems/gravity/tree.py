"""TreeSum: far stars as cubes with mass and quadrupole, near ones one by one.

Groups of neighbouring stars walk the octree together (Barnes 1990): what a group meets goes
to two lists, cubes and stars, and dense loops then run over the lists for each star of the
group, in float32 relative to the group's middle, with float64 sums over full lists.

*Opening.* A cube is taken as a whole when the octupole that is left out is small beside the group's
acceleration: B / d^5 < alpha |a|, with B the sum of m |x - centre|^3 over its stars and d the
distance of its centre from the group's box; and when it is not nearer than its own radius over
WIDEST. |a| is found by a short walk of the group's middle with monopoles only, so that forces depend on
the places alone: nothing is kept from one evaluation to the next, and a resumed run gives the same
bytes. Where stars feel much less than that (pulls cancel), the group walks again with what they feel.

*Accuracy.* alpha follows from the median error asked for. Measured on the sets of `tianim bench
gravity`, 1,000 stars against float64 sums: median and 99 %, then CPU time of an evaluation with the
tree's build (milliseconds, half of what two threads took; Intel Sapphire Rapids, AVX2).

    asked            10^4                   10^5                    10^6
    1e-2   plummer   1.2e-3 2.5e-2   4.7    1.6e-3 1.2e-2    45     1.9e-3 1.1e-2    492
           galaxy    9.3e-4 3.8e-2   4.7    1.2e-3 1.8e-2    44     2.2e-3 1.3e-2    507
    1e-3   plummer   5.2e-4 3.2e-3     9    4.8e-4 2.7e-3    58     4.5e-4 2.2e-3    646
           galaxy    6.4e-4 5.0e-3     7    6.0e-4 3.5e-3    56     6.0e-4 2.9e-3    620
    1e-4   plummer   5.6e-5 2.0e-4    13    5.1e-5 1.7e-4   159     3.8e-5 1.2e-4   2064
           galaxy    6.0e-5 2.6e-4    12    5.8e-5 2.3e-4   145     5.2e-5 1.9e-4   1908

A disk with a bulge in a heavy halo (`configs/galaxy.yaml`) is harder than either, with twice the median; what
is left to 1e-3 is for it. Above some 2e-3 the cubes may not grow further, and the forces are better
than asked. Stars evenly spaced in a line are the worst case, ten times the error asked for: all octupoles
there point the same way.
Monopoles alone take as long for 1e-3 on the Plummer sphere, 1.6 times as long on the galaxy, and twice for
3e-4 on either: they are not offered. The build is 10 to 15 % of an evaluation from 10^5 stars on.

*Limits.* Places are known to 5e-10 of the cube that holds all stars, and to 6e-8 of the box of a group: a
star that is flung a million times as far as the others costs them their accuracy, beyond two million
times also the speed (all others then share a cube of the last level, and are summed in pairs). The
sampled error tells. Stars in one place are a group without extent: all are as wrong as the worst of others.
"""

from typing import Any

from tianim.lang import ti
from tianim.spatial.octree import Octree
from tianim.systems.gravity.lists import CELL_PAGE, CELL_ROWS, PAGE, STAR_PAGE
from tianim.systems.gravity.sampling import Sampled
from tianim.systems.gravity.softening import Law
from tianim.systems.gravity.walk import GROUP, walk

# Radius of a cube over its distance, at most: beyond 1 a star might stand inside.
WIDEST = 0.9
# alpha at an accuracy of 1e-3, its growth with the accuracy, and where WIDEST alone decides.
ALPHA_AT, ALPHA_POWER, LARGEST_ALPHA = 0.007, 1.9, 0.3


def alpha_for(accuracy: float) -> float:
    """The opening criterion's alpha for a median error of `accuracy`; see the table in the module's text."""
    return min(ALPHA_AT * (accuracy / 1e-3) ** ALPHA_POWER, LARGEST_ALPHA)


class TreeSum(Sampled):
    """Forces on `count` stars by the octree, with a median relative error of `accuracy` at most."""

    def __init__(self, count: int, law: Law, accuracy: float = 1e-3) -> None:
        self.count, self.law = count, law
        self.alpha, self.widest = alpha_for(accuracy), WIDEST
        self.tree = Octree(count, GROUP)
        tasks = self.tree.tasks
        self._counter = ti.ndarray(ti.i32, 4)
        self._found = ti.ndarray(ti.i32, 3 * PAGE * tasks)
        self._cells = ti.ndarray(ti.f32, (CELL_ROWS, tasks * CELL_PAGE))
        self._stars = ti.ndarray(ti.f32, (4, tasks * STAR_PAGE))
        self._total = ti.ndarray(ti.f64, (4, tasks * GROUP))
        self._nothing = ti.ndarray(ti.f64, 4)

    def evaluate(self, x: Any, mass: Any, a: Any, phi: Any = None, active: Any = None) -> None:
        """Fill a (3, n) and, where given, phi (n,) for stars at x (3, n) with mass (n,); all float64.

        active  i32 (n,), 1 or 0: only stars with 1 are written, to the same bytes
        """
        if self.count == 0:
            return
        self.build(x, mass)
        self.walk(a, phi, active)

    def build(self, x: Any, mass: Any) -> None:
        """The tree of the stars at x with mass."""
        self.tree.build(x, mass)

    def walk(self, a: Any, phi: Any = None, active: Any = None) -> None:
        """Sum the forces with the tree as it was built."""
        tree, law = self.tree, self.law
        to_phi = -law.gravitational_constant * tree.mass / tree.side
        self._counter.fill(0)
        walk(
            law.code, phi is not None, active is not None, tree.group_count, tree.tasks, tree.stride,
            self.alpha, self.widest**-2, law.reach / tree.side, -to_phi / tree.side, to_phi, tree.groups,
            tree.link, tree.moment, tree.lattice, tree.weight, tree.order, self._counter, self._found,
            self._cells, self._stars, self._total, tree.order if active is None else active, a,
            self._nothing if phi is None else phi,
        )  # fmt: skip

    def memory_bytes(self) -> int:
        """Bytes of the solver's own arrays."""
        return self.tree.memory_bytes()
