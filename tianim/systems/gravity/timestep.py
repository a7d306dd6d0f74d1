"""Time steps: fixed, adaptive for all stars at once, or one for each star (block steps).

Each star allows a step of

    tau = eta sqrt(l / |a|),   l = softening, or |phi| / |a| without one (the distance of what pulls)

**Adaptive.** The time up to the next frame is halved, and its halves again, until every part is at most
the smallest tau at *both* of its ends. A part whose end does not allow it is undone. The rule is the same
seen from either end, so that with a time-symmetric integrator the steps are time-symmetric too, but for
what differs between undone and redone parts; it costs few undone steps (tau changes slowly), and room
for one saved state. (After Hut, Makino and McMillan 1995, ApJ 443, L93, and Makino et al. 2006, New
Astronomy 12, 124, who symmetrise with the mean of both ends.)

**Block.** Leapfrog with a rung for each star: rung r steps by 1 / 2^r of the whole. A star may go to a
finer rung at each end of its step, and to a coarser one where its larger step would begin anyway. Kicks
are the star's own, everybody drifts together. Block steps are *not* time-symmetric (tau is read at the
start of a step alone), and momentum is kept only to the order of the steps, because two stars
on different rungs kick one another at different times, and because a tree's net force can only be taken
away where all forces are found (measured 1e-5 to 2e-4 in a time unit, G = M = 1). At each of the finest
steps in use the tree is built anew, but forces are found for the stars whose step ends alone. Measured
on 20,000 stars and 6 levels: 14 to 28 % of the time on a Plummer sphere, of which one or two rungs hold
most stars, 34 % on a King sphere of W_0 = 9. (Springel 2005, MNRAS 364, 1105.)
"""

import math

import numpy as np
from numpy.typing import NDArray

from tianim.lang import f64_1d, f64_2d, i32_1d, ti, workers
from tianim.spatial.tubes import share
from tianim.systems.gravity.diagnostics import PIECES
from tianim.systems.gravity.external import field_at
from tianim.systems.gravity.integrators import Integrator
from tianim.systems.gravity.stars import Stars

# Keeps divisions finite where nothing pulls; representable in float32, as which kernels read it.
TINY = 1e-30
LARGEST = 1e38


@ti.func
def step_squared(eta, softening, rows: ti.template(), count, x: ti.template(), a: ti.template(), phi, i):
    """tau^2 of star i."""
    size = ti.sqrt(a[0, i] * a[0, i] + a[1, i] * a[1, i] + a[2, i] * a[2, i]) + ti.cast(TINY, ti.f64)
    length = softening
    if softening == 0.0:
        length = ti.abs(phi + field_at(rows, count, x[0, i], x[1, i], x[2, i])[3]) / size
    return eta * eta * length / size


@ti.kernel
def shortest(
    n: ti.i32,
    stride: ti.i32,
    eta: ti.f64,
    softening: ti.f64,
    rows: f64_2d,
    count: ti.i32,
    x: f64_2d,
    a: f64_2d,
    phi: f64_1d,
    out: f64_1d,
):
    """The smallest tau^2 of each piece of the stars into out (PIECES,)."""
    for block in range(PIECES * stride):
        if block % stride == 0:
            piece = block // stride
            least = ti.cast(LARGEST, ti.f64)
            for i in range(share(n, piece, PIECES), share(n, piece + 1, PIECES)):
                least = ti.min(least, step_squared(eta, softening, rows, count, x, a, phi[i], i))
            out[piece] = least


def allowed(stars: Stars, eta: float) -> float:
    """The smallest tau of all stars [own time]; infinite without stars."""
    if stars.count == 0:
        return math.inf
    least = np.empty(PIECES)
    shortest(
        stars.count, workers()[1], eta, stars.law.softening, stars.rows, stars.row_count,
        stars.x, stars.a, stars.phi, least,
    )  # fmt: skip
    return math.sqrt(least.min()) if np.isfinite(least).all() else math.nan


class Adaptive:
    """One step for all stars, halved until both of its ends allow it, `levels` times at most."""

    def __init__(self, stars: Stars, integrator: Integrator, eta: float, levels: int) -> None:
        self.stars, self.integrator, self.eta, self.levels = stars, integrator, eta, levels
        self.steps = 0

    def advance(self, time: float, scene_dt: float, dt: float) -> None:
        """Go on by dt [own time], which is scene_dt [s]; `steps` says in how many steps."""
        self.steps = 0
        self._part(time, scene_dt, dt, self.levels)

    def _part(self, time: float, scene_dt: float, dt: float, levels: int) -> None:
        if levels == 0 or not dt > allowed(self.stars, self.eta):
            if levels:
                self.stars.save()
            self.integrator(self.stars, time, scene_dt, dt)
            # Not-a-number allows anything: the check after the frame says what happened.
            if levels == 0 or not dt > allowed(self.stars, self.eta):
                self.steps += 1
                return
            self.stars.undo()
        self._part(time, scene_dt / 2, dt / 2, levels - 1)
        self._part(time + scene_dt / 2, scene_dt / 2, dt / 2, levels - 1)


@ti.func
def period(levels, rung):
    """Ticks of a step on a rung; the finest rung, `levels`, steps by one tick."""
    return 1 << (levels - rung)


@ti.func
def wanted_rung(levels, whole, tau2):
    """The coarsest rung whose step is at most tau."""
    rung = 0
    step2 = whole * whole
    while rung < levels and step2 > tau2:
        rung += 1
        step2 *= 0.25
    return rung


@ti.kernel
def choose_rungs(
    n: ti.i32,
    tick: ti.i32,
    levels: ti.i32,
    whole: ti.f64,
    eta: ti.f64,
    softening: ti.f64,
    rows: f64_2d,
    count: ti.i32,
    x: f64_2d,
    v: f64_2d,
    a: f64_2d,
    phi: f64_1d,
    rung: i32_1d,
    deepest: i32_1d,
):
    """End the steps that end at `tick` with half a kick, and give those stars their next rung.

    At tick 0 all stars begin: no kick, any rung. deepest[0]: the finest rung in use.
    """
    deepest[0] = 0
    for i in range(n):
        if tick == 0 or tick % period(levels, rung[i]) == 0:
            wanted = wanted_rung(levels, whole, step_squared(eta, softening, rows, count, x, a, phi[i], i))
            if tick == 0:
                rung[i] = wanted
            else:
                half = 0.5 * whole / (1 << rung[i])
                for c in ti.static(range(3)):
                    v[c, i] += half * a[c, i]
                new = ti.max(rung[i], wanted)
                while new > wanted and tick % period(levels, new - 1) == 0:
                    new -= 1
                rung[i] = new
        ti.atomic_max(deepest[0], rung[i])


@ti.kernel
def begin_and_drift(
    n: ti.i32,
    tick: ti.i32,
    ticks: ti.i32,
    levels: ti.i32,
    whole: ti.f64,
    x: f64_2d,
    v: f64_2d,
    a: f64_2d,
    rung: i32_1d,
    active: i32_1d,
):
    """Half a kick for stars whose step begins at `tick`; all drift for `ticks`.

    active   1 for those whose step ends then, else 0
    """
    drift = whole * ticks / (1 << levels)
    for i in range(n):
        own = period(levels, rung[i])
        half = 0.5 * whole / (1 << rung[i])
        for c in ti.static(range(3)):
            if tick % own == 0:
                v[c, i] += half * a[c, i]
            x[c, i] += drift * v[c, i]
        active[i] = ti.cast((tick + ticks) % own == 0, ti.i32)


class Block:
    """Leapfrog with a power-of-two step for each star; the finest rung is 1 / 2^levels of the whole."""

    def __init__(self, stars: Stars, eta: float, levels: int) -> None:
        self.stars, self.eta, self.levels = stars, eta, levels
        self._rung = ti.ndarray(ti.i32, stars.capacity)
        self._active = ti.ndarray(ti.i32, stars.capacity)
        self._deepest = ti.ndarray(ti.i32, 1)
        self.steps = 0

    def advance(self, time: float, scene_dt: float, dt: float) -> None:
        """Go on by dt [own time], which is scene_dt [s]; `steps` says in how many of the finest steps."""
        stars, tick, self.steps = self.stars, 0, 0
        whole = 1 << self.levels
        self._choose(0, dt)
        while tick < whole:
            ticks = 1 << (self.levels - int(self._deepest[0]))
            begin_and_drift(
                stars.count, tick, ticks, self.levels, dt, stars.x, stars.v, stars.a, self._rung, self._active
            )
            tick += ticks
            # In the end all are active, and diagnostics want the net force taken away.
            stars.accelerate(time + scene_dt * tick / whole, self._active if tick < whole else None)
            self._choose(tick, dt)
            self.steps += 1

    def rungs(self) -> NDArray[np.int32]:
        """The rung of each star at the end of the last step, (n,)."""
        return np.asarray(self._rung.to_numpy()[: self.stars.count])

    def _choose(self, tick: int, dt: float) -> None:
        stars = self.stars
        choose_rungs(
            stars.count, tick, self.levels, dt, self.eta, stars.law.softening, stars.rows, stars.row_count,
            stars.x, stars.v, stars.a, stars.phi, self._rung, self._deepest,
        )  # fmt: skip


class Fixed:
    """Each step as long as it is asked for."""

    def __init__(self, stars: Stars, integrator: Integrator) -> None:
        self.stars, self.integrator = stars, integrator
        self.steps = 1

    def advance(self, time: float, scene_dt: float, dt: float) -> None:
        """Go on by dt [own time], which is scene_dt [s]."""
        self.integrator(self.stars, time, scene_dt, dt)
