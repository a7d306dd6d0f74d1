"""A line of results: what `tianim bench --json` prints, the same keys in every line."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from statistics import median
from typing import Any


@dataclass(frozen=True)
class Round:
    """Repetitions one after another from the same start.

    steps    how many
    mean_ms  wall time of one, on average: what the peers give too
    least_ms wall time of the quickest
    split_ms shares of the mean, by pass
    error    of the result, where one is measured: "median" and "p99"
    simulated_s  simulated time that all steps cover, where that is what counts: then what is compared
             with peers is the wall time of a simulated second
    counts   of what a step needed: "iterations"
    """

    steps: int
    mean_ms: float
    least_ms: float
    split_ms: Mapping[str, float] = field(default_factory=dict)
    error: Mapping[str, float] = field(default_factory=dict)
    simulated_s: float = 0.0
    counts: Mapping[str, float] = field(default_factory=dict)

    @property
    def cost(self) -> float:
        """What is compared: ms a simulated second where time is simulated, else ms a step."""
        return self.mean_ms * (self.steps / self.simulated_s if self.simulated_s else 1.0)


@dataclass(frozen=True)
class Line:
    """One measurement.

    case, variant     what was measured; most cases have one variant, ""
    engine, compiler  who was measured: "tianim", or a peer by the name it gives itself
    ms_per_step       median over the rounds of a round's mean; a step, a frame or a start
    ms_min            the quickest of all
    split_ms          medians of the passes
    ratio             ours over each peer's ms_per_step, or ms per simulated second; below 1 we are faster
    simulated_per_wall  simulated seconds a second of wall time, None where a step is what counts
    counts            of what a step needed on average: "iterations"
    overhead_percent  over the first variant of the case, where the case compares variants
    peak_memory_mb    of the whole process, interpreter and compiler included
    bytes_per_item    of the arrays allocated, stored lists and scratch included
    error             of the result, where one is measured: relative, "median" and "p99"
    steps             in a round
    """

    case: str
    variant: str
    engine: str
    compiler: str
    n: int
    dim: int
    threads: int
    ms_per_step: float
    ns_per_item_step: float
    ratio: Mapping[str, float]
    split_ms: Mapping[str, float]
    ms_min: float
    overhead_percent: float | None
    peak_memory_mb: float | None
    bytes_per_item: float | None
    error: Mapping[str, float]
    simulated_per_wall: float | None
    counts: Mapping[str, float]
    steps: int
    rounds: int

    def as_dict(self) -> dict[str, Any]:
        """Plain values for JSON, numbers rounded to what the clock can tell."""
        return {name: _rounded(value) for name, value in asdict(self).items()}


def _rounded(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {name: _rounded(item) for name, item in value.items()}
    return float(f"{value:.5g}") if isinstance(value, float) else value


def summary(rounds: Sequence[Round]) -> Round:
    """The median round, pass by pass, with the quickest repetition of all."""
    return Round(
        rounds[0].steps,
        median(one.mean_ms for one in rounds),
        min(one.least_ms for one in rounds),
        {name: median(one.split_ms[name] for one in rounds) for name in rounds[0].split_ms},
        rounds[0].error,
        rounds[0].simulated_s,
        rounds[0].counts,
    )
