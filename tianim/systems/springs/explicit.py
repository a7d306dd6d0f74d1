"""Many short steps: each takes the forces of now.

    v' = v + h a(x, v),   x' = x + h [(1 - w) v + w v']        w 1, 0 or 1/2
    velocity Verlet       x += h v + h^2 a / 2,  v += h (a + a') / 2,   a' = a(x', v + h a)

w = 1 is symplectic Euler, which on a spring keeps E - h omega^2 x v / 2 exactly; w = 0 forward Euler, whose
energy grows by 1 + (h omega)^2 a step; w = 1/2 is what lectures call the trapezoid rule, and constant
acceleration: exact for a thrown ball, and growing by 1 + (h omega)^2 / 2 on a spring. `rk4` is Runge and
Kutta's of fourth order.

A step is at most `safety` x (2 / omega) long, shorter with damping: omega^2 (h^2 + 2 tau h) = 4, tau the
damping time. Beyond, the highest mode grows whatever the rule.

Limits: a step's number of launches is fixed, so small pieces pay for launching: 0.1 ms a step.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tianim.lang import f64_2d, ti
from tianim.systems.springs.arrays import copy
from tianim.systems.springs.assembly import Assembly, accelerate
from tianim.systems.springs.contact import Walls, bounce
from tianim.systems.springs.hinges import HingeForces
from tianim.systems.springs.points import Points
from tianim.systems.springs.solids import SolidForces

# Approaches slower than gravity makes in so many steps are rests.
RESTING = 4.0
WEIGHTS = {
    "symplectic_euler": 1.0,
    "forward_euler": 0.0,
    "trapezoid": 0.5,
    "constant_acceleration": 0.5,
}


@ti.kernel
def advance(n: ti.i32, h: ti.f64, w: ti.f64, a: f64_2d, x: f64_2d, v: f64_2d):
    """Add h a to v, and h times the mean of v before (1 - w) and after (w) to x."""
    for i in range(n):
        for c in ti.static(range(3)):
            dv = h * a[i, c]
            x[i, c] += h * (v[i, c] + w * dv)
            v[i, c] += dv


@ti.kernel
def kick(n: ti.i32, h: ti.f64, a: f64_2d, v: f64_2d):
    """Add h a to v."""
    for i in range(n):
        for c in ti.static(range(3)):
            v[i, c] += h * a[i, c]


@ti.kernel
def drift(n: ti.i32, h: ti.f64, v: f64_2d, x: f64_2d):
    """Add h v to x."""
    for i in range(n):
        for c in ti.static(range(3)):
            x[i, c] += h * v[i, c]


@ti.kernel
def add_stage(
    n: ti.i32, part: ti.f64, ahead: ti.f64, first: ti.i32, v0: f64_2d, x0: f64_2d, a: f64_2d, x: f64_2d,
    v: f64_2d, sum_v: f64_2d, sum_a: f64_2d,
):  # fmt: skip
    """Count the slopes v, a of a stage with weight `part`, and go to the next: x0 + ahead v, v0 + ahead a."""
    for i in range(n):
        for c in ti.static(range(3)):
            u = v[i, c]
            sum_v[i, c] = ti.select(first == 1, 0.0, sum_v[i, c]) + part * u
            sum_a[i, c] = ti.select(first == 1, 0.0, sum_a[i, c]) + part * a[i, c]
            x[i, c] = x0[i, c] + ahead * u
            v[i, c] = v0[i, c] + ahead * a[i, c]


class ExplicitSolver:
    """The solver `explicit`.

    longest  longest stable step [s]
    """

    name = "explicit"

    def __init__(self, whole: Assembly, points: Points, walls: Walls, integrator: str, safety: float) -> None:
        self._points, self._walls, self._integrator = points, walls, integrator
        self._start: Any = ti.ndarray(ti.f64, (points.capacity if walls.any else 1, 3))
        self._a: Any = ti.ndarray(ti.f64, (points.capacity, 3))
        self._a.fill(0.0)
        rooms = {"rk4": 4, "velocity_verlet": 1}.get(integrator, 0)
        self._rooms: list[Any] = [ti.ndarray(ti.f64, (points.capacity, 3)) for _ in range(rooms)]
        self._hinges = HingeForces(whole.hinges)
        self._solids = SolidForces(whole.elements, whole.count)
        self.longest = safety * longest_step(whole)

    def hold(self, held: Any) -> None:
        """Nothing to prepare."""

    def forget(self) -> None:
        """Nothing is remembered."""

    def state(self) -> dict[str, NDArray[Any]]:
        """Nothing is remembered."""
        return {}

    def restore(self, state: Mapping[str, NDArray[Any]]) -> None:
        """Nothing is remembered."""

    def step(self, time: float, dt: float) -> None:
        """Go on by dt [s]."""
        points, n = self._points, self._points.count
        if self._walls.any:
            copy(n, points.x, self._start)
        self._move(dt)
        if self._walls.any:
            self._bounce(dt)

    def _bounce(self, dt: float) -> None:
        p, walls = self._points, self._walls
        bounce(
            p.count, dt, walls.thickness, walls.restitution, RESTING * p.weight * dt, walls.bodies.table,
            walls.bodies.samples, walls.count, walls.bounds, walls.friction, p.inverse_mass, self._start,
            p.x, p.v,
        )  # fmt: skip

    def _move(self, dt: float) -> None:
        """One step of the integrator."""
        points, n = self._points, self._points.count
        if self._integrator == "rk4":
            self._runge_kutta(dt)
        elif self._integrator == "velocity_verlet":
            self._accelerate()
            advance(n, dt, WEIGHTS["constant_acceleration"], self._a, points.x, points.v)
            self._accelerate(self._rooms[0])
            kick(n, -0.5 * dt, self._a, points.v)
            kick(n, 0.5 * dt, self._rooms[0], points.v)
        else:
            self._accelerate()
            advance(n, dt, WEIGHTS[self._integrator], self._a, points.x, points.v)

    def _accelerate(self, into: Any = None) -> None:
        p, a = self._points, self._a if into is None else into
        accelerate(p.count, p.start, p.neighbour, p.row, p.external, p.inverse_mass, p.x, p.v, a)
        self._hinges.add(p.inverse_mass, p.x, p.v, a)
        self._solids.add(p.count, p.inverse_mass, p.x, p.v, a)

    def _runge_kutta(self, dt: float) -> None:
        p, n = self._points, self._points.count
        x0, v0, sum_v, sum_a = self._rooms
        copy(n, p.x, x0)
        copy(n, p.v, v0)
        for k, (part, ahead) in enumerate(((1 / 6, 0.5), (1 / 3, 0.5), (1 / 3, 1.0), (1 / 6, 1.0))):
            self._accelerate()
            add_stage(n, part, ahead * dt, int(k == 0), v0, x0, self._a, p.x, p.v, sum_v, sum_a)
        copy(n, x0, p.x)
        copy(n, v0, p.v)
        drift(n, dt, sum_v, p.x)
        kick(n, dt, sum_a, p.v)


def longest_step(whole: Assembly) -> float:
    """Longest stable step [s]; infinity without springs."""
    omega2 = float(whole.stiffest().max())
    if omega2 == 0.0:
        return float("inf")
    springs, hinges = whole.springs, whole.hinges
    taus = [springs.damping / springs.stiffness, hinges.damping / hinges.stiffness]
    taus += [] if whole.elements is None else [whole.elements.damping]
    tau = float(np.concatenate(taus).max())
    return float(-tau + np.sqrt(tau**2 + 4.0 / omega2))
