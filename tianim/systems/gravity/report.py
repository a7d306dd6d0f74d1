"""What a frame reports of the stars: energies, momenta, radii, profiles of disks, the error of the forces."""

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from tianim.errors import SceneError
from tianim.systems.gravity.checks import LOG
from tianim.systems.gravity.diagnostics import disk_profile, lagrangian_radii
from tianim.systems.gravity.params import GravityParams
from tianim.systems.gravity.stars import Stars

# The forces are warned of where 1 % of the stars have more than this many times the error asked for.
TAIL = 10.0


class Report:
    """Measures `stars`; remembers the energy at the start and the last sample of the force error.

    components: first id and count by name. `moved` says that there is something new to sample.
    """

    def __init__(
        self,
        name: str,
        params: GravityParams,
        stars: Stars,
        components: Mapping[str, tuple[int, int]],
        seed: int,
    ) -> None:
        self.name, self.params, self.stars, self.components, self.seed = name, params, stars, components, seed
        self.moved = True
        self._first_energy: float | None = None
        self._frames = 0
        self._error = (0.0, 0.0)
        for rings in params.diagnostics.rings:
            self._of(rings.component)

    def begin(self) -> None:
        """Drifts are measured from now, unless they already are from before."""
        if self._first_energy is None:
            self._first_energy = self.stars.totals().energy

    def forget(self) -> None:
        """A script has set something: drifts begin anew."""
        self._first_energy = None
        self.moved = True

    def state(self) -> NDArray[np.float64]:
        """What is remembered."""
        return np.array([self._first_energy or 0.0, self._frames, float(self.moved), *self._error])

    def restore(self, state: NDArray[np.float64]) -> None:
        """Take over what `state` gave."""
        self._first_energy, self._frames, self.moved = float(state[0]), int(state[1]), bool(state[2])
        self._error = (float(state[3]), float(state[4]))

    def measure(self) -> dict[str, float]:
        """All numbers of now, in own units; accelerations and potentials must be those of now."""
        now = self.stars.totals()
        first = self._first_energy or 0.0
        found = {
            "kinetic_energy": now.kinetic,
            "potential_energy": now.own + now.external,
            "total_energy": now.energy,
            "energy_drift": (now.energy - first) / abs(first) if first else 0.0,
            "virial_ratio": now.virial_ratio,
        }
        for key, vector in (
            ("momentum", now.momentum),
            ("angular_momentum", now.angular_momentum),
            ("centre", now.centre),
        ):
            found |= {f"{key}_{axis}": float(value) for axis, value in zip("xyz", vector, strict=True)}
        return found | self._radii() | self._rings() | self._force_error()

    def _radii(self) -> dict[str, float]:
        fractions, stars = self.params.diagnostics.lagrangian, self.stars
        if not fractions:
            return {}
        radii = lagrangian_radii(stars.read(stars.x), stars.read_one(stars.mass), fractions)
        return {f"radius_{100 * f:g}": float(r) for f, r in zip(fractions, radii, strict=True)}

    def _rings(self) -> dict[str, float]:
        found: dict[str, float] = {}
        stars = self.stars
        for rings in self.params.diagnostics.rings:
            own = self._of(rings.component)
            x, v, a = (stars.read(array)[own] for array in (stars.x, stars.v, stars.a))
            profile = disk_profile(
                x,
                v,
                stars.read_one(stars.mass)[own],
                a,
                np.asarray(rings.edges),
                stars.law.gravitational_constant,
            )
            values = {
                "rotation_curve": profile.rotation,
                "surface_density": profile.surface_density,
                "toomre_q": profile.toomre_q,
            }
            for quantity in rings.quantities:
                for radius, value in zip(profile.radius, values[quantity], strict=True):
                    found[f"{rings.component}_{quantity}_{radius:g}"] = float(value)
        return found

    def _of(self, component: str) -> slice:
        """The ids of a component; SceneError names those there are."""
        if component not in self.components:
            there = ", ".join(self.components) or "none"
            raise SceneError(f"diagnostics.rings: no component {component!r}; there are {there}")
        first, count = self.components[component]
        return slice(first, first + count)

    def _force_error(self) -> dict[str, float]:
        """The last sample, a new one each so many frames; and whether it is too large."""
        every = self.params.solver.check_every
        if not every:
            return {}
        limit = TAIL * self.params.solver.accuracy
        if self.moved and self.stars.solver is not None:
            if self._frames % every == 0:
                self._error = self.stars.force_error(self.seed)
                if self._error[1] > limit:
                    LOG.warning(
                        "%s: 1 %% of the forces are off by more than %.2g, %.2g was allowed",
                        self.name, self._error[1], limit,
                    )  # fmt: skip
            self._frames += 1
        self.moved = False
        median, tail = self._error
        return {
            "force_error_median": median,
            "force_error_p99": tail,
            "force_error_warning": float(tail > limit),
        }
