"""DirectSum: every pair, exact up to rounding. For few bodies, and for few that pull on many.

Only stars with mass pull; they are gathered first, so that a million massless test particles
around ten bodies cost ten million pairs.

`single`: differences of lattice places (31 bits an axis over the cube that holds all), which are exact,
then float32, in tiles of SOURCES_A_TILE whose sums are added in float64: some 1e-7 of the force. It takes
6 % more time than float32 places, which lose close pairs in a wide scene.
`double`: all in float64, nothing scaled or moved; three to four times slower.
"""

from typing import Any, Literal

from tianim.lang import f64_1d, f64_2d, i32_1d, i32_2d, ti, workers
from tianim.spatial.columns import staggered
from tianim.spatial.morton import Cube, on_lattice
from tianim.systems.gravity.sampling import Sampled
from tianim.systems.gravity.softening import NO_DISTANCE, Law, pair

Precision = Literal["single", "double"]
SOURCES_A_TILE = 2048
# Targets that a task takes at a time.
TARGETS_A_TURN = 64
# Fewer pairs than this are summed by one core: waking the other takes as long.
SERIAL_BELOW = 50_000
# `single` sums in lattice steps, and masses of this total: neither 1/d^3 nor their product underflows.
TOTAL_MASS = 2.0**24
NO_STEP = 1e-6  # squared lattice steps that are as good as none

pairs_2d: Any = ti.types.ndarray(ndim=2)
pairs_1d: Any = ti.types.ndarray(ndim=1)


@ti.kernel
def place_on_lattice(n: ti.i32, lx: ti.f64, ly: ti.f64, lz: ti.f64, scale: ti.f64, x: f64_2d, place: i32_2d):
    """Places in lattice steps."""
    for i in range(n):
        place[0, i] = on_lattice(x[0, i], lx, scale)
        place[1, i] = on_lattice(x[1, i], ly, scale)
        place[2, i] = on_lattice(x[2, i], lz, scale)


@ti.kernel
def gather_sources(
    n: ti.i32,
    factor: ti.f64,
    place: pairs_2d,
    mass: f64_1d,
    source: pairs_2d,
    weight: pairs_1d,
    slot: i32_1d,
    counter: i32_1d,
):
    """The stars with mass: slot[i] says which source star i is, -1 for none, counter[1] how many they are."""
    ti.loop_config(serialize=True)
    for _ in range(1):
        k = 0
        for i in range(n):
            slot[i] = -1
            if mass[i] > 0.0:
                slot[i] = k
                for c in ti.static(range(3)):
                    source[c, k] = place[c, i]
                weight[k] = mass[i] * factor
                k += 1
        counter[0] = 0
        counter[1] = k


def _summing(real: Any) -> Any:
    """The kernel of all pairs, in float32 or float64."""

    @ti.func
    def sum_sources(
        kind: ti.template(), with_phi: ti.template(), i, sources, reach, tiny, place: ti.template(),
        source: ti.template(), weight: ti.template(), slot: ti.template(),
    ):  # fmt: skip
        """Pull (three) and depth of all sources at star i, tile by tile."""
        px, py, pz = place[0, i], place[1, i], place[2, i]
        ax, ay, az, deep = ti.f64(0.0), ti.f64(0.0), ti.f64(0.0), ti.f64(0.0)
        own, begin = slot[i], 0
        while begin < sources:
            if begin == own:
                begin += 1  # a star does not pull itself
            end = ti.min(begin + SOURCES_A_TILE, sources)
            if begin < own:
                end = ti.min(end, own)
            sx, sy, sz, sd = reach * 0, reach * 0, reach * 0, reach * 0
            for j in range(begin, end):
                dx = ti.cast(source[0, j] - px, real)
                dy = ti.cast(source[1, j] - py, real)
                dz = ti.cast(source[2, j] - pz, real)
                r2 = dx * dx + dy * dy + dz * dz
                pull, depth = pair(kind, with_phi, r2, reach, tiny)
                w = weight[j] * pull
                sx += w * dx
                sy += w * dy
                sz += w * dz
                if ti.static(with_phi):
                    sd += weight[j] * depth
            ax += sx
            ay += sy
            az += sz
            deep += sd
            begin = end
        return ax, ay, az, deep

    @ti.kernel
    def sum_pairs(
        kind: ti.template(),
        with_phi: ti.template(),
        some: ti.i32,
        serial: ti.template(),
        n: ti.i32,
        tasks: ti.i32,
        stride: ti.i32,
        softening: ti.f64,
        nothing: ti.f64,
        to_a: ti.f64,
        to_phi: ti.f64,
        place: pairs_2d,
        source: pairs_2d,
        weight: pairs_1d,
        slot: i32_1d,
        counter: i32_1d,
        active: i32_1d,
        a: f64_2d,
        phi: f64_1d,
    ):
        """Acceleration (and potential) of every star from all sources; to_a and to_phi give both units.

        Where `some`, of the active stars alone.
        """
        ti.loop_config(serialize=serial)
        for task_block in range(tasks * stride):
            if task_block % stride == 0:
                reach, tiny = ti.cast(softening, real), ti.cast(nothing, real)
                sources = counter[1]
                turn = ti.atomic_add(counter[0], TARGETS_A_TURN)
                while turn < n:
                    for i in range(turn, ti.min(turn + TARGETS_A_TURN, n)):
                        if some == 0 or active[i] != 0:
                            ax, ay, az, deep = sum_sources(
                                kind, with_phi, i, sources, reach, tiny, place, source, weight, slot
                            )
                            a[0, i], a[1, i], a[2, i] = ax * to_a, ay * to_a, az * to_a
                            if ti.static(with_phi):
                                phi[i] = deep * to_phi
                    turn = ti.atomic_add(counter[0], TARGETS_A_TURN)

    return sum_pairs


SUM_PAIRS: dict[Precision, Any] = {"single": _summing(ti.f32), "double": _summing(ti.f64)}


class DirectSum(Sampled):
    """Forces on `count` stars by summing over all pairs."""

    def __init__(self, count: int, law: Law, precision: Precision = "single") -> None:
        self.count, self.law, self.precision = count, law, precision
        self.tasks, self.stride = workers()
        capacity = staggered(count)
        single = precision == "single"
        self._cube = Cube(count) if single else None
        self._place = ti.ndarray(ti.i32, (3, capacity)) if single else None
        self._source = ti.ndarray(ti.i32 if single else ti.f64, (3, capacity))
        self._weight = ti.ndarray(ti.f32 if single else ti.f64, capacity)
        self._slot = ti.ndarray(ti.i32, capacity)
        self._counter = ti.ndarray(ti.i32, 4)
        self._nothing = ti.ndarray(ti.f64, 4)

    def evaluate(self, x: Any, mass: Any, a: Any, phi: Any = None, active: Any = None) -> None:
        """Fill a (3, n) and, where given, phi (n,) for stars at x (3, n) with mass (n,); all float64.

        active  i32 (n,), 1 or 0: only stars with 1 are summed and written, to the same bytes
        """
        if self.count == 0:
            return
        place, factor, reach, nothing = x, 1.0, self.law.reach, NO_DISTANCE
        to_a, to_phi = self.law.gravitational_constant, -self.law.gravitational_constant
        if self._cube is not None:
            self._cube.measure(x, mass)
            place, scale = self._place, self._cube.scale
            place_on_lattice(self.count, *self._cube.lower, scale, x, place)
            factor, reach, nothing = TOTAL_MASS / self._cube.mass, reach * scale, NO_STEP
            to_a, to_phi = to_a / factor * scale * scale, to_phi / factor * scale
        gather_sources(self.count, factor, place, mass, self._source, self._weight, self._slot, self._counter)
        SUM_PAIRS[self.precision](
            self.law.code, phi is not None, active is not None, self.count**2 < SERIAL_BELOW, self.count,
            self.tasks, self.stride, reach, nothing, to_a, to_phi, place, self._source, self._weight,
            self._slot, self._counter, self._slot if active is None else active, a,
            self._nothing if phi is None else phi,
        )  # fmt: skip

    def memory_bytes(self) -> int:
        """Bytes of the solver's own arrays."""
        return staggered(self.count) * (32 if self.precision == "single" else 36)
