"""Gravity with few bodies: Kepler's orbit, the order of each integrator, the figure eight, steps.

The published numbers of the leapfrog are those of another program (REBOUND), which makes the same step:
they differ from ours by less than they are rounded. Star clusters and galaxies are in
`gravity_galaxies`, forces in `gravity_forces`.
"""

from functools import lru_cache, partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tianim.validate.build import built
from tianim.validate.case import Case

Floats = NDArray[np.float64]

PEERS = "measured with REBOUND, G = 1, two equal masses, e = 0.5, from the apocentre"
EIGHT_SOURCE = "Chenciner and Montgomery 2000, Annals of Mathematics 152, 881; REBOUND's leapfrog"

# Two bodies of mass 1/2 with semi-major axis 1: the period is 2 pi.
ECCENTRICITY = 0.5
PERIOD = 2.0 * np.pi
# The figure eight: G = m = 1.
EIGHT_PERIOD = 6.32591398
EIGHT_ENERGY = -1.28714199


def simulated(components: dict[str, Any], seed: int = 1, **fields: Any) -> Any:
    """A gravitating system at its start; no force samples, which cost more than so few bodies."""
    fields.setdefault("solver", {"check_every": 0})
    return built("gravity", seed=seed, components=components, **fields)


def bodies(*rows: tuple[float, Floats, Floats]) -> dict[str, Any]:
    """A component of bodies (mass, position, velocity)."""
    listed = [
        {"mass": m, "position": list(map(float, x)), "velocity": list(map(float, v))} for m, x, v in rows
    ]
    return {"all": {"kind": "bodies", "bodies": listed}}


def binary() -> dict[str, Any]:
    """Two bodies at their apocentre, on the x axis."""
    e = ECCENTRICITY
    x, v = np.array([1.0 + e, 0.0, 0.0]), np.array([0.0, 0.0, -np.sqrt((1.0 - e) / (1.0 + e))])
    return bodies((0.5, 0.5 * x, 0.5 * v), (0.5, -0.5 * x, -0.5 * v))


def kepler_place(time: float) -> Floats:
    """The first body of `binary` by Kepler's equation."""
    e, mean = ECCENTRICITY, time + np.pi
    anomaly = mean
    for _ in range(50):
        anomaly -= (anomaly - e * np.sin(anomaly) - mean) / (1.0 - e * np.cos(anomaly))
    return 0.5 * np.array([e - np.cos(anomaly), 0.0, np.sqrt(1.0 - e * e) * np.sin(anomaly)])


def run(system: Any, steps: int, dt: float) -> Any:
    """The system, so many steps on."""
    for step in range(steps):
        system.step(step * dt, dt)
    return system


class Orbits(NamedTuple):
    """Of 100 orbits: largest error of the energy, its mean's drift, turn of the apsides, angular momentum."""

    energy: float
    drift: float
    turn: float
    angular: float


@lru_cache(maxsize=2)
def orbits(steps: int, count: int) -> Orbits:
    """So many Kepler orbits with so many leapfrog steps each; the first and the last are looked at."""
    dt = PERIOD / steps
    system = simulated(binary(), time_step={"kind": "fixed", "length": dt})

    def look() -> tuple[Floats, Floats, Floats]:
        """Energy, angle of the apsides and angular momentum in the steps of an orbit."""
        found = np.empty((steps, 3))
        for step in range(steps):
            x, v = (system.read(name) for name in ("position", "velocity"))
            d, w = x[0] - x[1], v[0] - v[1]
            r, h = np.linalg.norm(d), np.cross(d, w)
            to_pericentre = np.cross(w, h) - d / r
            found[step] = (0.5 * w @ w - 1.0 / r, np.arctan2(-to_pericentre[2], to_pericentre[0]), h[1])
            system.step(step * dt, dt)
        return found[:, 0], np.unwrap(found[:, 1]), found[:, 2]

    energy, angle, angular = look()
    run(system, (count - 2) * steps, dt)
    last_energy, last_angle, last_angular = look()
    exact = energy[0]
    turned = last_angle.mean() - angle.mean()
    turned = (turned + np.pi) % (2.0 * np.pi) - np.pi
    return Orbits(
        float(max(np.abs(energy - exact).max(), np.abs(last_energy - exact).max()) / abs(exact)),
        float(abs(last_energy.mean() - energy.mean()) / abs(exact)),
        float(abs(turned) / (count - 1)),
        float(np.abs(np.append(angular, last_angular) / angular[0] - 1.0).max()),
    )


def _orbits(steps: int, count: int, which: str) -> float:
    return float(getattr(orbits(steps, count), which))


def period_error(count: int, steps: int) -> float:
    """How far a body is from its start after so many periods of forest_ruth, in its semi-major axis."""
    dt = PERIOD / steps
    system = simulated(binary(), integrator="forest_ruth", time_step={"kind": "fixed", "length": dt})
    start = system.read("position")
    return float(np.abs(run(system, count * steps, dt).read("position") - start).max() / 0.5)


def kepler_error(integrator: str, steps: int) -> float:
    """Error of a place after a quarter of a period in so many steps."""
    time = 0.25 * PERIOD
    dt = time / steps
    system = simulated(binary(), integrator=integrator, time_step={"kind": "fixed", "length": dt})
    return float(np.abs(run(system, steps, dt).read("position")[0] - kepler_place(time)).max())


def order(integrator: str, steps: int = 64) -> float:
    """Slope of the error over the step, from halving it."""
    return float(np.log2(kepler_error(integrator, steps) / kepler_error(integrator, 2 * steps)))


def euler_gain() -> float:
    """Relative rise of the energy in one orbit of 400 steps of forward Euler."""
    dt = PERIOD / 400
    system = simulated(binary(), integrator="forward_euler", time_step={"kind": "fixed", "length": dt})
    system.diagnostics()
    return float(run(system, 400, dt).diagnostics()["energy_drift"])


def parabola_error(integrator: str) -> float:
    """Error of a fall under a constant force after 50 steps; these steps are exact there."""
    system = simulated(
        bodies((1.0, np.zeros(3), np.array([1.0, 2.0, 0.0]))),
        integrator=integrator, time_step={"kind": "fixed", "length": 0.1}, recentre=False,
    )  # fmt: skip
    pull = np.array([0.0, -9.81, 0.5])
    system.add_force(lambda time, position, velocity: np.broadcast_to(pull, position.shape))
    x = run(system, 50, 0.1).read("position")[0]
    return float(np.abs(x - (5.0 * np.array([1.0, 2.0, 0.0]) + 12.5 * pull)).max())


def same_steps() -> float:
    """Largest difference of the lectures' constant-acceleration and trapezoid steps over an orbit."""
    dt = PERIOD / 100
    places = [
        run(
            simulated(binary(), integrator=one, time_step={"kind": "fixed", "length": dt}), 100, dt
        ).read("position")
        for one in ("constant_acceleration", "trapezoid")
    ]  # fmt: skip
    return float(np.abs(places[0] - places[1]).max())


def eight() -> dict[str, Any]:
    """Three equal masses that chase each other along an eight, in the plane z = 0."""
    x, v = np.array([0.97000436, -0.24308753, 0.0]), np.array([-0.93240737, -0.86473146, 0.0])
    return bodies((1.0, x, -0.5 * v), (1.0, -x, -0.5 * v), (1.0, np.zeros(3), v))


@lru_cache(maxsize=4)
def eight_run(steps: int, integrator: str = "leapfrog") -> tuple[float, float]:
    """After one period in so many steps: error of the return, largest relative error of the energy."""
    dt = EIGHT_PERIOD / steps
    system = simulated(eight(), integrator=integrator, time_step={"kind": "fixed", "length": dt})
    start = system.read("position")
    worst = 0.0
    for step in range(steps):
        system.step(step * dt, dt)
        worst = max(worst, abs(system.diagnostics()["total_energy"] / EIGHT_ENERGY - 1.0))
    return float(np.abs(system.read("position") - start).max()), worst


def _eight(steps: int, which: int, integrator: str = "leapfrog") -> float:
    return eight_run(steps, integrator)[which]


def cluster(count: int, **more: Any) -> dict[str, Any]:
    """A Plummer sphere of mass 1 and scale length 1."""
    return {"stars": {"kind": "plummer", "count": count, "mass": 1.0, **more}}


def symmetric_return() -> float:
    """Error of an eccentric orbit that goes one period on in adaptive steps and back with v reversed."""
    system = simulated(binary(), time_step={"kind": "adaptive", "eta": 0.05})
    start = system.read("position")
    frames = 24
    for _ in range(2):
        run(system, frames, PERIOD / frames)
        system.write("velocity", -system.read("velocity"))
    return float(np.abs(system.read("position") - start).max())


def block_orbit() -> float:
    """Error of a place after a period of an eccentric orbit in block steps, in the semi-major axis."""
    system = simulated(binary(), time_step={"kind": "block", "eta": 0.02})
    start = system.read("position")
    return float(np.abs(run(system, 24, PERIOD / 24).read("position") - start).max() / 0.5)


def block_error() -> float:
    """Largest difference of a cluster in block steps from one in the finest of them for all."""
    places = []
    for step in ({"kind": "block", "eta": 0.1, "levels": 5}, {"kind": "fixed", "length": 0.5 / 32}):
        system = simulated(cluster(300), softening={"length": 0.1}, time_step=step)
        for k in range(32 if step["kind"] == "fixed" else 1):
            dt = 0.5 / 32 if step["kind"] == "fixed" else 0.5
            system.step(k * dt, dt)
        places.append(system.read("position"))
    return float(np.abs(places[0] - places[1]).max())


ORDERS = {
    "leapfrog": 2, "forest_ruth": 4, "rk4": 4, "symplectic_euler": 1, "forward_euler": 1,
    "constant_acceleration": 1, "trapezoid": 1,
}  # fmt: skip

CASES: tuple[Case, ...] = (
    Case(
        "gravity", "Kepler, 100 orbits of 200 steps: largest energy error",
        partial(_orbits, 200, 100, "energy"), 2.6e-3, PEERS, tolerance=5e-5,
    ),
    Case(
        "gravity", "Kepler, 100 orbits of 200 steps: turn of the apsides an orbit",
        partial(_orbits, 200, 100, "turn"), 3.9e-3, PEERS, tolerance=5e-5, unit="rad",
    ),
    Case(
        "gravity", "Kepler, 100 orbits of 200 steps: drift of the mean energy",
        partial(_orbits, 200, 100, "drift"),
        # The mean over the steps of an orbit moves a little as the phase of the steps does.
        1e-7, "symplectic: no secular drift", comparison="below",
    ),
    Case(
        "gravity", "Kepler, 100 orbits of 200 steps: angular momentum", partial(_orbits, 200, 100, "angular"),
        1e-12, "exact: central forces", comparison="below",
    ),
    Case(
        "gravity", "Kepler, 100 orbits of 1,000 steps: largest energy error",
        partial(_orbits, 1000, 100, "energy"), 1.05e-4, PEERS, tolerance=1e-6, slow=True,
    ),
    Case(
        "gravity", "Kepler, 100 orbits of 1,000 steps: turn of the apsides an orbit",
        partial(_orbits, 1000, 100, "turn"), 1.6e-4, PEERS, tolerance=5e-6, unit="rad", slow=True,
    ),
    Case(
        "gravity", "Kepler, forest_ruth with 400 steps: off its place after 5 periods",
        partial(period_error, 5, 400), 1e-4,
        "exact: the period is 2 pi sqrt(a^3 / G M); the method's own error is 6e-5", comparison="below",
    ),
    *(
        # Halving 64 steps of a quarter orbit: the next power of the step still shows in the slope.
        Case("gravity", f"order of {name}", partial(order, name), expected, "theory: order of the method",
             tolerance=0.15)
        for name, expected in ORDERS.items()
    ),
    Case(
        "gravity", "forward Euler gains energy in an orbit of 400 steps", euler_gain, 0.2,
        "the lectures: forward Euler is not stable for orbits", comparison="above",
    ),
    *(
        Case("gravity", f"constant force: error of {name}", partial(parabola_error, name), 1e-11,
             "exact: x = v t + a t^2 / 2", comparison="below")
        for name in ("leapfrog", "constant_acceleration", "trapezoid", "rk4")
    ),
    Case(
        "gravity", "constant-acceleration and trapezoid steps differ by", same_steps, 1e-11,
        "exact: the same step where v' = v + a dt", comparison="below",
    ),
    Case(
        "gravity", "figure eight, 500 steps: error after a period", partial(_eight, 500, 0), 2.6e-4,
        EIGHT_SOURCE, tolerance=5e-6,
    ),
    Case(
        "gravity", "figure eight, 500 steps: largest energy error", partial(_eight, 500, 1), 9.5e-5,
        EIGHT_SOURCE, tolerance=1e-6,
    ),
    Case(
        "gravity", "figure eight, 1,000 steps: error after a period", partial(_eight, 1000, 0), 6.4e-5,
        EIGHT_SOURCE, tolerance=1e-6,
    ),
    Case(
        "gravity", "figure eight, 5,000 steps: error after a period", partial(_eight, 5000, 0), 2.6e-6,
        EIGHT_SOURCE, tolerance=5e-8, slow=True,
    ),
    Case(
        "gravity", "figure eight, forest_ruth, 1,000 steps: error after a period",
        partial(_eight, 1000, 0, "forest_ruth"), 2e-7,
        "theory: order 4, here 1e-7; the printed digits of the start give 3e-8", comparison="below",
    ),
    Case(
        "gravity", "adaptive steps: error of an orbit there and back", symmetric_return, 1e-9,
        "exact: time-symmetric steps retrace themselves", comparison="below",
    ),
    Case(
        "gravity", "block steps: off its place after a period of e = 0.5", block_orbit, 3e-4,
        "theory: second order, 1.4e-4 here", comparison="below",
    ),
    Case(
        "gravity", "block steps against the finest for all", block_error, 2e-3,
        "theory: second order in the steps", comparison="below",
    ),
)  # fmt: skip
