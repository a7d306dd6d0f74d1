"""A small system for tests of the engine: points that drift with a hashed noise, in NumPy alone.

As a script it is the `tianim` command with `kind: drift` added, for tests that need a process.
"""

import time as wall
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from tianim.errors import BlowupError
from tianim.frame import Points
from tianim.params import Count, NonNegative, Positive
from tianim.system import SystemParams, World
from tianim.systems import SYSTEMS, SystemKind


class DriftParams(SystemParams):
    kind: Literal["drift"] = "drift"
    count: Count = Field(10, description="points")
    noise: NonNegative = Field(1.0, description="largest speed [m/s]")
    time_step: Positive = Field(0.1, description="largest step [s]")
    blow_up_at: NonNegative = Field(1e9, description="time at which a point leaves for infinity [s]")
    seconds: NonNegative = Field(0.0, description="wall time that a step takes [s]")

    def particle_count(self) -> int:
        return self.count

    def memory_bytes(self) -> int:
        return 28 * self.count

    def seconds_per_step(self) -> float:
        return self.seconds

    def largest_step(self) -> float:
        return self.time_step


def hashed(seed: int, ids: NDArray[np.int32], step: int) -> NDArray[np.float32]:
    """Noise from -1 to 1, (n, 3): a function of seed, id and step alone."""
    word = ids.astype(np.uint64)[:, None] * np.uint64(3) + np.arange(3, dtype=np.uint64)
    word += np.uint64((seed * 1_000_003 + step) % 2**32) << np.uint64(32)
    for shift in (30, 27, 31):
        word = (word ^ (word >> np.uint64(shift))) * np.uint64(0xBF58476D1CE4E5B9)
    return ((word >> np.uint64(40)).astype(np.float32) / np.float32(2**23) - 1).astype(np.float32)


class Drift:
    """position (n, 3) [m] and velocity (n, 3) [m/s]; steps are counted for the noise."""

    def __init__(self, name: str, params: DriftParams, world: World) -> None:
        self.name, self.params, self.seed = name, params, world.seed
        self.ids = np.arange(params.count, dtype=np.int32)
        self.position = hashed(self.seed, self.ids, 0)
        self.velocity = np.zeros_like(self.position)
        self.steps = 0

    def max_step(self) -> float:
        return self.params.time_step

    def step(self, time: float, dt: float) -> None:
        wall.sleep(self.params.seconds)
        self.steps += 1
        self.velocity = np.float32(self.params.noise) * hashed(self.seed, self.ids, self.steps)
        self.position = self.position + np.float32(dt) * self.velocity
        if time >= self.params.blow_up_at and self.params.count:
            self.position[-1] = np.nan

    def snapshot(self) -> tuple[Points, ...]:
        data = {"id": self.ids.copy(), "velocity": self.velocity.copy()}
        return (Points(self.name, self.position.copy(), data, {"velocity": "m/s"}),)

    def diagnostics(self) -> dict[str, float]:
        return {"steps": float(self.steps), "spread": float(np.sum(np.abs(self.position), dtype=np.float64))}

    def check(self) -> None:
        bad = np.flatnonzero(~np.isfinite(self.position).all(axis=1))
        if len(bad):
            raise BlowupError(self.name, int(bad[0]), "position is not finite")

    def state(self) -> dict[str, NDArray[Any]]:
        return {"position": self.position, "velocity": self.velocity, "steps": np.asarray(self.steps)}

    def restore(self, state: Mapping[str, NDArray[Any]]) -> None:
        self.position, self.velocity = state["position"].copy(), state["velocity"].copy()
        self.steps = int(state["steps"])

    def arrays(self) -> tuple[str, ...]:
        return ("position", "velocity")

    def read(self, name: str) -> NDArray[Any]:
        return np.array(getattr(self, name))

    def write(self, name: str, values: NDArray[Any]) -> None:
        setattr(self, name, np.array(values, np.float32))


KIND = SystemKind(DriftParams, Drift)


@contextmanager
def registered() -> Iterator[None]:
    """With `kind: drift` in the table of systems."""
    SYSTEMS["drift"] = KIND
    try:
        yield
    finally:
        del SYSTEMS["drift"]


if __name__ == "__main__":
    from tianim.cli import main

    with registered():
        main()
