"""Cloth: a sheet that hangs, one that swings, one that falls onto a sphere, and how it holds its length.

The scenes are those of the peers' scripts: a sheet of 1 m and 0.2 kg/m2, stretch 1000 N/m, no damping, 60
frames a second. Time alone says little here, for what does not converge is fast: beside it stand the sag
over the exact one, the largest strain of any edge in any frame, and how deep points came into the sphere.
"""

import time
from typing import Any

import numpy as np
from pydantic import TypeAdapter

from tianim import runtime
from tianim.bench.cases import Task
from tianim.bench.lines import Round
from tianim.bench.measuring import array_bytes
from tianim.spatial.bodies import Bodies, Sphere
from tianim.system import Bounds, World
from tianim.systems.springs import SpringsParams, SpringSystem

FRAME = 1.0 / 60.0  # [s]
DENSITY, STRETCH, SHEAR, BEND = 0.2, 1000.0, 100.0, 1e-5
GRAVITY, LENGTH = 9.81, 1.0
SAG = DENSITY * GRAVITY * LENGTH / (2.0 * STRETCH)
RADIUS, ABOVE, THICKNESS, FRICTION = 0.3, 0.02, 0.001, 0.3
FRAMES = {"hang": 120, "swing": 45, "drape": 45}
# Frames at the end over which the sag is averaged, and at the start that are not timed.
LAST, WARM = 10, 2
# The explicit solver drapes up to so many points, as a reference for the strain: its time goes with n^1.5.
LARGEST_REFERENCE = 70_000


def cloth(scene: str, across: int, solver: str) -> SpringSystem:
    """The sheet of a scene, of `across` points a side."""
    directions = {"hang": ((0.0, -1.0, 0.0), (0.0, 0.0, 1.0))}
    u, v = directions.get(scene, ((1.0, 0.0, 0.0), (0.0, 0.0, 1.0)))
    drapes = scene == "drape"
    origin = (-0.5 * LENGTH, RADIUS + ABOVE, -0.5 * LENGTH) if drapes else (0.0, 0.0, 0.0)
    sheet = {
        "kind": "sheet", "segments": (across - 1, across - 1), "origin": origin, "u": u, "v": v,
        "density": DENSITY, "stretch": STRETCH, "shear": SHEAR, "bend": BEND, "damping": 0.0,
    }  # fmt: skip
    params: SpringsParams = TypeAdapter(SpringsParams).validate_python(
        {
            "kind": "springs", "pieces": {"sheet": sheet}, "solver": solver, "air": {"density": 0.0},
            "pins": {} if drapes else {"edge": {"piece": "sheet", "points": "left"}},
            "contact": {"thickness": THICKNESS, "friction": FRICTION},
        }
    )  # fmt: skip
    bodies = Bodies({"ball": Sphere(radius=RADIUS)} if drapes else {})
    return SpringSystem("cloth", params, World(Bounds(), bodies, 1))


class _Sheet:
    """One scene by one solver."""

    def __init__(self, scene: str, across: int, solver: str = "projective") -> None:
        self.scene, self.across = scene, across
        self.system = cloth(scene, across, solver)
        self._start = {name: np.array(array) for name, array in self.system.state().items()}
        self._steps = int(np.ceil(FRAME / self.system.max_step() * (1.0 - 1e-9)))
        self.system.step(0.0, FRAME / self._steps)  # compiles and factors

    def round(self) -> Round:
        """All frames from the start."""
        system, bodies = self.system, self.system.world.bodies
        system.restore(self._start)
        seconds, sags, strain, deepest = [], [], 0.0, 0.0
        dt = FRAME / self._steps
        for frame in range(FRAMES[self.scene]):
            started = time.perf_counter()
            for step in range(self._steps):
                now = frame * FRAME + step * dt
                bodies.move(now, dt)
                system.step(now, dt)
            seconds.append(time.perf_counter() - started)
            x = system.read("position").reshape(self.across, self.across, 3)
            strain = max(strain, self._strain(x))
            deepest = max(deepest, RADIUS - float(np.linalg.norm(x, axis=2).min()))
            sags.append(-float(x[-1, :, 1].mean()) / LENGTH - 1.0)
        error = {"peak_strain": strain}
        if self.scene == "hang":
            error["sag_over_exact"] = float(np.mean(sags[-LAST:])) / SAG
        if self.scene == "drape":
            error["penetration_m"] = max(deepest, 0.0)
        timed = seconds[WARM:]
        return Round(
            len(timed), 1e3 * float(np.median(timed)), 1e3 * min(timed), error=error,
            counts={"substeps": float(self._steps)},
        )  # fmt: skip

    def _strain(self, x: Any) -> float:
        """Largest strain of an edge along u or v."""
        h = LENGTH / (self.across - 1)
        return max(float(np.linalg.norm(np.diff(x, axis=axis), axis=2).max()) / h - 1.0 for axis in (0, 1))


class Cloth:
    """All three scenes, and the drape by short explicit steps."""

    def __init__(self, task: Task) -> None:
        runtime.start(threads=task.threads)
        self.dim = task.dim
        across = round(task.n**0.5)
        self.n = across**2
        self._sheets = {scene: _Sheet(scene, across) for scene in FRAMES}
        if self.n <= LARGEST_REFERENCE:
            self._sheets["drape, explicit"] = _Sheet("drape", across, "explicit")

    def round(self) -> dict[str, Round]:
        """Each scene from its start; a step is a frame."""
        return {name: sheet.round() for name, sheet in self._sheets.items()}

    def bytes_per_item(self) -> float:
        """Of the first scene."""
        return array_bytes(self._sheets["hang"].system) / self.n
