"""The commands beside `run`: what they print, where, and with which exit code."""

import json
import os
import select
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from command import Cli, Start

from tianim import __version__, info
from tianim.cli.scenes import duration
from tianim.errors import SceneError
from tianim.scene import load_scene
from tianim.terminal import Lines, Now

COMMANDS = (
    "run", "list", "check", "schema", "export", "surface", "foam", "render", "view", "sweep", "bench",
    "validate", "info",
)  # fmt: skip


@pytest.mark.parametrize("command", ["run", "check", "sweep"])
def test_the_examples_of_help_are_right(cli: Cli, command: str) -> None:
    text = cli(command, "--help").stdout.rpartition("Example:")[2]
    words = [word for word in text.split() if not word.startswith("-")][2:]
    overrides = [word.partition(",")[0] for word in words if "=" in word]
    assert overrides
    load_scene(words[0], overrides)


@pytest.mark.parametrize("command", [(), *((name,) for name in COMMANDS)])
def test_every_help_has_an_example(cli: Cli, command: tuple[str, ...]) -> None:
    result = cli(*command, "--help")
    assert result.exit_code == 0
    assert f"Example:\n    tianim {' '.join(command)}".rstrip() in result.stdout
    assert result.stderr == ""


def test_no_command_is_help_and_lists_all(cli: Cli) -> None:
    result = cli()
    assert result.exit_code == 0
    listed = [
        line.split()[0] for line in result.stdout.partition("Commands:")[2].splitlines() if line.strip()
    ]
    assert listed[: len(COMMANDS)] == list(COMMANDS)
    assert "..." not in result.stdout.partition("Commands:")[2]


def test_the_version(cli: Cli) -> None:
    assert cli("--version").stdout == f"tianim {__version__}\n"


@pytest.mark.parametrize(
    ("arguments", "complaint"),
    [
        (("ran",), "tianim: No such command 'ran'"),
        (("run",), "tianim run: Missing argument 'SCENE'"),
        (("run", "dust.yaml", "--frame", "3"), "tianim run: No such option: --frame"),
        (("run", "dust.yaml", "--frames", "many"), "tianim run: Invalid value for '--frames'"),
        (("run", "dust.yaml", "dust.cont=3"), "did you mean 'count'?"),
        (("run", "dust.yaml", "nonsense"), "must be key=value"),
        (("run", "dast.yaml"), "dast.yaml: no such file; did you mean dust.yaml?"),
        (("check", "murmuratoin"), "did you mean 'murmuration'?"),
        (("export",), "export needs RUN and --format"),
        (("export", "nowhere", "--format", "npz"), "nowhere: not the folder of a run"),
        (("render", "dust.yaml"), "dust.yaml: not the folder of a run"),
        (("view", "nowhere"), "nowhere: not the folder of a run"),
        (("sweep", "dust.yaml", "dust.count"), "must be key=value,value"),
        (("sweep", "dust.yaml", "dust.count=1,,2"), "must be key=value,value"),
        (("sweep", "dust.yaml", "seed=1", "seed=2"), "a key is given twice"),
        (("sweep", "dust.yaml", "seed=1,2", "--out", "dust.yaml"), "a file, not a folder"),
        (("sweep", "nowhere.yaml", "seed=1,2"), "nowhere.yaml: no such file"),
        (("bench", "boids", "--n", "many"), "--n many: must be whole numbers"),
        (("bench", "boids", "--n", "10,0"), "--n 10,0: must be whole numbers"),
        (("bench", "boids", "--n", "1000.5"), "--n 1000.5: must be whole numbers"),
        (("bench", "boids", "--n", "inf"), "--n inf: must be whole numbers"),
        (("schema", "--out", "."), "--out .: a folder; must be the name of a file"),
        (("export", "nowhere", "--format", " , "), "--format ' , ': must name formats"),
        (("run", "dust.yaml", "--threads", "7", "--arch", "cpu", "--no-preview"), "cannot start another"),
    ],
)
def test_wrong_usage_is_a_line_and_exit_code_2(
    scene: Path, cli: Cli, arguments: tuple[str, ...], complaint: str
) -> None:
    result = cli(*arguments)
    assert result.exit_code == 2
    assert complaint in result.stderr
    assert result.stderr.count("\n") == 1
    assert result.stdout == ""
    assert [path.name for path in scene.parent.iterdir()] == ["dust.yaml"]


def test_a_library_that_ends_the_program_is_not_silent(
    scene: Path, cli: Cli, monkeypatch: pytest.MonkeyPatch
) -> None:
    def leave(*_: object) -> None:
        sys.exit(1)  # as meshio does

    monkeypatch.setattr("tianim.scene.load_scene", leave, raising=False)
    result = cli("check", scene)
    assert result.exit_code == 1
    assert result.stderr == "tianim: a library ended the program with status 1\n"


def test_no_memory_is_a_line(scene: Path, cli: Cli, monkeypatch: pytest.MonkeyPatch) -> None:
    def burst(*_: object) -> None:
        raise MemoryError

    monkeypatch.setattr("tianim.scene.load_scene", burst, raising=False)
    result = cli("check", scene)
    assert (result.exit_code, result.stderr) == (1, "tianim: out of memory\n")


def test_a_defect_keeps_its_traceback(scene: Path, cli: Cli, monkeypatch: pytest.MonkeyPatch) -> None:
    def defect(*_: object) -> None:
        raise ZeroDivisionError

    monkeypatch.setattr("tianim.scene.load_scene", defect, raising=False)
    with pytest.raises(ZeroDivisionError):
        cli("check", scene)


def test_list_shows_scenes_with_a_line_each(scene: Path, cli: Cli) -> None:
    Path("configs").mkdir()
    scene.rename("configs/dust.yaml")
    lines = cli("list").stdout.splitlines()
    by_name = {line.split()[0]: line for line in lines}
    assert by_name["dust"].endswith("a few points drift")
    assert "murmuration" in by_name  # one that comes with the project
    assert cli("check", "dust").exit_code == 0


def test_check_says_what_a_scene_holds(scene: Path, cli: Cli) -> None:
    result = cli("check", scene, "dust.count=12345", "dust.seconds=50")
    assert result.exit_code == 0
    assert "12,345" in result.stdout
    assert "7 at 24 a second, 18 steps" in result.stdout
    assert "15 min on two cores" in result.stdout
    assert [path.name for path in scene.parent.iterdir()] == ["dust.yaml"]


def test_schema_goes_to_standard_output_or_a_file(scene: Path, cli: Cli) -> None:
    printed = json.loads(cli("schema").stdout)
    assert printed["title"] == "tianim scene"
    assert cli("schema", "--out", "schema.json").stdout == ""
    assert json.loads(Path("schema.json").read_text()) == printed


def test_export_writes_other_formats_without_simulating(scene: Path, cli: Cli) -> None:
    cli("run", scene, "--no-preview")
    result = cli("export", "out/dust", "--format", "npz", "--up", "z", "--scale", 100, "--out", "other")
    assert (result.exit_code, result.stdout) == (0, "other\n")
    assert {f"dust_{index:04d}.npz" for index in range(7)} <= {path.name for path in Path("other").iterdir()}
    wrong = cli("export", "out/dust", "--format", "npz", "--scale", -1)
    assert wrong.exit_code == 2
    assert "scale=-1.0: must be greater than 0" in wrong.stderr
    unknown = cli("export", "out/dust", "--format", "npzz")
    assert unknown.exit_code == 2
    assert "did you mean 'npz'?" in unknown.stderr


def test_export_prints_the_table_of_formats(cli: Cli) -> None:
    result = cli("export", "--formats")
    assert result.exit_code == 0
    assert {"vtu", "ply", "npz", "usd"} <= set(result.stdout.split())


def test_info_says_what_is_there(cli: Cli) -> None:
    result = cli("info")
    assert result.exit_code == 0
    for word in ("versions", "taichi", "machine", "cores", "back ends", "vulkan", "optional parts", "open3d"):
        assert word in result.stdout
    assert "cpu     usable" in result.stdout


def test_info_survives_a_probe_that_dies(monkeypatch: pytest.MonkeyPatch) -> None:
    codes = {
        "good": "pass",
        "killed": "import os; os.abort()",
        "bad": "raise ImportError('libfoo.so: not found')",
        "hangs": "import time; time.sleep(60)",
    }
    monkeypatch.setattr(info, "PROBE_SECONDS", 3.0)
    began = time.monotonic()
    assert info.probe(codes) == {
        "good": "usable",
        "killed": "not usable: ended with status -6",
        "bad": "not usable: libfoo.so: not found",
        "hangs": "not usable: no answer in 3 s",
    }
    assert time.monotonic() - began < 30.0  # the one that hangs was ended, not waited for


ROWS = [
    {"case": "boids", "system": "boids", "n": 10, "passed": True},
    {"case": "boids", "system": "boids", "n": 20, "passed": True},
]


def test_tables_of_bench_hide_little(cli: Cli, monkeypatch: pytest.MonkeyPatch) -> None:
    row = {"case": "boids", "engine": "[tianim]", "n": 1000, "ratio": {"numba": 0.25}, "passed": True}
    monkeypatch.setattr("tianim.bench.run", lambda *_: [row], raising=False)
    shown = cli("bench").stdout
    for text in ("boids", "[tianim]", "1000", "numba 0.25"):
        assert text in shown


@pytest.mark.parametrize("command", ["bench", "validate"])
@pytest.mark.parametrize("good", [True, False])
def test_json_is_one_object_a_line_and_the_exit_code_judges(
    cli: Cli, monkeypatch: pytest.MonkeyPatch, command: str, good: bool
) -> None:
    asked: list[tuple[object, ...]] = []

    def judged(*arguments: object) -> Iterator[dict[str, Any]]:
        asked.append(arguments)
        yield ROWS[0]
        yield {**ROWS[1], "passed": good}

    monkeypatch.setattr(f"tianim.{command}.run", judged, raising=False)
    result = cli(command, "boids", "--json")
    assert result.exit_code == (0 if good else 1)
    assert [json.loads(line) for line in result.stdout.splitlines()] == [ROWS[0], {**ROWS[1], "passed": good}]
    plain = cli(command, "boids")
    assert plain.exit_code == result.exit_code
    assert plain.stdout.count("boids") == 2
    assert asked[0][0] == "boids"


def test_bench_and_validate_pass_on_what_is_asked(cli: Cli, monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[tuple[object, ...]] = []

    def note(*arguments: object) -> list[dict[str, Any]]:
        asked.append(arguments)
        return []

    monkeypatch.setattr("tianim.bench.run", note, raising=False)
    monkeypatch.setattr("tianim.validate.run", note, raising=False)
    assert cli("bench", "boids", "--n", "10000,1e6", "--peers", "peers", "--threads", 2).exit_code == 0
    assert cli("validate", "--slow", "--out", "plots").exit_code == 0
    assert asked[0] == ("boids", [10_000, 1_000_000], Path("peers"), 2)
    assert asked[1][:3] == (None, True, Path("plots"))


def test_results_come_line_by_line_through_a_pipe(start: Start) -> None:
    child = start("validate", "vicsek")
    assert child.stdout is not None
    pipe, text = child.stdout.fileno(), b""
    while text.count(b"\n") < 3:
        text += os.read(pipe, 4096)
    names, rule, first = text.decode().splitlines()
    assert names.split()[:2] == ["system", "check"]
    assert set(rule) == {"-", " "}
    assert first.startswith("vicsek")
    assert select.select([pipe], [], [], 0.3) == ([], [], [])  # the next takes seconds


@pytest.mark.parametrize("width", [60, 160])
def test_lines_are_as_wide_as_the_terminal_at_most(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, width: int
) -> None:
    monkeypatch.setattr("tianim.terminal.FILE_WIDTH", width)
    table = Lines({"case": 12, "words": 100})
    words = "one two three four five six seven eight nine ten eleven twelve thirteen fourteen"
    table.add({"case": "short", "words": words})
    lines = capsys.readouterr().out.splitlines()
    assert max(map(len, lines)) <= width
    assert " ".join(line[14:] for line in lines[2:]) == words
    assert len(lines) == (3 if width == 160 else 4)


def test_what_is_being_done_is_said_on_a_terminal_alone(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    now = Now()
    now.show("1 of 2: pile")
    assert capsys.readouterr().err == ""
    monkeypatch.setattr("sys.stderr.isatty", lambda: True)
    now.show("2 of 2: heap")
    now.clear()
    now.clear()
    assert capsys.readouterr().err == "\r2 of 2: heap\x1b[K\r\x1b[K"


def test_an_unknown_case_is_a_line(cli: Cli, monkeypatch: pytest.MonkeyPatch) -> None:
    def unknown(*_: object) -> Iterator[dict[str, Any]]:
        raise SceneError("unknown case 'bird': did you mean 'boids'?")
        yield {}

    monkeypatch.setattr("tianim.bench.run", unknown, raising=False)
    for extra in ((), ("--json",)):
        result = cli("bench", "bird", *extra)
        assert (result.exit_code, result.stdout.strip()) == (2, "")
        assert result.stderr == "tianim: unknown case 'bird': did you mean 'boids'?\n"


def test_a_reader_that_leaves_early_is_no_error(start: Start) -> None:
    child = start("schema")
    assert child.stdout is not None
    child.stdout.read(10)
    child.stdout.close()
    assert child.stderr is not None
    assert child.stderr.read() == ""


def test_a_result_that_has_no_room_is_a_line() -> None:
    with open("/dev/full", "w") as full:
        done = subprocess.run(
            [sys.executable, "-m", "tianim", "schema"], stdout=full, stderr=subprocess.PIPE, text=True
        )
    assert (done.returncode, done.stderr) == (1, "tianim: the disk is full\n")


@pytest.mark.parametrize(
    ("seconds", "words"),
    [(0.0123, "0.012 s"), (40.0, "40 s"), (99.7, "2 min"), (200.0, "3 min"), (9000.0, "2.5 h")],
)
def test_durations_are_for_people(seconds: float, words: str) -> None:
    assert duration(seconds) == words


def test_python_m_tianim_is_the_command() -> None:
    done = subprocess.run([sys.executable, "-m", "tianim", "--version"], capture_output=True, text=True)
    assert done.stdout == f"tianim {__version__}\n"


@pytest.mark.parametrize("own", [None, "3"])
def test_numpy_gets_one_thread_before_it_is_loaded_unless_the_user_says(own: str | None) -> None:
    code = (
        "import atexit, os, sys; from tianim.cli import main\n"
        "atexit.register(lambda: print('THREADS', os.environ['OPENBLAS_NUM_THREADS']))\n"
        "assert 'numpy' not in sys.modules\nsys.argv = ['tianim', '--version']\nmain()"
    )
    environment = {name: value for name, value in os.environ.items() if name != "OPENBLAS_NUM_THREADS"}
    if own:
        environment["OPENBLAS_NUM_THREADS"] = own
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, env=environment)
    assert done.stdout.split()[-1] == (own or "1"), done.stderr


HEAVY = ("taichi", "scipy", "matplotlib", "open3d", "pyvista", "meshio", "h5py", "av", "PIL", "trimesh")


@pytest.mark.parametrize(
    ("arguments", "allowed"),
    [
        (("--help",), ()),
        (("list",), ()),
        (("run", "vicsek", "vicsek.count=100", "--frames", "1", "--no-preview"), ("taichi", "scipy")),
    ],
)
def test_heavy_packages_wait_until_they_are_needed(
    tmp_path: Path, arguments: tuple[str, ...], allowed: tuple[str, ...]
) -> None:
    code = (
        "import atexit, sys; from tianim.cli import main\n"
        f"atexit.register(lambda: print('LOADED', *[name for name in {HEAVY} if name in sys.modules]))\n"
        f"sys.argv = ['tianim', *{arguments}]\nmain()"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    loaded = done.stdout.partition("LOADED")[2].split()
    assert set(loaded) <= set(allowed)
