"""Cusick's drape test: a disc of cloth on a smaller one, and the shadow that it throws.

    drape coefficient = (shadow - disc of 18 cm) / (disc of 30 cm - disc of 18 cm)

The cloth is held between two discs of 18 cm, what hangs over falls in folds. Fabrics scatter by more than
simulations do (Kenkare et al., doi:10.1080/00405000701489222): their order is what is asked for, by
steps larger than the instrument's repeatability of 2 % points. They differ in their bending length
c = (B / w)^(1/3), w the weight per area.

Limits: the cloth is less stiff in its plane than fabrics are, by 0.2 % of strain, so that it comes to rest
soon; it may pass through itself.
"""

import tempfile
from functools import lru_cache, partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from scipy.signal import find_peaks
from scipy.spatial import Delaunay

from tianim.spatial.mesh_files import read_mesh
from tianim.validate.case import Case
from tianim.validate.springs_scenes import (
    DOWN,
    GRAVITY,
    Floats,
    calm,
    pinned,
    places,
    projective,
    run,
    springs,
)

SOURCE = "order of fabrics by their bending length; Cusick's test, BS 5058: 1973"
# Radii of the discs [m], cells [m], mass per area [kg/m2], stretch [N/m].
INNER, OUTER, CELL, DENSITY, STRETCH = 0.09, 0.15, 0.01, 0.2, 50.0
# Bending lengths [m], silk to stiff cotton.
LENGTHS = (0.01, 0.02, 0.03, 0.04)
PIXEL = 5e-4  # of the shadow [m]
UNEVEN = 2e-3  # how far its border is from flat at the start [m], in all waves round it up to WAVES
WAVES = 12
SECONDS = 4.0


class Draped(NamedTuple):
    """coefficient  of drape [1]; folds round the border."""

    coefficient: float
    folds: int


def disc(cell: float) -> tuple[Floats, Any]:
    """Points (n, 2) evenly spread in a circle, without any symmetry, and triangles."""
    turn = np.linspace(0.0, 2.0 * np.pi, round(2.0 * np.pi * OUTER / cell), endpoint=False)
    border = OUTER * np.stack([np.cos(turn), np.sin(turn)], axis=1)
    k = np.arange(round(np.pi * OUTER**2 / (0.5 * np.sqrt(3.0) * cell**2))) + 0.5
    r, angle = OUTER * np.sqrt(k / len(k)), np.pi * (3.0 - np.sqrt(5.0)) * k
    inner = np.stack([r * np.cos(angle), r * np.sin(angle)], axis=1)[r < OUTER - 0.6 * cell]
    points = np.concatenate([border, inner])
    return points, Delaunay(points).simplices


def shadow(points: Floats, triangles: Any) -> float:
    """Area that triangles cover in a plane [m2], by pixels."""
    size = int(2.1 * OUTER / PIXEL)
    covered = np.zeros((size, size), np.bool_)
    for corners in (points[triangles] + 1.05 * OUTER) / PIXEL - 0.5:
        low = np.floor(corners.min(axis=0)).astype(int)
        high = np.ceil(corners.max(axis=0)).astype(int) + 1
        at = np.stack(np.meshgrid(*map(np.arange, low, high), indexing="ij"), axis=-1)
        side = np.roll(corners, -1, axis=0) - corners
        away = at[:, :, None] - corners
        turn = side[:, 0] * away[..., 1] - side[:, 1] * away[..., 0]
        inside = (turn >= 0.0).all(axis=-1) | (turn <= 0.0).all(axis=-1)
        covered[low[0] : high[0], low[1] : high[1]] |= inside
    return float(covered.sum()) * PIXEL**2


@lru_cache(maxsize=8)
def draped(length: float, cell: float = CELL) -> Draped:
    """A disc of cloth of a bending length [m] that has come to rest."""
    flat, triangles = disc(cell)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "disc.obj"
        text = [f"v {x:.9f} 0 {z:.9f}\n" for x, z in flat]
        text += [f"f {a + 1} {b + 1} {c + 1}\n" for a, b, c in triangles]
        path.write_text("".join(text))
        mesh = read_mesh(path)  # its points are not in the order of the file
        radius = np.hypot(mesh.vertices[:, 0], mesh.vertices[:, 2])
        cloth = {
            "kind": "mesh", "file": path, "density": DENSITY, "stretch": STRETCH,
            "bend": DENSITY * GRAVITY * length**3, "damping": 2e-3,
        }  # fmt: skip
        system = springs(
            cloth, pins=pinned(np.flatnonzero(radius <= INNER).tolist()), gravity=DOWN, air=calm(8.0),
            **projective("implicit_euler", iterations=20),
        )  # fmt: skip
    x, random = places(system), np.random.default_rng(1)
    turn = np.arctan2(x[:, 2], x[:, 0])
    waves = [
        random.normal() * np.cos(k * turn + random.uniform(0.0, 2.0 * np.pi)) for k in range(2, WAVES + 1)
    ]
    x[:, 1] += UNEVEN * np.maximum(radius - INNER, 0.0) / (OUTER - INNER) * sum(waves)
    system.write("position", x)
    x = places(run(system, SECONDS))[:, [0, 2]]
    small, large = np.pi * INNER**2, np.pi * OUTER**2
    border = np.flatnonzero(radius > OUTER - 1e-6)
    border = border[np.argsort(turn[border])]
    return Draped((shadow(x, mesh.triangles) - small) / (large - small), _folds(x[border]))


def _folds(border: Floats) -> int:
    """Maxima of the radius round the border, of a tenth of its range at least."""
    waves = np.fft.rfft(np.hypot(*border.T))
    waves[WAVES + 5 :] = 0.0
    r = np.fft.irfft(waves, 720)
    top, _ = find_peaks(np.tile(r, 3), prominence=0.1 * np.ptp(r))
    return int(((top >= 720) & (top < 1440)).sum())


def coefficient(length: float) -> float:
    """Of drape."""
    return draped(length).coefficient


def least_step() -> float:
    """The least by which the coefficient grows from one fabric to the next stiffer."""
    return float(np.diff([draped(length).coefficient for length in LENGTHS]).min())


def folds(length: float) -> float:
    """Round the border."""
    return float(draped(length).folds)


def finer() -> float:
    """By how much the coefficient differs with cells of two thirds."""
    return abs(draped(LENGTHS[1], CELL / 1.5).coefficient - draped(LENGTHS[1]).coefficient)


CASES: tuple[Case, ...] = (
    Case(
        "springs", "Cusick's drape, bending lengths 1, 2, 3 and 4 cm: least step of the coefficient",
        least_step, 0.04, SOURCE, comparison="above", slow=True,
    ),
    Case(
        "springs", "Cusick's drape, bending length 1 cm: coefficient", partial(coefficient, LENGTHS[0]),
        (0.0, 0.3), "limp: most of what hangs over hangs down", comparison="between", slow=True,
    ),
    Case(
        "springs", "Cusick's drape, bending length 4 cm: coefficient", partial(coefficient, LENGTHS[-1]),
        (0.9, 1.0), "stiff: 6 cm of it sink by a few mm", comparison="between", slow=True,
    ),
    *(
        Case(
            "springs", f"Cusick's drape, bending length {100 * length:g} cm: folds", partial(folds, length),
            (4.0, 10.0), "as are counted on fabrics", comparison="between", slow=True,
        )
        for length in LENGTHS[:3]
    ),
    Case(
        "springs", "Cusick's drape, bending length 2 cm, cells of 1 cm and of 2/3: coefficients differ by",
        finer, 0.05, "resolution does not matter", comparison="below", slow=True,
    ),
)  # fmt: skip
