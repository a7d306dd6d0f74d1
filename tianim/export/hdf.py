"""HDF5 files that fail quietly: one error of the disk, not a line for every array of the file.

After a failed write HDF5 tries again for each object that is let go of, prints each failure
and may end the process. So room is asked for before anything is written, and a file that
failed all the same is closed into nothing, as it is lost anyway.
"""

import errno
import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import h5py

# Room beyond the arrays, in parts of their bytes (cells, tables) and in bytes (caches).
FACTOR, MARGIN = 2, 4 << 20


def require_room(path: Path, size: int) -> None:
    """OSError where the disk of `path` has not room for arrays of `size` bytes in HDF5."""
    if shutil.disk_usage(path.parent).free < FACTOR * size + MARGIN:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


@contextmanager
def new_hdf5(path: Path) -> Iterator[h5py.File]:
    """A new HDF5 file, closed at the end; OSError where it cannot be written."""
    # Not libver="latest", which would put the time of making into the groups.
    file = h5py.File(path, "w")
    try:
        yield file
        # Closing alone would hide a failure to write.
        file.flush()
        file.close()
    except BaseException as error:
        with suppress(Exception), open(os.devnull, "r+b") as nothing:
            os.dup2(nothing.fileno(), file.id.get_vfd_handle())
            file.close()
        if isinstance(error, RuntimeError):
            raise OSError(str(error)) from error
        raise
