"""Angular momentum of pressures whose displacements and velocities are of different moments.

Pressures push two particles along the line between them, by u_ij [m], where P is their pressure:

    u_ij = -(dt^2 / rho_i) (P_i + P_j) G_ij,         rho_i u_ij = -rho_j u_ji

Where that moves places and not velocities (drift of DFSPH), or is found at places where the particles are
not yet (predictions of PBF), the pair gains the angular momentum m_i u_ij x v_ij. It is given back by
turning its relative velocity down, as a skater's arms do,

    v_i += - sum_j (u_ij . x_ij / |x_ij|^2) (v_ij - its part along x_ij)

which is equal and opposite for the two, so that momentum is kept as well.

Limits: of first order in u / |x|; of walls and of displacements cut short nothing is given back.
"""

from typing import Any

from tianim.lang import f32_1d, f32_2d, i32_1d, i32_2d, ti
from tianim.spatial.neighbor_lists import nearest_image
from tianim.systems.fluid.motion import kick
from tianim.systems.fluid.pairs import TINY, Pairs
from tianim.systems.fluid.particles import Particles


@ti.kernel
def find_turns(
    n: ti.i32,
    dt: ti.f32,
    ahead: ti.f32,
    tiny: ti.f32,
    inverse_rho: f32_1d,
    phase: i32_2d,
    length: f32_1d,
    begin: i32_1d,
    end: i32_1d,
    neighbour: i32_1d,
    gradient: f32_2d,
    pressure: f32_1d,
    x: f32_2d,
    v: f32_2d,
    change: f32_2d,
):
    """The `change` of each velocity [m/s], by the places that are reached after the time `ahead` [s]."""
    for i in range(n):
        p = pressure[i]
        a, b, c = v[0, i], v[1, i], v[2, i]
        sx, sy, sz = 0.0, 0.0, 0.0
        for k in range(begin[i], end[i]):
            j = neighbour[k]
            wx, wy, wz = a - v[0, j], b - v[1, j], c - v[2, j]
            dx = nearest_image(x[0, i] - x[0, j], length[0]) + ahead * wx
            dy = nearest_image(x[1, i] - x[1, j], length[1]) + ahead * wy
            dz = nearest_image(x[2, i] - x[2, j], length[2]) + ahead * wz
            w = 1.0 / (dx * dx + dy * dy + dz * dz + tiny)
            along = w * (wx * dx + wy * dy + wz * dz)
            u = w * (p + pressure[j]) * (gradient[0, k] * dx + gradient[1, k] * dy + gradient[2, k] * dz)
            sx += u * (wx - along * dx)
            sy += u * (wy - along * dy)
            sz += u * (wz - along * dz)
        scale = dt * dt * inverse_rho[phase[0, i]]
        change[0, i], change[1, i], change[2, i] = scale * sx, scale * sy, scale * sz


def keep_spin(
    dt: float, ahead: float, particles: Particles, pairs: Pairs, inverse_rho: Any, pressure: Any, change: Any
) -> None:
    """Turn the velocities for `pressure` over dt [s]; `change`, (3, capacity), is written over.

    ahead  when the particles are where the pairs' gradients are, from now [s]
    """
    n, v = particles.count, particles["velocity"]
    find_turns(
        n, dt, ahead, TINY * particles.h**2, inverse_rho, particles["phase"], pairs.length, pairs.begin, pairs.end,
        pairs.neighbour, pairs.gradient, pressure, particles["position"], v, change,
    )  # fmt: skip
    kick(n, 1.0, change, v)
