"""Self-contact: sheets that are twisted, folded and stacked, and a count of what passes through what.

The count is that of `intersections.py`, by brute force.
"""

from functools import lru_cache, partial
from typing import Any

import numpy as np

from tianim.systems.springs.intersections import Ints, intersections
from tianim.validate.build import OPEN, built
from tianim.validate.case import Case
from tianim.validate.springs_scenes import DOWN, STILL, places, run

FRAME = 1.0 / 30.0
SOURCE = "edges that pass through triangles, counted by brute force on every frame"


def triangles_of(system: Any) -> Ints:
    """Triangles of all pieces."""
    whole = system.whole
    return np.concatenate([piece.triangles + whole.first[name] for name, piece in whole.pieces.items()])


def sheet(size: tuple[float, float], cells: tuple[int, int], **more: Any) -> dict[str, Any]:
    """A cotton sheet."""
    fabric = {"density": 0.2, "stretch": 500.0, "shear": 50.0, "bend": 1e-4, "damping": 3e-3}
    return {"kind": "sheet", "size": size, "segments": cells, **fabric, **more}


def twisted(cells: int, turns: float, seconds: float, thickness: float) -> Any:
    """A sheet held at two ends that turn against each other, and come nearer as it shortens."""
    ends = {}
    for name, side in (("left", -1.0), ("right", 1.0)):
        ends[name] = {
            "kind": "sphere", "radius": 1e-3,
            "position": {"keys": [[0.0, [0.6 * side, 0.0, 0.0]], [seconds, [0.42 * side, 0.0, 0.0]]]},
            "rotation": {"keys": [[0.0, [0.0] * 3], [seconds, [180.0 * turns * side, 0.0, 0.0]]]},
        }  # fmt: skip
    piece = sheet((1.2, 0.4), (3 * cells, cells), origin=(-0.6, 0.0, -0.2))
    pins = {name: {"piece": "p", "points": name, "body": name} for name in ends}
    return built(
        "springs", OPEN, bodies=ends, pieces={"p": piece}, pins=pins, air=STILL, gravity=(0.0, 0.0, 0.0),
        contact={"self_collision": True, "thickness": 1e-4, "self_thickness": thickness},
        solver="projective",
    )  # fmt: skip


def draped(cells: int, thickness: float) -> Any:
    """A sheet that falls on a sphere and folds on itself on the floor below."""
    bodies: dict[str, dict[str, Any]] = {
        "ball": {"kind": "sphere", "radius": 0.15, "position": (0.0, 0.15, 0.0)},
        "floor": {"kind": "plane"},
    }
    piece = sheet((1.2, 1.2), (cells, cells), origin=(-0.55, 0.4, -0.6))
    return built(
        "springs", OPEN, bodies=bodies, pieces={"p": piece}, air=STILL, gravity=DOWN, solver="projective",
        contact={"self_collision": True, "thickness": thickness},
    )  # fmt: skip


def stacked(sheets: int, cells: int, thickness: float, solver: str = "projective") -> Any:
    """Sheets one above the other, each turned a little by its cells, that fall on a small box."""
    bodies: dict[str, dict[str, Any]] = {
        "box": {"kind": "box", "size": (0.2, 0.2, 0.2), "position": (0.0, 0.1, 0.0)},
        "floor": {"kind": "plane"},
    }
    pieces = {}
    for k in range(sheets):
        angle = 0.3 * k
        u, v = (np.cos(angle), 0.0, np.sin(angle)), (-np.sin(angle), 0.0, np.cos(angle))
        corner = -0.3 * np.array(u) - 0.3 * np.array(v) + [0.0, 0.25 + 0.03 * k, 0.0]
        pieces[f"sheet_{chr(97 + k)}"] = sheet(
            (0.6, 0.6), (cells, cells), origin=tuple(map(float, corner)), u=u, v=v
        )
    return built(
        "springs", OPEN, bodies=bodies, pieces=pieces, air=STILL, gravity=DOWN, solver=solver,
        contact={"self_collision": True, "thickness": thickness},
    )  # fmt: skip


@lru_cache(maxsize=8)
def counted(scene: str) -> tuple[int, int, float]:
    """Passes on all frames of a scene, the most points in the fail-safe at one, the strain at its end."""
    seconds, build = SCENES[scene]
    system = build()
    triangles, found, unsafe = triangles_of(system), 0, 0
    for frame in range(round(seconds / FRAME)):
        run(system, FRAME, start=frame * FRAME)
        found += intersections(places(system), triangles)
        unsafe = max(unsafe, int(system.diagnostics()["self_failsafe"]))
    return found, unsafe, float(system.diagnostics()["strain_max"])


def passes(scene: str) -> float:
    """Passes on all frames."""
    return float(counted(scene)[0])


TWIST = "a sheet twisted by four turns"
DRAPE = "a sheet that falls on a ball and folds on the floor"
STACK = "ten sheets that fall on a box"
QUICK = "three small sheets that fall on a box"
# Seconds and the system at its start.
SCENES = {
    QUICK: (0.5, partial(stacked, 3, 8, 0.005)),
    TWIST: (4.0, partial(twisted, 16, 4.0, 4.0, 0.005)),
    DRAPE: (1.5, partial(draped, 48, 0.005)),
    STACK: (1.0, partial(stacked, 10, 16, 0.005)),
}

CASES = tuple(
    Case(
        "springs", f"passes through itself: {scene}", partial(passes, scene), 0.0, SOURCE, slow=scene != QUICK
    )
    for scene in SCENES
)
