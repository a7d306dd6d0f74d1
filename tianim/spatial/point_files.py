"""Points from files: positions and, where there are some, velocities."""

import zipfile
from functools import lru_cache
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tianim.errors import SceneError
from tianim.params import LARGE

POINT_SUFFIXES = (".npz", ".ply", ".vtu")
# A scene names one or two such files; they are read when checked and again when built.
CACHED_FILES = 4

Floats = NDArray[np.float64]


class PointData(NamedTuple):
    """Position (n, 3) [m] and velocity (n, 3) [m/s] or None."""

    position: Floats
    velocity: Floats | None


def read_points(path: Path) -> PointData:
    """The points of an NPZ, PLY or VTU file. SceneError says what is wrong with it."""
    try:
        stamp = path.stat().st_mtime_ns
    except OSError as error:
        raise SceneError(f"{path}: cannot be read ({error.strerror})") from error
    return _read(path, stamp)


@lru_cache(maxsize=CACHED_FILES)
def _read(path: Path, stamp: int) -> PointData:
    suffix = path.suffix.lower()
    if suffix not in POINT_SUFFIXES:
        raise SceneError(f"{path}: not a point file; must be one of {', '.join(POINT_SUFFIXES)}")
    try:
        arrays = _npz(path) if suffix == ".npz" else _mesh_points(path)
    except OSError as error:
        raise SceneError(f"{path}: cannot be read ({error.strerror or error})") from error
    except (Exception, SystemExit) as error:  # readers raise whatever parsing runs into; meshio exits
        raise SceneError(f"{path}: not a readable {suffix} file ({_first_line(error)})") from error
    if "position" not in arrays:
        raise SceneError(f"{path}: holds no array called position; there are {', '.join(arrays) or 'none'}")
    position = _vectors(arrays["position"], path, "position")
    velocity = _vectors(arrays["velocity"], path, "velocity") if "velocity" in arrays else None
    if velocity is not None and len(velocity) != len(position):
        raise SceneError(f"{path}: {len(position)} positions but {len(velocity)} velocities")
    return PointData(position, velocity)


def _npz(path: Path) -> dict[str, NDArray[np.generic]]:
    if not zipfile.is_zipfile(path):
        raise ValueError("not an archive of arrays")
    with np.load(path, allow_pickle=False) as archive:
        return {name: archive[name] for name in archive.files if name in ("position", "velocity")}


def _mesh_points(path: Path) -> dict[str, NDArray[np.generic]]:
    """Points of a PLY or VTU. PLY has no vectors: three columns make one."""
    import meshio

    # Not meshio.read, which ends the process where a file is bad.
    mesh = meshio.ply.read(str(path)) if path.suffix.lower() == ".ply" else meshio.vtu.read(str(path))
    arrays = {"position": np.asarray(mesh.points)}
    for names in (("velocity",), ("velocity_x", "velocity_y", "velocity_z"), ("vx", "vy", "vz")):
        if all(name in mesh.point_data for name in names):
            columns = [np.asarray(mesh.point_data[name]) for name in names]
            arrays["velocity"] = columns[0] if len(columns) == 1 else np.stack(columns, axis=1)
    return arrays


def _vectors(values: NDArray[np.generic], path: Path, name: str) -> Floats:
    if values.ndim != 2 or values.shape[1] not in (2, 3) or values.dtype.kind not in "fiu":
        raise SceneError(f"{path}: {name} has shape {values.shape} of {values.dtype}; must be (n, 3) numbers")
    vectors = np.zeros((len(values), 3))
    vectors[:, : values.shape[1]] = values
    if not (np.abs(vectors) <= LARGE).all():
        raise SceneError(f"{path}: {name} holds numbers that are not finite or beyond {LARGE:g}")
    vectors.flags.writeable = False  # shared through the cache
    return vectors


def _first_line(error: BaseException) -> str:
    return str(error).strip().split("\n")[0] or type(error).__name__
