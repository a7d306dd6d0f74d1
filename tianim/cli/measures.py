"""`tianim bench`, `validate` and `info`: how fast, how right, and on what."""

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Annotated, Any

import typer

from tianim.cli.options import Json, Out, Threads, whole_numbers
from tianim.terminal import live_table, rows, say

# What the tables show of each line; `--json` gives all of it.
BENCH_COLUMNS = (
    "case",
    "variant",
    "engine",
    "n",
    "dim",
    "ms_per_step",
    "ns_per_item_step",
    "ratio",
    "error",
    "split_ms",
)
VALIDATE_COLUMNS = ("system", "check", "expected", "measured", "error", "tolerance", "passed", "seconds")


def bench(
    case: Annotated[
        str | None, typer.Argument(metavar="[CASE]", help="Case to run; all if left out.")
    ] = None,
    sizes: Annotated[str | None, typer.Option("--n", metavar="N,N...", help="Numbers of items.")] = None,
    peers: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Folder of other programs to run beside.")
    ] = None,
    threads: Threads = None,
    as_json: Json = False,
) -> None:
    """Measure the speed of the kernels."""
    numbers = None if sizes is None else whole_numbers(sizes)
    from tianim import bench as cases

    _judge("bench", cases.run(case, numbers, peers, threads), as_json, BENCH_COLUMNS)


def validate(
    system: Annotated[
        str | None, typer.Argument(metavar="[SYSTEM]", help="System to check; all if left out.")
    ] = None,
    slow: Annotated[bool, typer.Option("--slow", help="The long checks too.")] = False,
    out: Out = None,
    as_json: Json = False,
) -> None:
    """Check systems against published numbers.

    Exit code 1 when a check fails.
    """
    from tianim import validate as checks

    _judge("validation", checks.run(system, slow, out), as_json, VALIDATE_COLUMNS)


def info() -> None:
    """Show versions, machine and optional parts."""
    from tianim import info as facts

    sections: dict[str, dict[str, Any]] = {"versions": facts.versions(), "machine": facts.machine()}
    sections |= {"back ends": facts.back_ends(), "optional parts": facts.parts()}
    for title, pairs in sections.items():
        say(title)
        rows(((name, str(value)) for name, value in pairs.items()), indent="  ")


def _judge(title: str, results: Iterable[dict[str, Any]], as_json: bool, columns: Sequence[str]) -> None:
    """Show results as they come; exit code 1 where one did not pass."""
    passed = True
    if as_json:
        import json

        for row in results:
            say(json.dumps(row))
            passed = passed and row.get("passed", True)
    else:
        with live_table(title, columns) as add:
            for row in results:
                add(row)
                passed = passed and row.get("passed", True)
    if not passed:
        raise typer.Exit(1)
