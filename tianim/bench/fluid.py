"""The double dam break, over a whole simulated second: what a second of water costs, and how dense it gets.

The tank and the two columns are those of the peers' script, at its spacing; methods at the tolerances
that the peers have (mean density error 0.05 %, divergence 0.1 %) or better. What is compared is the wall
time of a simulated second over the same span: steps differ in length, and cost more in some phases than
in others.
"""

import time
from typing import Any

import numpy as np
from pydantic import TypeAdapter

from tianim import runtime
from tianim.bench.cases import Task, fluid_span
from tianim.bench.lines import Round
from tianim.bench.measuring import PassClock, array_bytes
from tianim.spatial.bodies import Bodies
from tianim.system import Bounds, World
from tianim.systems.fluid import Fluid, FluidParams

LOWER, UPPER = (-1.5, 0.0, -1.5), (1.5, 3.0, 1.5)  # of the tank [m]
COLUMN = (1.0, 1.5, 1.0)  # [m]
VOLUME = 3.0  # of both columns [m3]
SAMPLES = 30  # of the density error in a second
SETTLED = 0.1  # errors count from here on [s]: before, the columns take up their own weight
METHODS = ("dfsph", "pbf")
# Methods of the pressure solvers that are timed by themselves.
PASSES = ("find", "accelerate", "solve", "move")


def spacing_for(n: int) -> float:
    """Spacing [m] at which the script of the peers makes about n particles."""
    return float((VOLUME / n) ** (1.0 / 3.0))


def double_dam(n: int, method: str) -> FluidParams:
    """Two columns in opposite corners, of as many particles as the peers' script makes."""
    d = spacing_for(n)
    size = np.array([(round(length / d) - 1) * d for length in COLUMN])
    low, high = np.array(LOWER), np.array(UPPER)
    high[1] = low[1] + size[1]
    blocks = {
        "near": {"kind": "box", "lower": tuple(low), "upper": tuple(low + size)},
        "far": {"kind": "box", "lower": tuple(high - size), "upper": tuple(high)},
    }
    params: FluidParams = TypeAdapter(FluidParams).validate_python(
        {"kind": "fluid", "method": method, "spacing": d, "blocks": blocks}
    )
    return params


class _Dam:
    """One method on the two columns."""

    def __init__(self, n: int, method: str) -> None:
        bounds = Bounds("contained", LOWER, UPPER)
        self._bodies = Bodies({})
        self.fluid = Fluid("water", double_dam(n, method), World(bounds, self._bodies, 1))
        self._start = self.fluid.state()
        self._clock = PassClock(
            self.fluid.method, {name: name for name in PASSES if hasattr(self.fluid.method, name)}
        )
        self.fluid.step(0.0, 1e-4)  # compiles

    def round(self, span: float) -> Round:
        """From the start to `span` [s]."""
        fluid = self.fluid
        fluid.restore(self._start)
        self._clock.reset()
        now, steps, seconds, least = 0.0, 0, 0.0, float("inf")
        worst, means, iterations = 0.0, [], 0.0
        due = 0.0
        while now < span * (1.0 - 1e-9):
            started = time.perf_counter()
            dt = min(fluid.max_step(), span - now)
            fluid.step(now, dt)
            took = time.perf_counter() - started
            now, steps, seconds, least = now + dt, steps + 1, seconds + took, min(least, took)
            iterations += fluid.method.diagnostics()["iterations"]
            if now >= due:
                due += 1.0 / SAMPLES
                found = fluid.diagnostics()
                means.append(found["density_error_mean"])
                if now >= SETTLED:
                    worst = max(worst, found["density_error_p99"])
        return Round(
            steps, 1e3 * seconds / steps, 1e3 * least, self._clock.split_ms(steps),
            {"mean": float(np.mean(means)), "worst_p99": worst}, span, {"iterations": iterations / steps},
        )  # fmt: skip


class DoubleDam:
    """Both methods, one after the other, each from the start."""

    def __init__(self, task: Task) -> None:
        runtime.start(threads=task.threads)
        self.dim = task.dim
        self._span = fluid_span(task.n)
        self._dams = {method: _Dam(task.n, method) for method in METHODS}
        self.n = self._dams[METHODS[0]].fluid.count

    def round(self) -> dict[str, Round]:
        """The same span with each method."""
        return {method: dam.round(self._span) for method, dam in self._dams.items()}

    def bytes_per_item(self) -> float:
        """Of the first method."""
        fluid: Any = self._dams[METHODS[0]].fluid
        return array_bytes(fluid) / self.n
