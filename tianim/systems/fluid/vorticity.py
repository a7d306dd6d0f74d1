"""Vorticity confinement: whirls that the discretisation would take out are kept going.

    omega_i = curl v = sum_j G_ij x (v_j - v_i)
    N_i = eta / |eta|,   eta_i = grad |omega| = sum_j (|omega_j| - |omega_i|) G_ij
    a_i = strength h |omega_i| (N_i x omega_i)

Fedkiw, Stam and Jensen 2001 (doi:10.1145/383259.383260), in SPH as Macklin and Mueller 2013. Their
a = epsilon N x omega holds for one resolution and one time scale; with the factor h |omega| `strength` is
a pure number, of the order of 0.1 to 1. N points to the middle of the whirl, and a along its circles.

Limits: it adds energy, and does not keep momentum to the last bit. A free surface has no outside, so its
eta points inwards: particles with few neighbours are left alone.
"""

from typing import Any

from tianim.lang import f32_1d, f32_2d, i32_1d, ti
from tianim.systems.fluid.pairs import Pairs
from tianim.systems.fluid.particles import Particles

# Below this relative density a particle lies at a free surface.
BULK = 0.9
TINY = 1e-12


@ti.kernel
def find_vorticity(
    n: ti.i32,
    begin: i32_1d,
    end: i32_1d,
    neighbour: i32_1d,
    gradient: f32_2d,
    v: f32_2d,
    vorticity: f32_2d,
):
    """Curl v [1/s] into rows 0 to 2 of `vorticity`, its size into row 3."""
    for i in range(n):
        a, b, c = v[0, i], v[1, i], v[2, i]
        x, y, z = 0.0, 0.0, 0.0
        for k in range(begin[i], end[i]):
            j = neighbour[k]
            dx, dy, dz = v[0, j] - a, v[1, j] - b, v[2, j] - c
            gx, gy, gz = gradient[0, k], gradient[1, k], gradient[2, k]
            x += gy * dz - gz * dy
            y += gz * dx - gx * dz
            z += gx * dy - gy * dx
        vorticity[0, i], vorticity[1, i], vorticity[2, i] = x, y, z
        vorticity[3, i] = ti.sqrt(x * x + y * y + z * z)


@ti.kernel
def confine(
    n: ti.i32,
    factor: ti.f32,
    begin: i32_1d,
    end: i32_1d,
    neighbour: i32_1d,
    gradient: f32_2d,
    density: f32_1d,
    vorticity: f32_2d,
    acceleration: f32_2d,
):
    """Add the confinement to `acceleration` [m/s2]; `factor` is strength h."""
    for i in range(n):
        own = vorticity[3, i]
        x, y, z = 0.0, 0.0, 0.0
        for k in range(begin[i], end[i]):
            steeper = vorticity[3, neighbour[k]] - own
            x += steeper * gradient[0, k]
            y += steeper * gradient[1, k]
            z += steeper * gradient[2, k]
        eta = ti.Vector([x, y, z])
        omega = ti.Vector([vorticity[0, i], vorticity[1, i], vorticity[2, i]])
        inside = ti.select(density[i] > BULK, 1.0, 0.0)
        a = inside * factor * own / ti.max(eta.norm(), TINY) * eta.cross(omega)
        for c in ti.static(range(3)):
            acceleration[c, i] += a[c]


class Vorticity:
    """Confinement of `strength` for `particles`; 0 does nothing and takes no memory.

    vorticity  curl v [1/s] and, in row 3, its size, (4, capacity), as of the last `add`
    """

    def __init__(self, strength: float, particles: Particles, pairs: Pairs) -> None:
        self.strength, self._particles, self._pairs = strength, particles, pairs
        self.vorticity: Any = ti.ndarray(ti.f32, (4, particles.columns.capacity if strength > 0.0 else 1))

    def add(self) -> None:
        """Add the confinement to the particles' accelerations, on the pairs and velocities of now."""
        if self.strength == 0.0:
            return
        particles, pairs = self._particles, self._pairs
        find_vorticity(
            particles.count, pairs.begin, pairs.end, pairs.neighbour, pairs.gradient,
            particles["velocity"], self.vorticity,
        )  # fmt: skip
        confine(
            particles.count, self.strength * particles.h, pairs.begin, pairs.end, pairs.neighbour,
            pairs.gradient, particles.density, self.vorticity, particles.acceleration,
        )  # fmt: skip
