"""What is measured of springs, in NumPy and float64: energies, momenta, strains."""

import numpy as np
from numpy.typing import NDArray

from tianim.systems.springs.assembly import Assembly
from tianim.systems.springs.hinges import hinge_angles
from tianim.systems.springs.intersections import intersections
from tianim.systems.springs.limits import Limits
from tianim.systems.springs.params import SpringsParams
from tianim.systems.springs.self_contact import joined
from tianim.systems.springs.solids import elements_of, energies, stretches

Floats = NDArray[np.float64]


class Report:
    """Measures one system's points."""

    def __init__(self, whole: Assembly, params: SpringsParams, limits: Limits) -> None:
        self._whole, self._params, self._limits = whole, params, limits
        self._counts_passes = params.report.self_intersections
        self._same = joined(whole)[0] if self._counts_passes else None
        counts = [len(piece.springs.ends) for piece in whole.pieces.values()]
        ends = np.cumsum([0, *counts])
        self._spans = {
            name: slice(int(a), int(b)) for name, a, b in zip(whole.pieces, ends, ends[1:], strict=False)
        }

    def span(self, piece: str) -> slice:
        """Where the springs of a piece are."""
        return self._spans[piece]

    def strains(self, x: Floats) -> tuple[Floats, Floats]:
        """Strain (length over rest length - 1; 0 where that is 0) and tension [N] of each spring."""
        return self._strained(self._lengths(x))

    def _strained(self, length: Floats) -> tuple[Floats, Floats]:
        springs = self._limits.springs()
        rest = springs.rest_length
        strain = np.divide(length, rest, out=np.ones_like(length), where=rest > 0.0) - 1.0
        strain[springs.stiffness == 0.0] = 0.0  # torn
        return strain, springs.stiffness * (length - rest)

    def whole_triangles(self, piece: str) -> NDArray[np.bool_]:
        """Which triangles of a piece have no torn edge."""
        built = self._whole.pieces[piece]
        torn = self._limits.springs().stiffness[self.span(piece)] == 0.0
        if not (self._limits.weakens and torn.any()):
            return np.ones(len(built.triangles), np.bool_)
        count = len(built.mass)
        gone = np.sort(built.springs.ends[torn], axis=1) @ np.array([count, 1])
        edges = np.sort(built.triangles[:, [[0, 1], [1, 2], [2, 0]]], axis=2) @ np.array([count, 1])
        return np.asarray(~np.isin(edges, gone).any(axis=1))

    def of_points(self, piece: str, strain: Floats, x: Floats) -> NDArray[np.float32]:
        """The largest strain at each point of a piece, of its springs or its tetrahedra, without its sign."""
        built, first = self._whole.pieces[piece], self._whole.first[piece]
        out = np.zeros(len(built.mass))
        for end in built.springs.ends.T:
            np.maximum.at(out, end, np.abs(strain))
        if built.solid is not None:
            own = elements_of(built.position, built.solid)
            np.maximum.at(out, own.corners, np.abs(stretches(x[first:], own))[:, None])
        return out.astype(np.float32)

    def elastic(self, x: Floats) -> float:
        """Energy of all springs and of bending [J]."""
        length = self._lengths(x)
        return self._energy(x, length, self._strained(length)[1])

    def _energy(self, x: Floats, length: Floats, tension: Floats) -> float:
        longer = length - self._limits.springs().rest_length
        return float(0.5 * tension @ longer) + self.bending(x) + self.turning(x) + self.solid(x)

    def _lengths(self, x: Floats) -> Floats:
        """Of all springs [m]."""
        a, b = self._limits.springs().ends.T
        between = np.take(x, b, axis=0) - np.take(x, a, axis=0)
        # With `take` and without a norm along rows, several times as fast.
        return np.sqrt(np.einsum("ij,ij->i", between, between))

    def solid(self, x: Floats) -> float:
        """Energy of all solids [J]."""
        elements = self._whole.elements
        return 0.0 if elements is None else float(energies(x, elements).sum())

    def turning(self, x: Floats) -> float:
        """Energy of all hinges [J]."""
        hinges = self._whole.hinges
        off = hinge_angles(x, hinges.points) - hinges.angle
        off -= 2.0 * np.pi * np.floor(off / (2.0 * np.pi) + 0.5)
        return float(0.5 * hinges.stiffness @ off**2)

    def bending(self, x: Floats) -> float:
        """Energy of bending [J]."""
        Q = self._limits.bending()
        energy = 0.0 if Q is None else float(0.5 * np.einsum("ij,ij->", x, Q @ x))
        for name, piece in self._whole.pieces.items():
            if piece.curved is not None:
                curved = piece.curved
                now = np.einsum("sp,spc->sc", curved.coefficient, x[curved.points + self._whole.first[name]])
                size = np.linalg.norm(now, axis=1)
                energy += float(curved.weight @ (0.5 * curved.length**2 - curved.length * size))
        return energy

    def self_intersections(self, x: Floats) -> int:
        """Edges of all surfaces that cut triangles; what is torn has none."""
        surfaces = [
            piece.triangles[self.whole_triangles(name)] + self._whole.first[name]
            for name, piece in self._whole.pieces.items()
        ]
        return intersections(x, np.concatenate(surfaces), self._same)

    def measure(self, x: Floats, v: Floats, time: float) -> dict[str, float]:
        """What a frame's metrics hold."""
        mass = self._whole.mass
        gravity = np.array(self._params.at(time).gravity)
        momentum = mass @ v
        centre = mass @ x / mass.sum()
        moment = mass * (x - centre).T @ v  # sum of m x_i v_j
        spin = np.array([moment[i - 2, i - 1] - moment[i - 1, i - 2] for i in range(3)])
        length = self._lengths(x)
        strained, tension = self._strained(length)
        found: dict[str, float] = {
            "kinetic_energy": float(0.5 * mass @ np.einsum("ij,ij->i", v, v)),
            "elastic_energy": self._energy(x, length, tension),
            "potential_energy": float(-mass @ x @ gravity),
        }
        found["total_energy"] = sum(found.values())
        for axis, p, L in zip("xyz", momentum, spin, strict=True):
            found[f"momentum_{axis}"], found[f"angular_momentum_{axis}"] = float(p), float(L)
        strain = np.abs(strained)
        if self._whole.elements is not None:
            strain = np.concatenate([strain, np.abs(stretches(x, self._whole.elements))])
        found["strain_max"] = float(strain.max()) if len(strain) else 0.0
        if self._limits.weakens:
            found["torn"] = float((self._limits.springs().stiffness == 0.0).sum())
        if self._counts_passes:
            found["self_intersections"] = float(self.self_intersections(x))
        found["strain_mean"] = float(strain.mean()) if len(strain) else 0.0
        return found
