"""How stars move: from the accelerations at the start of a step to those at its end.

Every integrator begins with accelerations that belong to the places, and leaves them so.

    leapfrog               v += a dt/2;  x += v dt;  new a;  v += a dt/2         order 2, symplectic
    forest_ruth            three leapfrogs of w1, w0, w1 dt                      order 4, symplectic
    rk4                    the classical Runge-Kutta method                      order 4
    symplectic_euler       v += a dt;  x += v' dt                                order 1, symplectic
    forward_euler          x += v dt;  v += a dt                                 order 1, gains energy
    constant_acceleration  x += v dt + a dt^2 / 2;  v += a dt                    order 1, gains energy
    trapezoid              v' = v + a dt;  x += (v + v') dt / 2                  the same in other words

The last three are the lectures' steps, right for a constant force and wrong for an orbit.
w1 = 1 / (2 - 2^(1/3)), w0 = 1 - 2 w1: Forest and Ruth 1990, Physica D 43, 105, in the velocity form;
Yoshida 1990, Phys. Lett. A 150, 262. At a fixed step, leapfrog and forest_ruth are time-symmetric.
"""

from collections.abc import Callable

from tianim.lang import f64_2d, ti
from tianim.systems.gravity.stars import Stars

Integrator = Callable[[Stars, float, float, float], None]

W1 = 1.0 / (2.0 - 2.0 ** (1.0 / 3.0))
W0 = 1.0 - 2.0 * W1
# (share of the step for x and for v, weight in the sum) of each stage of RK4.
RK4 = ((0.5, 1.0 / 6.0), (0.5, 1.0 / 3.0), (1.0, 1.0 / 3.0), (0.0, 1.0 / 6.0))


@ti.kernel
def kick_drift(n: ti.i32, kick: ti.f64, drift: ti.f64, x: f64_2d, v: f64_2d, a: f64_2d):
    """Kick, v += kick a, then drift, x += drift v."""
    for i in range(n):
        for c in ti.static(range(3)):
            new = v[c, i] + kick * a[c, i]
            v[c, i] = new
            x[c, i] += drift * new


@ti.kernel
def kick(n: ti.i32, dt: ti.f64, v: f64_2d, a: f64_2d):
    """Kick, v += dt a."""
    for i in range(n):
        for c in ti.static(range(3)):
            v[c, i] += dt * a[c, i]


@ti.kernel
def launch(n: ti.i32, dt: ti.f64, share: ti.f64, x: f64_2d, v: f64_2d, a: f64_2d):
    """Step to v' = v + a dt; x moves with (1 - share) v + share v'."""
    for i in range(n):
        for c in ti.static(range(3)):
            old = v[c, i]
            new = old + dt * a[c, i]
            x[c, i] += dt * ((1 - share) * old + share * new)
            v[c, i] = new


@ti.kernel
def rk4_stage(
    n: ti.i32,
    first: ti.i32,
    last: ti.i32,
    reach: ti.f64,
    weight: ti.f64,
    x: f64_2d,
    v: f64_2d,
    a: f64_2d,
    start: f64_2d,
    total: f64_2d,
):
    """Add the slopes (v, a) of this stage to `total`; go `reach` along them, or to the end of the step.

    start, total: places in rows 0 to 2, velocities in rows 3 to 5; `weight` and `reach` have dt in them.
    """
    for i in range(n):
        for c in ti.static(range(3)):
            if first == 1:
                start[c, i] = x[c, i]
                start[c + 3, i] = v[c, i]
                total[c, i] = x[c, i]
                total[c + 3, i] = v[c, i]
            slope = v[c, i]
            total[c, i] += weight * slope
            total[c + 3, i] += weight * a[c, i]
            x[c, i] = ti.select(last == 1, total[c, i], start[c, i] + reach * slope)
            v[c, i] = ti.select(last == 1, total[c + 3, i], start[c + 3, i] + reach * a[c, i])


def composition(shares: tuple[float, ...]) -> Integrator:
    """Leapfrogs of these shares of the step, one after the other; their kicks in between are joined."""
    halves = [0.5 * share for share in shares]
    kicks = [before + after for before, after in zip([0.0, *halves], [*halves, 0.0], strict=True)]

    def step(stars: Stars, time: float, scene_dt: float, dt: float) -> None:
        for k, share in enumerate(shares):
            kick_drift(stars.count, kicks[k] * dt, share * dt, stars.x, stars.v, stars.a)
            stars.accelerate(time + sum(shares[: k + 1]) * scene_dt)
        kick(stars.count, kicks[-1] * dt, stars.v, stars.a)

    return step


def one_sided(share: float) -> Integrator:
    """A step that uses the accelerations at its start alone; `share` of the new velocity moves the places."""

    def step(stars: Stars, time: float, scene_dt: float, dt: float) -> None:
        launch(stars.count, dt, share, stars.x, stars.v, stars.a)
        stars.accelerate(time + scene_dt)

    return step


def runge_kutta(stars: Stars, time: float, scene_dt: float, dt: float) -> None:
    """The classical fourth-order method."""
    start, total = stars.stage_arrays()
    for k, (reach, weight) in enumerate(RK4):
        rk4_stage(
            stars.count, int(k == 0), int(k == 3), reach * dt, weight * dt,
            stars.x, stars.v, stars.a, start, total,
        )  # fmt: skip
        stars.accelerate(time + (reach if k < 3 else 1.0) * scene_dt)


INTEGRATORS: dict[str, Integrator] = {
    "leapfrog": composition((1.0,)),
    "forest_ruth": composition((W1, W0, W1)),
    "rk4": runge_kutta,
    "symplectic_euler": one_sided(1.0),
    "forward_euler": one_sided(0.0),
    "constant_acceleration": one_sided(0.5),
    "trapezoid": one_sided(0.5),
}
