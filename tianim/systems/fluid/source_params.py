"""What adds fluid and what takes it away, as data: emitters and sinks.

    emitters: {hose: {kind: disc, radius: 0.05, position: [0, 1, 0], direction: [1, 0, 0], speed: 3.0}}
    sinks: {drain: {kind: box, lower: [-1, -1, -1], upper: [1, 0, 1]}}

An emitter is a flat mouth at right angles to its direction, out of which the fluid comes in whole
layers of the lattice. It has a pose of its own, over time, and may ride on a body.
"""

from __future__ import annotations

import math
from typing import Annotated, Literal

import numpy as np
from pydantic import Field, model_validator
from typing_extensions import Self

from tianim.errors import SceneError
from tianim.params import (
    Animated,
    Direction,
    Keyframes,
    Name,
    NonNegative,
    Params,
    Positive,
    ScenePath,
    Vector3,
)
from tianim.spatial.mesh_files import MESH_SUFFIXES, read_mesh
from tianim.systems.fluid.block_params import Many, check_corners

ORIGIN = (0.0, 0.0, 0.0)
UP = (0.0, 1.0, 0.0)
# Samples of a keyframed speed from which its layers are counted; layers that are kept beyond them.
SPEED_SAMPLES = 500
SPARE_LAYERS = 2
# A flat mesh that is seen from its edge has this part of its area, or it would have none.
EDGE_ON = 0.01

Jitter = Annotated[float, Field(ge=0, le=0.5)]
Speed = Annotated[float, Field(ge=0, le=1000)]


class Timed(Params):
    """What works for some time, on one phase."""

    start: NonNegative = Field(0.0, description="begins at [s]")
    end: NonNegative | None = Field(None, description="ends at [s]; never where left out", examples=[1.0])

    @model_validator(mode="after")
    def _start_is_before_end(self) -> Self:
        if self.end is not None and self.end <= self.start:
            raise ValueError(f"end {self.end:g} s: must be later than start, {self.start:g} s")
        return self


class Emitter(Timed):
    """What every emitter has: a pose, a direction, how much comes out, and when."""

    position: Animated[Vector3] = Field(
        ORIGIN, description="middle of the mouth; of the body's axes where it is `on` one [m]"
    )
    rotation: Animated[Vector3] = Field(
        ORIGIN, description="turns mouth and direction about the own x, then y, then z axis [deg]"
    )
    direction: Direction = Field(UP, description="where the fluid goes, any length but zero")
    on: Name | None = Field(None, description="body that it rides on")
    speed: Animated[Speed] | None = Field(
        None, description="speed of the fluid in the mouth [m/s]", examples=[1.0]
    )
    rate: Animated[Speed] | None = Field(
        None, description="volume that comes out [m3/s] (in two dimensions [m2/s]), instead of the speed"
    )
    jitter: Jitter = Field(
        0.0, description="random displacement of each particle along each axis, part of the spacing"
    )
    phase: Name | None = Field(
        None, description="which of `phases` comes out; the fluid's own where left out"
    )
    most: Many | None = Field(None, description="particles that it gives in all; no limit where left out")

    @model_validator(mode="after")
    def _one_of_speed_and_rate(self) -> Self:
        if (self.speed is None) == (self.rate is None):
            raise ValueError("speed, rate: an emitter needs one of the two")
        return self

    def area(self, dimension: int) -> float:
        """Area of the mouth [m2], in two dimensions its length [m]."""
        raise NotImplementedError

    def flow(self) -> float:
        """Whichever is given of the speed [m/s] and the rate [m3/s]; of what `at` gave."""
        return float((self.speed if self.rate is None else self.rate) or 0.0)

    def is_steady(self) -> bool:
        """Whether what comes out does not change."""
        return not any(isinstance(value, Keyframes) for value in (self.speed, self.rate))

    def particle_count(self, spacing: float, dimension: int) -> int | None:
        """Particles that it will give over the whole run, a few more than fewer; None: no end is known."""
        if self.end is None:
            return self.most
        times = [self.start] if self.is_steady() else np.linspace(self.start, self.end, SPEED_SAMPLES)
        amount = float(np.mean([self.at(time).flow() for time in times])) * (self.end - self.start)
        across = max(math.ceil(self.area(dimension) / spacing ** (dimension - 1)), 1)
        volume = amount if self.speed is None else amount * across * spacing ** (dimension - 1)
        # A mouth may hold a row more on each side than its area says: hence the tenth.
        count = math.ceil(1.1 * (volume / spacing**dimension + SPARE_LAYERS * across))
        return count if self.most is None else min(count, self.most)

    def fastest(self, dimension: int) -> float:
        """Speed at the start [m/s]."""
        flow = self.at(self.start).flow()
        return flow if self.rate is None else flow / self.area(dimension)


class DiscEmitter(Emitter):
    """A round mouth (in two dimensions a gap of two radii)."""

    kind: Literal["disc"] = "disc"
    radius: Positive = Field(0.1, description="radius [m]")

    def area(self, dimension: int) -> float:
        """Area of the mouth [m2], in two dimensions its length [m]."""
        return math.pi * self.radius**2 if dimension == 3 else 2.0 * self.radius


class BoxEmitter(Emitter):
    """A rectangular mouth (in two dimensions a gap as long as its height)."""

    kind: Literal["box"] = "box"
    width: Positive = Field(0.2, description="length at right angles to direction and up [m]")
    height: Positive = Field(0.2, description="length along up [m]")
    up: Direction = Field(UP, description="which way its height goes; any other where it is the direction's")

    def area(self, dimension: int) -> float:
        """Area of the mouth [m2], in two dimensions its length [m]."""
        return self.width * self.height if dimension == 3 else self.height


class MeshEmitter(Emitter):
    """A mouth of any outline: that of a mesh, flat or not, closed or open, seen along the direction."""

    kind: Literal["mesh"] = "mesh"
    file: ScenePath = Field(description=f"mesh file: {', '.join(MESH_SUFFIXES)}")
    scale: Positive = Field(1.0, description="factor on the file's coordinates")

    @model_validator(mode="after")
    def _is_a_mesh(self) -> Self:
        try:
            read_mesh(self.file)
        except SceneError as error:
            raise ValueError(str(error)) from error
        return self

    def area(self, dimension: int) -> float:
        """At most: that of the box about the mesh, seen along the direction."""
        x, y, z = read_mesh(self.file).extent * self.scale
        along = np.abs(self.direction)
        faces = np.array((y * z, x * z, x * y) if dimension == 3 else (y, x, 0.0))
        seen = along @ faces / np.linalg.norm(along[:dimension])
        return float(max(seen, EDGE_ON * faces.max()))


EmitterParams = Annotated[DiscEmitter | BoxEmitter | MeshEmitter, Field(discriminator="kind")]


class Sink(Timed):
    """What every sink has."""

    phase: Name | None = Field(None, description="takes this one of `phases` alone; all where left out")


class BoxSink(Sink):
    """Takes what is in a box."""

    kind: Literal["box"] = "box"
    lower: Vector3 = Field(description="corner with the smallest coordinates [m]", examples=[[0.0, 0.0, 0.0]])
    upper: Vector3 = Field(description="corner with the largest coordinates [m]", examples=[[1.0, 1.0, 1.0]])

    @model_validator(mode="after")
    def _lower_is_below_upper(self) -> Self:
        check_corners(self.lower, self.upper)
        return self


class OutsideSink(Sink):
    """Takes what has left a box."""

    kind: Literal["outside"] = "outside"
    lower: Vector3 = Field(
        description="corner with the smallest coordinates [m]", examples=[[-5.0, -5.0, -5.0]]
    )
    upper: Vector3 = Field(description="corner with the largest coordinates [m]", examples=[[5.0, 5.0, 5.0]])

    @model_validator(mode="after")
    def _lower_is_below_upper(self) -> Self:
        check_corners(self.lower, self.upper)
        return self


class SphereSink(Sink):
    """Takes what is in a ball."""

    kind: Literal["sphere"] = "sphere"
    centre: Animated[Vector3] = Field(ORIGIN, description="centre [m]")
    radius: Animated[Positive] = Field(1.0, description="radius [m]")


class PlaneSink(Sink):
    """Takes what is behind a plane, against its normal."""

    kind: Literal["plane"] = "plane"
    position: Animated[Vector3] = Field(ORIGIN, description="a point of the plane [m]")
    normal: Direction = Field(UP, description="direction in which fluid is kept, any length but zero")


SinkParams = Annotated[BoxSink | OutsideSink | SphereSink | PlaneSink, Field(discriminator="kind")]
