"""What a scene will cost, from its systems' estimates: for `tianim check`, and before a run starts."""

import math
import os
from dataclasses import dataclass
from pathlib import Path

from tianim.errors import SceneError
from tianim.scene.models import Scene
from tianim.simulation import MOST_SUBSTEPS

# Of the interpreter, the compiler and its kernels, whatever the scene [bytes].
BASE_MEMORY = 300_000_000
# Pictures and a frame in hand hold copies of positions and velocities [bytes a particle].
FRAME_BYTES = 64
CONTROL_GROUPS = Path("/sys/fs/cgroup")


@dataclass(frozen=True)
class Summary:
    """particles, memory [bytes], frames, steps of the whole run, and its time [s] on two ordinary cores."""

    particles: int
    memory: int
    frames: int
    steps: int
    seconds: float


def summarise(scene: Scene) -> Summary:
    """Estimates for `scene`; nothing is allocated. Drawing and writing are not in the time."""
    systems = scene.systems.values()
    particles = sum(params.particle_count() for params in systems)
    memory = BASE_MEMORY + FRAME_BYTES * particles + sum(params.memory_bytes() for params in systems)
    largest = min(params.largest_step() for params in systems)
    # A start alone may have a frame time of any length.
    substeps = max(1, math.ceil(min(1.0 / scene.fps / largest, MOST_SUBSTEPS) - 1e-9))
    steps = substeps * (scene.frame_count - 1)
    return Summary(
        particles, memory, scene.frame_count, steps, steps * sum(p.seconds_per_step() for p in systems)
    )


def check_memory(scene: Scene, available: int | None = None) -> Summary:
    """The summary; SceneError where the scene needs more than `available` bytes (default: this machine's)."""
    summary = summarise(scene)
    if available is None:
        available = available_memory()
    if available is not None and summary.memory > available:
        raise SceneError(
            f"the scene needs about {summary.memory / 1e9:.1f} GB for {summary.particles:,} particles; "
            f"this machine has {available / 1e9:.1f} GB available"
        )
    return summary


def available_memory() -> int | None:
    """Bytes that this process may still take: of the machine, or of its container; None where unknown."""
    found = [size for size in (_machine(), _container()) if size is not None]
    return min(found, default=None)


def _machine() -> int | None:
    try:
        for line in Path("/proc/meminfo").read_text().splitlines():
            if line.startswith("MemAvailable:"):
                return int(line.split()[1]) * 1024
    except OSError:
        pass
    try:
        return os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    except (AttributeError, ValueError, OSError):
        return None


def _container() -> int | None:
    """What a control group leaves, version 2 or 1; its page cache counts as free."""
    for version, limit_name, used_name, cache in (
        ("", "memory.max", "memory.current", "inactive_file"),
        ("memory", "memory.limit_in_bytes", "memory.usage_in_bytes", "total_inactive_file"),
    ):
        folder = CONTROL_GROUPS / version
        try:
            limit = int((folder / limit_name).read_text())
            used = int((folder / used_name).read_text())
            rows = (folder / "memory.stat").read_text().split()
        except (OSError, ValueError):  # no such group, or "max"
            continue
        # Where there is no limit, version 1 has a number near 2^63.
        return max(limit - used + int(rows[rows.index(cache) + 1] if cache in rows else 0), 0)
    return None
