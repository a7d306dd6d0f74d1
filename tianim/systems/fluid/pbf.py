"""Position Based Fluids: places are predicted, then moved until nothing is compressed.

    C_i = delta_i - 1 <= 0,   delta_i = sum_j V W_ij + lambda_i
    x = x* + u,   v = (x - x_before) / dt,   x* = x_before + dt v + dt^2 (g + forces)
    u_i = -(dt^2 / rho_i) [ sum_j (P_i + P_j) G_ij + P_i grad lambda_i ],   P_i >= 0

Macklin and Mueller 2013 (doi:10.1145/2461912.2461984): neighbours once a step at the predicted places,
Jacobi iterations on C, softness epsilon (`cfm`), artificial pressure s_corr, XSPH. Their multiplier is
-dt^2 P / rho; kept as a pressure over the iterations it can give back what was too much, and the next step
begins with it. What is apart is not pulled together, but in a periodic box that is full.

**What was compressed before the step** is taken out of the places alone, and no velocity comes of it, as the
contacts of Macklin, Mueller, Chentanez and Kim 2014 (doi:10.1145/2601097.2601152, section 4.4):

    motion   C_i = min(C_i, what dt v adds to it)     v and x get u
    places   all of C_i that is left then             x alone gets u

With a single solve, as in the paper of 2013, what a step leaves of a compression the next one gives back as a
velocity, over dt: an integrating controller of the places, unstable as soon as deep fluid leaves more than a
half, with warm pressures. A column of 80 layers hopped at 0.2 sqrt(g H) for ever; now it rests, at 0.01.

**An iteration** is two passes over the stored pairs: P_i <- max(0, P_i + omega C_i / (dt^2 D_i)), D the
change of C_i by its own P_i, then u. C and u are taken on the tangent of the places where kernels were last
computed, which is done anew after every RENEWAL iterations: a pass over stored gradients costs a half.
The places get one, from nothing.

**The number of iterations** follows the errors: in the next step there is up to one more where the mean of
max(C, 0), the 99 % quantile of C or what the motion leaves is over its limit, and slowly fewer where all have
long been far below. A solve that goes on until it is there does a step in 2 iterations and the next in 40;
that makes the fluid stiff of a sudden, and what was compressed flies apart.

In a box that is full the motion has corrected gradients (correction.py), for a lattice that is sheared
resists these sums: Taylor and Green's vortices die 3 % too fast with them, 50 % without.

`artificial_pressure` 0.1 pushes two particles apart like a compression of 0.001 at a spacing, in space of 0.1
at 0.2 h; from 0.2 on, a dam that breaks flies apart.

Limits: first order in time. What moves off its prediction by much of a spacing in a step is not seen by C
before it is renewed. Steps of STEEP d / sqrt(g H) at most.
"""

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tianim.lang import f32_1d, f32_2d, i32_1d, i32_2d, ti
from tianim.math.smoothing import spline, spline_slopes, spline_values
from tianim.spatial.crew import MOST_TURNS, PIECE, Crew
from tianim.spatial.neighbor_lists import nearest_image, wrapped
from tianim.system import Bounds
from tianim.systems.fluid.correction import Correction
from tianim.systems.fluid.forces import Forces
from tianim.systems.fluid.gauge_params import ForceGauge
from tianim.systems.fluid.motion import LARGEST_DRIFT, kick, move_on
from tianim.systems.fluid.pairs import Pairs
from tianim.systems.fluid.params import FluidParams
from tianim.systems.fluid.particles import Particles
from tianim.systems.fluid.pbf_passes import (
    FINISH,
    PLACE,
    PREPARE,
    PUSH,
    PUSH_PLACE,
    RELAX,
    RELAX_PLACE,
    RENEW,
    solve,
)
from tianim.systems.fluid.walls import Walls
from tianim.systems.fluid.wcsph import fall_height

# Iterations on one tangent. A step moves a particle some hundredths of a spacing off its prediction.
RENEWAL = 6
# Iterations for the places: one, for what they lift falls again, and waves run faster for it, by 1 % with
# two; in a box that is full, and nothing falls, more, so that it stays in order.
PLACES, PLACES_FULL = 1, 8
# More would not fit into the turns of a crew.
MOST_ITERATIONS = (MOST_TURNS - 2 * PLACES_FULL - 2) * RENEWAL // (2 * RENEWAL + 1)
# Predicted places nearer to a wall than so many spacings, or in it, are taken back to there.
NEAREST = 0.1
# Diagonals below this part of that of a particle with one neighbour belong to lone particles.
LONE = 1e-6
# Largest step, in the time that something as fast as sqrt(g H) takes for a spacing, H the depth. Pressures
# push as the predicted places say; an oscillation of w dt = z about their order is unstable beyond
# z^2 = 4/3, where z^2 is about 10 P dt^2 / (rho d^2) and P at most rho g H, often a half of it. The depth is
# that at the start.
STEEP = 0.3
# Part of their limits that errors are kept to: they are found before the last correction, and the number
# of iterations takes a few steps to follow.
AIM = 0.7
# Iterations of the first step: pressures are not known then, and what is not found at once is compressed.
FIRST = 8
# s_corr at a spacing; it goes with the 4th power of W, and in space is 1 at the paper's |dq| = 0.2 h.
AT_SPACING = 0.00915
# Fewer iterations, up to FEWER a step, where the errors are below this part of their limits.
CALM = 0.5
FEWER = 0.25
# What is left after a step of an error that is remembered: what swings is not calm in between.
MEMORY = 0.98


@ti.kernel
def predict(
    n: ti.i32, dt: ti.f32, gx: ti.f32, gy: ti.f32, gz: ti.f32, lower: f32_1d, length: f32_1d, x: f32_2d,
    v: f32_2d,
):  # fmt: skip
    """Add dt g to v and dt v to x, which is brought back into a periodic box."""
    for i in range(n):
        v[0, i] += dt * gx
        v[1, i] += dt * gy
        v[2, i] += dt * gz
        for c in ti.static(range(3)):
            x[c, i] = wrapped(x[c, i] + dt * v[c, i], lower[c], length[c])


@ti.kernel
def keep_out(n: ti.i32, dt: ti.f32, nearest: ti.f32, distance: f32_1d, normal: f32_2d, x: f32_2d, v: f32_2d):
    """Predictions nearer to a wall than `nearest` [m] end there."""
    for i in range(n):
        depth = nearest - distance[i]
        if depth > 0.0:
            for c in ti.static(range(3)):
                x[c, i] += depth * normal[c, i]
                v[c, i] += depth * normal[c, i] / dt


@ti.kernel
def step_back(n: ti.i32, dt: ti.f32, x: f32_2d, v: f32_2d, other: f32_2d, way: f32_2d):
    """Put x where the step began, the predictions in `other`, and the way to them in `way`."""
    for i in range(n):
        for c in ti.static(range(3)):
            other[c, i] = x[c, i]
            way[c, i] = dt * v[c, i]
            x[c, i] -= way[c, i]


@ti.kernel
def exchange(n: ti.i32, x: f32_2d, other: f32_2d):
    """Let x and `other` change places."""
    for i in range(n):
        for c in ti.static(range(3)):
            y = x[c, i]
            x[c, i] = other[c, i]
            other[c, i] = y


@ti.kernel
def start_from(
    n: ti.i32, dt: ti.f32, gx: ti.f32, gy: ti.f32, gz: ti.f32, acceleration: f32_2d, v: f32_2d, warm: f32_2d,
    change: f32_1d,
):  # fmt: skip
    """Give v the forces beside gravity; let pressures start warm."""
    for i in range(n):
        change[i] = warm[0, i]
        v[0, i] += dt * (acceleration[0, i] - gx)
        v[1, i] += dt * (acceleration[1, i] - gy)
        v[2, i] += dt * (acceleration[2, i] - gz)


@ti.kernel
def smooth_velocities(
    dimension: ti.template(),
    n: ti.i32,
    h: ti.f32,
    scale: ti.f32,
    rho: f32_1d,
    phase: i32_2d,
    length: f32_1d,
    begin: i32_1d,
    end: i32_1d,
    neighbour: i32_1d,
    x: f32_2d,
    v: f32_2d,
    out: f32_2d,
):
    """XSPH, what it adds to v: c sum_j V W_ij (v_j - v_i) 2 rho_j / (rho_i + rho_j); `scale` is c V s."""
    for i in range(n):
        own = rho[phase[0, i]]
        a, b, c = v[0, i], v[1, i], v[2, i]
        sx, sy, sz = 0.0, 0.0, 0.0
        for k in range(begin[i], end[i]):
            j = neighbour[k]
            dx = nearest_image(x[0, i] - x[0, j], length[0])
            dy = nearest_image(x[1, i] - x[1, j], length[1])
            dz = nearest_image(x[2, i] - x[2, j], length[2])
            other = rho[phase[0, j]]
            w = spline(dimension, ti.sqrt(dx * dx + dy * dy + dz * dz) / h) * 2.0 * other / (own + other)
            sx += w * (v[0, j] - a)
            sy += w * (v[1, j] - b)
            sz += w * (v[2, j] - c)
        out[0, i], out[1, i], out[2, i] = scale * sx, scale * sy, scale * sz


def plan_of(iterations: int, full: bool = False) -> list[int]:
    """The passes of a solve. Corrected gradients, of a box that is full, are found once and stay."""
    plan = [PREPARE]
    for iteration in range(iterations):
        if iteration:
            plan += [PUSH, RENEW] if iteration % RENEWAL == 0 and not full else [PUSH]
        plan.append(RELAX)
    plan.append(FINISH)
    for iteration in range(PLACES_FULL if full else PLACES):
        plan += [PUSH_PLACE, RELAX_PLACE] if iteration else [RELAX_PLACE]
    return [*plan, PLACE]


class Pbf:
    """The method `pbf`: steps `particles`.

    pairs       the rows of neighbours, at the predicted places of the last step
    iterations  that the next step will make, rounded up
    error       before the last corrections: mean of max(C, 0), share of the particles beyond the 99 % limit,
                mean change of the density that the motion leaves
    clamped     particles that the last step had to take out of a wall
    """

    def __init__(
        self, params: FluidParams, particles: Particles, pairs: Pairs, walls: Walls, forces: Forces
    ) -> None:
        self._fluid, self._params = params, params.pbf
        self._particles, self._walls, self._forces = particles, walls, forces
        self.pairs = pairs
        self._watched = any(isinstance(gauge, ForceGauge) for gauge in params.gauges.values())
        self.iterations = self._bounded(float(FIRST))
        self.error = (0.0, 0.0, 0.0)
        self._recent = 0.0
        self.clamped = 0
        self._gravity = (0.0, 0.0, 0.0)
        gravity = params.at(0.0).gravity
        swiftest = math.sqrt(math.hypot(*gravity) * fall_height(particles, walls, gravity))
        if swiftest > 0.0:
            forces.limits.depth = STEEP * particles.spacing / swiftest
        rho = particles.rest_density.to_numpy()
        self._inverse_rho: Any = ti.ndarray(ti.f32, len(rho))
        self._inverse_rho.from_numpy((1.0 / rho).astype(rho.dtype))
        # The part in a diagonal of one neighbour, a spacing away.
        steep = float(abs(spline_slopes(particles.spacing / particles.h, particles.dimension)))
        slope = particles.volume * particles.scale * steep / particles.h
        self._pair = slope**2 / float(rho.max())
        near = float(spline_values(particles.spacing / particles.h, particles.dimension))
        self._spread = params.pbf.artificial_pressure * AT_SPACING / (near**4 * self._pair)
        self._allocate(particles.columns.capacity)

    def _allocate(self, capacity: int) -> None:
        self._crew = Crew(capacity)
        self._correction = (
            Correction(self._particles, self.pairs, self._walls) if self.pairs.is_full else None
        )
        self._plan: Any = ti.ndarray(ti.i32, MOST_TURNS)
        self._planned = 0
        vectors, numbers = (3, capacity), (capacity,)
        self._start: Any = ti.ndarray(ti.f32, vectors)
        self._way: Any = ti.ndarray(ti.f32, vectors)
        self._moved: Any = ti.ndarray(ti.f32, vectors)
        self._diagonal: Any = ti.ndarray(ti.f32, numbers)
        self._source: Any = ti.ndarray(ti.f32, numbers)
        self._excess: Any = ti.ndarray(ti.f32, numbers)
        self._change: Any = ti.ndarray(ti.f32, numbers)
        self._own: Any = ti.ndarray(ti.f32, (1, capacity))
        self._own_change: Any = ti.ndarray(ti.f32, numbers)

    @staticmethod
    def pairs_for(params: FluidParams, particles: Particles, bounds: Bounds) -> Pairs:
        """Rows for one step: what comes nearer than h in its iterations alone weighs nothing there."""
        return Pairs(particles, bounds)

    def step(self, time: float, dt: float) -> None:
        """Go on from `time` [s] by `dt` [s]."""
        self.predict(time, dt)
        self.find()
        self.accelerate(time, dt)
        self.solve(dt)
        self.move(dt)

    def predict(self, time: float, dt: float) -> None:
        """Where gravity alone would lead the particles, though not deep into a wall."""
        particles, walls, pairs, n = self._particles, self._walls, self.pairs, self._particles.count
        x, v = particles["position"], particles["velocity"]
        gravity = np.array(self._fluid.at(time).gravity)
        gravity[self._fluid.dimension :] = 0.0
        self._gravity = (float(gravity[0]), float(gravity[1]), float(gravity[2]))
        predict(n, dt, *self._gravity, pairs.lower, pairs.length, x, v)
        if walls.count:
            walls.measure(n, x)
            keep_out(n, dt, NEAREST * particles.spacing, walls.distance, walls.normal, x, v)

    def find(self) -> None:
        """Neighbours and walls of each prediction, and its density."""
        self.pairs.build()
        particles = self._particles
        self._walls.measure(particles.count, particles["position"], particles.density)

    def accelerate(self, time: float, dt: float) -> None:
        """All forces but gravity and pressure, of the places where the step began: these keep the spin."""
        particles, n = self._particles, self._particles.count
        x, v = particles["position"], particles["velocity"]
        step_back(n, dt, x, v, self._start, self._way)
        self._forces.accelerate(time, dt)
        start_from(n, dt, *self._gravity, particles.acceleration, v, particles["warm"], self._change)
        self._forces.relax(dt)
        exchange(n, x, self._start)

    def solve(self, dt: float) -> None:
        """Iterate. Afterwards the particles are where the step began, and their velocities lead on.

        The correction of the places, for `move`, is then in `_moved`.
        """
        plan = plan_of(math.ceil(self.iterations), self.pairs.is_full)
        if self._correction:
            self._correction.find()
        if len(plan) != self._planned:
            self._plan.from_numpy(np.resize(np.array(plan, np.int32), MOST_TURNS))
            self._planned = len(plan)
        self._crew.begin()
        if self._crew.works:
            self._launch(0, len(plan), dt)
        else:
            for turn in range(len(plan)):
                self._launch(turn, turn + 1, dt)
        n = self._particles.count
        sums = self._crew.sums.to_numpy()[:3, : -(-n // PIECE)].sum(axis=1, dtype=np.float64) / n
        self.error = (float(sums[0]), float(sums[1]), float(sums[2]))
        self._adapt(self._params.divergence_error * min(dt / self._forces.limits.flow, 1.0) ** 2)
        if self._params.xsph > 0.0:
            self._smooth()

    def _launch(self, first: int, last: int, dt: float) -> None:
        """Passes of the plan."""
        particles, pairs, walls, crew, params = (
            self._particles, self.pairs, self._walls, self._crew, self._params
        )  # fmt: skip
        n, d = particles.count, particles.spacing
        forward, back = pairs.gradient, pairs.gradient
        if self._correction:
            forward, back = self._correction.gradient, self._correction.back
        solve(
            particles.dimension, pairs.is_full, params.artificial_pressure > 0.0, first, last, n, dt,
            particles.h, particles.volume * particles.scale, params.cfm, self._spread, LONE * self._pair,
            AIM * params.density_error_p99, LARGEST_DRIFT * d, crew.tasks_for(n), crew.stride,
            self._plan, crew.array, crew.sums, self._inverse_rho, particles["phase"], pairs.begin, pairs.end,
            pairs.neighbour, pairs.gradient, forward, back, pairs.length, walls.count, walls.support,
            walls.table, walls.samples, walls.shares, walls.gradient, walls.flux, walls.distance,
            particles.density, self._start, particles["position"], particles["velocity"],
            self._way, self._moved, self._diagonal, self._source, self._excess, particles["warm"],
            self._change, self._own, self._own_change, particles.pressure,
        )  # fmt: skip

    def _adapt(self, tolerance: float) -> None:
        """More iterations in the next step where an error is over its limit, slowly fewer where far below.

        tolerance: of the motion. What it leaves stirs, and in fluid at rest, whose steps are short beside the
        time that it takes through a spacing, nothing else does.
        """
        mean, beyond, stir = self.error
        over = max(
            mean / (AIM * self._params.density_error), beyond / 0.01, stir / tolerance if stir > 0.0 else 0.0
        )
        self._recent = max(over, MEMORY * self._recent)
        if over > 1.0:
            self.iterations = self._bounded(self.iterations + min(over - 1.0, 1.0))
        elif self._recent < CALM:
            self.iterations = self._bounded(self.iterations - FEWER * (1.0 - self._recent / CALM))

    def _bounded(self, iterations: float) -> float:
        most = min(self._params.most_iterations, MOST_ITERATIONS)
        return min(max(iterations, float(self._params.least_iterations)), float(most))

    def _smooth(self) -> None:
        particles, pairs, n = self._particles, self.pairs, self._particles.count
        smooth_velocities(
            particles.dimension, n, particles.h, self._params.xsph * particles.volume * particles.scale,
            particles.rest_density, particles["phase"], pairs.length, pairs.begin, pairs.end, pairs.neighbour,
            particles["position"], particles["velocity"], self._way,
        )  # fmt: skip
        kick(n, 1.0, self._way, particles["velocity"])

    def move(self, dt: float) -> None:
        """Places, kept out of the walls; what the walls bear."""
        particles, walls, pairs = self._particles, self._walls, self.pairs
        n, x, v = particles.count, particles["position"], particles["velocity"]
        if self._watched:
            walls.push(n, x, particles.pressure, dt)
        walls.hold(n, x, v, dt)
        move_on(n, dt, particles, walls, pairs)
        walls.shift(n, x, v, self._moved, pairs.lower, pairs.length)
        self.clamped = walls.clamp(n, x, v)

    def diagnostics(self) -> dict[str, float]:
        """Iterations of the next step; mean compression before the last correction."""
        return {"iterations": self.iterations, "solver_error": self.error[0]}

    def state(self) -> dict[str, NDArray[Any]]:
        """The number of iterations, which follows the error, and what is remembered of that."""
        return {"iterations": np.array([self.iterations, self._recent])}

    def restore(self, state: Mapping[str, NDArray[Any]]) -> None:
        """Take over what `state` gave."""
        self.iterations, self._recent = (float(value) for value in state["iterations"])
