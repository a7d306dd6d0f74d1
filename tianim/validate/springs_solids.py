"""Solids: the bar of the lectures, clamped at one end and bent at the other, of tetrahedra and of springs.

    d = P L^3 / (3 E I) + P L / (k G A)                     (Timoshenko's beam, k = 5/6 of a square section)

The bar is 10 times as long as thick; the second term is a hundredth. Linear tetrahedra and lattices of
springs get nearer with the square of their cells: the case is what two sizes say of the limit (Richardson).
"""

from functools import lru_cache, partial

import numpy as np

from tianim.spatial.bodies import Bodies
from tianim.system import Bounds, World
from tianim.systems.springs import SpringsParams, SpringSystem
from tianim.validate.case import Case

LENGTH, THICK, STIFFNESS, LOAD = 1.0, 0.1, 2e6, 2.0  # [m], [m], [Pa], [N]
POISSON = {"solid": 0.3, "block": 0.25}
# Twice the bar's lowest frequency, 4.5 rad/s, which is then damped critically.
DRAG, UNTIL = 9.0, 2.0  # [1/s], [s]
CELLS = (2, 4)
SOURCE = "theory: Timoshenko 1921"


def expected(kind: str) -> float:
    """Deflection of the beam [m]."""
    area, inertia = THICK**2, THICK**4 / 12.0
    shear = STIFFNESS / (2.0 * (1.0 + POISSON[kind]))
    return float(LOAD * LENGTH**3 / (3.0 * STIFFNESS * inertia) + LOAD * LENGTH / (5.0 / 6.0 * shear * area))


@lru_cache(maxsize=8)
def deflection(kind: str, cells: int) -> float:
    """How far the end comes down [m], with so many cells in the thickness."""
    piece = {
        "kind": kind, "size": (LENGTH, THICK, THICK), "spacing": THICK / cells, "stiffness": STIFFNESS,
        "damping": 2e-4, **({"poisson": POISSON[kind]} if kind == "solid" else {}),
    }  # fmt: skip
    each = -LOAD / (cells + 1) ** 2
    params = SpringsParams.model_validate(
        {
            "kind": "springs", "solver": "explicit", "gravity": (0.0, 0.0, 0.0), "air": {"drag": DRAG},
            "pieces": {"bar": piece}, "pins": {"wall": {"piece": "bar", "points": "left"}},
            "pushes": {"load": {"piece": "bar", "points": "right", "force": (0.0, each, 0.0)}},
        }
    )  # fmt: skip
    system = SpringSystem("bar", params, World(Bounds(), Bodies({}), 1))
    dt = system.max_step()
    for step in range(round(UNTIL / dt)):
        system.step(step * dt, dt)
    end = system.whole.pieces["bar"].groups["right"]
    return float(-np.mean(system.read("position")[end, 1]))


def limit(kind: str) -> float:
    """The deflection that two sizes lead to, over the beam's."""
    coarse, fine = (deflection(kind, cells) for cells in CELLS)
    return (fine + (fine - coarse) / ((CELLS[1] / CELLS[0]) ** 2 - 1.0)) / expected(kind)


CASES: tuple[Case, ...] = tuple(
    Case(
        "springs", f"bar bent by its end, {name}: deflection over the beam's", partial(limit, kind), 1.0,
        SOURCE, tolerance=0.05, slow=True,
    )
    for kind, name in (("solid", "tetrahedra"), ("block", "springs"))
)  # fmt: skip
