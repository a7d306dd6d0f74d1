"""Snapshots of stars from files: GADGET HDF5, NPZ and CSV.

- GADGET: `Header` and `PartTypeN/{Coordinates, Velocities, Masses}`, masses from the header's
  `MassTable` where a type has none. A `Parameters` group with UnitLength_in_cm, UnitMass_in_g and
  UnitVelocity_in_cm_per_s is converted to the units of the system, where these are known.
- NPZ: arrays `position` (n, 3), `velocity` (n, 3), `mass` (n,), as `tianim export --format npz` writes.
- CSV: a first line with the names x, y, z, vx, vy, vz, mass, in any order, others are passed over.
"""

from __future__ import annotations

import csv
import warnings
import zipfile
from collections.abc import Mapping
from functools import lru_cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tianim.errors import SceneError

Floats = NDArray[np.float64]

# Masses and lengths may be in SI: 2e30 kg, 1e21 m.
HUGE = 1e50
# A scene names one or two such files; they are read when checked and again when built.
CACHED_FILES = 2
GADGET_SUFFIXES = (".hdf5", ".h5")
SUFFIXES = (*GADGET_SUFFIXES, ".npz", ".csv")
CSV_COLUMNS = {"position": ("x", "y", "z"), "velocity": ("vx", "vy", "vz"), "mass": ("mass",)}


class Units(NamedTuple):
    """The units of a system: length [cm], mass [g], velocity [cm/s]."""

    length: float
    mass: float
    velocity: float


# IAU 2012 and 2015 nominal values, CODATA 2018 for G in the solar mass; a year is Julian.
KILOPARSEC, ASTRONOMICAL_UNIT, SOLAR_MASS, YEAR = 3.0856775814913673e21, 1.495978707e13, 1.98841e33, 3.15576e7
UNITS: Mapping[str, Units] = {
    "galactic": Units(KILOPARSEC, 1e10 * SOLAR_MASS, 1e5),
    "solar": Units(ASTRONOMICAL_UNIT, SOLAR_MASS, ASTRONOMICAL_UNIT / YEAR),
    "si": Units(1e2, 1e3, 1e2),
}


class Snapshot(NamedTuple):
    """Position (n, 3) [length], velocity (n, 3) [velocity], mass (n,) [mass] or None where not asked for."""

    position: Floats
    velocity: Floats
    mass: Floats | None


def read_snapshot(
    path: Path, types: tuple[int, ...] | None = None, units: Units | None = None, massless: bool = False
) -> Snapshot:
    """The stars of a file. SceneError says what is wrong with it.

    `types` chooses GADGET's; `units` are those to convert to, where the file states its own.
    """
    try:
        stamp = path.stat().st_mtime_ns
    except OSError as error:
        raise SceneError(f"{path}: cannot be read ({error.strerror})") from error
    read, own = _read(path, stamp, types, massless)
    if own is None or units is None:
        return read
    mass = None if read.mass is None else read.mass * (own.mass / units.mass)
    return Snapshot(
        read.position * (own.length / units.length), read.velocity * (own.velocity / units.velocity), mass
    )


@lru_cache(maxsize=CACHED_FILES)
def _read(
    path: Path, stamp: int, types: tuple[int, ...] | None, massless: bool
) -> tuple[Snapshot, Units | None]:
    """The stars as the file has them, and the units that it states."""
    suffix = path.suffix.lower()
    if suffix not in SUFFIXES:
        raise SceneError(f"{path}: not a snapshot; must be one of {', '.join(SUFFIXES)}")
    if types is not None and suffix not in GADGET_SUFFIXES:
        raise SceneError(f"{path}: only GADGET files have types; leave types out")
    names = ("position", "velocity") if massless else ("position", "velocity", "mass")
    units = None
    try:
        if suffix in GADGET_SUFFIXES:
            arrays, units = _gadget(path, types, names)
        else:
            arrays = _npz(path, names) if suffix == ".npz" else _csv(path, names)
    except OSError as error:
        raise SceneError(f"{path}: cannot be read ({error.strerror or _first_line(error)})") from error
    except (ValueError, LookupError, TypeError, zipfile.BadZipFile) as error:
        raise SceneError(f"{path}: not a readable {suffix} file ({_first_line(error)})") from error
    return _checked(path, arrays), units


def _npz(path: Path, names: tuple[str, ...]) -> dict[str, Floats]:
    if not zipfile.is_zipfile(path):
        raise ValueError("not an archive of arrays")
    with np.load(path, allow_pickle=False) as archive:
        _need(path, names, archive.files, "array")
        return {name: archive[name] for name in names}


def _csv(path: Path, names: tuple[str, ...]) -> dict[str, Floats]:
    with path.open(newline="", encoding="utf-8-sig") as file:
        head = [name.strip().lower() for name in next(csv.reader(file), [])]
    wanted = [column for name in names for column in CSV_COLUMNS[name]]
    _need(path, wanted, head, "column")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of a file without rows, which is told below
        columns_there = [head.index(name) for name in wanted]
        table = np.loadtxt(path, delimiter=",", skiprows=1, usecols=columns_there, ndmin=2, comments=None)
    if not len(table):
        raise SceneError(f"{path}: holds no stars")
    columns = {"position": table[:, :3], "velocity": table[:, 3:6]}
    return columns if len(names) == 2 else {**columns, "mass": table[:, 6]}


def _need(path: Path, wanted: Any, there: Any, what: str) -> None:
    for name in wanted:
        if name not in there:
            raise SceneError(f"{path}: holds no {what} called {name}; there are {', '.join(there) or 'none'}")


def _gadget(
    path: Path, types: tuple[int, ...] | None, names: tuple[str, ...]
) -> tuple[dict[str, Floats], Units | None]:
    import h5py  # a tenth of a second that other scenes should not pay

    with h5py.File(path, "r") as file:
        if "Header" not in file:
            raise SceneError(f"{path}: holds no group called Header; there are {', '.join(file) or 'none'}")
        parameters = dict(file["Parameters"].attrs) if "Parameters" in file else {}
        if parameters.get("ComovingIntegrationOn", 0):
            raise SceneError(
                f"{path}: a cosmological snapshot (comoving coordinates), which is not supported"
            )
        parts = int(file["Header"].attrs.get("NumFilesPerSnapshot", 1))
        if parts > 1:
            raise SceneError(f"{path}: one of {parts} files of a snapshot; join them into one first")
        there = [number for number in range(6) if f"PartType{number}" in file]
        for number in types or ():
            if number not in there:
                kinds = ", ".join(f"PartType{one}" for one in there) or "none"
                raise SceneError(f"{path}: holds no group called PartType{number}; there are {kinds}")
        table = np.asarray(file["Header"].attrs.get("MassTable", np.zeros(6)), np.float64)
        blocks = [
            _gadget_type(path, file[f"PartType{number}"], float(table[number]), names)
            for number in (there if types is None else sorted(set(types)))
        ]
    if not blocks:
        raise SceneError(f"{path}: holds no group called PartType0 to PartType5")
    arrays = {name: np.concatenate([block[name] for block in blocks]) for name in names}
    return arrays, _units(path, parameters)


def _gadget_type(path: Path, group: Any, mass: float, names: tuple[str, ...]) -> dict[str, Floats]:
    datasets = {"position": "Coordinates", "velocity": "Velocities", "mass": "Masses"}
    block = {}
    for name in names:
        if datasets[name] in group:
            block[name] = np.asarray(group[datasets[name]], np.float64)
        elif name == "mass" and mass > 0.0:
            block[name] = np.full(len(block["position"]), mass)
        else:
            where = " and no entry of MassTable" if name == "mass" else ""
            raise SceneError(
                f"{path}: {group.name[1:]} holds no dataset called {datasets[name]}{where}; "
                f"there are {', '.join(group) or 'none'}"
            )
    return block


def _units(path: Path, parameters: Mapping[str, Any]) -> Units | None:
    """The units that a file states, in cgs."""
    names = ("UnitLength_in_cm", "UnitMass_in_g", "UnitVelocity_in_cm_per_s")
    if not any(name in parameters for name in names):
        return None
    _need(path, names, list(parameters), "unit in Parameters")
    length, mass, velocity = (float(parameters[name]) for name in names)
    if not (length > 0.0 and mass > 0.0 and velocity > 0.0):
        raise SceneError(
            f"{path}: units in Parameters must be greater than 0: {length:g}, {mass:g}, {velocity:g}"
        )
    return Units(length, mass, velocity)


def _checked(path: Path, arrays: Mapping[str, Floats]) -> Snapshot:
    count = len(np.atleast_1d(arrays["position"]))
    if count == 0:
        raise SceneError(f"{path}: holds no stars")
    checked = {}
    for name, values in arrays.items():
        shape = (count,) if name == "mass" else (count, 3)
        if values.shape != shape or values.dtype.kind not in "fiu":
            raise SceneError(
                f"{path}: {name} has shape {values.shape} of {values.dtype}; must be {shape} numbers"
            )
        values = values.astype(np.float64)
        bad = ~(np.abs(values) <= HUGE)
        if bad.any():
            star = int(np.argwhere(bad)[0][0])
            raise SceneError(f"{path}: {name} of star {star} is not finite or beyond {HUGE:g}")
        values.flags.writeable = False  # shared through the cache
        checked[name] = values
    mass = checked.get("mass")
    if mass is not None and not (mass > 0.0).all():
        star = int(np.flatnonzero(mass <= 0.0)[0])
        raise SceneError(
            f"{path}: mass of star {star} is {mass[star]:g}; must be greater than 0 (test particles that "
            "pull on nothing: massless: true)"
        )
    return Snapshot(checked["position"], checked["velocity"], mass)


def _first_line(error: BaseException) -> str:
    return str(error).strip().split("\n")[0] or type(error).__name__
