"""The Simulation: owns the clock, steps the systems, yields frames.

A frame lasts 1/fps seconds and is made of substeps, as many equal ones as the systems' `max_step`
asks for at its start; where they ask for another number on the way, the rest of the frame is divided
anew. Frame k is at exactly k/fps seconds: no time is added up from frame to frame, so the same number
of frames gives the same frames, whether run at once or resumed.

    simulation = tianim.build(tianim.load_scene("configs/murmuration.yaml"))
    for frame in simulation.frames():
        print(frame.index, frame.diagnostics)
"""

import difflib
import math
import time as wall
from collections.abc import Callable, Iterator, Mapping
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from tianim.errors import BlowupError, SceneError, TianimError
from tianim.frame import Frame
from tianim.system import Bounds, Limited, System

if TYPE_CHECKING:
    from tianim.spatial.bodies import Bodies

State = dict[str, NDArray[np.generic]]
StepCallback = Callable[["Simulation", float], None]

# A frame of so many substeps would take minutes even with ten particles: a system's step has collapsed.
MOST_SUBSTEPS = 1_000_000
# Substeps are counted after rounding this share off, so that a step of a quarter frame gives 4, not 5.
STEP_ROUNDING = 1e-9


class Simulation:
    """Systems and bodies on one clock.

    systems      by name; `simulation["boids"]` is one of them
    bodies       the shapes that the systems see; they move as functions of time
    fps          frames a second
    frame_count  frames of the whole run, the start included
    bounds       the domain that the systems share
    """

    def __init__(
        self,
        systems: Mapping[str, System],
        bodies: "Bodies",
        fps: float,
        frame_count: int,
        bounds: Bounds,
    ) -> None:
        self.systems = dict(systems)
        self.bodies = bodies
        self.fps = fps
        self.frame_count = frame_count
        self.bounds = bounds
        self.index = 0
        self.substeps = 0
        self.step_seconds = 0.0
        self._time = 0.0
        self._start_given = False
        self._callbacks: list[StepCallback] = []

    @property
    def time(self) -> float:
        """Time of now [s]; within a frame, of the substep."""
        return self._time

    def __getitem__(self, name: str) -> System:
        """The system called `name`; SceneError names the nearest."""
        if name in self.systems:
            return self.systems[name]
        nearest = difflib.get_close_matches(name, self.systems, n=1)
        hint = (
            f"did you mean {nearest[0]!r}?" if nearest else f"there are {', '.join(self.systems) or 'none'}"
        )
        raise SceneError(f"no system {name!r}: {hint}")

    def on_step(self, callback: StepCallback) -> None:
        """Call `callback(simulation, dt)` after each substep, e.g. to add a force or to record."""
        self._callbacks.append(callback)

    def frames(self) -> Iterator[Frame]:
        """Frames up to `frame_count`, from here on: the start first, where it was not given yet."""
        if not self._start_given and self.index < self.frame_count:
            self._start_given = True
            for system in self.systems.values():
                self._check(system)
            yield self.frame()
        while self.index + 1 < self.frame_count:
            yield self.advance()

    def check_substeps(self) -> None:
        """Raise where the frame to come would need more substeps than there may be."""
        self._substeps_needed(1.0)

    def advance(self) -> Frame:
        """Go on by one frame and give it. Raises BlowupError with system, frame and particle."""
        self._start_given = True
        started = wall.perf_counter()
        self.substeps = 0
        for time, dt in self._plan():
            self._step(time, dt)
            self.substeps += 1
        self.index += 1
        self._time = self.index / self.fps
        for system in self.systems.values():
            self._check(system)
        self.step_seconds = wall.perf_counter() - started
        return self.frame()

    def frame(self) -> Frame:
        """The frame of now."""
        self.bodies.move(self._time, 1.0 / self.fps)
        parts = [part for system in self.systems.values() for part in system.snapshot()]
        parts += self.bodies.snapshot()
        diagnostics = {
            f"{name}.{key}": float(value)
            for name, system in self.systems.items()
            for key, value in system.diagnostics().items()
        }
        diagnostics["substeps"] = float(self.substeps)
        return Frame(self.index, self._time, tuple(parts), diagnostics)

    def state(self) -> State:
        """All that is needed to go on from this frame, by `<system>.<array>`; copies."""
        state: State = {
            "index": np.asarray(self.index),
            "substeps": np.asarray(self.substeps),
            "systems": np.array(list(self.systems), dtype=np.str_),
        }
        for name, system in self.systems.items():
            state |= {f"{name}.{key}": np.array(value) for key, value in system.state().items()}
        return state

    def restore(self, state: Mapping[str, NDArray[np.generic]]) -> None:
        """Go on from what `state` gave; the next frame is the one after it."""
        saved = [str(name) for name in state.get("systems", np.array([], dtype=np.str_))]
        if saved != list(self.systems):
            raise SceneError(f"the saved state is of the systems {saved}, the scene has {list(self.systems)}")
        self.index = int(state["index"])
        self.substeps = int(state["substeps"])
        self._time = self.index / self.fps
        self._start_given = True
        self.bodies.move(self._time, 1.0 / self.fps)
        for name, system in self.systems.items():
            system.restore(_with_prefix(state, f"{name}."))

    def _step(self, time: float, dt: float) -> None:
        self._time = time
        self.bodies.move(time, dt)
        for system in self.systems.values():
            system.step(time, dt)
        self._time = time + dt
        for callback in self._callbacks:
            callback(self, dt)

    def _plan(self) -> Iterator[tuple[float, float]]:
        """Start [s] and dt [s] of each substep of the frame to come; asked anew after each."""
        begin, done, planned = 0.0, 0, self._substeps_needed(1.0)
        while done < planned:
            part = 1.0 - begin
            yield (self.index + begin + part * done / planned) / self.fps, part / self.fps / planned
            done += 1
            rest = part * (planned - done) / planned
            needed = self._substeps_needed(rest) if done < planned else 0
            if needed != planned - done:
                begin, done, planned = 1.0 - rest, 0, needed

    def _substeps_needed(self, rest: float) -> int:
        """Equal steps that the systems ask for in the `rest` of the frame, part of it."""
        frame_dt = 1.0 / self.fps
        name, largest = "", math.inf
        for candidate, system in self.systems.items():
            step = system.max_step()
            if not step >= largest:  # a NaN is taken too, and refused below
                name, largest = candidate, step
        if not largest > frame_dt / MOST_SUBSTEPS:
            raise TianimError(
                f"{name}: frame {self.index + 1} would need more than {MOST_SUBSTEPS:,} substeps "
                f"(largest stable step {largest:g} s)"
            )
        needed = max(1, math.ceil(rest * frame_dt / largest * (1.0 - STEP_ROUNDING)))
        binding = self.systems.get(name)
        if isinstance(binding, Limited):
            done = self.substeps if rest < 1.0 else 0
            binding.check_substeps(done + needed)
        return needed

    def _check(self, system: System) -> None:
        try:
            system.check()
        except BlowupError as error:
            raise BlowupError(error.system, error.particle, error.reason, frame=self.index) from None


def _with_prefix(state: Mapping[str, NDArray[np.generic]], prefix: str) -> State:
    return {key[len(prefix) :]: value for key, value in state.items() if key.startswith(prefix)}
