"""Strips of rope, sheet and mesh that bend under their weight or buckle, held against the elastica.

It is exact for what cannot be stretched; pieces here stretch by some thousandths. A strip is clamped by its
first two rows of points, which makes half a cell stiff: it is made longer by that.
"""

import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from functools import lru_cache, partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from tianim.validate.case import Case, Comparison
from tianim.validate.springs_scenes import (
    DOWN,
    GRAVITY,
    Floats,
    calm,
    implicit,
    pinned,
    places,
    run,
    settled,
    springs,
)

ELASTICA_SOURCE = "exact: the elastica under its own weight, B theta'' = -w (L - s) cos theta"
# Mass per area of sheets [kg/m2].
DENSITY = 0.2
# Strips: mass per length [kg/m] and axial stiffness [N] of ropes 1 m long; width of sheets [m].
LIGHT, TAUT, WIDTH = 0.1, 500.0, 0.1
# Where a strip ends, over its length: along, down; the angle of its chord [deg]. By w L^3 / B.
ELASTICA = {1: (0.99125, 0.12347, 7.100), 8: (0.72442, 0.64063, 41.487)}
# Mass per area of meshes [kg/m2], and their rows of triangles.
LIGHT_MESH, MESH_ROWS = 0.01, 8
# Slow modes are calmed by drag [1/s], about twice their frequency.
CALM = {1: 20.0, 8: 8.0}


class Strip(NamedTuple):
    """Where a strip ends, over its length: along, down [1], and the angle of its chord [deg]."""

    along: float
    down: float
    angle: float


@contextmanager
def strip_mesh(length: float, cells: int) -> Iterator[Path]:
    """A file with a strip of equilateral triangles, but for halves at its ends, in a temporary folder."""
    h, lines = length / cells, []
    for j in range(MESH_ROWS + 1):
        z = 0.5 * np.sqrt(3.0) * h * j
        # Odd rows are shifted by half a cell and have points at both ends.
        line = np.linspace(0.0, length, cells + 1)
        if j % 2:
            line = np.concatenate([[0.0], line[:-1] + 0.5 * h, [length]])
        lines.append(np.stack([line, np.zeros_like(line), np.full_like(line, z)], axis=1))
    start = np.cumsum([0, *(len(line) for line in lines)])
    triangles = []
    for j in range(MESH_ROWS):
        a, b = 0, 0
        low, high = lines[j][:, 0], lines[j + 1][:, 0]
        while a < len(low) - 1 or b < len(high) - 1:
            forward = b == len(high) - 1 or (a < len(low) - 1 and low[a + 1] <= high[b + 1])
            p, q = start[j] + a, start[j + 1] + b
            triangles.append((p, p + 1, q) if forward else (p, q + 1, q))
            a, b = (a + 1, b) if forward else (a, b + 1)
    points = np.concatenate(lines)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "strip.obj"
        text = [f"v {x:.9f} {y:.9f} {z:.9f}\n" for x, y, z in points]
        text += [f"f {a + 1} {b + 1} {c + 1}\n" for a, b, c in triangles]
        path.write_text("".join(text))
        yield path


def strip(kind: str, load: float, cells: int, **fields: Any) -> tuple[Any, Floats, float]:
    """A horizontal strip clamped at one end, its points at the start, and where its stiff part ends.

    Its weight per length w is so that w L^3 / B = `load`.
    """
    length = 1.0 / (1.0 - 0.5 / cells)
    first = 0.5 * length / cells
    fields = {"gravity": DOWN, "air": calm(CALM[int(load)]), **fields}
    if kind == "rope":
        piece: dict[str, Any] = {
            "kind": "rope", "points": [(0.0, 0.0, 0.0), (length, 0.0, 0.0)], "segments": cells,
            "density": LIGHT, "stretch": TAUT, "bend": LIGHT * GRAVITY / load,
        }  # fmt: skip
        system = springs(piece, pins=pinned([0, 1]), **fields)
        return system, places(system), first
    # Far stiffer along than across, so that what bends does not bend the other way too.
    density = DENSITY if kind == "sheet" else LIGHT_MESH
    cloth = {"density": density, "bend": density * GRAVITY / load}
    held = {"pin": {"piece": "p", "lower": (-1.0,) * 3, "upper": (1.25 * length / cells, 1.0, 1.0)}}
    if kind == "sheet":
        across = max(round(WIDTH * cells), 1)
        piece = {"kind": "sheet", "size": (length, WIDTH), "segments": (cells, across), **cloth}
        system = springs(piece, pins=held, **fields)
        return system, places(system), first
    with strip_mesh(length, cells) as path:
        system = springs({"kind": "mesh", "file": path, **cloth}, pins=held, **fields)
    return system, places(system), first


@lru_cache(maxsize=16)
def cantilever(kind: str, load: float, scheme: str = "implicit_euler", cells: int = 32) -> Strip:
    """A strip that bends under its own weight."""
    system, start, first = strip(kind, load, cells, **implicit(scheme))
    x = places(settled(system))
    along, down, _ = x[start[:, 0] > start[:, 0].max() - 1e-9].mean(axis=0)
    return Strip(float(along - first), float(-down), float(np.degrees(np.arctan2(-down, along - first))))


def _cantilever(kind: str, load: float, scheme: str, which: str) -> float:
    return float(getattr(cantilever(kind, load, scheme), which))


@lru_cache(maxsize=4)
def pressed(kind: str, part: float, cells: int = 32) -> float:
    """How far the end of a strip is off its line under `part` of Euler's load, over its length.

    Started a hundredth of it off.
    """
    bend = 1.0
    load = part * 0.25 * np.pi**2 * bend * (1.0 if kind == "rope" else WIDTH)
    length = 1.0 / (1.0 - 0.5 / cells)
    # Its slow mode, as slow as it is near the onset, is calmed at 4 / s.
    density = bend
    if kind == "rope":
        piece: dict[str, Any] = {
            "kind": "rope", "points": [(0.0, 0.0, 0.0), (length, 0.0, 0.0)], "segments": cells,
            "density": density, "stretch": 4e3, "bend": bend,
        }  # fmt: skip
        pins, end = pinned([0, 1]), [cells]
    else:
        across = max(round(WIDTH * cells), 1)
        piece = {
            "kind": "sheet", "size": (length, WIDTH), "segments": (cells, across), "density": density,
            "stretch": 4e3, "bend": bend,
        }  # fmt: skip
        pins = pinned(list(range(2 * (across + 1))))
        end = list(range(cells * (across + 1), (cells + 1) * (across + 1)))
    force = (-load / len(end), 0.0, 0.0)
    system = springs(
        piece, pins=pins, air=calm(1.0), pushes={"load": {"piece": "p", "points": end, "force": force}},
        **implicit("strands" if kind == "rope" else "implicit_euler"),
    )  # fmt: skip
    x = places(system)
    x[:, 1] += 0.01 * (1.0 - np.cos(0.5 * np.pi * np.maximum(x[:, 0] - x[end[0], 0] / cells, 0.0)))
    system.write("position", x)
    run(system, 20.0)
    return float(np.abs(places(system)[end[0], 1]))


# Of Euler's load, how far off its line a strip then is, over its length.
ONSET: tuple[tuple[float, float, Comparison], ...] = ((0.95, 1e-3, "below"), (1.05, 0.1, "above"))


CASES: tuple[Case, ...] = (
    *(
        Case(
            "springs", f"cantilever, {kind}, w L^3 / B = {load}, {scheme}: {words}",
            partial(_cantilever, kind, float(load), scheme, which), ELASTICA[load][k], ELASTICA_SOURCE,
            tolerance=0.02 * ELASTICA[load][k], unit=unit,
            slow=kind == "mesh",
        )
        for kind, scheme in (
            ("rope", "strands"), ("rope", "implicit_euler"), ("rope", "bdf2"), ("sheet", "implicit_euler"),
            ("mesh", "implicit_euler"),
        )
        for load in ELASTICA
        for k, (which, words, unit) in enumerate((
            ("along", "where it ends, over L", ""), ("down", "drop, over L", ""),
            ("angle", "of its chord", "deg"),
        ))
    ),
    *(
        Case(
            "springs", f"{kind} pressed with {part:g} of Euler's load: off its line, over L",
            partial(pressed, kind, part), limit, "exact: pi^2 B / (4 L^2), clamped and free",
            comparison=comparison,
        )
        for kind in ("rope", "sheet")
        for part, limit, comparison in ONSET
    ),
)  # fmt: skip
