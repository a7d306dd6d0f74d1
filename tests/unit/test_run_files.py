"""What a run leaves on the disk: checkpoints that may be torn, metrics that may be torn, signals."""

import os
import signal
import zipfile
from pathlib import Path

import numpy as np
import pytest

from tianim import checkpoint
from tianim.errors import OutputError
from tianim.frame import Frame
from tianim.interrupts import Interrupts
from tianim.metrics import Metrics, read

STATE = {
    "index": np.asarray(3),
    "systems": np.array(["dust", "smoke"]),
    "dust.position": np.arange(300, dtype=np.float32).reshape(100, 3),
    "file": np.zeros(0, np.int32),  # a name that np.savez keeps for itself
}


def test_a_checkpoint_comes_back_as_it_was(tmp_path: Path) -> None:
    checkpoint.save(tmp_path, 3, STATE)
    found = checkpoint.newest(tmp_path)
    assert found is not None
    index, state = found
    assert index == 3
    assert state.keys() == STATE.keys()
    for name, value in STATE.items():
        assert state[name].dtype == value.dtype
        np.testing.assert_array_equal(state[name], value)
    assert [path.name for path in tmp_path.iterdir()] == ["frame_0003.npz"]


def test_the_last_two_are_kept(tmp_path: Path) -> None:
    for index in (9, 99, 9_999, 10_000):  # the order of numbers, not of names
        checkpoint.save(tmp_path, index, STATE)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["frame_10000.npz", "frame_9999.npz"]


@pytest.mark.parametrize("damage", ["short", "empty", "zeros", "flipped", "rubbish"])
def test_a_torn_checkpoint_is_passed_over(tmp_path: Path, damage: str) -> None:
    checkpoint.save(tmp_path, 3, STATE)
    torn = checkpoint.save(tmp_path, 6, STATE)
    whole = torn.read_bytes()
    middle = whole.index(STATE["dust.position"].tobytes()) + 100
    torn.write_bytes(
        {
            "short": whole[:-50],
            "empty": b"",
            "zeros": bytes(len(whole)),
            "flipped": whole[:middle] + bytes([whole[middle] ^ 1]) + whole[middle + 1 :],
            "rubbish": b"this is not a checkpoint",
        }[damage]
    )
    found = checkpoint.newest(tmp_path)
    assert found is not None
    assert found[0] == 3


def test_no_damage_is_taken_for_a_whole_checkpoint(tmp_path: Path) -> None:
    """A wrong byte in ZIP's directory, or zeros from there on: the same state or none, and no error.

    What stands before it, the arrays, has a checksum each.
    """
    path = checkpoint.save(tmp_path, 3, {"index": STATE["index"], "dust.steps": np.asarray(9)})
    whole = path.read_bytes()
    found = set()
    for position in range(whole.index(b"PK\x01\x02"), len(whole)):
        wrong = bytes([whole[position] ^ 0xFF])
        for damaged in (
            whole[:position] + wrong + whole[position + 1 :],
            whole[:position] + bytes(len(whole) - position),
        ):
            path.write_bytes(damaged)
            state = checkpoint.newest(tmp_path)
            found.add(None if state is None else tuple(f"{k}={v}" for k, v in state[1].items()))
    assert found <= {None, ("index=3", "dust.steps=9")}


def test_a_torn_checkpoint_does_not_count_among_the_last_two(tmp_path: Path) -> None:
    for index in (3, 6, 9):
        checkpoint.save(tmp_path, index, STATE)
    (tmp_path / "frame_0009.npz").write_bytes(b"torn")
    checkpoint.save(tmp_path, 7, STATE)  # the run went on from 6
    assert sorted(path.name for path in tmp_path.iterdir()) == ["frame_0006.npz", "frame_0007.npz"]


def test_a_pickle_is_never_read(tmp_path: Path) -> None:
    path = tmp_path / "frame_0001.npz"
    for kind, expected in ((np.int64, True), (object, False)):
        np.savez(path, evil=np.array([1], dtype=kind))
        with zipfile.ZipFile(path, "a") as archive:
            archive.comment = b"1"
        assert (checkpoint.newest(tmp_path) is not None) is expected


def test_objects_are_never_written(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="allow_pickle"):
        checkpoint.save(tmp_path, 1, {"dust.names": np.array([None], dtype=object)})
    assert list(tmp_path.iterdir()) == []


def test_no_checkpoints_is_none(tmp_path: Path) -> None:
    assert checkpoint.newest(tmp_path / "nowhere") is None


def test_a_failed_checkpoint_leaves_the_one_before(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    checkpoint.save(tmp_path, 3, STATE)

    def full(descriptor: int) -> None:
        raise OSError(28, os.strerror(28))

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(
        OutputError, match=r"cannot write checkpoint .*frame_0006.npz: No space left on device"
    ):
        checkpoint.save(tmp_path, 6, STATE)
    assert [path.name for path in tmp_path.iterdir()] == ["frame_0003.npz"]


def frame(index: int) -> Frame:
    return Frame(index, index / 24, (), {"dust.spread": 0.1 * index, "substeps": 2.0})


def test_metrics_have_a_row_a_frame(tmp_path: Path) -> None:
    path = tmp_path / "metrics.csv"
    with Metrics(path) as metrics:
        for index in range(3):
            metrics.write(frame(index), 0.25)
    assert path.read_text().splitlines()[:2] == [
        "frame,time,substeps,step_seconds,dust.spread",
        "0,0.0,2,0.25,0.0",
    ]
    assert read(path)[2] == {
        "frame": 2,
        "time": 2 / 24,
        "substeps": 2,
        "step_seconds": 0.25,
        "dust.spread": 0.1 * 2,
    }


def test_a_resumed_run_drops_later_and_torn_rows(tmp_path: Path) -> None:
    path, straight = tmp_path / "metrics.csv", tmp_path / "straight.csv"
    for target, count in ((path, 5), (straight, 7)):
        with Metrics(target) as metrics:
            for index in range(count):
                metrics.write(frame(index), 0.25)
    with path.open("a") as file:
        file.write("5,0.2083,2,0.2")
    with Metrics(path, kept=2) as metrics:
        for index in range(3, 7):
            metrics.write(frame(index), 0.25)
    assert path.read_bytes() == straight.read_bytes()


@pytest.mark.parametrize(
    "damage", [b"\xff\xfe\n", b"a,b\n", b"3,0.1\n", b"3,0.1,2,0.2,0.3,0.4\n", b"3,0.1,2,0.2,many\n"]
)
def test_damaged_metrics_are_an_output_error(tmp_path: Path, damage: bytes) -> None:
    path = tmp_path / "metrics.csv"
    with Metrics(path) as metrics:
        metrics.write(frame(0), 0.25)
    header, row = path.read_bytes().splitlines(keepends=True)
    for text in (header + damage + row, damage + row):
        path.write_bytes(text)
        with pytest.raises(OutputError, match=r"metrics.csv: damaged, or no table of metrics"):
            Metrics(path, kept=0)
        assert path.read_bytes() == text


def test_metrics_that_do_not_begin_leave_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(source: Path, target: Path) -> None:
        raise OSError(28, os.strerror(28))

    monkeypatch.setattr(os, "replace", full)
    with pytest.raises(OutputError, match="No space left"):
        Metrics(tmp_path / "metrics.csv")
    assert list(tmp_path.iterdir()) == []


def test_a_changed_set_of_diagnostics_is_refused(tmp_path: Path) -> None:
    with Metrics(tmp_path / "metrics.csv") as metrics:
        metrics.write(frame(0), 0.0)
        with pytest.raises(ValueError, match="same diagnostics"):
            metrics.write(Frame(1, 0.1, (), {"substeps": 1.0}), 0.0)


def test_metrics_that_cannot_be_written_are_an_output_error(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(OutputError, match=r"cannot write .*metrics.csv: Not a directory"):
        Metrics(tmp_path / "file" / "metrics.csv")


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_the_first_signal_is_noted_and_the_second_stops(number: signal.Signals) -> None:
    told: list[bool] = []
    before = signal.getsignal(number)
    with Interrupts(lambda: told.append(True)) as interrupts:
        assert interrupts.pending is None
        signal.raise_signal(number)
        assert interrupts.pending is number
        with pytest.raises(KeyboardInterrupt):
            signal.raise_signal(number)
    assert told == [True]
    assert signal.getsignal(number) is before
