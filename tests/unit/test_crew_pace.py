"""Pace: all workers where that is quicker, one where it is not."""

import pytest

from tianim.spatial import crew
from tianim.spatial.crew import PROBE, Pace


class Clock:
    """Time that passes as it is told."""

    def __init__(self) -> None:
        self.now = 0.0

    def perf_counter(self) -> float:
        return self.now


def tasks_of(monkeypatch: pytest.MonkeyPatch, together: float, alone: float, steps: int) -> list[int]:
    """Tasks of each of so many steps, which take so long with 4 tasks and with one."""
    clock, pace, found = Clock(), Pace(), []
    monkeypatch.setattr(crew, "time", clock)
    for _ in range(steps):
        tasks = pace.begin(4)
        found.append(tasks)
        clock.now += together if tasks == 4 else alone
        pace.end()
    return found


def test_all_work_where_that_is_quicker(monkeypatch: pytest.MonkeyPatch) -> None:
    tasks = tasks_of(monkeypatch, 1.0, 2.0, 5 * PROBE)
    assert tasks[:4] == [4, 4, 1, 4]  # the first is not timed
    assert tasks.count(1) == 1 + 4  # the first try, and every PROBE steps


def test_one_works_where_the_others_are_waited_for(monkeypatch: pytest.MonkeyPatch) -> None:
    tasks = tasks_of(monkeypatch, 30.0, 2.0, 5 * PROBE)
    assert tasks[:4] == [4, 4, 1, 1]
    assert tasks.count(4) == 2 + 4


def test_a_first_step_that_compiles_does_not_count(monkeypatch: pytest.MonkeyPatch) -> None:
    clock, pace = Clock(), Pace()
    monkeypatch.setattr(crew, "time", clock)
    tasks = []
    for step in range(10):
        tasks.append(pace.begin(4))
        clock.now += 1000.0 if step == 0 else (1.0 if tasks[-1] == 4 else 2.0)
        pace.end()
    assert tasks[3:] == [4] * 7


def test_a_machine_that_gets_quiet_is_noticed(monkeypatch: pytest.MonkeyPatch) -> None:
    clock, pace = Clock(), Pace()
    monkeypatch.setattr(crew, "time", clock)
    tasks = 0
    for step in range(20 * PROBE):
        tasks = pace.begin(4)
        clock.now += 2.0 if tasks == 1 else (30.0 if step < 2 * PROBE else 1.0)
        pace.end()
    assert tasks == 4
