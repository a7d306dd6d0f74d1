"""Models configs/meshes/bunny.ply: a sitting bunny, ours to give away, out of balls that melt together.

python tools/bunny.py FILE          (needs pyvista)
"""

import sys

import numpy as np
import pyvista
from numpy.typing import NDArray

Floats = NDArray[np.float64]

# One unit is the height of the bunny, which looks along +z; it sits on y = 0.
SAMPLES = 96
TRIANGLES = 3000
MELT = 0.035
# Ends of each limb and its radius at both; x is mirrored where it is not 0.
LIMBS = (
    ((0.0, 0.22, -0.08), (0.0, 0.30, 0.02), 0.20, 0.17),  # body
    ((0.0, 0.40, 0.08), (0.0, 0.50, 0.16), 0.12, 0.13),  # neck and head
    ((0.0, 0.47, 0.24), (0.0, 0.47, 0.26), 0.075, 0.06),  # snout
    ((0.06, 0.60, 0.12), (0.13, 0.93, 0.02), 0.045, 0.055),  # ears
    ((0.15, 0.13, -0.06), (0.16, 0.06, 0.14), 0.12, 0.055),  # hind legs
    ((0.08, 0.22, 0.16), (0.08, 0.045, 0.22), 0.055, 0.045),  # forelegs
    ((0.0, 0.17, -0.30), (0.0, 0.18, -0.31), 0.08, 0.075),  # tail
)


def limb(p: Floats, start: Floats, end: Floats, first: float, last: float) -> Floats:
    """Distance from a rod whose radius goes from `first` to `last`, at `p` (..., 3)."""
    axis = end - start
    share = np.clip((p - start) @ axis / (axis @ axis), 0.0, 1.0)
    return np.asarray(
        np.linalg.norm(p - start - share[..., None] * axis, axis=-1) - first - share * (last - first)
    )


def melted(distances: list[Floats]) -> Floats:
    """The union of all, smooth over about MELT."""
    return np.asarray(-MELT * np.log(sum(np.exp(-d / MELT) for d in distances)))


def main(path: str) -> None:
    """Sample the distance, cut it at 0, thin the triangles out."""
    low, high = np.array([-0.4, -0.05, -0.5]), np.array([0.4, 1.05, 0.45])
    spacing = float((high - low).max()) / SAMPLES
    shape = np.ceil((high - low) / spacing).astype(int) + 1
    axes = [low[k] + spacing * np.arange(shape[k]) for k in range(3)]
    p = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)
    sides = [
        (np.array(start) * mirror, np.array(end) * mirror, first, last)
        for start, end, first, last in LIMBS
        for mirror in ([1.0, 1.0, 1.0], [-1.0, 1.0, 1.0])[: 2 if start[0] else 1]
    ]
    value = melted([limb(p, *side) for side in sides])
    grid = pyvista.ImageData(dimensions=tuple(shape), spacing=(spacing,) * 3, origin=tuple(low))
    grid["distance"] = value.ravel(order="F")
    surface = grid.contour([0.0], scalars="distance").triangulate().clean()
    surface = surface.decimate(1.0 - TRIANGLES / surface.n_cells)
    surface.clear_data()
    surface.compute_normals(consistent_normals=True, auto_orient_normals=True, inplace=True)
    surface.clear_data()
    surface.save(path)


if __name__ == "__main__":
    main(sys.argv[1])
