"""What measurements share: timed repetitions, timed passes, the bytes that arrays take."""

import time
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from tianim.bench.lines import Round
from tianim.lang import ti

# A round does about so many items' steps, within limits: small sizes are repeated more often.
ITEM_STEPS = 1_000_000
FEWEST_STEPS, MOST_STEPS = 5, 100
WARM_UP = 2  # as the peers
WIDTHS = {"f64": 8, "i64": 8, "u8": 1}  # bytes of an entry; of all other types 4


def steps_for(n: int) -> int:
    """Steps of a round: enough that a round of a small flock is no flicker."""
    return min(max(ITEM_STEPS // max(n, 1), FEWEST_STEPS), MOST_STEPS)


class PassClock:
    """Times some methods of one object from now on, in whatever calls them.

    `passes` names them: {"flock": "forces"} adds the time of `owner.flock` to "forces".
    """

    def __init__(self, owner: object, passes: Mapping[str, str]) -> None:
        self.seconds = dict.fromkeys(passes.values(), 0.0)
        for method, name in passes.items():
            setattr(owner, method, self._timed(getattr(owner, method), name))

    def reset(self) -> None:
        """Start from nothing."""
        self.seconds = dict.fromkeys(self.seconds, 0.0)

    def split_ms(self, steps: int) -> dict[str, float]:
        """Milliseconds of each pass in one of `steps`."""
        return {name: 1e3 * seconds / steps for name, seconds in self.seconds.items()}

    def _timed(self, method: Callable[..., Any], name: str) -> Callable[..., Any]:
        def timed(*args: Any) -> Any:
            started = time.perf_counter()
            result = method(*args)
            self.seconds[name] += time.perf_counter() - started
            return result

        return timed


def timed_round(repeat: Callable[[int], object], steps: int, clock: PassClock | None = None) -> Round:
    """Call `repeat(0)` to `repeat(steps - 1)`; each call is timed, and the passes of `clock`."""
    if clock:
        clock.reset()
    seconds = []
    for step in range(steps):
        started = time.perf_counter()
        repeat(step)
        ti.sync()
        seconds.append(time.perf_counter() - started)
    split = clock.split_ms(steps) if clock else {}
    return Round(steps, 1e3 * sum(seconds) / steps, 1e3 * min(seconds), split)


def array_bytes(thing: object) -> int:
    """Bytes of the compiler's and NumPy's arrays that `thing` holds, its own objects' included."""
    return _array_bytes(thing, set())


def _array_bytes(thing: object, seen: set[int]) -> int:
    if id(thing) in seen:
        return 0
    seen.add(id(thing))
    if isinstance(thing, np.ndarray):
        return thing.nbytes
    if isinstance(thing, ti.Ndarray):
        return WIDTHS.get(str(thing.dtype), 4) * int(np.prod(thing.shape))
    if isinstance(thing, dict):
        return sum(_array_bytes(value, seen) for value in thing.values())
    if isinstance(thing, list | tuple):
        return sum(_array_bytes(value, seen) for value in thing)
    if type(thing).__module__.startswith("tianim.") and hasattr(thing, "__dict__"):
        return _array_bytes(vars(thing), seen)
    return 0
