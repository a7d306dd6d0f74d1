"""STAND-IN by the lead, to be overwritten by FORCES (keep what system.py uses: see NOTES-lead.md)."""

import numpy as np

from tianim.lang import f32_1d, f32_2d, i32_1d, ti


@ti.kernel
def uniform(n: ti.i32, x: ti.f32, y: ti.f32, z: ti.f32, acceleration: f32_2d):
    for i in range(n):
        acceleration[0, i] = x
        acceleration[1, i] = y
        acceleration[2, i] = z


@ti.kernel
def fastest(n: ti.i32, least: ti.i32, begin: i32_1d, end: i32_1d, v: f32_2d) -> ti.f32:
    most = 0.0
    for i in range(n):
        s = v[0, i] ** 2 + v[1, i] ** 2 + v[2, i] ** 2
        ti.atomic_max(most, ti.select(end[i] - begin[i] >= least, s, 0.0))
    return most


class Forces:
    def __init__(self, params, particles, pairs, walls):
        self.params, self.particles, self.pairs = params, particles, pairs

    def accelerate(self, time, dt):
        g = self.params.at(time).gravity
        uniform(self.particles.count, g[0], g[1], g[2] if self.params.dimension == 3 else 0.0, self.particles.acceleration)

    def relax(self, dt):
        pass

    def largest_step(self):
        p, step = self.particles, self.params.time_step
        if not p.count:
            return step.largest
        bulk, all_ = (np.sqrt(fastest(p.count, k, self.pairs.begin, self.pairs.end, p["velocity"])) for k in (5, 0))
        g = 9.81 * 0.005
        return min(step.largest, step.cfl * p.spacing / (bulk + g), 2.5 * step.cfl * p.spacing / (all_ + g))

    def diagnostics(self):
        return {}
