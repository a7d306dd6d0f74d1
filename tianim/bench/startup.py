"""How long one waits: `tianim run` of a small scene, from the command to its first frames."""

import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from tianim.bench.cases import Task
from tianim.bench.flocks import flock_scene
from tianim.bench.lines import Round
from tianim.errors import TianimError

# A start takes seconds: what is left out by looking this often [s] is nothing.
LOOK_EVERY = 0.002
LONGEST = 120.0  # s
VARIANTS = {"first frame": 0, "first step": 1}


class Startup:
    """Starts the command anew each round; the first, untimed start compiles the kernels into the cache."""

    def __init__(self, task: Task) -> None:
        self.n, self.dim, self._threads = task.n, task.dim, task.threads
        self._start()

    def round(self) -> dict[str, Round]:
        """One start."""
        seconds = self._start()
        return {
            name: Round(1, 1e3 * seconds[index], 1e3 * seconds[index]) for name, index in VARIANTS.items()
        }

    def bytes_per_item(self) -> None:
        """A start is not about memory."""

    def _start(self) -> dict[int, float]:
        """Seconds from the command until frame 0 and frame 1 stand in the folder."""
        with tempfile.TemporaryDirectory(prefix="tianim-bench-") as folder:
            scene = Path(folder, "small.json")
            scene.write_text(json.dumps(flock_scene(self.n, self.dim, {"kind": "metric"})))
            out = Path(folder, "out")
            command = [sys.executable, "-m", "tianim", "run", str(scene), "--out", str(out), "--frames", "2"]
            command += ["--no-preview", "--quiet"]
            command += ["--threads", str(self._threads)] if self._threads else []
            began = time.perf_counter()
            path = os.pathsep.join(entry or os.getcwd() for entry in sys.path)
            with subprocess.Popen(
                command,
                stdout=subprocess.DEVNULL,
                stderr=subprocess.PIPE,
                env={**os.environ, "PYTHONPATH": path},
            ) as process:
                try:
                    return _watch(process, out / "frames", began)
                finally:
                    process.kill()


def _watch(process: "subprocess.Popen[bytes]", frames: Path, began: float) -> dict[int, float]:
    seen: dict[int, float] = {}
    while len(seen) < len(VARIANTS):
        ended = process.poll() is not None
        now = time.perf_counter() - began
        for index in VARIANTS.values():
            if index not in seen and (frames / f"flock_{index:04d}.vtu").exists():
                seen[index] = now
        if (ended or now > LONGEST) and len(seen) < len(VARIANTS):
            said = process.stderr.read().decode().strip() if ended and process.stderr else "too slow"
            raise TianimError(f"startup: `tianim run` wrote no frame: {said}")
        time.sleep(LOOK_EVERY)
    return seen
