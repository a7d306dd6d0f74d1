"""NPZ: one uncompressed NumPy archive a part and frame.

Keys: `position`, `triangles` or `segments`, each data array by its name, data per cell as
`cell.<name>`, and `frame` and `time` [s].
"""

from pathlib import Path

import numpy as np

from tianim.errors import FormatError
from tianim.export.files import whole_file
from tianim.export.formats import Stamp
from tianim.export.parts import cell_data_of, cells_of
from tianim.frame import Mesh, Part

CELL_PREFIX = "cell."
# Names that `numpy.savez` takes as its own arguments.
ARGUMENTS = ("file", "allow_pickle")


def write_part(path: Path, part: Part, stamp: Stamp) -> None:
    """Write one part of one frame."""
    arrays: dict[str, object] = {"position": part.position, "frame": stamp.index, "time": stamp.time}
    cells = cells_of(part)
    if cells is not None:
        arrays["triangles" if isinstance(part, Mesh) else "segments"] = cells
    for name, values in part.data.items():
        if name in arrays or name in ARGUMENTS:
            raise FormatError(
                f"format 'npz': part {part.name!r} has an array called {name!r}, which npz keeps for itself"
            )
        arrays[name] = values
    arrays.update({CELL_PREFIX + name: values for name, values in cell_data_of(part).items()})
    with whole_file(path) as temporary, temporary.open("wb") as file:
        np.savez(file, **arrays)  # type: ignore[arg-type]
