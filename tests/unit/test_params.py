"""Params and channels: strict data, and values over time that pass through their keys."""

from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pydantic import Field, ValidationError
from scipy.interpolate import CubicSpline, PchipInterpolator

from tianim.params import (
    Animated,
    Count,
    Fraction,
    Keyframes,
    NonNegative,
    Number,
    Params,
    Positive,
    Range,
    ScenePath,
    Vector3,
)

# Curves pass through their keys up to rounding of values near 1.
AT_KEYS = 1e-12
TIMES = np.linspace(-1.0, 6.0, 141)


class Inner(Params):
    weight: Animated[Positive] = 1.0


class Outer(Params):
    speed: Animated[Number] = 2.0
    place: Animated[Vector3] = (0.0, 0.0, 0.0)
    inner: Inner = Inner()
    several: tuple[Inner, ...] = ()
    named: dict[str, Inner] = Field({})
    count: Count = 3

    @cached_property
    def double(self) -> float:
        return 2.0 * self.speed


def channel(
    keys: list[list[Any]], interpolation: str = "linear", repeat: str = "none", of: Any = Number
) -> Any:
    return Keyframes[of].model_validate({"keys": keys, "interpolation": interpolation, "repeat": repeat})


KEYS = [[0.0, 1.0], [1.0, 3.0], [2.5, 0.5], [4.0, 0.6], [5.0, 2.0]]
X, Y = np.array(KEYS).T


def test_linear_midpoint() -> None:
    curve = channel([[0, 1.0], [2, 5.0]])
    assert curve.value_at(1.0) == pytest.approx(3.0, abs=AT_KEYS)


def test_ends_hold() -> None:
    curve = channel(KEYS, "cubic")
    assert curve.value_at(-7.0) == pytest.approx(1.0, abs=AT_KEYS)
    assert curve.value_at(7.0) == pytest.approx(2.0, abs=AT_KEYS)


@pytest.mark.parametrize("interpolation", ["linear", "cubic", "pchip", "step"])
@pytest.mark.parametrize("repeat", ["none", "pingpong"])
def test_exact_at_keys(interpolation: str, repeat: str) -> None:
    curve = channel(KEYS, interpolation, repeat)
    for time, value in KEYS:
        assert curve.value_at(time) == pytest.approx(value, abs=AT_KEYS)


@pytest.mark.parametrize("interpolation", ["linear", "cubic", "pchip", "step"])
def test_vector_exact_at_keys(interpolation: str) -> None:
    keys = [[0, [0, 1, 2]], [1, [3, -1, 2]], [3, [1, 1, 5]]]
    curve = channel(keys, interpolation, of=Vector3)
    for time, value in keys:
        at = curve.value_at(time)
        assert isinstance(at, tuple)
        assert at == pytest.approx(value, abs=AT_KEYS)


def test_cubic_is_the_natural_spline() -> None:
    curve, reference = channel(KEYS, "cubic"), CubicSpline(X, Y, bc_type="natural")
    inside = TIMES[(TIMES >= 0) & (TIMES <= 5)]
    assert [curve.value_at(t) for t in inside] == pytest.approx(reference(inside), abs=AT_KEYS)


@pytest.mark.parametrize("of", [Number, Vector3])
def test_cubic_need_not_turn(of: Any) -> None:
    keys = [[0, 1.0], [2, 5.0]] if of is Number else [[0, [1, 1, 1]], [2, [5, 1, -3]]]
    middle = channel(keys, "cubic", of=of).value_at(1.0)
    assert middle == pytest.approx(3.0 if of is Number else (3.0, 1.0, -1.0), abs=AT_KEYS)


def test_pchip_is_scipys_and_does_not_overshoot() -> None:
    curve, reference = channel(KEYS, "pchip"), PchipInterpolator(X, Y)
    inside = TIMES[(TIMES >= 0) & (TIMES <= 5)]
    values = np.array([curve.value_at(t) for t in inside])
    assert values == pytest.approx(reference(inside), abs=AT_KEYS)
    between = np.searchsorted(X, inside, side="right").clip(1, len(X) - 1)
    low, high = np.minimum(Y[between - 1], Y[between]), np.maximum(Y[between - 1], Y[between])
    assert (values >= low - AT_KEYS).all()
    assert (values <= high + AT_KEYS).all()


def test_step_holds_until_the_next_key() -> None:
    curve = channel(KEYS, "step")
    assert curve.value_at(np.nextafter(1.0, 0.0)) == 1.0
    assert curve.value_at(1.0) == 3.0
    assert curve.value_at(2.4) == 3.0


def test_loop_repeats() -> None:
    curve = channel([[1, 0.0], [3, 4.0]], repeat="loop")
    # From the key at 1 s on, each 2 s: 3 s is the start again.
    assert [curve.value_at(t) for t in (0.0, 1.0, 2.0, 2.5, 3.0, 4.0, 6.5)] == pytest.approx(
        [2.0, 0.0, 2.0, 3.0, 0.0, 2.0, 3.0], abs=AT_KEYS
    )


def test_pingpong_goes_back() -> None:
    curve = channel([[0, 0.0], [2, 4.0]], repeat="pingpong")
    assert [curve.value_at(t) for t in (-0.5, 0.0, 1.5, 2.0, 2.5, 3.5, 4.0, 4.5)] == pytest.approx(
        [1.0, 0.0, 3.0, 4.0, 3.0, 1.0, 0.0, 1.0], abs=AT_KEYS
    )


def test_cubic_loop_is_smooth_over_the_seam() -> None:
    curve = channel([[0, 1.0], [1, 3.0], [2, 0.0], [3, 1.0]], "cubic", "loop")
    h = 1e-5
    slope_before = (curve.value_at(3.0 - h) - curve.value_at(3.0 - 2 * h)) / h
    slope_after = (curve.value_at(3.0 + 2 * h) - curve.value_at(3.0 + h)) / h
    # Slopes are about 3 and one-sided differences err by h times the second derivative, about 20.
    assert slope_before == pytest.approx(slope_after, abs=100 * h)


def test_one_key_is_a_constant() -> None:
    for interpolation in ("linear", "cubic", "pchip", "step"):
        assert channel([[3, 7.0]], interpolation, "loop").value_at(11.0) == 7.0


def test_cubic_that_leaves_the_limits_is_refused() -> None:
    keys = [[0, 0.0], [1, 0.0], [2, 3.0], [3, 0.0]]
    with pytest.raises(ValidationError, match=r"the cubic curve reaches -0\.\d+ at .* pchip"):
        channel(keys, "cubic", of=NonNegative)
    with pytest.raises(ValidationError, match="the cubic curve reaches"):
        channel([[0, [0, 1]], [1, [1, 1]], [2, [1, 1]], [3, [0, 1]]], "cubic", of=Range)
    assert channel(keys, "pchip", of=NonNegative).value_at(0.5) == 0.0
    # It turns at the keys themselves: 0 and 1 are reached, rounding may not go beyond.
    waves = channel([[t, t % 2] for t in range(9)], "cubic", of=Number)
    assert np.ptp([waves.value_at(t) for t in np.linspace(0, 8, 999)]) > 1.0


def test_rounding_does_not_break_a_limit() -> None:
    """SciPy's pchip through these ends at -1.1e-16."""
    assert channel([[0, 0.7], [1, 0.9], [2, 0.0]], "pchip", of=Fraction).value_at(2.0) == 0.0


fractions = st.integers(0, 10).map(lambda value: value / 10)


@given(st.lists(fractions, min_size=1, max_size=6), st.sampled_from(["linear", "cubic", "pchip", "step"]))
@settings(deadline=None, derandomize=True, database=None)
def test_accepted_curves_keep_their_limits_exactly(values: list[float], interpolation: str) -> None:
    keys = [[float(time), value] for time, value in enumerate(values)]
    try:
        curve = channel(keys, interpolation, "pingpong", of=Fraction)
    except ValidationError:
        assert interpolation == "cubic"  # the only one that may overshoot
        return
    for time in np.linspace(-2.0, 2.0 * len(values), 101):
        assert 0.0 <= curve.value_at(time) <= 1.0


@pytest.mark.parametrize(
    ("keys", "message"),
    [
        ([[0, 1], [2, 1], [1, 1]], "keyframe times must rise: 1 comes after 2"),
        ([[0, 1], [0, 1]], "keyframe times must rise: 0 comes after 0"),
        ([[0, 1], [1e-9, 1]], "keyframe times must be 1e-06 s apart"),
        ([], "at least 1 item"),
        ([[float("nan"), 1]], "finite number"),
    ],
)
def test_wrong_keys_are_refused(keys: list[list[Any]], message: str) -> None:
    with pytest.raises(ValidationError, match=message):
        channel(keys)


MOVING = {
    "speed": {"keys": [[0, 1.0], [2, 3.0]]},
    "place": {"keys": [[0, [0, 0, 0]], [2, [2, 4, 6]]]},
    "inner": {"weight": {"keys": [[0, 1.0], [2, 5.0]]}},
    "several": [{"weight": 2.0}, {"weight": {"keys": [[0, 1.0], [2, 2.0]]}}],
    "named": {"a": {"weight": {"keys": [[0, 4.0], [2, 2.0]]}}},
}


def test_at_evaluates_nested_channels() -> None:
    now = Outer.model_validate(MOVING).at(1.0)
    assert now.speed == 2.0
    assert now.place == (1.0, 2.0, 3.0)
    assert now.inner.weight == 3.0
    assert [inner.weight for inner in now.several] == [2.0, 1.5]
    assert now.named["a"].weight == 3.0
    assert now.count == 3
    assert now.at(2.0) is now, "what has no channels left does not depend on time"


def test_at_of_constants_is_the_thing_itself() -> None:
    constant = Outer()
    assert constant.at(5.0) is constant


def test_at_forgets_what_was_cached_for_another_time() -> None:
    params = Outer.model_validate({"speed": {"keys": [[0, 1.0], [2, 3.0]]}})
    assert params.at(0.0).double == 2.0
    assert params.at(2.0).double == 6.0
    assert params.at(0.0).at(2.0).double == 2.0


@pytest.mark.parametrize(
    "wrong",
    [
        {"count": 1.0},
        {"count": True},
        {"count": "3"},
        {"speed": "2"},
        {"speed": True},
        {"speed": float("inf")},
        {"speed": 1e19},
        {"place": [1.0, 2.0]},
        {"sped": 1.0},
        {"inner": {"weight": 0.0}},
        {"inner": {"weight": {"keys": [[0, 0.0]]}}},
        {"count": {"keys": [[0, 1]]}},
    ],
    ids=str,
)
def test_params_are_strict(wrong: dict[str, Any]) -> None:
    with pytest.raises(ValidationError):
        Outer.model_validate(wrong)


def test_params_are_frozen_and_lists_become_tuples() -> None:
    params = Outer.model_validate({"place": [1, 2, 3]})
    assert params.place == (1.0, 2.0, 3.0)
    with pytest.raises(ValidationError):
        params.count = 4  # type: ignore[misc]


class Twin(Params):
    weight: Animated[Positive] = 1.0


def test_equal_are_those_of_one_model_with_equal_fields() -> None:
    assert Inner(weight=2.0) == Inner(weight=2.0) != Inner(weight=3.0)
    assert Inner() != Twin()
    assert Inner() != 1.0
    moving = Outer.model_validate(MOVING)
    moving.at(1.0)  # caches arrays, which are not compared
    assert moving == Outer.model_validate(MOVING)


class WithFile(Params):
    path: ScenePath


def test_scene_path_is_relative_to_the_scene(tmp_path: Path) -> None:
    (tmp_path / "points.npz").touch()
    params = WithFile.model_validate({"path": "points.npz"}, context={"folder": tmp_path})
    assert params.path == tmp_path / "points.npz"
    with pytest.raises(ValidationError, match=r"no such file: .*other\.npz"):
        WithFile.model_validate({"path": "other.npz"}, context={"folder": tmp_path})
