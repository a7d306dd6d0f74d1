"""Surface tension as a stress in the surface layer, in N/m.

    T_i = 2 sigma s(|g_i|) |g_i| ((1 + k) I - n n) = (1 + k) |m_i|^2 I - m_i m_i
    g_i = sum_j G_ij = grad c,   n = g / |g|
    rho_i a_i = sum_j V (T_i + T_j) . grad K_ij + T_i . grad lambda_i + core + friction,    K ~ (1 - q^2)^2

|grad c| integrated through a surface is 1, half of it on the side of the fluid: hence 2 sigma |g| (I - n n),
the continuum surface stress (Lafaurie et al. 1994, doi:10.1006/jcph.1994.1123; Hu & Adams 2006,
doi:10.1016/j.jcp.2005.09.001). It needs no curvature and its pair forces add up to nothing. What keeps it in
order where there is no air on the other side:

- cohesion, k I: the layer pulls in all directions alike. It is a mere pressure to the fluid, but without it
  a free surface under tension comes apart into vapour;
- K is concave up to 1.15 d, so that neighbours under tension do not pair (the cubic spline's are in pairs
  within ten steps), and a soft core keeps them 0.8 d apart;
- s, from 0 to 1 between |g| d = 0.1 and 0.2: the inside of a disordered fluid has no tension;
- friction in the layer of about `FRICTION` sqrt(sigma d / rho), for a stress has no energy to keep.

Tried and left: the gradient of the area 2 sigma sum V |grad c| (drops evaporate: a lone particle has no
gradient and so no energy), attraction between pairs (drops freeze, whatever its form), Akinci et al. 2013.

`CALIBRATION` is set by the periods of drops (n = 2): 3D at R = 5, 8 and 12 d all want 0.82 +- 0.01; 2D at
R = 12 and 24 d want 0.80 and 0.70, and get 0.77: a period is then right to 4 %.

Walls mirror the fluid: the contact angle is 90 degrees. There is no tension between phases.
Momentum is kept to rounding, angular momentum nearly (the stress of a pair is not along its line). Steps are
stable up to 0.6 sqrt(rho d^3 / (2 pi sigma)).

Limits: a drop that starts as a lattice swings 12 % too fast, until it has melted; the pressure in one at rest
is not Laplace's (0.65 to 0.95 of it in the plane, as its particles happen to lie, 1.5 in space at R = 8 d); a
drop of R = 8 d loses half of its swing in a period (3D), one of R = 12 d a fifth (2D). At walls the surface
stands a particle high.

Cost in 3D on 2 cores, CPU time over two in ns a particle (27 neighbours): 22 and 49.
"""

import math
from typing import Any

from scipy.integrate import quad

from tianim.lang import f32_1d, f32_2d, i32_1d, i32_2d, ti
from tianim.systems.fluid.pairs import Pairs
from tianim.systems.fluid.particles import Particles
from tianim.systems.fluid.viscous_pairs import difference

# |g| d below which there is no surface, and twice which is all of it. In the first layer of a flat surface
# it is 0.4 to 0.5, in the disorder of the inside 0.05 to 0.08.
INSIDE = 0.1
# By dimension: k, as little as holds a drop together, and sigma over what the drop shows.
COHESION = {2: 1.0, 3: 0.5}
CALIBRATION = {2: 0.77, 3: 0.82}
# Core: force of two particles in sigma d at a distance r below CORE d: CORE_FORCE (1 - (r / CORE d)^2) d / r.
CORE, CORE_FORCE = 0.8, 1.0
# Friction of the layer, and what keeps it and the core finite for two particles in one place, in spacings.
FRICTION, SOFTENING = 0.05, 0.25
# A wall has less than this share of what surrounds a particle that is not in it.
MOST_SHARE = 0.5


def kernel_scale(h: float, dimension: int) -> float:
    """Factor [1/m^dimension] that makes (1 - q^2)^2 integrate to 1 over support h [m]."""
    sphere = 4.0 * math.pi if dimension == 3 else 2.0 * math.pi
    moment = quad(lambda q: (1.0 - q * q) ** 2 * q ** (dimension - 1), 0.0, 1.0)[0]
    return float(1.0 / (sphere * moment * h**dimension))


@ti.func
def mirrored(g, wall, share):
    """Gradient `g` of the fluid with what a wall that mirrors it adds; `wall` and `share` are lambda's.

    Along the wall, as much more as the wall takes up. Across, what is missing before a wall, and no more:
    no gradient into the wall, or a film would feel its own far side and climb.
    """
    size = wall.norm()  # without a wall all of it adds nothing
    e = wall / ti.max(size, 1e-20)
    across = g.dot(e)
    along = (g - across * e) / (1.0 - ti.min(share, MOST_SHARE))
    return along + ti.min(across + size, ti.max(across, 0.0)) * e


@ti.kernel
def find_layer(
    walled: ti.template(),
    n: ti.i32,
    faintest: ti.f32,
    sigma: ti.f32,
    begin: i32_1d,
    end: i32_1d,
    gradient: f32_2d,
    share: f32_1d,
    wall: f32_2d,
    layer: f32_2d,
):
    """The layer's m [sqrt(N/m2)] from the stored gradients; `faintest` is |g| of the inside [1/m]."""
    for i in range(n):
        a, b, c = 0.0, 0.0, 0.0
        for k in range(begin[i], end[i]):
            a += gradient[0, k]
            b += gradient[1, k]
            c += gradient[2, k]
        if ti.static(walled):
            g = mirrored(ti.Vector([a, b, c]), ti.Vector([wall[0, i], wall[1, i], wall[2, i]]), share[i])
            a, b, c = g[0], g[1], g[2]
        size = ti.sqrt(a * a + b * b + c * c)
        t = ti.min(ti.max(size / faintest - 1.0, 0.0), 1.0)
        w = ti.sqrt(2.0 * sigma * t * t * (3.0 - 2.0 * t) / ti.max(size, 1e-20))
        layer[0, i], layer[1, i], layer[2, i] = w * a, w * b, w * c


@ti.kernel
def add_tension(
    dimension: ti.template(),
    periodic: ti.template(),
    walled: ti.template(),
    n: ti.i32,
    inverse_h: ti.f32,
    slope: ti.f32,
    isotropic: ti.f32,
    softening: ti.f32,
    inverse_core: ti.f32,
    core: ti.f32,
    friction: ti.f32,
    length: f32_1d,
    rho: f32_1d,
    phase: i32_2d,
    x: f32_2d,
    v: f32_2d,
    begin: i32_1d,
    end: i32_1d,
    neighbour: i32_1d,
    wall: f32_2d,
    layer: f32_2d,
    acceleration: f32_2d,
    pull: f32_2d,
):
    """Add the acceleration by tension, core and friction; `pull`: what walls do [m/s2].

    slope         V K'(r) / r is -slope (1 - q^2); `isotropic` is 1 + k
    core          force density of the core over its form [N/m2], ends at 1 / sqrt(inverse_core) [m]
    friction      of a pair over the strength of its tension [s]
    """
    for i in range(n):
        a, b, c = x[0, i], x[1, i], x[2, i]
        v0, v1, v2 = v[0, i], v[1, i], v[2, i]
        m = ti.Vector([layer[0, i], layer[1, i], layer[2, i]])
        own = m.dot(m)
        s0, s1, s2 = 0.0, 0.0, 0.0
        for k in range(begin[i], end[i]):
            j = neighbour[k]
            p, q, r = layer[0, j], layer[1, j], 0.0
            dx = difference(periodic, a - x[0, j], length[0])
            dy = difference(periodic, b - x[1, j], length[1])
            dz, r2, along = 0.0, dx * dx + dy * dy, (v0 - v[0, j]) * dx + (v1 - v[1, j]) * dy
            if ti.static(dimension == 3):
                r = layer[2, j]
                dz = difference(periodic, c - x[2, j], length[2])
                r2 += dz * dz
                along += (v2 - v[2, j]) * dz
            both = own + p * p + q * q + r * r
            near = ti.max(1.0 - r2 * inverse_h * inverse_h, 0.0)
            inverse = 1.0 / (r2 + softening)
            # Along x_ij: cohesion, core and friction; along m_i and m_j: what they take off.
            line = core * ti.max(1.0 - r2 * inverse_core, 0.0) * inverse
            line -= near * both * (slope * isotropic + friction * inverse * along)
            mine = slope * near * (m[0] * dx + m[1] * dy + m[2] * dz)
            theirs = slope * near * (p * dx + q * dy + r * dz)
            s0 += line * dx + mine * m[0] + theirs * p
            s1 += line * dy + mine * m[1] + theirs * q
            s2 += line * dz + mine * m[2] + theirs * r
        w = 1.0 / rho[phase[0, i]]
        if ti.static(walled):
            g = ti.Vector([wall[0, i], wall[1, i], wall[2, i]])
            f = w * (isotropic * own * g - m.dot(g) * m)
            for k in ti.static(range(3)):
                acceleration[k, i] += f[k]
                pull[k, i] += f[k]
        acceleration[0, i] += w * s0
        acceleration[1, i] += w * s1
        acceleration[2, i] += w * s2


class SurfaceTension:
    """Surface tension [N/m] of a fluid against nothing.

    layer  m of each particle in the last step [sqrt(N/m2)]: into the fluid, 0 inside, (3, capacity)
    """

    def __init__(self, sigma: float, particles: Particles, pairs: Pairs, walls: Any) -> None:
        self._particles, self._pairs, self._walls = particles, pairs, walls
        self._periodic = bool(pairs.length.to_numpy().any())
        self.active = sigma > 0.0
        d, h, dimension = particles.spacing, particles.h, particles.dimension
        sigma *= CALIBRATION[dimension]
        self._sigma, self._isotropic = sigma, 1.0 + COHESION[dimension]
        self._slope = 4.0 * d**dimension * kernel_scale(h, dimension) / (h * h)
        self._core = CORE_FORCE * sigma / d
        self._friction = FRICTION * math.sqrt(particles.lightest * d / sigma) if self.active else 0.0
        self.layer: Any = ti.ndarray(ti.f32, (3, particles.columns.capacity if self.active else 1))

    def add(self, pull: Any) -> None:
        """Add the acceleration by tension to that of the particles; that by walls to `pull` too."""
        particles, pairs, walls = self._particles, self._pairs, self._walls
        n, d = particles.count, particles.spacing
        find_layer(
            walls.count > 0, n, INSIDE / d, self._sigma, pairs.begin, pairs.end, pairs.gradient, walls.share,
            walls.gradient, self.layer,
        )  # fmt: skip
        add_tension(
            particles.dimension, self._periodic, walls.count > 0, n, 1.0 / particles.h, self._slope,
            self._isotropic, (SOFTENING * d) ** 2,
            1.0 / (CORE * d) ** 2, self._core, self._friction, pairs.length, particles.rest_density,
            particles["phase"], particles["position"], particles["velocity"], pairs.begin, pairs.end,
            pairs.neighbour, walls.gradient, self.layer, particles.acceleration, pull,
        )  # fmt: skip
