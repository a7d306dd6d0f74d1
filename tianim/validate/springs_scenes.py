"""Springs for the cases: how they are built, run and measured, for all files of springs' cases.

Nothing pulls or blows unless a case asks for it: no gravity, no air.
"""

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tianim.validate.build import OPEN, advance, built

Floats = NDArray[np.float64]

GRAVITY = 9.81
DOWN, NONE = (0.0, -GRAVITY, 0.0), (0.0, 0.0, 0.0)
STILL = {"density": 0.0}
SCHEMES = ("implicit_euler", "bdf2")


def explicit(integrator: str, **more: Any) -> dict[str, Any]:
    """Fields that choose an explicit integrator."""
    return {"solver": "explicit", "explicit": {"integrator": integrator, **more}}


def projective(scheme: str | None = None, **more: Any) -> dict[str, Any]:
    """Fields that choose the implicit solver; None: its own choice of a scheme."""
    return {"solver": "projective", "projective": {"scheme": scheme, **more}}


STRANDS = {"solver": "strands"}
# At rest when nothing is faster than this [m/s].
SLOW = 1e-5


def implicit(solver: str) -> dict[str, Any]:
    """Fields that choose `strands`, or the implicit solver by its scheme."""
    return STRANDS if solver == "strands" else projective(solver)


def fields_of(solver: str) -> dict[str, Any]:
    """The fields that choose a solver by its integrator or its scheme."""
    return projective(solver) if solver in SCHEMES else explicit(solver, safety=2.0)


def calm(drag: float) -> dict[str, float]:
    """No air but drag [1/s]."""
    return {"density": 0.0, "drag": drag}


def springs(
    piece: Mapping[str, Any],
    bodies: Mapping[str, Mapping[str, Any]] | None = None,
    bounds: Any = OPEN,
    **fields: Any,
) -> Any:
    """A system of one piece, named `p`, at its start."""
    fields.setdefault("gravity", NONE)
    fields.setdefault("air", STILL)
    return built("springs", bounds, bodies=bodies, pieces={"p": dict(piece)}, **fields)


def network(points: Any, springs_of: Any = (), **more: Any) -> dict[str, Any]:
    """Masses at `points`, and springs (a, b, stiffness, rest length or None, damping)."""
    listed = [
        {"between": (a, b), "stiffness": k, "rest_length": rest, "damping": c}
        for a, b, k, rest, c in springs_of
    ]
    return {"kind": "network", "points": _rows(points), "springs": listed, **more}


def _rows(points: Any) -> list[tuple[float, ...]]:
    return [tuple(map(float, point)) for point in points]


def pinned(*points: Any) -> dict[str, Any]:
    """Pins that hold points of `p`, each by a name or by numbers."""
    return {f"pin_{chr(97 + k)}": {"piece": "p", "points": which} for k, which in enumerate(points)}


def run(
    system: Any,
    seconds: float,
    look: Callable[[float, Any], object] | None = None,
    start: float = 0.0,
    frames: int = 1,
) -> Any:
    """The system, so many seconds on, in equal steps within what it allows; `look` after each frame."""
    length = float(seconds) / frames
    steps = int(np.ceil(length / system.max_step() - 1e-9))
    for frame in range(frames):
        advance(system, steps, length / steps, start + frame * length)
        if look is not None:
            look(start + (frame + 1) * length, system)
    return system


def settled(system: Any, most: float = 20.0) -> Any:
    """The system, run until it rests, or for `most` seconds."""
    time = 0.0
    while time < most:
        run(system, 0.5, start=time)
        time += 0.5
        if np.abs(speeds(system)).max() < SLOW:
            break
    return system


def places(system: Any) -> Floats:
    """(n, 3) [m]."""
    return np.asarray(system.read("position"), np.float64)


def speeds(system: Any) -> Floats:
    """(n, 3) [m/s]."""
    return np.asarray(system.read("velocity"), np.float64)


def spin(system: Any) -> Floats:
    """Angular momentum about the origin [kg m2/s]."""
    moments = system.read("mass")[:, None] * np.cross(places(system), speeds(system))
    return np.asarray(moments.sum(axis=0))


def crossings(time: Floats, value: Floats) -> Floats:
    """Times at which samples change their sign, on the cubic through two samples before and two after."""
    found = []
    for k in np.flatnonzero(value[:-1] * value[1:] < 0.0):
        near = slice(max(k - 1, 0), k + 3)
        origin = time[k]
        curve = np.polynomial.Polynomial.fit(time[near] - origin, value[near], len(time[near]) - 1)
        roots = curve.roots()
        real = roots[np.abs(roots.imag) < 1e-9].real
        inside = real[(real >= -1e-12) & (real <= time[k + 1] - origin + 1e-12)]
        found.append(origin + float(inside[0]))
    return np.array(found)
