"""Params and channels: validated plain data, some of it a function of time.

Every model of a scene file is a `Params`: frozen, strict (no silent casts), unknown keys
refused. A field marked `Animated[...]` takes a constant or keyframes:

    weight: Animated[Positive]        # weight: 1.5   or
                                      # weight: {keys: [[0, 1.0], [2.5, 4.0]], interpolation: pchip}

`params.at(time)` gives a copy with every channel evaluated, so that code reads plain numbers;
for type checkers `Animated[float]` is therefore a float.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from functools import cached_property
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Generic, Literal, TypeVar

import numpy as np
from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Discriminator,
    Field,
    Tag,
    TypeAdapter,
    ValidationError,
    ValidationInfo,
    model_validator,
)
from typing_extensions import Self

if TYPE_CHECKING:
    from numpy.typing import NDArray

T = TypeVar("T")


def _not_zero(value: Any) -> Any:
    if not any(value):
        raise ValueError("must not be the zero vector")
    return value


# Bounds that keep float32 arithmetic finite: squares of LARGE still fit (1e18 squared = 1e36).
LARGE = 1e18
MAX_COUNT = 100_000_000
# Keys nearer than this [s] would give slopes that overflow; a frame at 1000 fps is 1e-3 s.
SHORTEST_INTERVAL = 1e-6
# Share of the keys' range within which a turning point is the key itself: far over float64 rounding.
TURNS_AT_KEY = 1e-9

Number = Annotated[float, Field(ge=-LARGE, le=LARGE)]
Positive = Annotated[float, Field(gt=0, le=LARGE)]
NonNegative = Annotated[float, Field(ge=0, le=LARGE)]
Fraction = Annotated[float, Field(ge=0, le=1)]
Degrees = Annotated[float, Field(ge=0, le=360)]
Count = Annotated[int, Field(ge=0, le=MAX_COUNT)]


def _tuples(value: Any) -> Any:
    """Lists (from YAML) as tuples, so that strict frozen models take them."""
    if isinstance(value, list | tuple):
        return tuple(_tuples(item) for item in value)
    return value


class Params(BaseModel):
    """Base of all validated data: immutable, strict types, unknown keys are errors."""

    model_config = ConfigDict(
        extra="forbid",
        frozen=True,
        strict=True,
        allow_inf_nan=False,
        validate_default=False,
        ser_json_inf_nan="null",
    )

    @model_validator(mode="before")
    @classmethod
    def _sequences_are_tuples(cls, data: Any) -> Any:
        return {key: _tuples(value) for key, value in data.items()} if isinstance(data, dict) else data

    @cached_property
    def _is_constant(self) -> bool:
        return not any(_has_keyframes(getattr(self, name)) for name in type(self).model_fields)

    def __eq__(self, other: object) -> bool:
        # pydantic's own comparison takes in what was cached, arrays among it.
        if type(self) is not type(other):
            return NotImplemented
        return all(getattr(self, name) == getattr(other, name) for name in type(self).model_fields)

    def __hash__(self) -> int:
        return hash((type(self), *(getattr(self, name) for name in type(self).model_fields)))

    def at(self, time: float) -> Self:
        """This, with every keyframed field replaced by its value at `time` [s]."""
        if self._is_constant:
            return self
        fields = type(self).model_fields
        copy = self.model_copy(update={name: _evaluate(getattr(self, name), time) for name in fields})
        # What this cached (`cached_property`) came with the copy and may not hold at `time`.
        for name in copy.__dict__.keys() - fields.keys():
            del copy.__dict__[name]
        return copy


def _has_keyframes(value: Any) -> bool:
    if isinstance(value, Keyframes):
        return True
    if isinstance(value, Params):
        return not value._is_constant
    if isinstance(value, tuple):
        return any(_has_keyframes(item) for item in value)
    if isinstance(value, dict):
        return any(_has_keyframes(item) for item in value.values())
    return False


def _evaluate(value: Any, time: float) -> Any:
    if isinstance(value, Keyframes):
        return value.value_at(time)
    if isinstance(value, Params):
        return value.at(time)
    if isinstance(value, tuple):
        return tuple(_evaluate(item, time) for item in value)
    if isinstance(value, dict):
        return {key: _evaluate(item, time) for key, item in value.items()}
    return value


class Keyframes(Params, Generic[T]):
    """A value over time, through keys [time in s, value]; T is a number or a tuple of numbers.

    `linear`, `cubic` (C2 spline, natural ends), `pchip` (monotone, no overshoot) or `step`.
    Outside the keys the end values hold, or the keys repeat: `loop` or `pingpong`. The limits
    of the field hold at every time: a cubic curve that overshoots them is refused.
    """

    keys: tuple[tuple[Number, T], ...] = Field(min_length=1, description="pairs [time, value], times rising")
    interpolation: Literal["linear", "cubic", "pchip", "step"] = Field(
        "linear", description="curve between the keys"
    )
    repeat: Literal["none", "loop", "pingpong"] = Field("none", description="what follows the last key")

    @model_validator(mode="after")
    def _times_rise(self) -> Self:
        times = [time for time, _ in self.keys]
        for before, after in pairwise(times):
            if after <= before:
                raise ValueError(f"keyframe times must rise: {after:g} comes after {before:g}")
            if after - before < SHORTEST_INTERVAL:
                raise ValueError(
                    f"keyframe times must be {SHORTEST_INTERVAL:g} s apart: {before:g} and {after:g}"
                )
        return self

    @model_validator(mode="after")
    def _curve_keeps_limits(self) -> Self:
        if self.interpolation != "cubic" or len(self.keys) == 1:
            return self
        item = TypeAdapter(
            type(self).__pydantic_generic_metadata__["args"][0], config=ConfigDict(strict=True)
        )
        for time, turning in self._turning_points:
            value = _plain(turning)
            try:
                item.validate_python(value)
            except ValidationError:
                reached = np.round(turning, 4).tolist()
                raise ValueError(
                    f"the cubic curve reaches {reached} at {time:.3g} s, outside the limits: "
                    "choose interpolation pchip, which does not overshoot, or other keys"
                ) from None
        return self

    def value_at(self, time: float) -> Any:
        """The value at `time` [s]: a float, or a tuple of floats."""
        lower, upper = self._extremes
        return _plain(np.clip(self._curve(self._fold(time)), lower, upper))

    def _fold(self, time: float) -> float:
        first, last = self.keys[0][0], self.keys[-1][0]
        length = last - first
        if self.repeat == "none" or length == 0.0:
            return min(max(time, first), last)
        turns, phase = divmod(time - first, length)
        if self.repeat == "pingpong" and turns % 2 == 1:
            phase = length - phase
        return first + phase

    @cached_property
    def _times(self) -> NDArray[np.float64]:
        return np.array([time for time, _ in self.keys], dtype=np.float64)

    @cached_property
    def _values(self) -> NDArray[np.float64]:
        return np.array([value for _, value in self.keys], dtype=np.float64)

    @cached_property
    def _turning_points(self) -> list[tuple[float, NDArray[np.float64]]]:
        """Times between the keys where a component of the cubic curve turns, with its values."""
        values = self._values
        roots = np.atleast_1d(self._curve.derivative().roots(extrapolate=False))  # type: ignore[attr-defined]
        # Of a vector, an array of each component's roots; of a number, its roots, which may be none.
        times = np.unique(np.concatenate([np.zeros(0), *(np.atleast_1d(times) for times in roots)]))
        points = []
        for time in times[np.isfinite(times)]:
            value = self._curve(float(time))
            # A curve that turns at a key differs from it by rounding, which must not break a limit.
            nearest = np.take_along_axis(values, np.abs(values - value).argmin(axis=0)[None], axis=0)[0]
            near = np.abs(nearest - value) <= TURNS_AT_KEY * np.ptp(values, axis=0)
            points.append((float(time), np.where(near, nearest, value)))
        return points

    @cached_property
    def _extremes(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Lowest and highest value of the curve; what rounding adds beyond is cut off."""
        values = self._values
        if self.interpolation == "cubic" and len(self.keys) > 1:
            values = np.stack([*values, *(value for _, value in self._turning_points)])
        return values.min(axis=0), values.max(axis=0)

    @cached_property
    def _curve(self) -> Callable[[float], NDArray[np.float64]]:
        times, values = self._times, self._values
        if len(times) == 1:
            return lambda time: values[0]
        if self.interpolation == "step":
            return lambda time: values[max(int(np.searchsorted(times, time, side="right")) - 1, 0)]
        if self.interpolation == "linear":
            columns = values.reshape(len(times), -1).T
            shape = values.shape[1:]
            return lambda time: np.array([np.interp(time, times, column) for column in columns]).reshape(
                shape
            )
        from scipy.interpolate import CubicSpline, PchipInterpolator

        if self.interpolation == "pchip":
            return PchipInterpolator(times, values)
        ends = "periodic" if self.repeat == "loop" and np.array_equal(values[0], values[-1]) else "natural"
        return CubicSpline(times, values, bc_type=ends)


def _plain(value: NDArray[np.float64]) -> Any:
    return float(value) if np.ndim(value) == 0 else tuple(float(v) for v in value)


def _constant_or_keyframes(value: Any) -> str:
    if isinstance(value, Keyframes | dict):
        return "keyframes"
    return "constant"


if TYPE_CHECKING:
    Animated = Annotated[T, "may be keyframed"]
else:

    class Animated:
        """`Animated[T]`: a constant T, or keyframes of T with the same limits on each value."""

        def __class_getitem__(cls, item: Any) -> Any:
            return Annotated[
                Annotated[item, Tag("constant")] | Annotated[Keyframes[item], Tag("keyframes")],
                Discriminator(_constant_or_keyframes),
            ]


def _existing_file(value: Any, info: ValidationInfo) -> Any:
    if not isinstance(value, str | Path):
        return value
    path = Path(value)
    base = (info.context or {}).get("folder")
    return path if path.is_absolute() or base is None else Path(base) / path


def _must_exist(path: Path) -> Path:
    if not os.path.isfile(path):  # Path.is_file raises OSError for a name that is too long
        raise ValueError(f"no such file: {path}")
    return path


def _rising(value: Any) -> Any:
    lower, upper = value
    if lower > upper:
        raise ValueError(f"the first must not exceed the second: {lower:g} > {upper:g}")
    return value


Vector3 = tuple[Number, Number, Number]
Positive3 = tuple[Positive, Positive, Positive]
# A vector of any length but zero.
Direction = Annotated[Vector3, AfterValidator(_not_zero)]
Range = Annotated[tuple[NonNegative, NonNegative], AfterValidator(_rising)]
# A file named in a scene: relative names are relative to the scene file.
ScenePath = Annotated[Path, Field(strict=False), BeforeValidator(_existing_file), AfterValidator(_must_exist)]
Name = Annotated[str, Field(pattern=r"^[A-Za-z]([A-Za-z0-9_]*[A-Za-z_])?$", max_length=64)]
