"""A sweep: one scene with every combination of some values, each run in a process of its own.

A process may start the compiler only once, and one that crashes must not take the others along;
so each combination is a `tianim run` of its own. The processes share the cores.
"""

import csv
import hashlib
import io
import itertools
import re
import subprocess
import sys
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path

from tianim import metrics
from tianim.errors import SceneError
from tianim.export.files import write_text
from tianim.run_folder import alone, must_be_writable
from tianim.scene import load_scene

# More runs than this in one sweep are a slip of the keyboard.
MOST_RUNS = 10_000
# Names of folders stay below this length, so that paths can be typed.
LONGEST_NAME = 80


@dataclass(frozen=True)
class Sweep:
    """What to run: `values` are texts `key=value,value`, `options` go to each `tianim run`."""

    scene: str
    values: tuple[str, ...]
    folder: Path
    threads: int
    options: tuple[str, ...] = ()

    def combinations(self) -> list[dict[str, str]]:
        """Every combination, as values by key. SceneError where `values` cannot be read."""
        axes = dict(_axis(text) for text in self.values)
        if len(axes) < len(self.values):
            raise SceneError(f"sweep: a key is given twice in {' '.join(self.values)}")
        chosen = list(itertools.islice(itertools.product(*axes.values()), MOST_RUNS + 1))
        if len(chosen) > MOST_RUNS:
            raise SceneError(f"sweep: more than {MOST_RUNS:,} combinations")
        return [dict(zip(axes, one, strict=True)) for one in chosen]

    @staticmethod
    def folder_of(values: Mapping[str, str]) -> str:
        """`count=1000_seed=2`: the last words of the keys; a digest where that is long or ambiguous."""
        short = [key.rpartition(".")[2] for key in values]
        keys = short if len(set(short)) == len(short) else list(values)
        plain = "_".join(f"{key}={value}" for key, value in zip(keys, values.values(), strict=True))
        name = re.sub(r"[^A-Za-z0-9=._+-]", "-", plain)
        if name == plain and len(name) <= LONGEST_NAME:
            return name
        return f"{name[:LONGEST_NAME]}_{hashlib.blake2b(plain.encode(), digest_size=4).hexdigest()}"


@dataclass(frozen=True)
class Result:
    """How one combination went: `message` is the error where it failed, `last` the last row of metrics."""

    values: Mapping[str, str]
    folder: Path
    status: int
    message: str = ""
    last: Mapping[str, float] = field(default_factory=dict)

    @property
    def failed(self) -> bool:
        """True where the run did not end well."""
        return self.status != 0

    @property
    def outcome(self) -> str:
        """`done`, or the error."""
        return f"failed: {self.message}" if self.failed else "done"

    def line(self) -> str:
        """The result in a line."""
        return f"{' '.join(f'{key}={value}' for key, value in self.values.items())}: {self.outcome}"

    def row(self) -> dict[str, str | float]:
        """The result as a row of the table: values, outcome, metrics."""
        return {**self.values, "outcome": self.outcome, **self.last}


def run_sweep(sweep: Sweep, jobs: int, report: Callable[[Result], None]) -> list[Result]:
    """Run every combination, `jobs` at a time; `report` hears of each as it ends. Writes sweep.csv.

    SceneError where the values, the scene or the folder will not do, or another sweep writes there.
    """
    combinations = sweep.combinations()
    must_be_writable(sweep.folder)
    load_scene(sweep.scene)
    results = []
    with alone(sweep.folder), ThreadPoolExecutor(jobs) as pool:
        for result in pool.map(lambda values: _run_one(sweep, values), combinations):
            report(result)
            results.append(result)
            write_text(sweep.folder / "sweep.csv", _csv(results))
    return results


def _run_one(sweep: Sweep, values: Mapping[str, str]) -> Result:
    folder = sweep.folder / Sweep.folder_of(values)
    overrides = [f"{key}={value}" for key, value in values.items()]
    command = [
        sys.executable,
        "-m",
        "tianim",
        "run",
        sweep.scene,
        *overrides,
        "--out",
        str(folder),
        "--quiet",
    ]
    command += [f"--threads={sweep.threads}", *sweep.options]
    child = subprocess.run(command, stdin=subprocess.DEVNULL, capture_output=True, text=True)
    rows = metrics.read(folder / "metrics.csv") if child.returncode == 0 else []
    said = [line for line in child.stderr.splitlines() if line.strip()]
    message = (
        said[-1].removeprefix("tianim: ") if said else f"the process ended with status {child.returncode}"
    )
    return Result(values, folder, child.returncode, message, rows[-1] if rows else {})


def _axis(text: str) -> tuple[str, list[str]]:
    key, equals, values = text.partition("=")
    found = _split(values)
    if not equals or not key.strip() or not all(found):
        raise SceneError(f"sweep {text!r}: must be key=value,value, for example boids.count=1000,2000")
    if len(set(found)) < len(found):
        raise SceneError(f"sweep {text!r}: a value is given twice")
    return key.strip(), found


def _split(values: str) -> list[str]:
    """Values between commas; a comma within brackets or braces belongs to its value."""
    found, depth = [""], 0
    for letter in values:
        depth += (letter in "[{") - (letter in "]}")
        if letter == "," and depth == 0:
            found.append("")
        else:
            found[-1] += letter
    return [value.strip() for value in found]


def _csv(results: list[Result]) -> str:
    table = [result.row() for result in results]
    columns = list(dict.fromkeys(name for row in table for name in row))
    text = io.StringIO()
    writer = csv.DictWriter(text, columns, lineterminator="\n")
    writer.writeheader()
    writer.writerows(table)
    return text.getvalue()
