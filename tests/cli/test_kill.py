"""`kill -9` at any moment, then --resume: the same bytes as a run that was left alone.

The moments come from a seeded generator; every second kill waits for a file that is being written.
Frames of 60,000 points (1.7 MB) are written in this process, of 160,000 (4.5 MB) by the writer process.
"""

import os
import random
import time
from contextlib import suppress
from pathlib import Path

import pytest
from command import Cli, Start, frame_bytes

from tianim import metrics

FRAMES = 25
# A frame takes at least 30 ms, so that a kill after this time [s] comes with frames still to be made.
LONGEST_WAIT = 0.25


def kill_until_done(start: Start, arguments: tuple[object, ...], kills: int, seed: int) -> int:
    """Start, kill and resume the run `kills` times, then let it end; count the kills during a write."""
    dice = random.Random(seed)
    folder = Path("killed")
    during_write = 0
    for kill in range(kills):
        child = start("run", *arguments, "--out", folder, "--resume", "--no-preview", "--quiet")
        before = progress(folder)
        while progress(folder) == before and child.poll() is None:
            time.sleep(0.002)
        until = time.monotonic() + dice.uniform(0.0, LONGEST_WAIT)
        while time.monotonic() < until and child.poll() is None:
            time.sleep(0.002)
        while kill % 2 and child.poll() is None and not is_writing(folder):
            pass
        during_write += is_writing(folder)
        child.kill()
        _, said = child.communicate()
        assert child.returncode == -9, said
    child = start("run", *arguments, "--out", folder, "--resume", "--no-preview")
    _, said = child.communicate()
    assert child.returncode == 0, said
    return during_write


def is_writing(folder: Path) -> bool:
    """Whether a file is half written just now."""
    with suppress(FileNotFoundError):  # a run that starts anew clears the folder
        return any(name.endswith(".tmp") for name in os.listdir(folder / "frames"))
    return False


def progress(folder: Path) -> int:
    """Grows with every frame made."""
    path = folder / "metrics.csv"
    return path.stat().st_mtime_ns if path.exists() else 0


def without_clock(path: Path) -> list[dict[str, float]]:
    return [{**row, "step_seconds": 0.0} for row in metrics.read(path)]


@pytest.mark.parametrize(
    ("count", "kills"),
    [
        (60_000, 2),
        (160_000, 2),
        pytest.param(60_000, 20, marks=pytest.mark.slow),
        pytest.param(160_000, 20, marks=pytest.mark.slow),
    ],
)
def test_a_killed_run_resumes_to_the_same_bytes(
    scene: Path, cli: Cli, start: Start, count: int, kills: int
) -> None:
    # A slower scene for more kills: each must find frames still to be made.
    length = FRAMES * max(1, kills // 2)
    arguments: tuple[object, ...] = (scene, f"dust.count={count}", "dust.time_step=1", "dust.seconds=0.03")
    arguments += ("fps=25", f"duration={(length - 1) / 25}", "checkpoint.every=3")
    assert kill_until_done(start, arguments, kills, seed=count) > 0
    assert cli("run", *arguments, "dust.seconds=0", "--out", "straight", "--no-preview").exit_code == 0
    ours, theirs = frame_bytes(Path("killed")), frame_bytes(Path("straight"))
    assert len(theirs) == length + 2
    assert ours.keys() == theirs.keys()
    assert [name for name in theirs if ours[name] != theirs[name]] == []
    assert without_clock(Path("killed/metrics.csv")) == without_clock(Path("straight/metrics.csv"))
