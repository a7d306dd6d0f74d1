"""How wrong forces are: some stars' accelerations against float64 sums over all the others."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from tianim.lang import f64_1d, f64_2d, i32_1d, ti, workers
from tianim.spatial.tubes import share
from tianim.systems.gravity.softening import NO_DISTANCE, Law, pair

SAMPLE = 1000


@ti.kernel
def sum_sampled(
    kind: ti.template(),
    n: ti.i32,
    samples: ti.i32,
    tasks: ti.i32,
    stride: ti.i32,
    reach: ti.f64,
    x: f64_2d,
    mass: f64_1d,
    chosen: i32_1d,
    out: f64_2d,
):
    """Sum of m d / |d|^3, softened, at the chosen stars: out (3, samples)."""
    for task_block in range(tasks * stride):
        if task_block % stride == 0:
            t = task_block // stride
            for k in range(share(samples, t, tasks), share(samples, t + 1, tasks)):
                i = chosen[k]
                px, py, pz = x[0, i], x[1, i], x[2, i]
                ax, ay, az = ti.f64(0.0), ti.f64(0.0), ti.f64(0.0)
                for j in range(n):
                    dx = x[0, j] - px
                    dy = x[1, j] - py
                    dz = x[2, j] - pz
                    pull, _ = pair(kind, False, dx * dx + dy * dy + dz * dz, reach, ti.f64(NO_DISTANCE))
                    w = mass[j] * pull
                    ax += w * dx
                    ay += w * dy
                    az += w * dz
                out[0, k], out[1, k], out[2, k] = ax, ay, az


class Sampled:
    """What every solver has: `count` stars, a law, and a test of its own forces."""

    count: int
    law: Law

    def sample_error(
        self, x: Any, mass: Any, a: Any, rng_seed: int, sample: int = SAMPLE
    ) -> tuple[float, float]:
        """Median and 99 % of |a - exact| / |exact| over `sample` stars chosen by the seed.

        `a` is what `evaluate` gave for these places, nothing added to it. (0, 0) for fewer than two stars.
        """
        if self.count < 2:
            return 0.0, 0.0
        rng = np.random.default_rng(rng_seed)
        chosen = np.sort(rng.choice(self.count, min(sample, self.count), replace=False)).astype(np.int32)
        exact = exact_acceleration(self.law, self.count, x, mass, chosen)
        found = a.to_numpy()[:, chosen]
        length = np.linalg.norm(exact, axis=0)
        apart = np.linalg.norm(found - exact, axis=0)
        felt = length > 0  # nothing pulls a star that is alone with test particles
        if not felt.any():
            return float(apart.max() > 0), float(apart.max() > 0)
        error = apart[felt] / length[felt]
        return float(np.median(error)), float(np.quantile(error, 0.99))


def exact_acceleration(
    law: Law, count: int, x: Any, mass: Any, chosen: NDArray[np.int32]
) -> NDArray[np.float64]:
    """Accelerations (3, k) of the chosen stars by a float64 sum over all others."""
    tasks, stride = workers()
    out = np.zeros((3, len(chosen)))
    sum_sampled(law.code, count, len(chosen), tasks, stride, law.reach, x, mass, chosen, out)
    return law.gravitational_constant * out
