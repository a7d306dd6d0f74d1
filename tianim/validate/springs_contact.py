"""What bodies do to springs: friction that sticks and slides, bounces, thin walls and fast things, draping.

Slopes are planes turned about z; what lies on them starts at the distance that contact keeps. The laws are
those of a rigid block: sheets are stiff beside their weight.
"""

from functools import lru_cache, partial
from typing import Any

import numpy as np

from tianim.validate.build import advance
from tianim.validate.case import Case
from tianim.validate.springs_scenes import (
    DOWN,
    GRAVITY,
    NONE,
    Floats,
    explicit,
    network,
    places,
    projective,
    run,
    speeds,
    springs,
)

FRICTION_SOURCE = "exact: Coulomb's law; it slides at g (sin - mu cos)"
SOLVERS = {
    "explicit": explicit("symplectic_euler"),
    "projective": projective(),
}
MU = 0.5  # sticks up to 26.57 deg
THICK = 0.002  # distance that contact keeps [m]
# Float32 distances to bodies that are metres away.
DEPTH = 1e-6
FRAME = 1.0 / 60.0
# Bullets in a shot, each a little farther from the wall than the one before.
BULLETS = 64


def slope(angle: float) -> tuple[dict[str, Any], Floats, Floats]:
    """A plane that falls towards +x at `angle` [deg], the direction down it and its normal."""
    a = np.radians(angle)
    down, normal = np.array([np.cos(a), -np.sin(a), 0.0]), np.array([np.sin(a), np.cos(a), 0.0])
    return {"floor": {"kind": "plane", "normal": tuple(normal.tolist())}}, down, normal


def piece_on(what: str, angle: float, height: float = THICK, cells: int = 8) -> dict[str, Any]:
    """A mass or a small sheet, so far above a slope."""
    _, down, normal = slope(angle)
    at = tuple((height * normal).tolist())
    if what == "mass":
        return network([at])
    return {
        "kind": "sheet", "size": (0.2, 0.2), "segments": (cells, cells), "origin": at,
        "u": tuple(down.tolist()),
    }  # fmt: skip


@lru_cache(maxsize=32)
def slid(what: str, solver: str, angle: float, seconds: float = 1.0) -> float:
    """How far it slid down a slope of so many degrees [m]."""
    bodies, down, _ = slope(angle)
    system = springs(
        piece_on(what, angle), bodies, gravity=DOWN, contact={"friction": MU, "thickness": THICK},
        **SOLVERS[solver],
    )  # fmt: skip
    start = places(system)
    run(system, seconds)
    return float(((places(system) - start) @ down).mean())


def slide_ratio(what: str, solver: str, angle: float) -> float:
    """How far it slid in a second over that of the law."""
    a = np.radians(angle)
    return slid(what, solver, angle) / (0.5 * GRAVITY * (np.sin(a) - MU * np.cos(a)))


def creep(solver: str, angle: float = 20.0) -> float:
    """How far a cloth that friction holds creeps down in 10 s [mm]; its landing, half a second, is before."""
    bodies, down, _ = slope(angle)
    # Short steps are longer for large cells.
    cells = 2 if solver == "explicit" else 8
    system = springs(
        piece_on("sheet", angle, 1.5 * THICK, cells), bodies, gravity=DOWN,
        contact={"friction": MU, "thickness": THICK}, **SOLVERS[solver],
    )  # fmt: skip
    run(system, 0.5)
    start = places(system)
    run(system, 10.0, start=0.5)
    return float(1000.0 * np.abs((places(system) - start) @ down).max())


@lru_cache(maxsize=4)
def bounces(restitution: float) -> Floats:
    """Tops of the first two bounces of a mass that falls 1 m, over 1 m."""
    floor, _, _ = slope(0.0)
    system = springs(
        network([(0.0, 1.0 + THICK, 0.0)]), floor, gravity=DOWN, time_step={"largest": 1e-3},
        contact={"restitution": restitution, "thickness": THICK}, **explicit("velocity_verlet"),
    )  # fmt: skip
    heights: list[float] = []
    fall = np.sqrt(2.0 / GRAVITY)
    run(
        system, fall * (1.0 + 2.0 * restitution + 2.0 * restitution**2),
        lambda time, system: heights.append(float(places(system)[0, 1]) - THICK), frames=1500,
    )  # fmt: skip
    h = np.array(heights)
    tops = np.flatnonzero((h[1:-1] > h[:-2]) & (h[1:-1] >= h[2:])) + 1
    return np.asarray(h[tops][:2])


def bounce(restitution: float, number: int) -> float:
    """Height of a bounce over where it fell from."""
    return float(bounces(restitution)[number])


@lru_cache(maxsize=16)
def misses(speed: float, solver: str, aslant: float = 0.0) -> float:
    """Bullets of 64 that went through a wall 1 cm thick, with a step of a sixtieth of a second."""
    a = np.radians(aslant)
    heading = np.array([np.cos(a), np.sin(a), 0.0])
    points = [(-1.0 - 0.1 * k * speed / 100.0, 0.3 * k, 0.0) for k in range(BULLETS)]
    wall = {"wall": {"kind": "box", "size": (0.01, 400.0, 10.0)}}
    system = springs(
        network(points, velocity=tuple((speed * heading).tolist())), wall,
        time_step={"largest": FRAME}, contact={"friction": 0.0}, **SOLVERS[solver],
    )  # fmt: skip
    through = np.zeros(BULLETS, bool)
    for step in range(20):
        advance(system, 1, FRAME, step * FRAME)
        through |= places(system)[:, 0] > -0.005
    return float(through.sum())


def plate_misses(speed: float, solver: str) -> float:
    """Masses of 5 at rest that a keyframed plate of 1 cm went through, moved face on by 4 m."""
    path = {"keys": [[0.0, (-2.0, 0.0, 0.0)], [4.0 / speed, (2.0, 0.0, 0.0)]]}
    plate = {"plate": {"kind": "box", "size": (0.01, 1.0, 1.0), "position": path}}
    system = springs(
        network([(0.1 * k, 0.1 * k, 0.0) for k in range(-2, 3)]), plate, time_step={"largest": FRAME},
        contact={"friction": 0.0}, **SOLVERS[solver],
    )  # fmt: skip
    advance(system, int(np.floor(4.0 / speed / FRAME)), FRAME)
    end = -2.0 + speed * FRAME * np.floor(4.0 / speed / FRAME)
    return float((places(system)[:, 0] < end).sum())


@lru_cache(maxsize=4)
def drape(solver: str, across: int = 32, seconds: float = 1.0) -> tuple[float, float]:
    """A sheet that falls over a ball: least distance in any frame over what is kept, largest strain."""
    radius = 0.3
    sheet = {"kind": "sheet", "segments": (across, across), "origin": (-0.5, radius + 0.02, -0.5)}
    system = springs(
        sheet, {"ball": {"kind": "sphere", "radius": radius}}, gravity=DOWN, air={}, **SOLVERS[solver]
    )
    least, strain = np.inf, 0.0

    def look(time: float, system: Any) -> None:
        nonlocal least, strain
        x = places(system)
        least = min(least, float(np.linalg.norm(x, axis=1).min()) - radius)
        strain = max(strain, system.diagnostics()["strain_max"])

    run(system, seconds, look, frames=round(60 * seconds))
    return least / THICK, strain


def drape_part(solver: str, which: int) -> float:
    """Distance, or strain over that of the explicit solver."""
    if which == 0:
        return drape(solver)[0]
    return drape(solver)[1] / drape("explicit")[1]


def belt(solver: str) -> float:
    """Speed of a mass on a floor that moves at 1 m/s along x, after a second, over that."""
    path = {"keys": [[0.0, (0.0, -0.05, 0.0)], [2.0, (2.0, -0.05, 0.0)]]}
    floor = {"floor": {"kind": "box", "size": (10.0, 0.1, 10.0), "position": path}}
    system = springs(
        piece_on("mass", 0.0), floor, gravity=DOWN, contact={"friction": MU, "thickness": THICK},
        **SOLVERS[solver],
    )  # fmt: skip
    run(system, 1.0)
    return float(speeds(system)[0, 0])


def no_pull(solver: str) -> float:
    """Speed at which a mass leaves a wall that it was thrown from: contact must not hold it back [m/s]."""
    floor, _, normal = slope(0.0)
    system = springs(
        network([tuple((THICK * normal).tolist())], velocity=tuple(normal.tolist())), floor, gravity=NONE,
        contact={"thickness": THICK}, **SOLVERS[solver],
    )  # fmt: skip
    run(system, 0.5)
    return float(speeds(system)[0, 1])


CASES: tuple[Case, ...] = (
    *(
        Case(
            "springs", f"{what} on a slope of 26 deg, mu = {MU:g}, {solver}: slid in a second",
            partial(slid, what, solver, 26.0), 1e-4, FRICTION_SOURCE, comparison="below", unit="m",
            slow=(what, solver) == ("sheet", "explicit"),
        )
        for what in ("mass", "sheet") for solver in SOLVERS
    ),
    *(
        Case(
            # A step of a hundredth of the time, taken at its start or its end, is 1 %.
            "springs", f"{what} on a slope of {angle:g} deg, mu = {MU:g}, {solver}: slid over the law's",
            partial(slide_ratio, what, solver, angle), 1.0, FRICTION_SOURCE, tolerance=0.02,
            slow=(what, solver) == ("sheet", "explicit"),
        )
        for what in ("mass", "sheet") for solver in SOLVERS for angle in (30.0, 40.0)
    ),
    *(
        Case(
            "springs", f"cloth on a slope of 20 deg, mu = {MU:g}, {solver}: creep in 10 s",
            partial(creep, solver), 1.0, "it sticks", comparison="below", unit="mm", slow=True,
        )
        for solver in SOLVERS
    ),
    *(
        Case(
            "springs", f"mass that falls 1 m, restitution {e:g}: bounce {number + 1}",
            partial(bounce, e, number), e ** (2 * number + 2), "exact: e^2 of the height before",
            tolerance=0.01, unit="m",
        )
        for e in (1.0, 0.8, 0.5) for number in (0, 1)
    ),
    *(
        Case(
            "springs", f"64 bullets of {speed:g} m/s{words}, 1 cm wall, steps of 1/60 s, {solver}: misses",
            partial(misses, speed, solver, aslant), 0.0, "nothing goes through", comparison="below",
        )
        for speed in (100.0, 300.0) for words, aslant in (("", 0.0), (" at 60 deg", 60.0))
        for solver in SOLVERS
    ),
    *(
        Case(
            "springs", f"a plate of 1 cm at {speed:g} m/s meets 5 masses, {solver}: misses",
            partial(plate_misses, speed, solver), 0.0, "nothing goes through", comparison="below",
        )
        for speed in (10.0, 100.0) for solver in SOLVERS
    ),
    *(
        Case(
            "springs", f"sheet draped over a ball, {solver}: least distance over that kept",
            partial(drape_part, solver, 0), 1.0 - DEPTH / THICK, "nothing goes in", comparison="above",
            slow=solver == "explicit",
        )
        for solver in SOLVERS
    ),
    Case(
        "springs", "sheet draped over a ball, projective: largest strain over that of explicit",
        partial(drape_part, "projective", 1), 1.2, "the explicit solver, converged", comparison="below",
        slow=True,
    ),
    *(
        Case("springs", f"mass on a moving floor, {solver}: its speed after a second", partial(belt, solver),
             1.0, "exact: friction brings it along", tolerance=1e-3, unit="m/s")
        for solver in SOLVERS
    ),
    *(
        Case("springs", f"mass thrown from a wall, {solver}: speed", partial(no_pull, solver), 1.0,
             "exact: contact only pushes", tolerance=1e-6, unit="m/s")
        for solver in SOLVERS
    ),
)  # fmt: skip
