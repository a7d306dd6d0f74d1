"""The softened law of attraction, alone: what one pair contributes.

    plummer   a = G m d / (d^2 + eps^2)^(3/2)
    spline    the mass of each star is spread over a cubic spline of support h = 2.8 eps (Springel et al.
              2001, eq. 71): Newtonian beyond h, the Plummer depth -G m / eps at the centre

A solver works in its own units, in which G is 1 and `softening` is eps (plummer) or h (spline).
"""

from dataclasses import dataclass
from typing import Literal

from tianim.lang import ti

Kind = Literal["plummer", "spline"]
PLUMMER, SPLINE = 0, 1
KINDS: dict[str, int] = {"plummer": PLUMMER, "spline": SPLINE}
# Squared distance [length^2] that is as good as none in float64, whatever the units.
NO_DISTANCE = 1e-160
# Support of the spline in softening lengths: gives both laws the same depth at the centre.
SUPPORT = 2.8


@dataclass(frozen=True)
class Law:
    """Newton's law with one softening length for all stars.

    gravitational_constant   G in the scene's units [length velocity^2 / mass]
    softening                eps [length]; 0: none, and a star does not feel one in the same place
    """

    gravitational_constant: float
    softening: float
    kind: Kind = "plummer"

    @property
    def code(self) -> int:
        """The kind as the kernels take it."""
        return KINDS[self.kind]

    @property
    def reach(self) -> float:
        """Length that the kernels take: eps, or the support of the spline."""
        return self.softening * (SUPPORT if self.kind == "spline" else 1.0)


@ti.func
def pair(kind: ti.template(), with_depth: ti.template(), r2, reach, tiny):
    """Pull and depth of a unit mass at squared distance r2.

    The pull is the acceleration over the distance vector, the depth minus the potential (0 unless
    `with_depth`). tiny > 0 is added to r2 and keeps 0/0 away.
    """
    pull, depth = r2 * 0, r2 * 0
    if ti.static(kind == PLUMMER):
        s = r2 + (reach * reach + tiny)
        if ti.static(with_depth):
            u = 1 / ti.sqrt(s)
            pull = u * u * u
            depth = ti.select(s > tiny, u, 0)  # one place, no softening
        else:
            pull = 1 / (s * ti.sqrt(s))  # quicker than u^3: one product less
    else:
        s = r2 + tiny
        over = 1 / ti.sqrt(s)
        h = 1 / ti.max(reach, ti.sqrt(tiny))
        u = ti.min(s * over * h, 1)
        v = ti.max(u, 0.5)  # where 1/v stays small
        w = 1 / v
        # All over 15, so that every coefficient is exact in float32 too.
        third = h * h * h / 15
        inner = 160 + u * u * (480 * u - 576)
        outer = 320 + v * (-720 + v * (576 - 160 * v)) - w * w * w
        pull = ti.select(u < 1, ti.select(u < 0.5, inner, outer) * third, over * over * over)
        if ti.static(with_depth):
            deep = 42 + u * u * (-80 + u * u * (144 - 96 * u))
            rim = 48 - w + v * v * (-160 + v * (240 + v * (-144 + 32 * v)))
            depth = ti.select(u < 1, ti.select(u < 0.5, deep, rim) * (h / 15), over)
            depth = ti.select(r2 + reach > 0, depth, 0)
    return pull, depth
