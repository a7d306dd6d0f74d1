"""Writing beside the simulation: the process, its errors, its end, and what it may not load."""

import errno
import gc
import json
import os
import shutil
import signal
import subprocess
import sys
import textwrap
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tianim import buffers
from tianim.errors import FormatError, OutputError
from tianim.export import (
    FORMATS,
    FrameWriter,
    OutputOptions,
    RunFrames,
    files,
    open_exporters,
    read_vtu,
    shared,
    writer,
)
from tianim.export.shared import map_memory, pack, unpack
from tianim.frame import Frame, Lines, Mesh, Points

FPS = 30.0
# A cloud of this many points goes to the process, with the limit that the tests set.
LARGE_FRAME = 200_000
LARGE = LARGE_FRAME // 28 + 1
# 5.5 MB in the record: some of these fill the small disk of a test.
HUGE = 150_000


@pytest.fixture(autouse=True)
def _smaller_frames_are_large(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(writer, "LARGE_FRAME", LARGE_FRAME)


def cloud(index: int, count: int = LARGE) -> Frame:
    """A frame of `count` points whose numbers tell its index."""
    position = np.full((count, 3), index, np.float32)
    data = {"velocity": position + 0.5, "id": np.arange(count, dtype=np.int32)}
    return Frame(index, index / FPS, (Points("boids", position, data, {"velocity": "m/s"}),))


def is_alive(pid: int) -> bool:
    """Whether the process runs (one that ended but was not waited for does not)."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


def process_of(open_writer: FrameWriter) -> "subprocess.Popen[bytes]":
    assert open_writer._remote is not None
    return open_writer._remote._process


def test_large_frames_go_to_a_process_and_small_ones_do_not(tmp_path: Path) -> None:
    with open_exporters(tmp_path, (), OutputOptions(), FPS) as out:
        for index in range(3):
            out.write(cloud(index, 100))
            assert out._remote is None
        for index in range(3, 8):
            out.write(cloud(index))
        process = process_of(out)
        out.write(cloud(8, 100))
        out.wait()
        assert len(RunFrames(tmp_path)) == 9
    assert process.returncode == 0
    frames = RunFrames(tmp_path)
    assert [frame.index for frame in frames] == list(range(9))
    for index, frame in enumerate(frames):
        part = frame.part("boids")
        assert (part.position == index).all()
        assert (part.data["velocity"] == index + 0.5).all()
        np.testing.assert_array_equal(part.data["id"], np.arange(len(part.position)))


def test_the_process_writes_the_same_bytes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    formats = ("npz", "vtkhdf")
    frames = [cloud(index, LARGE + index % 2) for index in range(4)]
    for name in ("beside", "here"):
        if name == "here":
            monkeypatch.setattr(writer, "LARGE_FRAME", 1 << 40)
        with open_exporters(tmp_path / name, formats, OutputOptions(up_axis="z"), FPS) as out:
            for frame in frames:
                out.write(frame)
            assert (out._remote is None) == (name == "here")
    made = [
        {path.name: path.read_bytes() for path in (tmp_path / name).iterdir()} for name in ("beside", "here")
    ]
    assert made[0] == made[1]
    assert len(made[0]) == 4 * 2 + 2 + 1


def test_arrays_are_free_after_write(tmp_path: Path) -> None:
    frame = cloud(0)
    with open_exporters(tmp_path, (), OutputOptions(), FPS) as out:
        for index in range(4):
            frame.parts[0].position[:] = index
            out.write(Frame(index, index / FPS, frame.parts))
            frame.parts[0].position[:] = -1.0
    assert [float(one.parts[0].position.max()) for one in RunFrames(tmp_path)] == [0.0, 1.0, 2.0, 3.0]


def test_arrays_in_shared_memory_are_handed_over_and_can_no_longer_be_changed(tmp_path: Path) -> None:
    count = buffers.SMALLEST // 12 + 1
    with open_exporters(tmp_path, (), OutputOptions(), FPS) as out:
        for index in range(5):
            position = buffers.new_array((count, 3), np.float32)
            position[:] = index
            out.write(Frame(index, index / FPS, (Points("boids", position),)))
            with pytest.raises(ValueError, match="read-only"):
                position[0] = -1.0
    found = [one.parts[0].position for one in RunFrames(tmp_path)]
    assert all((one == index).all() and one.shape == (count, 3) for index, one in enumerate(found))


def test_frames_may_grow_and_memory_stays_bounded(tmp_path: Path) -> None:
    large = buffers.SMALLEST // 28 + 1
    gc.collect()
    before = len(buffers._held)
    with open_exporters(tmp_path, (), OutputOptions(), FPS) as out:
        for index in range(12):
            out.write(cloud(index, large * (1 + index % 3)))
            # One copy of each frame under way.
            assert len(buffers._held) <= before + writer.SLOTS
            assert len(buffers._spare) <= buffers.SPARE
    assert len(RunFrames(tmp_path)) == 12
    assert len(buffers._held) == before


def test_every_part_survives_the_shared_memory(monkeypatch: pytest.MonkeyPatch) -> None:
    random = np.random.default_rng(0)
    position = random.random((5, 3)).astype(np.float32)
    empty = np.zeros((0, 3), np.float32)
    frame = Frame(
        3,
        0.1,
        (
            Points("a", position[::-1], {"id": np.arange(5, dtype=np.int64), "none": np.zeros((5, 0))}),
            Points("b", empty, {"velocity": empty}),
            Mesh(
                "c",
                position,
                np.array([[0, 1, 2]], np.int32),
                {"u": np.ones(5, np.uint8)},
                {"f": np.ones((1, 9))},
            ),
            Lines("d", position, np.array([[0, 1]], np.int32), {}, {"t": np.ones(1)}, {"t": "N"}),
        ),
    )
    # With arrays of these sizes, one lies in shared memory, the others are copied there or stay.
    for smallest, count in ((1, 2), (40, 2), (1 << 20, 0)):
        monkeypatch.setattr(buffers, "SMALLEST", smallest)
        monkeypatch.setattr(shared, "SMALLEST", smallest)
        own = buffers.new_array((5, 3), np.float32)
        own[:] = position
        parcel = pack(replace(frame, parts=(*frame.parts, Points("e", own[1:], {"x": own[:, 0]}))))
        assert len(parcel.buffers) == count
        memories = [map_memory(os.dup(buffer.descriptor)) for buffer in parcel.buffers]
        again = unpack(parcel.skeleton, memories)
        assert repr(again.parts[:-1]) == repr(frame.parts)
        assert (again.parts[-1].position == position[1:]).all()
        assert (again.parts[-1].data["x"] == position[:, 0]).all()


def write_all(
    folder: Path,
    count: int,
    formats: tuple[str, ...] = (),
    size: int = LARGE,
    after_first: Callable[[FrameWriter], None] = FrameWriter.wait,
) -> None:
    """Write `count` frames; `after_first` is called between the first and the second."""
    with open_exporters(folder, formats, OutputOptions(), FPS) as out:
        for index in range(count):
            out.write(cloud(index, size))
            if index == 0:
                after_first(out)


def test_an_error_of_the_process_comes_back_at_the_next_call(tmp_path: Path) -> None:
    folder = tmp_path / "frames"
    writers: list[FrameWriter] = []

    def remove_folder(out: FrameWriter) -> None:
        writers.append(out)
        out.wait()
        shutil.rmtree(folder)

    # 2 fill the buffers, the third must wait for one of them.
    with pytest.raises(OutputError, match=r"frames/.*cannot write: no such file or directory") as first:
        write_all(folder, 2 + writer.SLOTS, after_first=remove_folder)
    assert "\n" not in str(first.value)
    assert process_of(writers[0]).returncode is not None
    # And at every later call.
    with pytest.raises(OutputError) as second:
        writers[0].wait()
    assert str(second.value) == str(first.value)


def test_a_process_that_was_killed_is_named(tmp_path: Path) -> None:
    def kill(out: FrameWriter) -> None:
        out.wait()
        process_of(out).kill()

    with pytest.raises(OutputError, match=r"process that writes frames ended \(exit code -9\)"):
        write_all(tmp_path, 10, after_first=kill)
    assert RunFrames(tmp_path)[0].index == 0


def test_an_error_in_the_simulation_keeps_the_frames_given(tmp_path: Path) -> None:
    def simulate() -> None:
        with open_exporters(tmp_path, ("vtkhdf",), OutputOptions(), FPS) as out:
            for index in range(3):
                out.write(cloud(index))
            raise RuntimeError("blow-up")

    with pytest.raises(RuntimeError, match="blow-up"):
        simulate()
    assert len(RunFrames(tmp_path)) == 3
    # Files of a whole run belong to a whole run.
    assert not (tmp_path / "boids.vtkhdf").exists()


@pytest.mark.parametrize("size", [10, LARGE])
def test_a_run_that_is_stopped_may_leave_out_the_files_of_the_whole_run(tmp_path: Path, size: int) -> None:
    with open_exporters(tmp_path, ("vtkhdf",), OutputOptions(), FPS) as out:
        out.write(cloud(0, size))
        out.abandon()
    assert len(RunFrames(tmp_path)) == 1
    assert not (tmp_path / "boids.vtkhdf").exists()
    # Resumed with nothing left to do, the run is whole.
    with open_exporters(tmp_path, ("vtkhdf",), OutputOptions(), FPS, resume_from=1):
        pass
    assert (tmp_path / "boids.vtkhdf").exists()


def test_a_format_that_refuses_does_so_at_once(tmp_path: Path) -> None:
    with pytest.raises(FormatError, match="'stl' holds triangles only"):
        write_all(tmp_path, 1, ("stl",))


SCRIPT = """
    # No `if __name__ == "__main__"`: a user's script need not have one.
    import sys, time
    from pathlib import Path
    from tianim.export import OutputOptions, open_exporters, writer
    sys.path.insert(0, {tests!r})
    from test_export_writer import LARGE_FRAME, cloud
    writer.LARGE_FRAME = LARGE_FRAME
    with open_exporters(Path({folder!r}), (), OutputOptions(), 30.0, resume_from={start}) as out:
        for index in range({start}, {end}):
            out.write(cloud(index))
            print(index, out._remote._process.pid, flush=True)
"""


@contextmanager
def running(folder: Path, start: int = 0, end: int = 100_000) -> "Iterator[subprocess.Popen[str]]":
    """A run in another process, which prints each frame's index and the writer's process."""
    script = textwrap.dedent(SCRIPT).format(
        folder=str(folder), tests=str(Path(__file__).parent), start=start, end=end
    )
    process = subprocess.Popen([sys.executable, "-c", script], stdout=subprocess.PIPE, text=True)
    try:
        yield process
    finally:
        process.kill()
        process.communicate()


def wait_for(condition: Callable[[], bool], seconds: float = 20.0) -> bool:
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        if condition():
            return True
        time.sleep(0.02)
    return False


def test_a_killed_run_leaves_nothing_behind_and_resumes_to_the_same_bytes(tmp_path: Path) -> None:
    folder = tmp_path / "killed"
    shared = set(os.listdir("/dev/shm"))
    with running(folder) as process:
        assert process.stdout is not None
        line = ""
        for _ in range(6):
            line = process.stdout.readline()
        process.kill()
        process.wait()
    index, pid = map(int, line.split())
    assert wait_for(lambda: not is_alive(pid)), "the writer outlived its run"
    assert set(os.listdir("/dev/shm")) <= shared
    # Every frame of the index is whole, and all but the two in flight are there.
    frames = RunFrames(folder)
    assert len(frames) >= index - writer.SLOTS
    assert all((frame.parts[0].position == frame.index).all() for frame in frames)
    assert not [path for path in folder.glob("boids_*.vtu") if read_vtu(path).position.shape != (LARGE, 3)]
    start = len(frames) - 1
    with open_exporters(folder, (), OutputOptions(), FPS, resume_from=start) as out:
        for index in range(start, 8):
            out.write(cloud(index))
    with open_exporters(tmp_path / "whole", (), OutputOptions(), FPS) as out:
        for index in range(8):
            out.write(cloud(index))
    made = [{path.name: path.read_bytes() for path in one.iterdir()} for one in (folder, tmp_path / "whole")]
    assert made[0] == made[1]


def test_ctrl_c_does_not_reach_the_process(tmp_path: Path) -> None:
    with running(tmp_path, end=3) as process:
        assert process.stdout is not None
        pid = int(process.stdout.readline().split()[1])
        assert os.getpgid(pid) != os.getpgid(process.pid)
        # By its own number it is ignored too, once the process has set that up.
        assert wait_for(lambda: (tmp_path / "boids_0000.vtu").exists())
        os.kill(pid, signal.SIGINT)
        assert process.wait(30) == 0
    assert len(RunFrames(tmp_path)) == 3


def test_neither_import_nor_process_loads_the_compiler(tmp_path: Path) -> None:
    heavy = (
        "[m for m in ('taichi', 'quadrants', 'meshio', 'h5py', 'pxr', 'scipy', 'open3d') if m in sys.modules]"
    )
    code = f"import sys, json, tianim.export, tianim.frame; print(json.dumps({heavy}))"
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert json.loads(run.stdout) == []
    with open_exporters(tmp_path, (), OutputOptions(), FPS) as out:
        out.write(cloud(0))
        out.wait()
        maps = Path(f"/proc/{process_of(out).pid}/maps").read_text()
    assert "numpy" in maps
    assert "taichi" not in maps
    assert "quadrants" not in maps


def test_large_files_leave_the_cache_and_are_let_go_of(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(files, "LARGE_FILE", 1000)
    before = len(os.listdir("/proc/self/fd"))
    with open_exporters(tmp_path, (), OutputOptions(), FPS) as out:
        for index in range(10):
            out.write(cloud(index, 100))
        assert len(files._settling) == files.SETTLING
    assert len(os.listdir("/proc/self/fd")) == before
    assert [float(frame.parts[0].position.max()) for frame in RunFrames(tmp_path)] == list(range(10))


def test_a_full_disk_is_one_clear_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    real = os.writev
    given: list[int] = []

    def writev(descriptor: int, chunks: list[bytes]) -> int:
        given.append(descriptor)
        if len(given) == 3:
            real(descriptor, chunks[:1])
            raise OSError(errno.ENOSPC, "No space left on device")
        return real(descriptor, chunks)

    monkeypatch.setattr(os, "writev", writev)
    with pytest.raises(OutputError, match=r"boids_0002\.vtu: cannot write: the disk is full"):
        write_all(tmp_path, 5, size=10)
    # Nothing half is left, and what the indexes name is there.
    assert [frame.index for frame in RunFrames(tmp_path)] == [0, 1]
    assert {path.name for path in tmp_path.iterdir()} == {
        "boids.pvd",
        "boids.vtu.series",
        "boids_0000.vtu",
        "boids_0001.vtu",
    }


@pytest.mark.parametrize(
    "formats", [(), ("vtk",), ("xdmf",), ("npz",), ("vtkhdf",), ("xdmf_series",), ("usd",)]
)
def test_a_disk_that_is_full_indeed(tmp_path: Path, formats: tuple[str, ...]) -> None:
    # Room for some frames of 6 MB, or for a record of two and no file of the whole run beside it.
    if "usd" in formats:
        pytest.importorskip("pxr")
    disk = tmp_path / "disk"
    disk.mkdir()
    if subprocess.run(
        ["mount", "-t", "tmpfs", "-o", "size=16m", "none", disk], capture_output=True
    ).returncode:
        pytest.skip("cannot mount a small disk here")
    try:
        count = 2 if formats and FORMATS[formats[0]].whole_run else 10
        with pytest.raises(OutputError, match="the disk is full"):
            write_all(disk / "frames", count, formats, HUGE)
        left = [path.name for path in (disk / "frames").iterdir()]
        assert not [name for name in left if name.endswith(".tmp")]
        assert len(RunFrames(disk / "frames")) in (1, 2, 3)
        assert (RunFrames(disk / "frames")[0].parts[0].position == 0).all()
    finally:
        subprocess.run(["umount", disk], check=True)


def test_an_unwritable_folder_is_told_before_the_run(tmp_path: Path) -> None:
    if os.geteuid() == 0:
        folder = Path("/proc/tianim")
    else:
        tmp_path.chmod(0o500)
        folder = tmp_path / "frames"
    with (
        pytest.raises(OutputError, match=f"{folder}: cannot write"),
        open_exporters(folder, (), OutputOptions(), FPS),
    ):
        raise AssertionError("opened")
