"""Other programs to run beside us: found in a folder, compiled, started, their lines read.

The folder has one subfolder a subject (`boids/boids_cpp.cc`, `boids/boids_python.py`); each
program prints one JSON line. What is not there is said in one line on standard error.
"""

import json
import os
import shutil
import subprocess
import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from tianim.bench.lines import Round

LONGEST = 600.0  # s a run
COMPILER_FLAGS = ("-O3", "-march=native", "-ffast-math", "-fopenmp")
PYTHON_VARIABLE = "TIANIM_PEERS_PYTHON"
PYTHON_FOLDER = "~/tianim-peers"
# The script sets this number itself.
NUMBA_THREADS = 2
# A step of the array programs takes seconds at a million, and is no rival there.
LARGEST_ARRAYS = 100_000
ARRAY_STEPS = 5


def note(text: str) -> None:
    """A line on standard error, beside the results."""
    sys.stderr.write(f"bench: {text}\n")


@dataclass(frozen=True)
class Peer:
    """A program started as `command(n, dim, steps)`.

    threads     that it uses, None: as many as we do
    once        run it once a size, not in every round: starting it takes long
    """

    command: Callable[[int, int, int], list[str]]
    compiler: str
    threads: int | None = None
    once: bool = False
    largest: int = 1 << 31
    most_steps: int = 1 << 31
    environment: Mapping[str, str] = field(default_factory=dict)

    def measure(self, n: int, dim: int, steps: int, threads: int) -> tuple[str, Round]:
        """The name that it gives itself, and its round; OSError or ValueError where it fails."""
        steps = min(steps, self.most_steps)
        environment = {**os.environ, "OMP_NUM_THREADS": str(threads), **self.environment}
        command = self.command(n, dim, steps)
        done = subprocess.run(
            command, capture_output=True, text=True, timeout=LONGEST, env=environment, check=False
        )
        lines = done.stdout.strip().splitlines()
        if done.returncode or not lines:
            said = done.stderr.strip().splitlines()[-1:] or [f"status {done.returncode}"]
            raise ValueError(said[0])
        return _read(json.loads(lines[-1]))


def _read(values: dict[str, Any]) -> tuple[str, Round]:
    mean = float(values["ms_per_step"])
    split = {"sort": "ms_sort", "forces": "ms_force"}
    known = {ours: float(values[theirs]) for ours, theirs in split.items() if theirs in values}
    return str(values["code"]), Round(int(values["steps"]), mean, float(values.get("ms_min", mean)), known)


def find_peers(case: str, folder: Path, work: Path) -> list[Peer]:
    """The peers of a case that can run here; programs are compiled into `work`."""
    if case not in ("boids", "boids_topological"):
        note(f"no peers for the case {case}")
        return []
    if not folder.is_dir():
        note(f"no folder {folder}: peers are left out")
        return []
    source, script = folder / "boids" / "boids_cpp.cc", folder / "boids" / "boids_python.py"
    if case == "boids_topological":
        return _array_peers(script, ("knn7",))
    return [*_cpp(source, work), *_array_peers(script, ("numba", "pairs"))]


def _cpp(source: Path, work: Path) -> list[Peer]:
    compiler = shutil.which("g++")
    if not source.is_file() or compiler is None:
        note(f"{'no g++' if source.is_file() else f'no {source}'}: the peer in C++ is left out")
        return []
    program = work / source.stem
    built = subprocess.run(
        [compiler, *COMPILER_FLAGS, str(source), "-o", str(program)],
        capture_output=True,
        text=True,
        check=False,
    )
    if built.returncode:
        note(f"{source} does not compile ({(built.stderr.strip().splitlines() or ['?'])[0]}): left out")
        return []
    return [Peer(lambda n, dim, steps: [str(program), str(dim), str(n), str(steps)], "g++")]


def _array_peers(script: Path, methods: tuple[str, ...]) -> list[Peer]:
    python = _python()
    if not script.is_file() or python is None:
        why = (
            f"no Python with numba and scipy ({PYTHON_VARIABLE}, {PYTHON_FOLDER})"
            if script.is_file()
            else f"no {script}"
        )
        note(f"{why}: the peers {', '.join(methods)} are left out")
        return []

    def peer(method: str) -> Peer:
        def command(n: int, dim: int, steps: int) -> list[str]:
            return [python, str(script), method, str(dim), str(n), str(steps)]

        if method == "numba":
            threads = {"NUMBA_NUM_THREADS": str(NUMBA_THREADS)}
            return Peer(command, "numba", NUMBA_THREADS, once=True, environment=threads)
        workers = None if method == "knn7" else 1
        return Peer(command, "scipy", workers, once=True, largest=LARGEST_ARRAYS, most_steps=ARRAY_STEPS)

    return [peer(method) for method in methods]


def _python() -> str | None:
    """A Python that has numba and scipy: the one named in the environment, the peers' own, this one."""
    named = os.environ.get(PYTHON_VARIABLE)
    for candidate in (
        [named] if named else [Path(PYTHON_FOLDER).expanduser() / "bin" / "python", sys.executable]
    ):
        try:
            tried = subprocess.run(
                [str(candidate), "-c", "import numba, scipy"], capture_output=True, check=False
            )
        except OSError:
            continue
        if tried.returncode == 0:
            return str(candidate)
    return None
