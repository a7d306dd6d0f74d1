"""Parameters of the three methods: how far their solves go. Each has its own section in a scene."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field, model_validator
from typing_extensions import Self

from tianim.params import Fraction, NonNegative, Params, Positive

ErrorLimit = Annotated[float, Field(ge=1e-6, le=0.2)]
Iterations = Annotated[int, Field(ge=1, le=10_000)]


class _Iterated(Params):
    least_iterations: Iterations = Field(2, description="iterations that are made in any case")
    most_iterations: Iterations = Field(100, description="iterations after which the solve is left as it is")

    @model_validator(mode="after")
    def _least_is_below_most(self) -> Self:
        if self.least_iterations > self.most_iterations:
            raise ValueError(
                f"least_iterations {self.least_iterations}: must not exceed most_iterations, "
                f"{self.most_iterations}"
            )
        return self


class DfsphParams(_Iterated):
    """Divergence-free SPH (Bender and Koschier 2015): a pressure for the density, one for the divergence."""

    density_error: ErrorLimit = Field(5e-4, description="mean error of the density, part of it")
    divergence_error: ErrorLimit = Field(
        1e-3, description="mean error of the density that the divergence would make in a step, part of it"
    )


class PbfParams(_Iterated):
    """Position Based Fluids (Macklin and Mueller 2013)."""

    density_error: ErrorLimit = Field(0.01, description="mean error of the density, part of it")
    density_error_p99: ErrorLimit = Field(
        0.05, description="error that 99 % of the particles keep, part of it"
    )
    divergence_error: ErrorLimit = Field(
        0.02, description="mean error of the density that the fastest motion would make in a step, part of it"
    )
    cfm: NonNegative = Field(
        0.0, description="softness of the constraint (epsilon of the paper), 0: as hard as can be"
    )
    artificial_pressure: Annotated[float, Field(ge=0, le=0.1)] = Field(
        0.0, description="k of the paper's s_corr, which keeps particles apart; 0: none"
    )
    xsph: Fraction = Field(0.0, description="share of the neighbours' velocity that is taken over in a step")


class WcsphParams(Params):
    """Weakly compressible SPH: pressure from density (Tait), no iterations, short steps."""

    sound_speed: Positive | None = Field(
        None, description="speed of sound [m/s]; ten times the fastest flow expected where left out"
    )
    gamma: Annotated[float, Field(ge=1, le=10)] = Field(7.0, description="exponent of Tait's equation")
