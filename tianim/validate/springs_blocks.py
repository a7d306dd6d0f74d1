"""Blocks of springs, held against Young's modulus and a clamped beam."""

from functools import partial
from typing import Any

import numpy as np

from tianim.validate.case import Case
from tianim.validate.springs_scenes import (
    DOWN,
    GRAVITY,
    calm,
    pinned,
    places,
    projective,
    settled,
    springs,
)


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


CASES: tuple[Case, ...] = (
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
