"""What tests of the command line share: the scene of drifting points, and reading back what a run wrote."""

import subprocess
from collections.abc import Callable
from pathlib import Path

from typer.testing import Result

Cli = Callable[..., Result]
Start = Callable[..., "subprocess.Popen[str]"]

SCENE = """\
tianim: 1
title: Dust
description: a few points drift
fps: 24
duration: 0.25
seed: 3
systems:
  dust: {kind: drift, count: 20, time_step: 0.02}
checkpoint: {every: 2}
"""
FRAMES = 7


def frame_bytes(folder: Path) -> dict[str, bytes]:
    """Every file of a run's frames, by name."""
    return {path.name: path.read_bytes() for path in (folder / "frames").iterdir()}
