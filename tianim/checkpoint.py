"""Checkpoints: the state of a simulation in an NPZ file, uncompressed and without pickles.

A file appears whole or not at all: it is written beside its place, flushed to the disk, then
renamed. ZIP keeps a CRC-32 of each array, and the archive's comment the number of arrays, so that
a file torn by a power cut or a full disk is known and passed over for the one before it; the last
two are kept.
"""

import contextlib
import os
import re
import zipfile
import zlib
from collections.abc import Mapping
from pathlib import Path
from typing import IO

import numpy as np
from numpy.typing import NDArray

from tianim.errors import OutputError

KEPT = 2
_NAME = re.compile(r"frame_(\d+)\.npz")


def save(folder: Path, index: int, state: Mapping[str, NDArray[np.generic]]) -> Path:
    """Write the state after frame `index`, then drop all but the last two up to it.

    Later ones were torn, or the run would have gone on from there. OutputError: disk full, ...
    """
    path = folder / f"frame_{index:04d}.npz"
    beside = folder / f".{path.name}.tmp"
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with beside.open("wb") as file:
            _write(file, state)
            file.flush()
            os.fsync(file.fileno())
        os.replace(beside, path)
    except OSError as error:
        raise OutputError(f"cannot write checkpoint {path}: {error.strerror or error}") from error
    finally:
        with contextlib.suppress(OSError):
            beside.unlink(missing_ok=True)
    there = _by_index(folder)
    kept = [old for number, old in there if number <= index][-KEPT:]
    for _, old in there:
        if old not in kept:
            old.unlink(missing_ok=True)
    return path


def newest(folder: Path) -> tuple[int, dict[str, NDArray[np.generic]]] | None:
    """The frame and state of the newest whole checkpoint; None where there is none."""
    for index, path in reversed(_by_index(folder)):
        state = _read(path)
        if state is not None:
            return index, state
    return None


def drop_oldest(folder: Path) -> None:
    """Free the room of the older of two checkpoints."""
    for _, old in _by_index(folder)[:-1]:
        old.unlink(missing_ok=True)


def _write(file: IO[bytes], state: Mapping[str, NDArray[np.generic]]) -> None:
    # Not np.savez: it takes names as keyword arguments, of which it keeps some for itself.
    with zipfile.ZipFile(file, "w", zipfile.ZIP_STORED) as archive:
        archive.comment = str(len(state)).encode()
        for name, value in state.items():
            with archive.open(f"{name}.npy", "w", force_zip64=True) as member:
                np.lib.format.write_array(member, np.asarray(value), allow_pickle=False)


def _read(path: Path) -> dict[str, NDArray[np.generic]] | None:
    try:
        with zipfile.ZipFile(path) as archive:
            whole = archive.comment == str(len(archive.namelist())).encode()
            if not whole or archive.testzip() is not None:
                return None
        with np.load(path, allow_pickle=False) as arrays:
            return {name: arrays[name] for name in arrays.files}
    except (OSError, ValueError, zipfile.BadZipFile, zlib.error, EOFError, RuntimeError):
        return None  # RuntimeError: a torn header asks for a password or another compression


def _by_index(folder: Path) -> list[tuple[int, Path]]:
    if not folder.is_dir():
        return []
    found = [(_NAME.fullmatch(path.name), path) for path in folder.iterdir()]
    return sorted((int(match[1]), path) for match, path in found if match)
