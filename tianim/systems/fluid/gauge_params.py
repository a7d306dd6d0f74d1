"""Gauges as data: what is measured of a fluid in each frame, for metrics.csv.

    gauges: {wall: {kind: height, line: [0.5, 0.0]}, toe: {kind: front, direction: [1, 0, 0]}}

Each gives the number `gauge_<name>`, or several with an axis or a word behind.
"""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, model_validator
from typing_extensions import Self

from tianim.params import Direction, Name, Number, Params, Positive, Vector3
from tianim.systems.fluid.block_params import check_corners


class Gauge(Params):
    """What every gauge has."""

    phase: Name | None = Field(None, description="counts this one of `phases` alone; all where left out")


class HeightGauge(Gauge):
    """Height of the surface over a point of the ground, y [m]; the floor's where there is no fluid.

    Going up, the first surface counts: where the line goes through a body under water, that is the body's
    lower side. With the body's upper side as the floor it is the water's.
    """

    kind: Literal["height"] = "height"
    line: tuple[Number, Number] = Field(description="x and z of the line upwards [m]", examples=[[0.0, 0.0]])
    floor: Number | None = Field(
        None,
        description="y of the ground, below which nothing counts: over a body under water, the body's upper "
        "side [m]; the bounds' lower face or the lowest fluid where left out",
    )


class FrontGauge(Gauge):
    """How far the fluid reaches along a direction [m]: drops that have left the bulk do not count."""

    kind: Literal["front"] = "front"
    direction: Direction = Field((1.0, 0.0, 0.0), description="direction, any length but zero")
    origin: Vector3 = Field((0.0, 0.0, 0.0), description="where counting begins [m]")
    depth: Positive | None = Field(
        None,
        description="thickness of the bottom layer in which it is sought [m]; the whole fluid where left out",
    )


class PressureGauge(Gauge):
    """Pressure at a point [Pa], which may lie on a wall; 0 where no fluid is near."""

    kind: Literal["pressure"] = "pressure"
    position: Vector3 = Field(description="where [m]", examples=[[0.0, 0.0, 0.0]])


class ForceGauge(Params):
    """Force of the fluid on a body, mean since the last frame: _x, _y, _z [N] (2D: [N/m])."""

    kind: Literal["force"] = "force"
    body: Name = Field(description="name of a body")


class _InBox(Gauge):
    lower: Vector3 = Field(description="corner with the smallest coordinates [m]", examples=[[0.0, 0.0, 0.0]])
    upper: Vector3 = Field(description="corner with the largest coordinates [m]", examples=[[1.0, 1.0, 1.0]])

    @model_validator(mode="after")
    def _lower_is_below_upper(self) -> Self:
        check_corners(self.lower, self.upper)
        return self


class VolumeGauge(_InBox):
    """Volume of the particles in a box [m3] (2D: area [m2])."""

    kind: Literal["volume"] = "volume"


class SpeedGauge(_InBox):
    """Mean speed in a box [m/s], and the mean velocity: _x, _y, _z; 0 where nothing is in it."""

    kind: Literal["speed"] = "speed"


GaugeParams = Annotated[
    HeightGauge | FrontGauge | PressureGauge | ForceGauge | VolumeGauge | SpeedGauge,
    Field(discriminator="kind"),
]
