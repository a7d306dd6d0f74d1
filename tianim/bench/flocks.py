"""The flock that the peers simulate too, stepped by the system `boids` itself.

A periodic box with 20 neighbours in the radius of 1 m on average, a random start; separation
-d/|d|^2 of weight 0.05, alignment 0.5, cohesion 0.2, speed 1 to 2 m/s, dt 0.05 s, no limit on the
acceleration. Every round starts from the same state, takes two steps to warm up and times the next ones
of the moving flock, as the peers do: flocks draw together, so later steps cost more.
"""

import math
from collections.abc import Mapping
from typing import Any, ClassVar

from tianim import runtime
from tianim.bench.cases import Task
from tianim.bench.lines import Round
from tianim.bench.measuring import WARM_UP, PassClock, array_bytes, steps_for, timed_round
from tianim.params import LARGE
from tianim.scene import build, scene_from
from tianim.simulation import Simulation

NEIGHBOURS = 20
RADIUS = 1.0
TIME_STEP = 0.05
PASSES = {"sort": "sort", "flock": "forces", "integrate": "integrate"}


def box_length(n: int, dim: int) -> float:
    """Side [m] of the box in which a ball (disc) of one radius holds NEIGHBOURS on average."""
    volume = math.pi if dim == 2 else 4 / 3 * math.pi
    return float((n * volume * RADIUS**dim / NEIGHBOURS) ** (1 / dim))


def flock_scene(n: int, dim: int, neighbourhood: Mapping[str, Any], steps_a_frame: int = 1) -> dict[str, Any]:
    """The scene as data."""
    length = box_length(n, dim)
    depth = length if dim == 3 else RADIUS
    size = [length, length, depth]
    return {
        "tianim": 1,
        "fps": 1 / TIME_STEP / steps_a_frame,
        "duration": 1000.0,
        "bounds": {"kind": "periodic", "lower": [0.0, 0.0, 0.0], "upper": size},
        "systems": {
            "flock": {
                "kind": "boids",
                "dimension": dim,
                "count": n,
                "time_step": TIME_STEP,
                "neighbourhood": dict(neighbourhood),
                "start": {"kind": "box", "centre": [side / 2 for side in size], "size": size},
                "speed": 1.0,
                "separation": {"radius": RADIUS, "weight": 0.05},
                "alignment": {"radius": RADIUS, "weight": 0.5},
                "cohesion": {"radius": RADIUS, "weight": 0.2},
                "limits": {"min_speed": 1.0, "max_speed": 2.0, "max_acceleration": LARGE},
            }
        },
    }


def flock(
    task: Task,
    neighbourhood: Mapping[str, Any],
    steps_a_frame: int = 1,
    output: Mapping[str, Any] | None = None,
) -> Simulation:
    """The flock of a task, ready to step; starts the compiler. `output` as in a scene."""
    runtime.start(threads=task.threads)
    scene = flock_scene(task.n, task.dim, neighbourhood, steps_a_frame)
    return build(scene_from({**scene, "output": dict(output or {})}))


class Flock:
    """Whole steps of the flock, split by pass."""

    neighbourhood: ClassVar[dict[str, Any]] = {"kind": "metric"}

    def __init__(self, task: Task) -> None:
        self.n, self.dim = task.n, task.dim
        self.system: Any = flock(task, self.neighbourhood)["flock"]
        self._start = self.system.state()
        self._clock = PassClock(self.system, PASSES)

    def round(self) -> dict[str, Round]:
        """The steps after the first two."""
        self.system.restore(self._start)
        return {"": self._steps()}

    def _steps(self) -> Round:
        for step in range(WARM_UP):
            self._step(step - WARM_UP)
        return timed_round(self._step, steps_for(self.n), self._clock)

    def _step(self, step: int) -> None:
        self.system.step((WARM_UP + step) * TIME_STEP, TIME_STEP)

    def bytes_per_item(self) -> float:
        """Columns, cells, scratch and what else the system allocated."""
        return array_bytes(self.system) / self.n


class TopologicalFlock(Flock):
    """The same with the seven nearest."""

    neighbourhood: ClassVar[dict[str, Any]] = {"kind": "topological", "k": 7}


class Grid(Flock):
    """The sort and the walk of the neighbour search, as the flock uses them."""

    def round(self) -> dict[str, Round]:
        """Sort the start, which is in no order; then the passes of the moving flock."""
        self.system.restore(self._start)
        unsorted = timed_round(lambda _: self.system.sort(), 1)
        whole = self._steps()
        return {
            "sort from any order": unsorted,
            "sort": _one_pass(whole, "sort"),
            "walk": _one_pass(whole, "forces"),
        }


def _one_pass(whole: Round, name: str) -> Round:
    return Round(whole.steps, whole.split_ms[name], whole.split_ms[name])
