"""GADGET: HDF5 snapshots as galaxy codes write them; yt, pynbody and GADGET's own tools read them.

One file a part and frame: `Header`, `Parameters` with the units in cgs, and a group `PartTypeN` with
Coordinates, Velocities, Masses and ParticleIDs; other arrays keep their names. Stars with an array
`component` are sorted into types by it: component 0 is PartType1, and so on, the sixth and all after
it in PartType5 (GADGET calls 1 halo, 2 disk, 3 bulge, 4 stars; 0 is gas, which has other arrays).
Without it all are PartType4. Of a part without `mass` each point weighs 1, by the header's MassTable.

Units are those that the part names; positions without one are in metres. Where GADGET has no word for a
unit (a system with G = 1), there is no `Parameters`, and readers take their own for granted. `Time` is
that of the frame [s], not of the system. The format is described in GADGET-4's documentation, chapter
"Snapshot file format", https://wwwmpa.mpa-garching.mpg.de/gadget4/.
"""

from collections.abc import Mapping
from pathlib import Path

import h5py
import numpy as np
from numpy.typing import NDArray

from tianim.errors import FormatError
from tianim.export.axes import LENGTH_UNITS, USUAL_UNITS
from tianim.export.files import whole_file
from tianim.export.formats import Stamp
from tianim.export.hdf import new_hdf5, require_room
from tianim.export.parts import byte_count
from tianim.frame import Array, Part

# Our arrays by GADGET's names.
DATASETS = {
    "position": "Coordinates",
    "velocity": "Velocities",
    "mass": "Masses",
    "id": "ParticleIDs",
    "potential": "Potential",
    "acceleration": "Acceleration",
}
TYPES, STARS, LAST = 6, 4, 5
# A reader finds the domain by BoxSize, 0 for open space; yt then takes the extent of the stars.
OPEN = 0.0
# Units in cgs: IAU 2012 and 2015 nominal values; a year is Julian.
KILOPARSEC, ASTRONOMICAL_UNIT, SOLAR_MASS, YEAR = 3.0856775814913673e21, 1.495978707e13, 1.98841e33, 3.15576e7
LENGTHS = {"m": 1e2, "km": 1e5, "au": ASTRONOMICAL_UNIT, "pc": 1e-3 * KILOPARSEC, "kpc": KILOPARSEC}
MASSES = {"kg": 1e3, "Msun": SOLAR_MASS, "1e10 Msun": 1e10 * SOLAR_MASS}
VELOCITIES = {"m/s": 1e2, "km/s": 1e5, "au/yr": ASTRONOMICAL_UNIT / YEAR}


def write_part(path: Path, part: Part, stamp: Stamp) -> None:
    """Write one part of one frame."""
    arrays = _datasets(part)
    kinds = _types(part)
    counts = np.bincount(kinds, minlength=TYPES)
    with whole_file(path) as temporary:
        require_room(path, byte_count(part))
        with new_hdf5(temporary) as file:
            _write_header(file, counts, "Masses" not in arrays, stamp)
            units = _units(part, stamp)
            if units:
                file.create_group("Parameters").attrs.update(units)
            for kind in np.flatnonzero(counts) if len(kinds) else [STARS]:
                chosen = slice(None) if counts[kind] == len(kinds) else kinds == kind
                group = file.create_group(f"PartType{kind}")
                for name, values in arrays.items():
                    group[name] = values[chosen]


def _datasets(part: Part) -> dict[str, Array]:
    """All arrays under their names in the file; FormatError where two have one name."""
    arrays: dict[str, Array] = {}
    for name, values in {"position": part.position, **part.data}.items():
        called = DATASETS.get(name, name)
        if called in arrays:
            raise FormatError(
                f"format 'gadget': part {part.name!r} has an array called {name!r}, which gadget keeps for "
                f"{next(one for one, other in DATASETS.items() if other == called)}"
            )
        arrays[called] = values.astype(np.uint8) if values.dtype.kind == "b" else values
    if "ParticleIDs" not in arrays:
        arrays["ParticleIDs"] = np.arange(len(part.position), dtype=np.int32)
    return arrays


def _types(part: Part) -> NDArray[np.int64]:
    """GADGET's type of each point."""
    component = part.data.get("component")
    if component is None or component.ndim != 1 or component.dtype.kind not in "iu":
        return np.full(len(part.position), STARS)
    return np.clip(component.astype(np.int64) + 1, 1, LAST)


def _write_header(file: h5py.File, counts: NDArray[np.int64], weightless: bool, stamp: Stamp) -> None:
    # No HubbleParam: pynbody takes a file that has one for comoving.
    attributes = {
        "NumPart_ThisFile": counts.astype(np.int32),
        "NumPart_Total": counts.astype(np.uint32),
        "NumPart_Total_HighWord": np.zeros(TYPES, np.uint32),
        "MassTable": np.where(counts > 0, 1.0 if weightless else 0.0, 0.0),
        "Time": stamp.time,
        "Redshift": 0.0,
        "BoxSize": OPEN,
        "NumFilesPerSnapshot": 1,
    }
    header = file.create_group("Header")
    for name, value in attributes.items():
        header.attrs[name] = value


def _units(part: Part, stamp: Stamp) -> Mapping[str, float]:
    """The attributes of `Parameters`; empty where a unit has no value in cgs."""
    named = {name: part.units.get(name, USUAL_UNITS.get(name, "kg")) for name in ("position", "velocity")}
    length, velocity = LENGTHS.get(named["position"]), VELOCITIES.get(named["velocity"])
    mass = MASSES.get(part.units.get("mass", "kg"))
    if length is None or velocity is None or mass is None:
        return {}
    # What the axes of the output have scaled.
    length /= stamp.axes.scale if named["position"] in LENGTH_UNITS else 1.0
    velocity /= stamp.axes.scale if named["velocity"] in LENGTH_UNITS else 1.0
    return {
        "UnitLength_in_cm": length,
        "UnitMass_in_g": mass,
        "UnitVelocity_in_cm_per_s": velocity,
        "ComovingIntegrationOn": 0,
    }
