"""Runs cases one after another and yields their lines; peers take turns with us, round by round.

Machines are noisy: only figures of one run can be compared, and of those the ones measured side
by side. So each size is measured in rounds, and in each round we go first, then the peers.
"""

import subprocess
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from tianim.bench.cases import CASES, Case, Task, find_case
from tianim.bench.lines import Line, Round, summary
from tianim.bench.peers import Found, Peer, find_peers, note
from tianim.bench.worker import Worker, worker
from tianim.errors import TianimError
from tianim.scene import load_scene

ROUNDS = 3
# Small sizes go on for at least so long [s], but not for ever.
LEAST_SECONDS = 0.6
MOST_ROUNDS = 12

Measured = dict[str, list[Round]]
# By variant and name.
Theirs = dict[tuple[str, str], tuple[Found, list[Round]]]


def run(
    case: str | None = None,
    sizes: list[int] | None = None,
    peers: Path | None = None,
    threads: int | None = None,
) -> Iterator[dict[str, Any]]:
    """Measure a case, or all; yield a line (see `Line`) for each size, dimension, variant and engine.

    sizes    numbers of items instead of the case's own
    peers    folder of other programs to run beside
    threads  worker threads, None: every core

    Raises SceneError at once where the arguments are wrong, TianimError at the end where a
    measurement failed.
    """
    chosen = [find_case(case)] if case is not None else list(CASES.values())
    tasks = [(one, one.tasks(sizes, threads)) for one in chosen]
    for one in chosen:
        if not one.sized:
            load_scene(one.name)
    return _lines(tasks, peers)


def _lines(tasks: list[tuple[Case, list[Task]]], folder: Path | None) -> Iterator[dict[str, Any]]:
    failed = []
    with tempfile.TemporaryDirectory(prefix="tianim-peers-") as work:
        for case, sizes in tasks:
            peers = find_peers(case.name, folder, Path(work)) if folder is not None else []
            for task in sizes:
                try:
                    for line in _measure(case, task, peers):
                        yield line.as_dict()
                except TianimError as error:
                    failed.append(f"{task.case} n={task.n} {task.dim}D: {error}")
    if failed:
        raise TianimError(f"bench: {len(failed)} failed: {'; '.join(failed)}")


def _measure(case: Case, task: Task, peers: list[Peer]) -> list[Line]:
    """Lines of one size: ours, each variant, then the peers'."""
    ours: Measured = {}
    theirs: Theirs = {}
    waiting = [peer for peer in peers if task.n <= peer.largest]
    most = case.rounds or ROUNDS
    with worker(task) as process:
        threads = int(process.about["threads"])
        seconds, rounds = 0.0, 0
        while rounds < most or (seconds < LEAST_SECONDS and rounds < MOST_ROUNDS):
            for variant, one in process.round().items():
                ours.setdefault(variant, []).append(one)
                seconds += 1e-3 * one.steps * one.mean_ms
            steps = next(iter(ours.values()))[-1].steps
            for peer in list(waiting):
                if rounds >= most or not _run_peer(peer, task, steps, threads, theirs) or peer.once:
                    waiting.remove(peer)
            rounds += 1
        return [*_our_lines(case, process, ours, theirs), *_their_lines(task, threads, theirs)]


def _run_peer(peer: Peer, task: Task, steps: int, threads: int, theirs: Theirs) -> bool:
    try:
        found = peer.measure(task.n, task.dim, steps, threads)
    except (OSError, ValueError, KeyError, subprocess.TimeoutExpired) as error:
        note(f"{peer.command(task.n, task.dim, steps)[0]}: {error}: left out")
        return False
    for one in found:
        theirs.setdefault((one.variant, one.name), (one, []))[1].append(one.round)
    return True


def _our_lines(case: Case, process: Worker, ours: Measured, theirs: Theirs) -> list[Line]:
    about, end = process.about, process.end()
    results = {variant: summary(rounds) for variant, rounds in ours.items()}
    first = next(iter(results.values()))
    peers = {key: summary(rounds).cost for key, (_, rounds) in theirs.items()}
    return [
        Line(
            case=case.name,
            variant=variant,
            engine="tianim",
            compiler=about["compiler"],
            n=about["n"],
            dim=about["dim"],
            threads=about["threads"],
            ms_per_step=one.mean_ms,
            ns_per_item_step=1e6 * one.mean_ms / max(about["n"], 1),
            ratio={
                name: one.cost / cost
                for (of, name), cost in peers.items()
                if of in ("", variant.split(",")[0])
            },
            split_ms=one.split_ms,
            ms_min=one.least_ms,
            overhead_percent=100 * (one.mean_ms / first.mean_ms - 1) if case.compared else None,
            peak_memory_mb=end["peak_memory_mb"],
            bytes_per_item=end["bytes_per_item"],
            error=one.error,
            simulated_per_wall=1e3 / one.cost if one.simulated_s else None,
            counts=one.counts,
            steps=one.steps,
            rounds=len(ours[variant]),
        )
        for variant, one in results.items()
    ]


def _their_lines(task: Task, threads: int, theirs: Theirs) -> list[Line]:
    lines = []
    for (variant, name), (found, rounds) in theirs.items():
        one = summary(rounds)
        lines.append(
            Line(
                case=task.case,
                variant=variant,
                engine=name,
                compiler=found.compiler,
                n=task.n,
                dim=task.dim,
                threads=found.threads or threads,
                ms_per_step=one.mean_ms,
                ns_per_item_step=1e6 * one.mean_ms / task.n,
                ratio={},
                split_ms=one.split_ms,
                ms_min=one.least_ms,
                overhead_percent=None,
                peak_memory_mb=None,
                bytes_per_item=None,
                error=one.error,
                simulated_per_wall=1e3 / one.cost if one.simulated_s else None,
                counts=one.counts,
                steps=one.steps,
                rounds=len(rounds),
            )
        )
    return lines
