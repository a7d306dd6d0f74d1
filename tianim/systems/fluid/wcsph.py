"""Weakly compressible SPH: the pressure is a function of the density, and nothing is solved for.

    P_i = (rho c^2 / gamma) (delta_i^gamma - 1) + rho zeta D delta_i / Dt, not below 0       (Tait; damped)
    a_i = -(1/rho_i) [ sum_j (P_i + P_j) G_ij + P_i grad lambda_i ] + g + forces
        + alpha c h sum_j (v_ij . x_ij) / (r^2 + 0.01 h^2) G_ij 2 rho_j / (rho_i + rho_j)
    v += dt a,  x += dt v

After Becker and Teschner 2007 (doi:10.2312/SCA/SCA07/209-218). The density is the sum over the neighbours
of now, walls included, so that it cannot drift and needs no diffusion; the last term, Monaghan's viscosity,
takes noise out. The sound of the start, as long as the fluid is deep, dies by zeta = DAMPING c h, which
resists compression alone (an acoustic damper, as that of Sun, Pilloton, Antuono and Colagrossi 2023, J.
Comput. Phys.). With c ten times the fastest flow the density varies by about 1 %. Where `sound_speed`
is left out that is 10 max(sqrt(g H), speeds at the start), H from the top of the fluid to the bottom of the
bounds. Walls push as in the other methods and stop what would come through.

In a box that is full gradients are corrected, as in the other methods (correction.py).

Limits: steps of 0.4 h / (c + |v|), some ten times shorter than the other methods'. Noise of the pressure
of a few percent of rho g H. Where a lattice is sheared until it breaks up, sums over what is left of it are
uneven, and the pressures that answer stir and slow the flow: Taylor and Green's vortices at Re 100 die 28 %
too fast, uncorrected 70 %. It is a known limit of densities that are sums, which formulations with shifted
particles overcome (Adami, Hu and Adams 2013, doi:10.1016/j.jcp.2013.01.043); shifting as such made it worse.
"""

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tianim.lang import f32_1d, f32_2d, i32_1d, i32_2d, ti
from tianim.spatial.bodies import POSITION, SHAPE
from tianim.spatial.neighbor_lists import nearest_image
from tianim.system import Bounds
from tianim.systems.fluid.correction import Correction
from tianim.systems.fluid.forces import Forces
from tianim.systems.fluid.gauge_params import ForceGauge
from tianim.systems.fluid.motion import kick, move_on
from tianim.systems.fluid.pairs import Pairs
from tianim.systems.fluid.params import FluidParams
from tianim.systems.fluid.particles import Particles
from tianim.systems.fluid.walls import BOUNDS, Walls

# Speed of sound over the fastest flow: variations of the density go with its inverse square.
MACH = 10.0
# Least flow [m/s] that a speed of sound is made for: a fluid at rest without gravity.
SLOWEST = 0.1
# Relative density below which nothing pulls harder.
THINNEST = 0.9
# Strength of Monaghan's viscosity. It is a kinematic viscosity of alpha c h / (2 (dimension + 2)), less what
# the fluid has anyway.
ALPHA = 0.05
# Bulk viscosity over c h. It is explicit: by the lattice's eigenvalue the acoustic step bears some 0.4.
DAMPING = 0.15


@ti.kernel
def press(
    n: ti.i32, thinnest: ti.f32, gamma: ti.f32, damping: ti.f32, stiffness: f32_1d, rho: f32_1d,
    phase: i32_2d, begin: i32_1d, end: i32_1d, neighbour: i32_1d, gradient: f32_2d,
    wall: f32_2d, flux: f32_1d, v: f32_2d, density: f32_1d, pressure: f32_1d,
):  # fmt: skip
    """Pressure [Pa] of densities, or of `thinnest`.

    stiffness: rho c^2 / gamma by phase; damping: zeta [m2/s].
    """
    for i in range(n):
        a, b, c = v[0, i], v[1, i], v[2, i]
        rate = wall[0, i] * a + wall[1, i] * b + wall[2, i] * c - flux[i]
        for k in range(begin[i], end[i]):
            j = neighbour[k]
            rate += (
                gradient[0, k] * (a - v[0, j])
                + gradient[1, k] * (b - v[1, j])
                + gradient[2, k] * (c - v[2, j])
            )
        p = stiffness[phase[0, i]] * (ti.max(density[i], thinnest) ** gamma - 1.0)
        damped = p + damping * rho[phase[0, i]] * rate
        # Where a surface may be, nothing pulls, and nothing is damped that is apart.
        if thinnest == 1.0:
            damped = ti.select(p > 0.0, ti.max(damped, 0.0), 0.0)
        pressure[i] = damped


@ti.kernel
def push(
    n: ti.i32,
    h: ti.f32,
    viscosity: ti.f32,
    rho: f32_1d,
    phase: i32_2d,
    length: f32_1d,
    begin: i32_1d,
    end: i32_1d,
    neighbour: i32_1d,
    gradient: f32_2d,
    back: f32_2d,
    wall: f32_2d,
    pressure: f32_1d,
    x: f32_2d,
    v: f32_2d,
    out: f32_2d,
):
    """Out = v + dt (push of the pressures + Monaghan's viscosity); `viscosity` is alpha c h [m2/s]."""
    for i in range(n):
        p, own = pressure[i], rho[phase[0, i]]
        px, py, pz = x[0, i], x[1, i], x[2, i]
        vx, vy, vz = v[0, i], v[1, i], v[2, i]
        fx, fy, fz = p * wall[0, i], p * wall[1, i], p * wall[2, i]
        sx, sy, sz = 0.0, 0.0, 0.0
        for k in range(begin[i], end[i]):
            j = neighbour[k]
            gx, gy, gz = gradient[0, k], gradient[1, k], gradient[2, k]
            bx, by, bz = back[0, k], back[1, k], back[2, k]
            q = pressure[j]
            fx += p * gx + q * bx
            fy += p * gy + q * by
            fz += p * gz + q * bz
            dx = nearest_image(px - x[0, j], length[0])
            dy = nearest_image(py - x[1, j], length[1])
            dz = nearest_image(pz - x[2, j], length[2])
            other = rho[phase[0, j]]
            meeting = dx * (vx - v[0, j]) + dy * (vy - v[1, j]) + dz * (vz - v[2, j])
            w = meeting / (dx * dx + dy * dy + dz * dz + 0.01 * h * h) * 2.0 * other / (own + other)
            sx += 0.5 * w * (gx + bx)
            sy += 0.5 * w * (gy + by)
            sz += 0.5 * w * (gz + bz)
        a = viscosity * ti.Vector([sx, sy, sz]) - ti.Vector([fx, fy, fz]) / own
        for c in ti.static(range(3)):
            out[c, i] = a[c]


def fall_height(particles: Particles, walls: Walls, gravity: tuple[float, float, float]) -> float:
    """From the highest particle to the bottom of the bounds, or to the lowest particle [m]."""
    size = float(np.linalg.norm(gravity))
    if size == 0.0 or particles.count == 0:
        return 0.0
    up = -np.array(gravity) / size
    heights = up @ particles["position"].to_numpy()[:, : particles.count]
    lowest = float(heights.min())
    if walls.names and walls.names[-1] == BOUNDS:
        walls.measure(0, particles["position"])  # poses them
        row = walls.table.to_numpy()[walls.count - 1]
        axes = slice(particles.dimension)
        half = np.abs(up[axes]) @ row[SHAPE : SHAPE + 3][axes]
        lowest = min(lowest, float(up[axes] @ row[POSITION : POSITION + 3][axes] - half))
    return float(heights.max()) - lowest


class Wcsph:
    """The method `wcsph`: steps `particles`.

    pairs        the rows of neighbours
    sound_speed  [m/s]
    alpha_c_h    strength of Monaghan's viscosity [m2/s]
    clamped      particles that the last step had to take out of a wall
    """

    def __init__(
        self, params: FluidParams, particles: Particles, pairs: Pairs, walls: Walls, forces: Forces
    ) -> None:
        self._gamma = params.wcsph.gamma
        self._particles, self._walls, self._forces = particles, walls, forces
        self.pairs = pairs
        self.clamped = 0
        self._watched = any(isinstance(gauge, ForceGauge) for gauge in params.gauges.values())
        self.sound_speed = params.wcsph.sound_speed or MACH * self._fastest(params)
        forces.limits.sound_speed = self.sound_speed
        least = min(phase.viscosity for phase in params.all_phases())
        self.alpha_c_h = ALPHA * self.sound_speed * particles.h
        self.alpha_c_h = max(self.alpha_c_h - 2.0 * (particles.dimension + 2) * least, 0.0)
        rho = particles.rest_density.to_numpy()
        self._stiffness: Any = ti.ndarray(ti.f32, len(rho))
        self._stiffness.from_numpy((rho * self.sound_speed**2 / self._gamma).astype(np.float32))
        self._correction = Correction(particles, pairs, walls) if pairs.is_full else None
        self._push: Any = ti.ndarray(ti.f32, (3, particles.columns.capacity))

    @staticmethod
    def pairs_for(params: FluidParams, particles: Particles, bounds: Bounds) -> Pairs:
        """Rows for one step: to list anew costs little more than to weigh rows with a skin."""
        return Pairs(particles, bounds)

    def _fastest(self, params: FluidParams) -> float:
        """Speed [m/s] that is to be expected."""
        gravity = params.at(0.0).gravity
        fall = math.sqrt(math.hypot(*gravity) * fall_height(self._particles, self._walls, gravity))
        blocks = [math.hypot(*block.velocity) for block in params.blocks.values()]
        emitters = [emitter.fastest(params.dimension) for emitter in params.emitters.values()]
        return max([SLOWEST, fall, *blocks, *emitters])

    def step(self, time: float, dt: float) -> None:
        """Go on from `time` [s] by `dt` [s]."""
        self.find()
        self.accelerate(time, dt)
        self.solve(dt)
        self.move(dt)

    def find(self) -> None:
        """Neighbours and walls of each particle, and its density."""
        self.pairs.build()
        particles = self._particles
        self._walls.measure(particles.count, particles["position"], particles.density)
        particles.moment.fill(1.0)  # Tait's pressure is that of the fluid

    def accelerate(self, time: float, dt: float) -> None:
        """All forces but pressure."""
        particles = self._particles
        self._forces.accelerate(time, dt)
        kick(particles.count, dt, particles.acceleration, particles["velocity"])
        self._forces.relax(dt)

    def solve(self, dt: float) -> None:
        """Pressures, and what they do to the velocities."""
        particles, pairs, walls, n = self._particles, self.pairs, self._walls, self._particles.count
        x, v, phase = particles["position"], particles["velocity"], particles["phase"]
        gradient, back = pairs.gradient, pairs.gradient
        if self._correction:
            self._correction.find()
            gradient, back = self._correction.gradient, self._correction.back
        # Where there is a surface nothing pulls; a box that is full has none, and would tear.
        thinnest = THINNEST if pairs.is_full else 1.0
        press(
            n, thinnest, self._gamma, DAMPING * self.sound_speed * particles.h, self._stiffness,
            particles.rest_density, phase, pairs.begin, pairs.end, pairs.neighbour, gradient,
            walls.gradient, walls.flux, v, particles.density, particles.pressure,
        )  # fmt: skip
        push(
            n, particles.h, self.alpha_c_h, particles.rest_density, phase,
            pairs.length, pairs.begin, pairs.end, pairs.neighbour, gradient, back, walls.gradient,
            particles.pressure, x, v, self._push,
        )  # fmt: skip
        kick(n, dt, self._push, v)

    def move(self, dt: float) -> None:
        """Places, kept out of the walls; what the walls bear."""
        particles, walls, pairs = self._particles, self._walls, self.pairs
        n, x, v = particles.count, particles["position"], particles["velocity"]
        if self._watched:
            walls.push(n, x, particles.pressure, dt)
        walls.hold(n, x, v, dt)
        move_on(n, dt, particles, walls, pairs)
        self.clamped = walls.clamp(n, x, v)

    def diagnostics(self) -> dict[str, float]:
        """The speed of sound [m/s]."""
        return {"sound_speed": self.sound_speed}

    def state(self) -> dict[str, NDArray[Any]]:
        """Nothing: a step depends on the columns alone."""
        return {}

    def restore(self, state: Mapping[str, NDArray[Any]]) -> None:
        """Nothing to take over."""
