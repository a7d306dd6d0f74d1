"""Any scene as a case: its substeps and the frames they lead to, nothing written."""

import time

from tianim import runtime
from tianim.bench.cases import Task
from tianim.bench.lines import Round
from tianim.bench.measuring import PassClock, array_bytes
from tianim.scene import build, load_scene

FRAMES = 5


class SceneSteps:
    """The first frames of a scene; `dim` is the greatest of its systems' dimensions."""

    def __init__(self, task: Task) -> None:
        runtime.start(threads=task.threads)
        scene = load_scene(task.case)
        self._simulation = build(scene)
        self._start = self._simulation.state()
        self.n = sum(params.particle_count() for params in scene.systems.values())
        self.dim = max(getattr(params, "dimension", 3) for params in scene.systems.values())
        self._clocks = [
            PassClock(system, {"step": name}) for name, system in self._simulation.systems.items()
        ]

    def round(self) -> dict[str, Round]:
        """A few frames after the first one; the times are those of a substep."""
        simulation = self._simulation
        simulation.restore(self._start)
        simulation.advance()
        for clock in self._clocks:
            clock.reset()
        steps, total, least = 0, 0.0, float("inf")
        for _ in range(FRAMES):
            started = time.perf_counter()
            simulation.advance()
            seconds = time.perf_counter() - started
            steps += simulation.substeps
            total += seconds
            least = min(least, seconds / simulation.substeps)
        split = {name: ms for clock in self._clocks for name, ms in clock.split_ms(steps).items()}
        return {"": Round(steps, 1e3 * total / steps, 1e3 * least, split)}

    def bytes_per_item(self) -> float:
        """Arrays of the systems and bodies."""
        return array_bytes(self._simulation) / max(self.n, 1)
