"""What frames cost beside the steps: writing them with the exporters of a run, drawing them."""

import tempfile
from pathlib import Path

from tianim.bench.cases import Task
from tianim.bench.flocks import Flock, flock
from tianim.bench.lines import Round
from tianim.bench.measuring import WARM_UP, array_bytes, timed_round
from tianim.export import FrameWriter, OutputOptions, open_exporters
from tianim.frame import Frame
from tianim.simulation import Simulation
from tianim.view.look import Look
from tianim.view.painter import Painter

# Of each way; four frames of the slower rhythm.
STEPS = 32
STEPS_A_FRAME = 8
FIELDS = ("velocity", "id")  # as in configs/boids_million.yaml
# Frames written before the clock starts: the writer's process, which takes half a second to start, is then
# at work, and its buffers are as full as they stay.
FRAMES_BEFORE = 6


class Export(Flock):
    """The flock's steps alone, with the frames made but not written, and with them written.

    The wait for the last frames is outside the time: a run goes on meanwhile.
    """

    def __init__(self, task: Task) -> None:
        super().__init__(task)
        self._simulations = {
            steps: flock(task, self.neighbourhood, steps, {"fields": list(FIELDS)})
            for steps in (1, STEPS_A_FRAME)
        }
        self._starts = {steps: simulation.state() for steps, simulation in self._simulations.items()}

    def round(self) -> dict[str, Round]:
        """The five ways one after another, each from the start."""
        self.system.restore(self._start)
        for step in range(WARM_UP):
            self._step(step - WARM_UP)
        alone = timed_round(self._step, STEPS, self._clock)
        return {
            "steps": alone,
            "a frame a step, not written": self._with_frames(1, written=False),
            "a frame a step": self._with_frames(1, written=True),
            f"a frame every {STEPS_A_FRAME} steps, not written": self._with_frames(
                STEPS_A_FRAME, written=False
            ),
            f"a frame every {STEPS_A_FRAME} steps": self._with_frames(STEPS_A_FRAME, written=True),
        }

    def _with_frames(self, steps_a_frame: int, written: bool) -> Round:
        simulation = self._simulations[steps_a_frame]
        simulation.restore(self._starts[steps_a_frame])
        options = OutputOptions(fields=FIELDS)
        with (
            tempfile.TemporaryDirectory(prefix="tianim-bench-") as folder,
            open_exporters(Path(folder), (), options, simulation.fps) as writer,
        ):
            return _paced(simulation, writer if written else None, steps_a_frame)


def _paced(simulation: Simulation, writer: FrameWriter | None, steps_a_frame: int) -> Round:
    def make(_: int) -> None:
        frame = simulation.advance()
        if writer is not None:
            writer.write(frame)

    for k in range(FRAMES_BEFORE):
        make(k)
    frames = timed_round(make, STEPS // steps_a_frame)
    return Round(STEPS, frames.mean_ms / steps_a_frame, frames.least_ms / steps_a_frame)


class Render:
    """Pictures of the flock's first frames; n counts its boids."""

    def __init__(self, task: Task) -> None:
        self.n, self.dim = task.n, task.dim
        simulation = flock(task, Flock.neighbourhood)
        self._frames: list[Frame] = [simulation.frame(), simulation.advance()]
        self._bytes = array_bytes(simulation) / task.n
        looks = {
            kind: Look.model_validate({"parts": {"flock": {"kind": kind}}}) for kind in ("darts", "spheres")
        }
        self._painters = {kind: Painter(self._frames, look) for kind, look in looks.items()}
        for painter in self._painters.values():
            painter.picture(0)

    def round(self) -> dict[str, Round]:
        """Each kind of picture, twice."""
        return {
            kind: timed_round(lambda index, painter=painter: painter.picture(index % 2), 2)  # type: ignore[misc]
            for kind, painter in self._painters.items()
        }

    def bytes_per_item(self) -> None:
        """A picture's arrays are of its pixels."""
