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

from tianim.bench.cases import fluid_span
from tianim.bench.lines import Round

LONGEST = 600.0  # s a run
COMPILER_FLAGS = ("-O3", "-march=native", "-ffast-math", "-fopenmp")
PYTHON_VARIABLE = "TIANIM_PEERS_PYTHON"
PYTHON_FOLDER = "~/tianim-peers"
# The script sets this number itself.
NUMBA_THREADS = 2
# Codes of the script, how they are made, and for how many stars they are asked.
GRAVITY_CODES = (("pytreegrav", "numba", 1 << 31), ("rebound", "C", 1 << 31), ("direct", "numba", 200_000))
LONGEST_FORCES = 1800.0  # s
LONGEST_FLUID = 1800.0  # s
FLUID_THREADS = 2
PBD, NEWTON = "pbd_cloth.py", "newton_cloth.py"
LONGEST_CLOTH = 900.0  # s
# A frame of more points takes many seconds there.
LARGEST_NEWTON = 5000
# Cells along a side of the peer's map of the walls, at so many particles.
WALL_CELLS, WALL_PARTICLES = 25, 30_000
# A step of the array programs takes seconds at a million, and is no rival there.
LARGEST_ARRAYS = 100_000
ARRAY_STEPS = 5


def note(text: str) -> None:
    """A line on standard error, beside the results."""
    sys.stderr.write(f"bench: {text}\n")


@dataclass(frozen=True)
class Found:
    """What a peer measured, for the `variant` of our case ("": for all); `threads` None: as many as we."""

    name: str
    round: Round
    compiler: str
    variant: str = ""
    threads: int | None = None


@dataclass(frozen=True)
class Peer:
    """A program started as `command(n, dim, steps)`.

    read        makes measurements of the lines that it prints; ValueError where there are none
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
    read: Callable[["Peer", list[str]], list[Found]] | None = None
    longest: float = LONGEST

    def measure(self, n: int, dim: int, steps: int, threads: int) -> list[Found]:
        """What it measured, under the names that it gives; OSError or ValueError where it fails."""
        steps = min(steps, self.most_steps)
        environment = {**os.environ, "OMP_NUM_THREADS": str(threads), **self.environment}
        command = self.command(n, dim, steps)
        done = subprocess.run(
            command, capture_output=True, text=True, timeout=self.longest, env=environment, check=False
        )
        lines = done.stdout.strip().splitlines()
        if done.returncode or not lines:
            said = done.stderr.strip().splitlines()[-1:] or [f"status {done.returncode}"]
            raise ValueError(said[0])
        return (self.read or _read)(self, lines)


def _read(peer: Peer, lines: list[str]) -> list[Found]:
    values: dict[str, Any] = json.loads(lines[-1])
    mean = float(values["ms_per_step"])
    split = {"sort": "ms_sort", "forces": "ms_force"}
    known = {ours: float(values[theirs]) for ours, theirs in split.items() if theirs in values}
    one = Round(int(values["steps"]), mean, float(values.get("ms_min", mean)), known)
    return [Found(str(values["code"]), one, peer.compiler, threads=peer.threads)]


def _read_forces(peer: Peer, lines: list[str]) -> list[Found]:
    """One line for each code, opening angle and set of stars."""
    found = []
    for values in map(json.loads, lines):
        if "skipped" in values:
            note(f"{values['code']}: {values['skipped']}: left out")
        if "err_median" not in values:
            continue
        angle = "" if values["theta"] is None else f" {values['theta']:g}"
        ms = 1e3 * float(values["seconds"])
        error = {"median": float(values["err_median"]), "p99": float(values["err_99"])}
        one = Round(1, ms, ms, error=error)
        name = f"{values['code']}{angle}"
        found.append(Found(name, one, peer.compiler, str(values["ic"]), int(values["threads"])))
    if not found:
        raise ValueError("it measured nothing")
    return found


def find_peers(case: str, folder: Path, work: Path) -> list[Peer]:
    """The peers of a case that can run here; programs are compiled into `work`."""
    if case not in ("boids", "boids_topological", "fluid", "gravity", "springs"):
        note(f"no peers for the case {case}")
        return []
    if not folder.is_dir():
        note(f"no folder {folder}: peers are left out")
        return []
    if case == "gravity":
        return _gravity_peers(folder / "gravity" / "run_gravity.py")
    if case == "fluid":
        return _fluid_peers(folder / "fluid" / "run_splish.py")
    if case == "springs":
        return _cloth_peers(folder / "cloth")
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


def _gravity_peers(script: Path) -> list[Peer]:
    """One process a code: a million stars take some minutes each."""
    python = _python()
    if not script.is_file() or python is None:
        note(
            f"{f'no {script}' if python else f'no Python with numba ({PYTHON_VARIABLE})'}: peers are left out"
        )
        return []

    def peer(code: str, compiler: str, largest: int) -> Peer:
        def command(n: int, dim: int, steps: int) -> list[str]:
            return [python, str(script), "--codes", code, "--n", str(n), "--ic", "plummer,galaxy"]

        return Peer(command, compiler, once=True, largest=largest, read=_read_forces, longest=LONGEST_FORCES)

    return [peer(*one) for one in GRAVITY_CODES]


def _read_second(peer: Peer, lines: list[str]) -> list[Found]:
    """One line for the whole span; densities are those of its end."""
    values = json.loads(lines[-1])
    steps = int(values["steps"])
    rest = 1000.0
    one = Round(
        steps, float(values["ms_per_step"]), float(values["ms_per_step"]),
        error={"end_p99": float(values["rho_p99"]) / rest - 1.0},
        simulated_s=float(values["sim_s"]),
        counts={"iterations": sum(v for k, v in values["counts"].items() if "iterations" in k)},
    )  # fmt: skip
    return [
        Found(
            f"{values['engine'].split()[0]} {values['method']}", one, peer.compiler, values["method"].lower()
        )
    ]


def _fluid_peers(script: Path) -> list[Peer]:
    """SPlisHSPlasH with both methods; its map of the walls gets finer with the particles."""
    python = _python("pysplishsplash")
    if not script.is_file() or python is None:
        note(
            f"{f'no {script}' if python else f'no Python with pysplishsplash ({PYTHON_VARIABLE})'}: left out"
        )
        return []

    def peer(method: str, *options: str) -> Peer:
        def command(n: int, dim: int, steps: int) -> list[str]:
            span, cells = fluid_span(n), round(WALL_CELLS * (n / WALL_PARTICLES) ** (1.0 / 3.0))
            return [
                python, str(script), str(n), method, "--stop", str(span), "--mapres", str(cells),
                "--wall", str(LONGEST_FLUID), "--threads", str(FLUID_THREADS), *options,
            ]  # fmt: skip

        return Peer(command, "C++", FLUID_THREADS, once=True, read=_read_second, longest=1.2 * LONGEST_FLUID)

    return [peer("DFSPH"), peer("PBF", "--dt", "0.0025", "--boundary", "0")]


def _read_frames(peer: Peer, lines: list[str]) -> list[Found]:
    """A step is a frame; what diverged says so."""
    values = json.loads([line for line in lines if line.startswith("{")][-1])
    error = {"peak_strain": float(values["peak_strain"])}
    if values["scene"] == "hang":
        error["sag_over_exact"] = float(values["sag"]) / float(values["sag_analytic"])
    if values["scene"] == "drape":
        error["penetration_m"] = float(values["penetration_max"])
    ms = float(values["ms_per_frame"])
    one = Round(int(values["frames"]), ms, ms, error=error, counts={"substeps": float(values["substeps"])})
    return [Found(str(values["code"]), one, peer.compiler, str(values["scene"]))]


def _cloth_peers(folder: Path) -> list[Peer]:
    """PyPBD with 30 substeps, and Newton's vertex block descent where it is installed."""

    def peer(python: str, script: str, scene: str, frames: int, largest: int) -> Peer:
        def command(n: int, dim: int, steps: int) -> list[str]:
            across = str(round(n**0.5))
            given = {
                PBD: [scene, across, "30", "1", "4", str(frames)],
                NEWTON: ["vbd", scene, across, "10", "5", str(frames)],
            }
            return [python, str(folder / script), *given[script]]

        return Peer(command, "C++", once=True, largest=largest, read=_read_frames, longest=LONGEST_CLOTH)

    found = []
    for script, needs, largest, frames in (
        (PBD, "pypbd", 1 << 31, {"hang": 120, "swing": 45}),
        (NEWTON, "newton", LARGEST_NEWTON, {"hang": 30}),
    ):
        python = _python(needs)
        if not (folder / script).is_file() or python is None:
            missing = f"no Python with {needs} ({PYTHON_VARIABLE})" if python is None else f"no {script}"
            note(f"{missing}: left out")
            continue
        found += [peer(python, script, scene, count, largest) for scene, count in frames.items()]
    return found


def _python(needs: str = "numba") -> str | None:
    """A Python that has SciPy and what is needed: the one named in the environment, the peers', this one."""
    named = os.environ.get(PYTHON_VARIABLE)
    for candidate in (
        [named] if named else [Path(PYTHON_FOLDER).expanduser() / "bin" / "python", sys.executable]
    ):
        try:
            tried = subprocess.run(
                [str(candidate), "-c", f"import scipy, importlib.util as u; assert u.find_spec({needs!r})"],
                capture_output=True,
                check=False,
            )
        except OSError:
            continue
        if tried.returncode == 0:
            return str(candidate)
    return None
