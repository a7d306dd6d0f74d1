"""Position Based Fluids: places are predicted, then moved until nothing is compressed.

    C_i = delta_i - 1 <= 0                     delta_i = sum_j V W_ij + lambda_i
    x_i = x*_i + u_i,   v_i = (x_i - x_i(t)) / dt,   x* = x + dt v + dt^2 (g + forces)
    u_i = -(dt^2/rho_i) [ sum_j (P_i + P_j) G_ij + 2 P_i grad lambda_i ],       P_i >= 0

Macklin and Mueller 2013 (doi:10.1145/2461912.2461984): neighbours once a step at the predicted places, Jacobi
iterations on C, relaxation epsilon (`cfm`), artificial pressure s_corr, XSPH. Their multiplier is
lambda_i = -dt^2 P_i / rho: kept as a pressure over all iterations it may give back what was too much, and
the next step can begin with it.

**An iteration** is two passes over the stored pairs, P_i <- max(0, P_i + omega C_i / (dt^2 D_i)) and u, with
C on the tangent of the places where kernels were last computed, which are computed anew after each RENEWAL
iterations. Walls are on their tangent from x*; contacts see to the rest. The error of an iteration is its
mean of max(C, 0), and the share of particles with C beyond the limit for 99 %; it ends when both are kept.

**Warm start** from WARM times the last pressures. A step is an integrating controller of the places: a mode
of which it leaves the part Q of the error grows under a full warm start where Q > 1/2 (z^3 = Q (z^3 -
(z - 1)^3)), which the slow modes of deep fluid do for any affordable number of iterations: a column then
hops. A half is stable for all Q.

**Along walls** the mirrored pressure of a wall has no gradient, so that its share of the tangential push
is missing, and a resting layer at a wall would sink for ever: `push_of` adds it.

Limits: deep fluid at rest stays compressed by 1 to 2 % (30 layers), the more the deeper.
"""

from typing import Any

from tianim.lang import f32_1d, f32_2d, i32_1d, i32_2d, ti
from tianim.math.smoothing import cubic, cubic_slope, cubic_slopes, cubic_scale
from tianim.spatial.neighbor_lists import nearest_image
from tianim.system import Bounds
from tianim.systems.fluid.crew import MOST_TURNS, Crew, first_of, last_of, meet, pieces, take
from tianim.systems.fluid.dfsph import advect
from tianim.systems.fluid.forces import Forces
from tianim.systems.fluid.pairs import TINY, Pairs
from tianim.systems.fluid.params import FluidParams
from tianim.systems.fluid.particles import Particles
from tianim.systems.fluid.wall_shares import wall_terms
from tianim.systems.fluid.walls import Walls

# The largest eigenvalue of D^-1 A is 2.8 on the lattice: beyond 0.7 the iterations diverge.
RELAXATION = 0.5
WARM = 0.5
# Iterations on one tangent. A step moves a particle some hundredths of a spacing off its prediction.
RENEWAL = 6
# Predicted places nearer to a wall than so many spacings, or in it, are taken back to there.
NEAREST = 0.1
# s_corr is 1 at so many support radii (the paper's |dq| = 0.1 to 0.3 h), and falls with the 4th power of W.
APART = 0.2
# Diagonals below this part of that of a particle with one neighbour belong to lone particles.
LONE = 1e-6
MOST_ITERATIONS = MOST_TURNS // 3
# The error is kept within this part of its limits.
AIM = 0.7
# Below this part of them there are fewer iterations, FEWER a step.
CALM = 0.5
FEWER = 0.125


@ti.kernel
def predict(
    n: ti.i32, dt: ti.f32, gx: ti.f32, gy: ti.f32, gz: ti.f32, lower: f32_1d, length: f32_1d, x: f32_2d,
    v: f32_2d,
):  # fmt: skip
    """v += dt g, x += dt v, brought back into a periodic box."""
    for i in range(n):
        v[0, i] += dt * gx
        v[1, i] += dt * gy
        v[2, i] += dt * gz
        for c in ti.static(range(3)):
            y = x[c, i] + dt * v[c, i]
            turns = ti.floor((y - lower[c]) / ti.max(length[c], 1e-30))
            x[c, i] = y - ti.select(length[c] > 0.0, turns * length[c], 0.0)


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
def kick(
    n: ti.i32, dt: ti.f32, gx: ti.f32, gy: ti.f32, gz: ti.f32, acceleration: f32_2d, x: f32_2d, v: f32_2d,
    start: f32_2d, warm: f32_2d, change: f32_1d,
):  # fmt: skip
    """`start`: where predictions began; v gets the forces other than gravity, which it has."""
    for i in range(n):
        warm[0, i] *= WARM
        change[i] = warm[0, i]
        for c in ti.static(range(3)):
            start[c, i] = x[c, i] - dt * v[c, i]
        v[0, i] += dt * (acceleration[0, i] - gx)
        v[1, i] += dt * (acceleration[1, i] - gy)
        v[2, i] += dt * (acceleration[2, i] - gz)


@ti.func
def push_of(
    i, inverse_rho: ti.template(), phase: ti.template(), begin: ti.template(), end: ti.template(),
    neighbour: ti.template(), gradient: ti.template(), wall: ti.template(), change: ti.template(),
):  # fmt: skip
    """Acceleration [m/s2] of particle i by the pressures `change`."""
    p = change[i]
    x, y, z = p * wall[0, i], p * wall[1, i], p * wall[2, i]
    for k in range(begin[i], end[i]):
        both = p + change[neighbour[k]]
        x += both * gradient[0, k]
        y += both * gradient[1, k]
        z += both * gradient[2, k]
    return -inverse_rho[phase[0, i]] * ti.Vector([x, y, z])


@ti.func
def prepare(
    spreading: ti.template(), i, dt, h, spread, inverse_rho: ti.template(), phase: ti.template(),
    begin: ti.template(), end: ti.template(), neighbour: ti.template(), gradient: ti.template(),
    length: ti.template(), wall: ti.template(), flux: ti.template(), density: ti.template(),
    start: ti.template(), x: ti.template(), v: ti.template(), offset: ti.template(),
    diagonal: ti.template(), source: ti.template(),
):  # fmt: skip
    """Diagonal and source of particle i at its prediction, and its `offset` by forces from there."""
    square = 0.0
    s, apart = ti.Vector([0.0, 0.0, 0.0]), ti.Vector([0.0, 0.0, 0.0])
    for k in range(begin[i], end[i]):
        j = neighbour[k]
        g = ti.Vector([gradient[0, k], gradient[1, k], gradient[2, k]])
        square += g.dot(g) * inverse_rho[phase[0, j]]
        s += g
        if ti.static(spreading):
            r2 = TINY * h * h
            for c in ti.static(range(3)):
                difference = nearest_image(x[c, i] - x[c, j], length[c])
                r2 += difference * difference
            w = cubic(ti.sqrt(r2) / h) / cubic(APART)
            apart += w * w * w * w * g
    g = ti.Vector([wall[0, i], wall[1, i], wall[2, i]])
    own = inverse_rho[phase[0, i]]
    diagonal[i] = square + own * (s + g).norm_sqr()
    source[i] = density[i] - 1.0 - dt * flux[i]
    for c in ti.static(range(3)):
        if ti.static(spreading):
            v[c, i] -= spread * own / dt * apart[c]
        offset[c, i] = start[c, i] + dt * v[c, i] - x[c, i]


@ti.func
def renew(
    i, dt, h, scale, inverse_rho: ti.template(), phase: ti.template(), begin: ti.template(),
    end: ti.template(), neighbour: ti.template(), gradient: ti.template(), length: ti.template(),
    wall: ti.template(), share: ti.template(), flux: ti.template(), x: ti.template(), v: ti.template(),
    moved: ti.template(), offset: ti.template(), diagonal: ti.template(), source: ti.template(), change: ti.template(),
):  # fmt: skip
    """Tangent of particle i at x + `moved`, from where its pressure's `change` counts from now on."""
    total, tangent, square = cubic(0.0), 0.0, 0.0
    s = ti.Vector([0.0, 0.0, 0.0])
    ux, uy, uz = moved[0, i], moved[1, i], moved[2, i]
    for k in range(begin[i], end[i]):
        j = neighbour[k]
        ax, ay, az = ux - moved[0, j], uy - moved[1, j], uz - moved[2, j]
        dx = nearest_image(x[0, i] - x[0, j], length[0]) + ax
        dy = nearest_image(x[1, i] - x[1, j], length[1]) + ay
        dz = nearest_image(x[2, i] - x[2, j], length[2]) + az
        r = ti.sqrt(dx * dx + dy * dy + dz * dz + TINY * h * h)
        total += cubic(r / h)
        g = scale * cubic_slope(r / h) / (h * r)
        gradient[0, k] = g * dx
        gradient[1, k] = g * dy
        gradient[2, k] = g * dz
        tangent += g * (dx * ax + dy * ay + dz * az)
        square += g * g * r * r * inverse_rho[phase[0, j]]
        s += g * ti.Vector([dx, dy, dz])
    g = ti.Vector([wall[0, i], wall[1, i], wall[2, i]])
    diagonal[i] = square + inverse_rho[phase[0, i]] * (s + g).norm_sqr()
    change[i] = 0.0
    for c in ti.static(range(3)):
        v[c, i] += (moved[c, i] - offset[c, i]) / dt
        offset[c, i] = moved[c, i]
    source[i] = scale * total + share[i] - 1.0 - dt * flux[i] - tangent


@ti.func
def relax(
    i, dt2, cfm, lone, begin: ti.template(), end: ti.template(), neighbour: ti.template(),
    gradient: ti.template(), wall: ti.template(), diagonal: ti.template(), source: ti.template(),
    warm: ti.template(), change: ti.template(), moved: ti.template(),
):  # fmt: skip
    """One relaxation of the pressure of particle i; its C before."""
    a, b, c = moved[0, i], moved[1, i], moved[2, i]
    r = source[i] + wall[0, i] * a + wall[1, i] * b + wall[2, i] * c
    for k in range(begin[i], end[i]):
        j = neighbour[k]
        r += (
            gradient[0, k] * (a - moved[0, j])
            + gradient[1, k] * (b - moved[1, j])
            + gradient[2, k] * (c - moved[2, j])
        )
    d = diagonal[i]
    stiff = dt2 * ti.max(d, lone)
    before = warm[0, i]
    p = ti.max(before + RELAXATION * (r / stiff - cfm * before), 0.0)
    p = ti.select(d > lone, p, 0.0)
    warm[0, i] = p
    change[i] += p - before
    return ti.select(d > lone, ti.max(r, 0.0), 0.0)


@ti.func
def total_of(which, n, sums: ti.template()):
    """Sum over the particles of what was summed by piece."""
    total = 0.0
    for k in range(pieces(n)):
        total += sums[which, k]
    return total


@ti.kernel
def solve(
    spreading: ti.template(),
    n: ti.i32,
    dt: ti.f32,
    h: ti.f32,
    scale: ti.f32,
    cfm: ti.f32,
    spread: ti.f32,
    lone: ti.f32,
    tolerance_p99: ti.f32,
    most: ti.i32,
    tasks: ti.i32,
    stride: ti.i32,
    crew: i32_1d,
    sums: f32_2d,
    inverse_rho: f32_1d,
    phase: i32_2d,
    begin: i32_1d,
    end: i32_1d,
    neighbour: i32_1d,
    gradient: f32_2d,
    length: f32_1d,
    wall: f32_2d,
    share: f32_1d,
    flux: f32_1d,
    density: f32_1d,
    start: f32_2d,
    x: f32_2d,
    v: f32_2d,
    offset: f32_2d,
    moved: f32_2d,
    diagonal: f32_1d,
    source: f32_1d,
    warm: f32_2d,
    change: f32_1d,
    pressure: f32_1d,
    report: f32_1d,
):
    """Iterate; afterwards v is the way from `start` over dt, and x is `start` again.

    report: iterations, mean compression before the last of them, share of particles beyond the 99 % limit.
    sums: (4, pieces): of each error two rows used in turn.
    """
    for block in range(tasks * stride):
        if block % stride == 0:
            turn, iteration = 0, 0
            while iteration < most:
                piece = take(crew, turn)
                while piece < pieces(n):
                    for i in range(first_of(piece), last_of(piece, n)):
                        if iteration == 0:
                            prepare(
                                spreading, i, dt, h, spread, inverse_rho, phase, begin, end, neighbour,
                                gradient, length, wall, flux, density, start, x, v, offset, diagonal, source,
                            )  # fmt: skip
                        a = push_of(
                            i, inverse_rho, phase, begin, end, neighbour, gradient, wall, change
                        )
                        for c in ti.static(range(3)):
                            moved[c, i] = offset[c, i] + dt * dt * a[c]
                    piece = take(crew, turn)
                turn += 1
                meet(crew, tasks)
                if iteration > 0 and iteration % RENEWAL == 0:
                    piece = take(crew, turn)
                    while piece < pieces(n):
                        for i in range(first_of(piece), last_of(piece, n)):
                            renew(
                                i, dt, h, scale, inverse_rho, phase, begin, end, neighbour, gradient, length,
                                wall, share, flux, x, v, moved, offset, diagonal, source, change,
                            )  # fmt: skip
                        piece = take(crew, turn)
                    turn += 1
                    meet(crew, tasks)
                half = 2 * (iteration % 2)
                piece = take(crew, turn)
                while piece < pieces(n):
                    total, beyond = 0.0, 0.0
                    for i in range(first_of(piece), last_of(piece, n)):
                        error = relax(
                            i, dt * dt, cfm, lone, begin, end, neighbour, gradient, wall, diagonal, source,
                            warm, change, moved,
                        )  # fmt: skip
                        total += error
                        beyond += ti.select(error > tolerance_p99, 1.0, 0.0)
                    sums[half, piece] = total
                    sums[half + 1, piece] = beyond
                    piece = take(crew, turn)
                turn += 1
                meet(crew, tasks)
                iteration += 1
                total, beyond = total_of(half, n, sums), total_of(half + 1, n, sums)
                if block == 0:
                    report[0] = iteration
                    report[1] = total / n
                    report[2] = beyond / n
            piece = take(crew, turn)
            while piece < pieces(n):
                for i in range(first_of(piece), last_of(piece, n)):
                    a = push_of(
                        i, inverse_rho, phase, begin, end, neighbour, gradient, wall, change
                    )
                    pressure[i] = warm[0, i]
                    for c in ti.static(range(3)):
                        v[c, i] += dt * a[c]
                        x[c, i] = start[c, i]
                piece = take(crew, turn)


@ti.kernel
def smooth_velocities(
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
    """XSPH: out = v + sum_j m_j / mean m V c W_ij (v_j - v_i); `scale` is c V s. Momentum is kept."""
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
            w = cubic(ti.sqrt(dx * dx + dy * dy + dz * dz) / h) * 2.0 * other / (own + other)
            sx += w * (v[0, j] - a)
            sy += w * (v[1, j] - b)
            sz += w * (v[2, j] - c)
        out[0, i], out[1, i], out[2, i] = a + scale * sx, b + scale * sy, c + scale * sz


@ti.kernel
def take_over(n: ti.i32, source: f32_2d, target: f32_2d):
    """Copy the rows of n particles."""
    for i in range(n):
        for c in ti.static(range(3)):
            target[c, i] = source[c, i]


@ti.kernel
def measure_density(
    n: ti.i32,
    h: ti.f32,
    scale: ti.f32,
    reach: ti.f32,
    count: ti.i32,
    support: ti.f32,
    table: f32_2d,
    samples: f32_1d,
    shares: f32_2d,
    distance: f32_1d,
    length: f32_1d,
    begin: i32_1d,
    end: i32_1d,
    neighbour: i32_1d,
    x: f32_2d,
    density: f32_1d,
):
    """delta at the places of now, on rows made nearby; walls farther than `reach` when measured are none."""
    for i in range(n):
        total = cubic(0.0)
        for k in range(begin[i], end[i]):
            j = neighbour[k]
            dx = nearest_image(x[0, i] - x[0, j], length[0])
            dy = nearest_image(x[1, i] - x[1, j], length[1])
            dz = nearest_image(x[2, i] - x[2, j], length[2])
            total += cubic(ti.sqrt(dx * dx + dy * dy + dz * dz) / h)
        share = 0.0
        if distance[i] < reach:
            p = ti.Vector([x[0, i], x[1, i], x[2, i]])
            share = wall_terms(table, samples, shares, support, count, p).w
        density[i] = scale * total + share


class Pbf:
    """The method `pbf`: steps `particles`.

    pairs    the rows of neighbours at the predicted places of the last step
    clamped  particles that the last step had to take out of a wall
    """

    def __init__(
        self, params: FluidParams, particles: Particles, pairs: Pairs, walls: Walls, forces: Forces
    ) -> None:
        self._fluid, self._params = params, params.pbf
        self._particles, self._walls, self._forces = particles, walls, forces
        self.pairs = pairs
        self.clamped = 0
        self._crew = Crew(particles.columns.capacity)
        self._allocate(particles.columns.capacity)
        rho = particles.rest_density.to_numpy()
        self._inverse_rho: Any = ti.ndarray(ti.f32, len(rho))
        self._inverse_rho.from_numpy((1.0 / rho).astype(rho.dtype))
        # A slope of the kernel, squared: the size of one pair's part in a diagonal.
        slope = particles.volume * particles.scale * float(abs(cubic_slopes(0.5))) / particles.h
        self._pair = slope**2 / float(rho.max())
        self.iterations = float(self._params.least_iterations)

    def _allocate(self, capacity: int) -> None:
        self._start: Any = ti.ndarray(ti.f32, (3, capacity))
        self._offset: Any = ti.ndarray(ti.f32, (3, capacity))
        self._moved: Any = ti.ndarray(ti.f32, (3, capacity))
        self._diagonal: Any = ti.ndarray(ti.f32, capacity)
        self._source: Any = ti.ndarray(ti.f32, capacity)
        self._change: Any = ti.ndarray(ti.f32, capacity)
        self._sums: Any = ti.ndarray(ti.f32, (4, self._crew.sums.shape[1]))
        self._report: Any = ti.ndarray(ti.f32, 3)
        self._report.fill(0.0)

    @staticmethod
    def pairs_for(params: FluidParams, particles: Particles, bounds: Bounds) -> Pairs:
        """Rows for one step: what comes nearer than h in its iterations alone weighs nothing there."""
        return Pairs(particles, bounds)

    def step(self, time: float, dt: float) -> None:
        """Go on from `time` [s] by `dt` [s]."""
        particles, walls, pairs = self._particles, self._walls, self.pairs
        n = particles.count
        gravity = self._gravity(time)
        self._predict(n, gravity, dt)
        pairs.build()
        x, v = particles["position"], particles["velocity"]
        walls.measure(n, x, particles.density)
        self._forces.accelerate(time, dt)
        kick(n, dt, *gravity, particles.acceleration, x, v, self._start, particles["warm"], self._change)
        self._forces.relax(dt)
        walls.push(n, x, self._solve(n, dt), dt)
        if self._params.xsph > 0.0:
            self._smooth(n)
        walls.hold(n, x, v, dt)
        advect(n, dt, particles.pressure, particles.acceleration, pairs.lower, pairs.length, x, v)
        self.clamped = walls.clamp(n, x, v)

    def _gravity(self, time: float) -> tuple[float, float, float]:
        x, y, z = self._fluid.at(time).gravity
        return x, y, z if self._fluid.dimension == 3 else 0.0

    def _predict(self, n: int, gravity: tuple[float, float, float], dt: float) -> None:
        """Predicted places, none of them deep in a wall."""
        particles, walls, pairs = self._particles, self._walls, self.pairs
        x, v = particles["position"], particles["velocity"]
        predict(n, dt, *gravity, pairs.lower, pairs.length, x, v)
        if walls.count:
            walls.measure(n, x)
            keep_out(n, dt, NEAREST * particles.spacing, walls.distance, walls.normal, x, v)

    def _solve(self, n: int, dt: float) -> Any:
        """Iterate; gives the pressures."""
        particles, pairs, walls, crew, params = (
            self._particles, self.pairs, self._walls, self._crew, self._params
        )  # fmt: skip
        crew.begin()
        solve(
            params.artificial_pressure > 0.0, n, dt, particles.h, particles.volume * particles.scale,
            params.cfm, params.artificial_pressure / self._pair, LONE * self._pair,
            AIM * params.density_error_p99, int(self.iterations), crew.tasks, crew.stride, crew.array, self._sums,
            self._inverse_rho, particles["phase"], pairs.begin, pairs.end, pairs.neighbour, pairs.gradient,
            pairs.length, walls.gradient, walls.share, walls.flux, particles.density, self._start,
            particles["position"], particles["velocity"], self._offset, self._moved, self._diagonal,
            self._source, particles["warm"], self._change, particles.pressure, self._report,
        )  # fmt: skip
        self._adapt()
        return particles.pressure

    def _adapt(self) -> None:
        """More iterations in the next step where the error is over its limits, slowly fewer where it is not."""
        params = self._params
        mean, beyond = (float(value) for value in self._report.to_numpy()[1:3])
        if mean > params.density_error or beyond > 0.01:
            self.iterations += 1.0
        elif mean < CALM * params.density_error and beyond < CALM * 0.01:
            self.iterations -= FEWER
        most = min(params.most_iterations, MOST_ITERATIONS)
        self.iterations = min(max(self.iterations, float(params.least_iterations)), float(most))

    def _smooth(self, n: int) -> None:
        particles, pairs = self._particles, self.pairs
        smooth_velocities(
            n, particles.h, self._params.xsph * particles.volume * particles.scale, particles.rest_density,
            particles["phase"], pairs.length, pairs.begin, pairs.end, pairs.neighbour,
            particles["position"], particles["velocity"], self._moved,
        )  # fmt: skip
        take_over(n, self._moved, particles["velocity"])

    def refresh(self) -> None:
        """Densities of the places of now: a step leaves those of its predictions."""
        particles, pairs, walls = self._particles, self.pairs, self._walls
        measure_density(
            particles.count, particles.h, particles.volume * particles.scale,
            walls.support + particles.spacing, walls.count, walls.support, walls.table, walls.samples,
            walls.shares, walls.distance, pairs.length, pairs.begin, pairs.end, pairs.neighbour,
            particles["position"], particles.density,
        )  # fmt: skip

    def diagnostics(self) -> dict[str, float]:
        """Iterations of the last step; mean compression before the last one, share beyond the 99 % limit."""
        iterations, error, beyond = (float(value) for value in self._report.to_numpy())
        return {"iterations": iterations, "solver_error": error, "share_beyond_p99": beyond}
