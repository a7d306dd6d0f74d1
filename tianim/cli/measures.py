"""`tianim bench`, `validate` and `info`: how fast, how right, and on what."""

import json
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Annotated, Any

import typer

from tianim.cli.options import Json, Out, Threads, whole_numbers
from tianim.terminal import Lines, Now, rows, say

# What the tables show of each line, and the widest that columns are; `--json` gives all of it.
BENCH_COLUMNS = {
    "case": 12, "variant": 18, "engine": 8, "n": 9, "dim": 3, "ms_per_step": 11, "ns_per_item_step": 16,
    "ratio": 18, "error": 9, "split_ms": 36,
}  # fmt: skip
VALIDATE_COLUMNS = {
    "system": 8, "check": 72, "expected": 12, "measured": 10, "error": 10, "tolerance": 9, "passed": 6,
    "seconds": 8,
}  # fmt: skip


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

    _judge(cases.run(case, numbers, peers, threads), as_json, BENCH_COLUMNS)


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

    now = Now()
    results = checks.run(system, slow, out, lambda k, count, name: now.show(f"{k} of {count}: {name}"))
    _judge(results, as_json, VALIDATE_COLUMNS, now)


def info() -> None:
    """Show versions, machine and optional parts."""
    from tianim import info as facts

    sections: dict[str, dict[str, Any]] = {"versions": facts.versions(), "machine": facts.machine()}
    sections |= {"back ends": facts.back_ends(), "optional parts": facts.parts()}
    for title, pairs in sections.items():
        say(title)
        rows(((name, str(value)) for name, value in pairs.items()), indent="  ")


def _judge(
    results: Iterable[dict[str, Any]], as_json: bool, columns: Mapping[str, int], now: Now | None = None
) -> None:
    """Show results as they come; exit code 1 where one did not pass."""
    passed = True
    table = Lines(columns)
    for row in results:
        if now is not None:
            now.clear()
        if as_json:
            say(json.dumps(row))
        else:
            table.add(row)
        passed = passed and row.get("passed", True)
    if not passed:
        raise typer.Exit(1)
