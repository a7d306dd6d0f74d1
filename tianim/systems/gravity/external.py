"""External potentials: analytic masses that pull the stars and feel nothing.

    point           phi = -G M / sqrt(r^2 + s^2)
    nfw             phi = -G M_s ln(1 + r/r_s) / r,  M_s = M / (ln(1 + c) - c/(1 + c))
    logarithmic     phi = v_0^2 / 2 ln(r_c^2 + R^2 + (y/q)^2)
    miyamoto_nagai  phi = -G M / sqrt(R^2 + (a + sqrt(y^2 + b^2))^2)

R lies in the plane x, z about the axis +Y; r^2 = R^2 + y^2. Sources: Navarro, Frenk and White 1997,
ApJ 490, 493; Binney and Tremaine, Galactic Dynamics, 2.3.2; Miyamoto and Nagai 1975, PASJ 27, 533.
Lengths, masses and speeds are in the system's own units. The logarithmic potential has no end: it is
infinite far away, so the total energy of stars in it says nothing of being bound.
"""

from collections.abc import Sequence
from typing import Annotated, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from tianim.lang import f64_1d, f64_2d, i32_1d, ti
from tianim.params import Params

# Masses and lengths may be in SI: 2e30 kg, 1e21 m.
HUGE = 1e50
Magnitude = Annotated[float, Field(gt=0, le=HUGE)]
Place = Annotated[float, Field(ge=-HUGE, le=HUGE)]

WIDTH = 7  # kind, centre (3), three numbers of the kind
POINT, NFW, LOGARITHMIC, DISK = range(4)
# Below this r / r_s the enclosed NFW mass is taken from its series: the logarithms cancel.
NEAR = 1e-3


class _Centred(Params):
    centre: tuple[Place, Place, Place] = Field((0.0, 0.0, 0.0), description="centre [own length]")


class PointPotential(_Centred):
    """A point mass, softened or not."""

    kind: Literal["point"] = "point"
    mass: Magnitude = Field(1.0, description="mass [own mass]")
    softening: Annotated[float, Field(ge=0, le=HUGE)] = Field(0.0, description="Plummer length [own length]")

    def numbers(self, g: float) -> tuple[float, ...]:
        """What the kernels need besides the centre."""
        return (POINT, g * self.mass, self.softening, 0.0)


class NFWPotential(_Centred):
    """A dark halo after Navarro, Frenk and White; it goes on beyond its virial radius."""

    kind: Literal["nfw"] = "nfw"
    mass: Magnitude = Field(1.0, description="mass within concentration scale radii [own mass]")
    scale_radius: Magnitude = Field(1.0, description="radius where the density falls as r^-2 [own length]")
    concentration: Annotated[float, Field(gt=0, le=1e6)] = Field(
        10.0, description="virial radius over scale radius"
    )

    def numbers(self, g: float) -> tuple[float, ...]:
        """What the kernels need besides the centre."""
        c = self.concentration
        return (NFW, g * self.mass / (np.log1p(c) - c / (1.0 + c)), self.scale_radius, 0.0)


class LogarithmicPotential(_Centred):
    """A halo with a flat rotation curve."""

    kind: Literal["logarithmic"] = "logarithmic"
    speed: Magnitude = Field(1.0, description="circular speed far out [own speed]")
    core: Magnitude = Field(1.0, description="core radius [own length]")
    flattening: Annotated[float, Field(gt=0, le=10)] = Field(
        1.0, description="axis ratio q of the potential, along y"
    )

    def numbers(self, g: float) -> tuple[float, ...]:
        """What the kernels need besides the centre."""
        return (LOGARITHMIC, self.speed**2, self.core, self.flattening)


class MiyamotoNagaiPotential(_Centred):
    """A thick disk in the plane x, z."""

    kind: Literal["miyamoto_nagai"] = "miyamoto_nagai"
    mass: Magnitude = Field(1.0, description="mass [own mass]")
    scale_length: Magnitude = Field(1.0, description="length a along the plane [own length]")
    height: Magnitude = Field(0.1, description="length b across the plane [own length]")

    def numbers(self, g: float) -> tuple[float, ...]:
        """What the kernels need besides the centre."""
        return (DISK, g * self.mass, self.scale_length, self.height)


External = Annotated[
    PointPotential | NFWPotential | LogarithmicPotential | MiyamotoNagaiPotential,
    Field(discriminator="kind"),
]


def table(potentials: Sequence[External], g: float) -> NDArray[np.float64]:
    """The rows that the kernels read, at least one (of nothing), shape (m, WIDTH)."""
    rows = np.zeros((max(len(potentials), 1), WIDTH))
    for row, potential in zip(rows, potentials, strict=False):
        kind, *numbers = potential.numbers(g)
        row[:] = (kind, *potential.centre, *numbers)
    return rows


@ti.func
def nfw_share(u):
    """ln(1 + u) - u / (1 + u), from the series where the two cancel."""
    near = u * u * (0.5 - u * (ti.cast(2, ti.f64) / 3 - u * 0.75))
    return ti.select(u < NEAR, near, ti.log(1 + u) - u / (1 + u))


@ti.func
def field_at(rows: ti.template(), count, x, y, z):
    """Acceleration (3) and potential per mass of the first `count` rows at a place, as a vector of 4."""
    total = ti.Vector([0.0, 0.0, 0.0, 0.0], dt=ti.f64)
    for k in range(count):
        kind = ti.cast(rows[k, 0], ti.i32)
        dx, dy, dz = x - rows[k, 1], y - rows[k, 2], z - rows[k, 3]
        p, q, s = rows[k, 4], rows[k, 5], rows[k, 6]
        r2 = dx * dx + dy * dy + dz * dz
        across, along, phi = ti.cast(0, ti.f64), ti.cast(0, ti.f64), ti.cast(0, ti.f64)
        if kind == POINT:
            d = ti.sqrt(r2 + q * q)
            # Without softening, a star exactly at the centre feels nothing.
            inverse = ti.select(d > 0, 1 / d, ti.cast(0, ti.f64))
            phi = -p * inverse
            across = phi * inverse * inverse
            along = across
        elif kind == NFW:
            r = ti.max(ti.sqrt(r2), 1e-6 * q)
            u = r / q
            phi = -p * ti.log(1 + u) / r
            across = -p * nfw_share(u) / (r * r * r)
            along = across
        elif kind == LOGARITHMIC:
            d2 = q * q + dx * dx + dz * dz + (dy / s) ** 2
            phi = 0.5 * p * ti.log(d2)
            across = -p / d2
            along = across / (s * s)
        else:
            height = ti.sqrt(dy * dy + s * s)
            inverse = 1 / ti.sqrt(dx * dx + dz * dz + (q + height) ** 2)
            phi = -p * inverse
            across = phi * inverse * inverse
            along = across * (q + height) / height
        total += ti.Vector([across * dx, along * dy, across * dz, phi], dt=ti.f64)
    return total


@ti.kernel
def add_field(some: ti.i32, n: ti.i32, rows: f64_2d, count: ti.i32, active: i32_1d, x: f64_2d, a: f64_2d):
    """Add the accelerations of the external potentials; where `some`, to the active stars alone."""
    for i in range(n):
        if some == 0 or active[i] != 0:
            field = field_at(rows, count, x[0, i], x[1, i], x[2, i])
            for c in ti.static(range(3)):
                a[c, i] += field[c]


@ti.kernel
def potential_of(n: ti.i32, rows: f64_2d, count: ti.i32, x: f64_2d, out: f64_1d):
    """The external potential at each star [own speed^2], into out (n,)."""
    for i in range(n):
        out[i] = field_at(rows, count, x[0, i], x[1, i], x[2, i])[3]
