"""Ctrl-C and SIGTERM as a wish to stop: the frame in hand is finished and a checkpoint written.

A second one stops at once (KeyboardInterrupt).
"""

import signal
import threading
from collections.abc import Callable
from types import FrameType, TracebackType
from typing import Any

from typing_extensions import Self

SIGNALS = (signal.SIGINT, signal.SIGTERM)


class Interrupts:
    """While entered, `pending` is the signal that asks to stop, or None; `notify` hears of the first."""

    def __init__(self, notify: Callable[[], None]) -> None:
        self.pending: signal.Signals | None = None
        self._notify = notify
        self._before: dict[signal.Signals, Any] = {}

    def __enter__(self) -> Self:
        if threading.current_thread() is threading.main_thread():
            self._before = {number: signal.signal(number, self._note) for number in SIGNALS}
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        for number, handler in self._before.items():
            signal.signal(number, handler)

    def _note(self, number: int, frame: FrameType | None) -> None:
        if self.pending is not None:
            raise KeyboardInterrupt
        self.pending = signal.Signals(number)
        self._notify()
