"""`tianim bench`: the lines, the errors, the peers, and that the flock is the one the peers simulate."""

import json
import stat
from contextlib import nullcontext
from pathlib import Path

import numpy as np
import pytest

from tianim import bench, runtime
from tianim.bench import flocks, peers, running
from tianim.bench.cases import CASES, Task, find_case
from tianim.bench.lines import Round, summary
from tianim.bench.worker import worker
from tianim.errors import SceneError, TianimError

N = 500
# Of the double dam break at 500 asked for: two columns of 5 x 7 x 5 or so, as the peers' script makes them.
COLUMNS = 2 * 5 * 7 * 5
SQUARE = round(N**0.5) ** 2  # points of a sheet that is as long as wide
KEYS = {
    "case",
    "variant",
    "engine",
    "compiler",
    "n",
    "dim",
    "threads",
    "ms_per_step",
    "ns_per_item_step",
    "ratio",
    "split_ms",
    "ms_min",
    "overhead_percent",
    "peak_memory_mb",
    "bytes_per_item",
    "error",
    "simulated_per_wall",
    "counts",
    "steps",
    "rounds",
}
VARIANTS = {
    "boids": [""],
    "boids_topological": [""],
    "grid": ["sort from any order", "sort", "walk"],
    "fluid": ["dfsph", "pbf"],
    "gravity": ["plummer", "galaxy", "plummer, direct sum", "galaxy, direct sum"],
    "export": [
        "steps",
        "a frame a step, not written",
        "a frame a step",
        "a frame every 8 steps, not written",
        "a frame every 8 steps",
    ],
    "render": ["darts", "spheres"],
    "startup": ["first frame", "first step"],
    "springs": ["hang", "swing", "drape", "drape, explicit"],
}
# One step in float32 against float64: velocities of 1 m/s from sums of some 20 terms up to 1/d.
STEP_TOLERANCE = 1e-3
# Mean of 500 Poisson counts of 20 has a deviation of 0.2; a wrong box would be off by a factor.
NEIGHBOUR_TOLERANCE = 1.0


@pytest.fixture
def _one_round(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(running, "ROUNDS", 1)
    monkeypatch.setattr(running, "LEAST_SECONDS", 0.0)


class Here:
    """A worker without a process of its own, which takes seconds to start."""

    def __init__(self, task: Task) -> None:
        self._measurement = find_case(task.case).measurement(task)
        started = runtime.current()
        self.about: dict[str, int | str] = {"n": self._measurement.n, "dim": self._measurement.dim}
        self.about |= {"threads": started.threads, "compiler": started.compiler}
        self.round = self._measurement.round

    def end(self) -> dict[str, float | None]:
        return {"peak_memory_mb": 100.0, "bytes_per_item": self._measurement.bytes_per_item()}


@pytest.fixture
def _in_this_process(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(running, "worker", lambda task: nullcontext(Here(task)))


def test_every_case_is_tried_here() -> None:
    assert set(VARIANTS) == set(CASES)
    assert all(case.description for case in CASES.values())


@pytest.mark.usefixtures("_one_round", "_in_this_process")
@pytest.mark.parametrize("name", VARIANTS)
def test_a_tiny_run(name: str) -> None:
    lines = list(bench.run(name, [N], None, threads=2))
    dims = CASES[name].dims
    assert [(line["dim"], line["variant"]) for line in lines] == [
        (dim, v) for dim in dims for v in VARIANTS[name]
    ]
    for line in lines:
        assert set(line) == KEYS
        assert json.loads(json.dumps(line, allow_nan=False)) == line
        assert (line["case"], line["engine"], line["threads"]) == (name, "tianim", 2)
        assert line["n"] == {"fluid": COLUMNS, "springs": SQUARE}.get(name, N)
        assert 0 < line["ms_min"] <= line["ms_per_step"]
        assert line["ns_per_item_step"] == pytest.approx(1e6 * line["ms_per_step"] / line["n"], rel=1e-3)


@pytest.mark.usefixtures("_one_round")
def test_a_process_of_its_own_gives_split_and_memory() -> None:
    line = next(iter(bench.run("boids", [N], None, threads=1)))
    assert line["threads"] == 1
    assert list(line["split_ms"]) == ["sort", "forces", "integrate"]
    assert min(line["split_ms"].values()) > 0
    assert sum(line["split_ms"].values()) <= line["ms_per_step"]
    assert line["bytes_per_item"] > 60  # position and velocity twice, acceleration
    assert 50 < line["peak_memory_mb"] < 1000  # the compiler's, no more


@pytest.mark.usefixtures("_one_round", "_in_this_process")
def test_a_scene_file_is_a_case(tmp_path: Path) -> None:
    path = tmp_path / "flock.json"
    path.write_text(json.dumps(flocks.flock_scene(N, 2, {"kind": "metric"}, steps_a_frame=2)))
    (line,) = bench.run(str(path), threads=2)
    assert (line["n"], line["dim"], line["steps"]) == (N, 2, 10)
    assert 0 < line["split_ms"]["flock"] <= line["ms_per_step"]


@pytest.mark.parametrize(
    ("case", "sizes", "said"),
    [
        (
            "boid",
            None,
            "bench: no case 'boid'; did you mean 'boids'? there are boids, boids_topological, grid",
        ),
        ("zzz", None, "bench: no case 'zzz'; there are boids"),
        ("boids", [1000, 120], "--n 120: boids needs at least 200 items in 3D"),
        ("nowhere/scene.yaml", None, "nowhere/scene.yaml: no such file"),
    ],
)
def test_wrong_arguments_are_told_at_once(case: str, sizes: list[int] | None, said: str) -> None:
    with pytest.raises(SceneError) as caught:
        bench.run(case, sizes)
    assert said in str(caught.value)


def test_a_scene_takes_no_sizes(tmp_path: Path) -> None:
    path = tmp_path / "flock.json"
    path.write_text(json.dumps(flocks.flock_scene(N, 2, {"kind": "metric"})))
    with pytest.raises(SceneError, match="has its own counts"):
        bench.run(str(path), [10])


def test_a_missing_peers_folder_is_one_line(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    assert peers.find_peers("boids", tmp_path / "nothing", tmp_path) == []
    out, err = capfd.readouterr()
    assert out == ""
    assert err == f"bench: no folder {tmp_path / 'nothing'}: peers are left out\n"


def test_missing_compiler_and_numba_are_a_line_each(
    tmp_path: Path, capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "boids").mkdir()
    for name in ("boids_cpp.cc", "boids_python.py"):
        (tmp_path / "boids" / name).touch()
    monkeypatch.setenv("PATH", "")
    monkeypatch.setenv(peers.PYTHON_VARIABLE, str(tmp_path / "no_python"))
    assert peers.find_peers("boids", tmp_path, tmp_path) == []
    no_compiler, no_numba = capfd.readouterr().err.splitlines()
    assert no_compiler == "bench: no g++: the peer in C++ is left out"
    assert no_numba.startswith("bench: no Python with numba and scipy (TIANIM_PEERS_PYTHON")


@pytest.fixture
def stub_peers(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder with a script, and a Python that answers for it: 1 ms a step with numba, else failure."""
    (tmp_path / "boids").mkdir()
    (tmp_path / "boids" / "boids_python.py").touch()
    python = tmp_path / "python"
    answer = json.dumps({"code": "stub", "ms_per_step": 1.0, "steps": "$5"}).replace('"$5"', "'$5'")
    python.write_text(
        "#!/bin/sh\n"
        'case "$1 $2" in\n'
        "  '-c import'*) exit 0;;\n"
        f"  *numba) echo compiling; echo '{answer}';;\n"
        "  *) echo 'no such method' >&2; exit 1;;\n"
        "esac\n"
    )
    python.chmod(python.stat().st_mode | stat.S_IXUSR)
    monkeypatch.setenv(peers.PYTHON_VARIABLE, str(python))
    return tmp_path


@pytest.mark.usefixtures("_one_round", "_in_this_process")
def test_peers_are_lines_and_ratios(stub_peers: Path, capfd: pytest.CaptureFixture[str]) -> None:
    lines = list(bench.run("boids", [N], stub_peers, threads=2))
    assert [(line["engine"], line["dim"]) for line in lines] == [
        ("tianim", 2),
        ("stub", 2),
        ("tianim", 3),
        ("stub", 3),
    ]
    ours, theirs = lines[:2]
    assert set(theirs) == KEYS
    assert ours["ratio"] == {"stub": pytest.approx(ours["ms_per_step"], rel=1e-3)}
    assert (theirs["ratio"], theirs["ms_per_step"], theirs["steps"]) == ({}, 1.0, ours["steps"])
    err = capfd.readouterr().err
    assert "boids_cpp.cc: the peer in C++ is left out" in err
    assert "no such method: left out" in err


def test_a_dead_measuring_process_is_an_error() -> None:
    with worker(Task("boids", N, 2, 1)) as process:
        process._process.kill()
        with pytest.raises(TianimError, match="ended with status -9"):
            process.round()


def test_a_failure_does_not_stop_the_rest(monkeypatch: pytest.MonkeyPatch) -> None:
    def measure(case: bench.Case, task: Task, peers: list) -> list:
        if task.n == 200:
            raise TianimError("out of luck")
        return []

    monkeypatch.setattr(running, "_measure", measure)
    with pytest.raises(TianimError, match=r"bench: 2 failed: boids n=200 2D: out of luck; boids n=200 3D"):
        list(bench.run("boids", [200, 300]))


def test_the_median_round_counts() -> None:
    rounds = [Round(5, mean, mean / 2, {"sort": mean / 4}) for mean in (1.0, 9.0, 2.0)]
    assert summary(rounds) == Round(5, 2.0, 0.5, {"sort": 0.5})


def one_step(
    x: np.ndarray, v: np.ndarray, length: float, dim: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The peers' step by brute force in float64: place, velocity, number of neighbours."""
    d = x[None] - x[:, None]
    d[..., :dim] -= length * np.round(d[..., :dim] / length)
    r2 = (d**2).sum(axis=2)
    near = (r2 < 1.0) & ~np.eye(len(x), dtype=bool)
    count = near.sum(axis=1)
    a = 0.05 * -(near[..., None] * d / np.maximum(r2, 1e-9)[..., None]).sum(axis=1)
    mean_v, mean_d = ((near[..., None] * w).sum(axis=1) / np.maximum(count, 1)[:, None] for w in (v[None], d))
    a += (count > 0)[:, None] * (0.5 * (mean_v - v) + 0.2 * mean_d)
    new = v + flocks.TIME_STEP * a
    speed = np.linalg.norm(new, axis=1, keepdims=True)
    new *= np.clip(speed, 1.0, 2.0) / speed
    moved = x + flocks.TIME_STEP * new
    moved[:, :dim] %= length
    return moved, new, count


@pytest.mark.parametrize("dim", [2, 3])
def test_the_flock_is_the_peers_flock(dim: int) -> None:
    measured = flocks.Flock(Task("boids", N, dim, 2))
    x, v = (measured.system.read(name).astype(np.float64) for name in ("position", "velocity"))
    length = flocks.box_length(N, dim)
    moved, new, count = one_step(x, v, length, dim)
    assert count.mean() == pytest.approx(flocks.NEIGHBOURS, abs=NEIGHBOUR_TOLERANCE)
    assert np.linalg.norm(v, axis=1) == pytest.approx(1.0, abs=1e-5)
    measured._step(0)
    assert np.abs(measured.system.read("velocity") - new).max() < STEP_TOLERANCE
    apart = measured.system.read("position") - moved
    apart[:, :dim] -= length * np.round(apart[:, :dim] / length)
    assert np.abs(apart).max() < STEP_TOLERANCE


def test_every_round_starts_from_the_same_state() -> None:
    measured = flocks.Flock(Task("boids", N, 3, 2))
    measured.round()
    first = measured.system.read("position")
    measured.round()
    assert np.array_equal(first, measured.system.read("position"))
