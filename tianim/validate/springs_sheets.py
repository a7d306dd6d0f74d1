"""Sheets, meshes, ropes and blocks in the units of their material, held against statics and waves.

The elastica, the catenary and the buckling strip are exact for what cannot be stretched; pieces here stretch
by some thousandths. A strip is clamped by its first two rows of points, which makes half a cell stiff: it is
made longer by that.
"""

import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from functools import lru_cache, partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from scipy.special import j0

from tianim.validate.build import acceleration
from tianim.validate.case import Case, Comparison
from tianim.validate.springs_scenes import (
    DOWN,
    GRAVITY,
    SCHEMES,
    STRANDS,
    Floats,
    crossings,
    explicit,
    implicit,
    pinned,
    places,
    projective,
    run,
    speeds,
    springs,
)

SAG_SOURCE = "exact: rho g L / (2 Y)"
ELASTICA_SOURCE = "exact: the elastica under its own weight, B theta'' = -w (L - s) cos theta"

# The hanging sheet: 1 m, [kg/m2], [N/m].
DENSITY, STRETCH = 0.2, 1000.0
SAG = 100.0 * DENSITY * GRAVITY / (2.0 * STRETCH)  # [%]
# Sags agree far better than the 10 % that peers are held to.
SAG_TOLERANCE = 0.01 * SAG
# Strips: mass per length [kg/m] and axial stiffness [N] of ropes 1 m long; width of sheets [m].
LIGHT, TAUT, WIDTH = 0.1, 500.0, 0.1
# Where a strip ends, over its length: along, down; the angle of its chord [deg]. By w L^3 / B.
ELASTICA = {1: (0.99125, 0.12347, 7.100), 8: (0.72442, 0.64063, 41.487)}
# Mass per area of meshes [kg/m2], and their rows of triangles.
LIGHT_MESH, MESH_ROWS = 0.01, 8
# Slow modes are calmed by drag [1/s], about twice their frequency.
CALM = {1: 20.0, 8: 8.0}
# At rest when nothing is faster than this [m/s].
SLOW = 1e-5


def settled(system: Any, most: float = 20.0) -> Any:
    """The system, run until it rests, or for `most` seconds."""
    time = 0.0
    while time < most:
        run(system, 0.5, start=time)
        time += 0.5
        if np.abs(speeds(system)).max() < SLOW:
            break
    return system


def calm(drag: float) -> dict[str, float]:
    """No air but drag [1/s]."""
    return {"density": 0.0, "drag": drag}


def hanging(across: int, **fields: Any) -> float:
    """Mean elongation of a sheet hung by its whole top edge [%]."""
    sheet = {"kind": "sheet", "segments": (across, across), "v": (0.0, 1.0, 0.0)}
    system = springs(sheet, pins=pinned("top"), gravity=DOWN, **fields)
    run(system, 0.15 if fields["solver"] == "explicit" else 1.0)
    return float(-100.0 * places(system)[:: across + 1, 1].mean())


def hanging_projective(across: int, scheme: str) -> float:
    """By the implicit solver, as it is by default."""
    return hanging(across, **projective(scheme))


def hanging_explicit(across: int) -> float:
    """By short steps, with the drag that calms its first mode soonest."""
    omega = 0.5 * np.pi * np.sqrt(STRETCH / DENSITY)
    return hanging(across, air=calm(2.0 * omega), **explicit("symplectic_euler"))


def hanging_xpbd(across: int) -> float:
    """By small steps that solve it line by line, calmed."""
    return hanging(across, air=calm(10.0), solver="xpbd")


def sag_spread(scheme: str) -> float:
    """Largest over least sag of 32, 64 and 128 cells, less 1."""
    sags = [hanging_projective(across, scheme) for across in (32, 64, 128)]
    return float(max(sags) / min(sags) - 1.0)


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


def wave_speed(across: int = 64, **fields: Any) -> float:
    """Speed of a long wave along a narrow sheet between two pinned ends, over sqrt(Y / rho)."""
    sheet = {
        "kind": "sheet", "size": (1.0, 4.0 / across), "segments": (across, 4), "damping": 0.0,
    }  # fmt: skip
    system = springs(sheet, pins=pinned("left", "right"), **(fields or explicit("velocity_verlet")))
    x = places(system)
    mode = np.sin(np.pi * x[:, 0])
    start = x.copy()
    x[:, 0] += 1e-3 * mode
    system.write("position", x)
    seen = [(0.0, float(mode @ mode) * 1e-3)]

    def look(time: float, system: Any) -> None:
        seen.append((time, float(mode @ (places(system) - start)[:, 0])))

    run(system, 0.06, look, frames=240)
    when = crossings(*np.array(seen).T)
    half = (when[-1] - when[0]) / (len(when) - 1)
    return float(1.0 / half / np.sqrt(STRETCH / DENSITY))


def stiffness_at(angle: float, diagonals: int, shear: float = 300.0) -> float:
    """Of a sheet of 8 x 8 cells, [N/m], that is drawn out at `angle` [deg] and nowhere else.

    The work of the forces that the kernels give, for a homogeneous strain.
    """
    strain = 1e-4
    sheet = {"kind": "sheet", "segments": (8, 8), "shear": shear, "diagonals": diagonals}
    system = springs(sheet, **explicit("symplectic_euler"))
    x = places(system)
    n = np.array([np.cos(np.radians(angle)), 0.0, np.sin(np.radians(angle))])
    moved = strain * (x @ n)[:, None] * n
    system.write("position", x + moved)
    force = system.read("mass")[:, None] * acceleration(system)
    return float(-(force * moved).sum() / strain**2)


def law_at(diagonals: int, sign: int, shear: float = 300.0) -> float:
    """The same by the law: springs along u and v, and diagonals of 4 G in all along each or one of them."""
    c = 0.5 * (STRETCH + np.hypot(STRETCH, 2.0 * shear))
    own = {2: 2.0, 1: 4.0 if sign > 0 else 0.0}[diagonals] * shear
    return float(0.5 * (c - shear) + own)


def rolled_energy(**sheet: Any) -> float:
    """Elastic energy of a sheet rolled on a cylinder of radius 1 m, its cells flat [J]."""
    system = springs({"kind": "sheet", "segments": (32, 32), **sheet}, **explicit("symplectic_euler"))
    x = places(system)
    h, radius = 1.0 / 32, 1.0
    angle = 2.0 * np.arcsin(0.5 * h / radius) * np.round(x[:, 0] / h)
    x[:, 0], x[:, 1] = radius * np.sin(angle), radius * (1.0 - np.cos(angle))
    system.write("position", x)
    return float(system.diagnostics()["elastic_energy"])


BEND = 1e-3


def catenary(which: str, solver: str, cells: int = 64) -> float:
    """A rope 1.5 long between ends 1 apart: its sag, or its horizontal tension over its weight."""
    low = (0.5, -np.sqrt(0.75**2 - 0.5**2), 0.0)
    rope = {
        "kind": "rope", "points": [(0.0, 0.0, 0.0), low, (1.0, 0.0, 0.0)], "segments": cells,
        "density": LIGHT, "stretch": 1e3,
    }  # fmt: skip
    system = springs(rope, pins=pinned("ends"), gravity=DOWN, air=calm(4.0), **implicit(solver))
    x = places(settled(system))
    if which == "sag":
        return float(-x[:, 1].min())
    _, tension = system.report.strains(x)
    d = np.diff(x, axis=0)
    along = tension * d[:, 0] / np.linalg.norm(d, axis=1)
    return float(along.mean() / (LIGHT * GRAVITY))


def hanging_rope(tip: float, cells: int = 32, **fields: Any) -> float:
    """Elongation of a hanging rope over rho g L^2 / 2 EA + M g L / EA; `tip` is M [kg]."""
    stretch = 100.0
    rope = {
        "kind": "rope", "points": [(0.0, 0.0, 0.0), (0.0, -1.0, 0.0)], "segments": cells,
        "density": LIGHT, "stretch": stretch,
    }  # fmt: skip
    weight = {"tip": {"piece": "p", "points": "last", "force": (0.0, -tip * GRAVITY, 0.0)}}
    system = springs(
        rope, pins=pinned("first"), pushes=weight, gravity=DOWN, air=calm(50.0),
        **(fields or projective("bdf2")),
    )  # fmt: skip
    x = places(settled(system))
    return float((-x[-1, 1] - 1.0) / ((0.5 * LIGHT + tip) * GRAVITY / stretch))


def swinging_rope(scheme: str, cells: int = 32) -> float:
    """Period of a hanging rope's first mode over 2 pi / (1.2024 sqrt(g / L)), 2.4048 / 2 of Bessel's J0."""
    rope = {
        "kind": "rope", "points": [(0.0, 0.0, 0.0), (0.0, -1.0, 0.0)], "segments": cells,
        "density": LIGHT, "stretch": 1e3,
    }  # fmt: skip
    system = springs(rope, pins=pinned("first"), gravity=DOWN, **implicit(scheme))
    x = places(system)
    mode = j0(FIRST_ZERO * np.sqrt(1.0 + x[:, 1]))
    x[:, 0] = 0.02 * mode
    system.write("position", x)
    weight = system.read("mass") * mode
    seen: list[tuple[float, float]] = []
    run(system, 4.0, lambda time, system: seen.append((time, weight @ places(system)[:, 0])), frames=480)
    when = crossings(*np.array(seen).T)
    measured = 2.0 * (when[-1] - when[0]) / (len(when) - 1)
    return float(measured * FIRST_ZERO / 2.0 * np.sqrt(GRAVITY) / (2.0 * np.pi))


FIRST_ZERO = 2.404826


def block(spacing: float = 0.1, **more: Any) -> tuple[dict[str, Any], float, float]:
    """A bar 0.6 x 0.2 x 0.2 along x; Young's modulus and side."""
    modulus, side = 2e4, 0.2
    piece = {
        "kind": "block", "size": (0.6, side, side), "spacing": spacing, "stiffness": modulus, **more
    }  # fmt: skip
    return piece, modulus, side


def young(spacing: float) -> float:
    """Young's modulus of a bar that is drawn out at its ends, which may narrow, over that given."""
    piece, modulus, side = block(spacing)
    count = round(side / spacing) + 1
    # Each end is drawn with the force of its share of the face.
    share = np.ones(count)
    share[[0, -1]] = 0.5
    share = np.outer(share, share).ravel() / (count - 1) ** 2
    stress = 200.0
    pushes: dict[str, Any] = {}
    system = springs(piece, **projective())
    groups = system.whole.pieces["p"].groups
    for name, sign in (("left", -1.0), ("right", 1.0)):
        for k, (point, part) in enumerate(zip(groups[name].tolist(), share.tolist(), strict=True)):
            letters = "".join(chr(97 + int(digit)) for digit in str(k))
            force = (sign * stress * side**2 * part, 0.0, 0.0)
            pushes[f"{name}_{letters}"] = {"piece": "p", "points": [point], "force": force}
    system = settled(springs(piece, pushes=pushes, air=calm(20.0), **projective("implicit_euler")))
    x = places(system)
    strain = (x[groups["right"], 0].mean() - x[groups["left"], 0].mean()) / 0.6 - 1.0
    return float(stress / strain / modulus)


def bar_drop(spacing: float) -> float:
    """How far a bar clamped at one end hangs down under its weight, over w L^4 / (8 E I) and its shear."""
    length, side, density, modulus = 0.6, 0.1, 100.0, 1e5
    piece = {
        "kind": "block", "size": (length, side, side), "spacing": spacing, "stiffness": modulus,
        "density": density,
    }  # fmt: skip
    system = springs(piece, pins=pinned("left"), gravity=DOWN, air=calm(20.0), **projective("implicit_euler"))
    start = places(system)
    tip = start[:, 0] > start[:, 0].max() - 1e-9
    drop = (start - places(settled(system)))[tip, 1].mean()
    weight, inertia = density * side**2 * GRAVITY, side**4 / 12.0
    shear = modulus / 2.5
    exact = weight * length**4 / (8.0 * modulus * inertia) + weight * length**2 / (
        2.0 * 5.0 / 6.0 * shear * side**2
    )
    return float(drop / exact)


def bar_gain() -> float:
    """How much nearer to the beam a bar of twice as fine cells is."""
    return (1.0 - bar_drop(0.05)) / (1.0 - bar_drop(0.025))


# Of Euler's load, how far off its line a strip then is, over its length.
ONSET: tuple[tuple[float, float, Comparison], ...] = ((0.95, 1e-3, "below"), (1.05, 0.1, "above"))

CASES: tuple[Case, ...] = (
    *(
        Case(
            "springs", f"hanging sheet of {across} x {across} cells, {scheme}: sag",
            partial(hanging_projective, across, scheme), SAG, SAG_SOURCE, tolerance=SAG_TOLERANCE, unit="%",
            slow=across > 64,
        )
        for scheme in SCHEMES for across in (32, 64, 128)
    ),
    *(
        Case(
            "springs", f"hanging sheet of {across} x {across} cells, explicit: sag",
            partial(hanging_explicit, across), SAG, SAG_SOURCE, tolerance=SAG_TOLERANCE, unit="%",
            slow=across > 32,
        )
        for across in (32, 64)
    ),
    *(
        Case(
            "springs", f"hanging sheet of {across} x {across} cells, xpbd: sag",
            partial(hanging_xpbd, across), SAG, SAG_SOURCE, tolerance=SAG_TOLERANCE, unit="%",
            slow=across > 32,
        )
        for across in (32, 64, 128)
    ),
    *(
        Case(
            "springs", f"hanging sheet of 32, 64 and 128 cells, {scheme}: sags differ by",
            partial(sag_spread, scheme), 0.05, "resolution does not matter", comparison="below", slow=True,
        )
        for scheme in SCHEMES
    ),
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
    Case(
        "springs", "long wave along a sheet, velocity_verlet: speed over sqrt(Y / rho)", wave_speed, 1.0,
        "exact: 70.7 m/s here", tolerance=0.03,
    ),
    Case(
        "springs", "long wave along a sheet, bdf2 at 0.5 ms: speed over sqrt(Y / rho)",
        partial(wave_speed, 64, **projective("bdf2"), time_step={"largest": 5e-4}), 1.0,
        "exact: 70.7 m/s here", tolerance=0.03,
    ),
    *(
        Case(
            "springs", f"sheet of {words}, drawn at {45 * sign:+d} deg: stiffness",
            partial(stiffness_at, 45.0 * sign, diagonals), law_at(diagonals, sign),
            "exact: its springs' stiffness", tolerance=1e-3 * law_at(diagonals, sign), unit="N/m",
        )
        for diagonals, words in ((1, "one diagonal"), (2, "two diagonals")) for sign in (1, -1)
    ),
    Case(
        # Lengths are of float64 but for rounding.
        "springs", "sheet rolled on a cylinder, no bending stiffness: energy", rolled_energy, 1e-12,
        "exact: nothing is stretched", comparison="below", unit="J",
    ),
    Case(
        "springs", "sheet rolled on a cylinder: energy", partial(rolled_energy, bend=BEND), 0.5 * BEND,
        "exact: B / 2 times the curvature squared; half a cell at each end is flat",
        tolerance=0.04 * 0.5 * BEND, unit="J",
    ),
    Case(
        "springs", "sheet rolled on a cylinder, springs over two cells: energy",
        partial(rolled_energy, skip=10.0), 1e-9, "they resist folds", comparison="above", unit="J",
    ),
    *(
        Case(
            "springs", f"catenary, span 1, length 1.5, {solver}: {words}", partial(catenary, which, solver),
            expected, "exact: y = a cosh(x / a)", tolerance=0.005 * expected, unit="m",
        )
        for solver in ("strands", "implicit_euler")
        for words, which, expected in (
            ("sag", "sag", 0.502633), ("horizontal tension over rho g", "tension", 0.308236),
        )
    ),
    *(
        Case("springs", f"hanging rope{words}, {name}: elongation over the law's",
             partial(hanging_rope, tip, **fields), 1.0, "exact: (rho L / 2 + M) g L / EA", tolerance=0.01)
        for words, tip in (("", 0.0), (" with a weight", 0.2))
        for name, fields in (
            ("strands", STRANDS), ("bdf2", projective("bdf2")), ("explicit", explicit("symplectic_euler")),
        )
    ),
    *(
        Case("springs", f"swinging rope, {scheme}: first period over the law's",
             partial(swinging_rope, scheme), 1.0, "exact: omega = j_0,1 / 2 sqrt(g / L), J_0(j_0,1) = 0",
             tolerance=0.02)
        for scheme in ("strands", *SCHEMES)
    ),
    *(
        Case("springs", f"bar of {spacing:g} m cells, drawn out: Young's modulus over that given",
             partial(young, spacing), 1.0, "exact: E", tolerance=0.02, slow=spacing < 0.1)
        for spacing in (0.1, 0.05)
    ),
    Case(
        # Cells of springs resist being bent: halving them halves that, at least.
        "springs", "bar of 2 and of 4 cells across, clamped: too stiff by, one over the other", bar_gain, 1.7,
        "theory: Timoshenko's beam, w L^4 / 8 E I + w L^2 / 2 kappa G A", comparison="above", slow=True,
    ),
)  # fmt: skip
