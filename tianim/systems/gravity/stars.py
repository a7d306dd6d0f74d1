"""Stars: the state of a gravitating system on the device, and the one way to its accelerations.

Arrays in id order, never sorted (the solvers sort copies of their own):

    x, v, a  (3, capacity) float64   place, velocity, acceleration [own units]
    mass     (capacity,)   float64   0: a test particle, which feels and does not pull
    phi      (capacity,)   float64   potential of the other stars [own speed^2]
"""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tianim.errors import SceneError
from tianim.lang import f32_2d, f64_1d, f64_2d, ti, workers
from tianim.spatial.columns import staggered
from tianim.spatial.tubes import share
from tianim.systems.gravity import diagnostics, external
from tianim.systems.gravity.diagnostics import PIECES
from tianim.systems.gravity.params import SolverParams
from tianim.systems.gravity.solver import Law, Solver, TreeSum, make_solver

Floats = NDArray[np.float64]
Force = Callable[[float, Floats, Floats], NDArray[Any]]


@ti.kernel
def to_rows_f64(n: ti.i32, source: f64_2d, out: f64_2d):
    """(3, capacity) into out (n, 3)."""
    for i in range(n):
        for c in ti.static(range(3)):
            out[i, c] = source[c, i]


@ti.kernel
def to_rows_f32(first: ti.i32, n: ti.i32, source: f64_2d, out: f32_2d):
    """Copy n stars from `first` on into out (n, 3)."""
    for i in range(n):
        for c in ti.static(range(3)):
            out[i, c] = ti.cast(source[c, first + i], ti.f32)


@ti.kernel
def from_rows(n: ti.i32, values: f64_2d, target: f64_2d):
    """Copy values (n, 3) into (3, capacity)."""
    for i in range(n):
        for c in ti.static(range(3)):
            target[c, i] = values[i, c]


@ti.kernel
def add_rows(n: ti.i32, values: f64_2d, target: f64_2d):
    """Add values (n, 3) onto (3, capacity)."""
    for i in range(n):
        for c in ti.static(range(3)):
            target[c, i] += values[i, c]


@ti.func
def strength(a: ti.template(), i):
    """|a| of star i."""
    return ti.sqrt(a[0, i] * a[0, i] + a[1, i] * a[1, i] + a[2, i] * a[2, i])


@ti.kernel
def net_force(n: ti.i32, stride: ti.i32, mass: f64_1d, a: f64_2d, out: f64_2d):
    """Sums of m a (3) and of m |a| over fixed pieces of the stars, (PIECES, 4)."""
    for block in range(PIECES * stride):
        if block % stride == 0:
            piece = block // stride
            total = ti.Vector([0.0] * 4, ti.f64)
            for i in range(share(n, piece, PIECES), share(n, piece + 1, PIECES)):
                for c in ti.static(range(3)):
                    total[c] += mass[i] * a[c, i]
                total[3] += mass[i] * strength(a, i)
            for c in ti.static(range(4)):
                out[piece, c] = total[c]


@ti.kernel
def balance(n: ti.i32, x: ti.f64, y: ti.f64, z: ti.f64, a: f64_2d):
    """Subtract (x, y, z) |a| from every acceleration."""
    for i in range(n):
        size = strength(a, i)
        a[0, i] -= x * size
        a[1, i] -= y * size
        a[2, i] -= z * size


@ti.kernel
def copy_state(
    n: ti.i32,
    x: f64_2d,
    v: f64_2d,
    a: f64_2d,
    phi: f64_1d,
    x2: f64_2d,
    v2: f64_2d,
    a2: f64_2d,
    phi2: f64_1d,
):
    """Places, velocities, accelerations and potentials into another set of arrays."""
    for i in range(n):
        phi2[i] = phi[i]
        for c in ti.static(range(3)):
            x2[c, i] = x[c, i]
            v2[c, i] = v[c, i]
            a2[c, i] = a[c, i]


class Stars:
    """Arrays, solver and external potentials; `accelerate` fills `a` and `phi` for the places of now.

    law       G and softening
    choose    what the solver is to be
    rows      the external potentials' table, `row_count` of them
    forces    accelerations of a script's own
    """

    def __init__(
        self,
        name: str,
        mass: Floats,
        law: Law,
        choose: SolverParams,
        potentials: Sequence[external.External],
    ) -> None:
        self.name, self.law, self._choose = name, law, choose
        self.count = len(mass)
        self.capacity = staggered(self.count)
        self.x, self.v, self.a = (ti.ndarray(ti.f64, (3, self.capacity)) for _ in range(3))
        self.mass, self.phi = ti.ndarray(ti.f64, self.capacity), ti.ndarray(ti.f64, self.capacity)
        for array in (self.x, self.v, self.a, self.phi):
            array.fill(0.0)
        rows = external.table(potentials, law.gravitational_constant)
        self.rows, self.row_count = ti.ndarray(ti.f64, rows.shape), len(potentials)
        self.rows.from_numpy(rows)
        self.forces: list[Force] = []
        self._nobody = ti.ndarray(ti.i32, 1)
        self._saved: tuple[Any, ...] = ()
        self._stage: tuple[Any, ...] = ()
        self._sums = np.zeros((diagnostics.PIECES, diagnostics.SUMS))
        self._net = np.zeros((PIECES, 4))
        self.set_mass(mass)

    def set_mass(self, mass: Floats) -> None:
        """Set the masses (n,) and choose the solver for as many as have one."""
        self.mass.from_numpy(self._padded(mass))
        self.massive = int(np.count_nonzero(mass))
        how = self._choose
        self.solver: Solver | None = None
        if self.massive:
            self.solver = make_solver(
                self.count, self.law, how.accuracy, how.kind, how.precision, self.massive
            )

    def accelerate(self, time: float, active: Any = None) -> None:
        """Accelerations and potentials at the places of now, `time` [s].

        active  i32 (capacity,), 1 or 0: those of the stars with 1 alone, the others' stay as they were
        """
        if self.solver is None:
            self.a.fill(0.0)
            active = None
        else:
            self.solver.evaluate(self.x, self.mass, self.a, self.phi, active)
            # The net force is not known from some alone.
            if isinstance(self.solver, TreeSum) and active is None:
                self._balance()
        if self.row_count:
            external.add_field(
                active is not None, self.count, self.rows, self.row_count,
                self._nobody if active is None else active, self.x, self.a,
            )  # fmt: skip
        if self.forces:
            self._add_forces(time, active)

    def _balance(self) -> None:
        """Take the net force from the stars: a tree's forces are not in pairs and push the whole.

        Each gives by its own acceleration, about 1e-4 of it, so that no star's error grows; the
        momentum is then kept to rounding.
        """
        net_force(self.count, workers()[1], self.mass, self.a, self._net)
        x, y, z, size = (float(value) for value in self._net.sum(axis=0))
        if size > 0.0:
            balance(self.count, x / size, y / size, z / size, self.a)

    def _add_forces(self, time: float, active: Any) -> None:
        position, velocity = self.read(self.x), self.read(self.v)
        chosen = slice(None) if active is None else active.to_numpy()[: self.count] != 0
        for force in self.forces:
            given = np.ascontiguousarray(force(time, position, velocity), np.float64)
            if given.shape != position.shape:
                raise SceneError(f"{self.name}: a force gave shape {given.shape}, must be {position.shape}")
            own = np.zeros_like(given)
            own[chosen] = given[chosen]
            add_rows(self.count, own, self.a)

    def read(self, array: Any) -> Floats:
        """x, v or a as (n, 3)."""
        out = np.empty((self.count, 3))
        if self.count:
            to_rows_f64(self.count, array, out)
        return out

    def read_single(self, array: Any, first: int, count: int) -> NDArray[np.float32]:
        """x, v or a of `count` stars from `first` on, (count, 3) float32."""
        out = np.empty((count, 3), np.float32)
        if count:
            to_rows_f32(first, count, array, out)
        return out

    def write(self, array: Any, values: Floats) -> None:
        """Set x, v or a from (n, 3)."""
        if self.count:
            from_rows(self.count, np.ascontiguousarray(values, np.float64), array)

    def read_one(self, array: Any) -> Floats:
        """One of mass and phi as (n,)."""
        return np.array(array.to_numpy()[: self.count])

    def write_one(self, array: Any, values: Floats) -> None:
        """Set mass or phi from (n,)."""
        array.from_numpy(self._padded(values))

    def make_room(self, to_undo: bool, for_stages: bool) -> None:
        """Allocate what `save` and `undo`, and what a Runge-Kutta step needs."""
        vectors = [ti.ndarray(ti.f64, (3, self.capacity)) for _ in range(3 if to_undo else 0)]
        self._saved = (*vectors, ti.ndarray(ti.f64, self.capacity)) if to_undo else ()
        self._stage = tuple(ti.ndarray(ti.f64, (6, self.capacity)) for _ in range(2 if for_stages else 0))

    def save(self) -> None:
        """Keep places, velocities, accelerations and potentials for `undo`."""
        copy_state(self.count, self.x, self.v, self.a, self.phi, *self._saved)

    def undo(self) -> None:
        """Back to what was saved."""
        copy_state(self.count, *self._saved, self.x, self.v, self.a, self.phi)

    def stage_arrays(self) -> tuple[Any, ...]:
        """Room for a Runge-Kutta step: its start and its sum, each (6, capacity)."""
        return self._stage

    def force_error(self, seed: int) -> tuple[float, float]:
        """Median and 99 % of the relative error of the solver's forces, on a sample."""
        own = self.a
        if self.solver is None:
            return 0.0, 0.0
        if self.row_count or self.forces:
            # What the solver alone gives, with the same old accelerations before it.
            own, phi = ti.ndarray(ti.f64, (3, self.capacity)), ti.ndarray(ti.f64, self.capacity)
            own.copy_from(self.a)
            self.solver.evaluate(self.x, self.mass, own, phi)
        median, tail = self.solver.sample_error(self.x, self.mass, own, seed)
        return float(median), float(tail)

    def totals(self) -> diagnostics.Totals:
        """Energies, momenta, centre of mass, virial of now."""
        if self.count:
            diagnostics.sums(
                self.count, workers()[1], self.rows, self.row_count,
                self.x, self.v, self.mass, self.a, self.phi, self._sums,
            )  # fmt: skip
        return diagnostics.totals(self._sums)

    def _padded(self, values: Floats) -> Floats:
        out = np.zeros(self.capacity)
        out[: self.count] = values
        return out
