"""Gauges read off what is there: heights, fronts, pressures, forces, volumes and speeds."""

import tracemalloc
from typing import Any

import numpy as np
import pytest
from fluid_scenes import OPEN, bodies, box, contained, filled, fluid
from numpy.typing import NDArray

from tianim.system import Bounds
from tianim.systems.fluid.gauges import Gauges, Reading

D = 0.1  # the spacing of all these fluids [m]
RHO_G = 1000.0 * 9.81
BLOCKS: dict[str, Any] = {
    "low": box((0, 0, 0), (2, 0.5, 0.6), settled=True),
    "high": box((0, 0.5, 0), (1, 0.9, 0.6), settled=True),
}
TANK = contained((0, 0, 0), (3, 2, 0.6))


def reading(extra: Any = (), **fields: Any) -> tuple[Reading, dict[str, Any]]:
    """The fluid at the start and some particles more, in a mixed order."""
    start = filled(**fields)
    x = np.concatenate([start.position, np.reshape(extra, (-1, 3))]).astype(np.float32)
    count, order = len(x), np.random.default_rng(1).permutation(len(x))
    more = count - len(start.position)
    pressure = np.concatenate([start.pressure, np.zeros(more, np.float32)])
    phase = np.concatenate([start.phase, np.zeros(more, np.int32)])
    velocity = np.stack([x[:, 1], 0.0 * x[:, 1], 2.0 * x[:, 0]], axis=1)
    return Reading(x[order], velocity[order], pressure[order], phase[order], {}), fields


def gauge(fluid_now: tuple[Reading, dict[str, Any]], bounds: Bounds = TANK, **given: Any) -> dict[str, float]:
    now, fields = fluid_now
    return Gauges(fluid(**fields, gauges={"g": given}), bounds).read(now)


def value(fluid_now: tuple[Reading, dict[str, Any]], bounds: Bounds = TANK, **given: Any) -> float:
    return gauge(fluid_now, bounds, **given)["gauge_g"]


@pytest.mark.parametrize("dimension", [2, 3])
@pytest.mark.parametrize(
    ("x", "height"), [(0.5, 0.9), (1.6, 0.5), (0.0, 0.9), (2.0, 0.5), (0.05, 0.9), (2.5, 0.0)]
)
def test_height_is_that_of_the_surface(dimension: int, x: float, height: float) -> None:
    """Also on the lattice and beside it, at walls and at the fluid's edge; a drop over it does not count."""
    drop = np.indices((3, 3, 3 if dimension == 3 else 1)).reshape(3, -1).T * D
    drop += [x - D, 1.3, 0.2 if dimension == 3 else 0.0]
    now = reading(drop if height > 0.0 else (), dimension=dimension, blocks=BLOCKS)
    assert value(now, kind="height", line=(x, 0.3)) == pytest.approx(height, abs=0.05 * D)


def test_a_drop_that_falls_for_ever_costs_nothing() -> None:
    """100 km over the line of a height: sampled throughout, that was 16 million samples."""
    now = reading([[0.5, 1e5, 0.3]], blocks=BLOCKS)
    near = reading([[0.5, 1.5, 0.3]], blocks=BLOCKS)
    tracemalloc.start()
    try:
        high = value(now, kind="height", line=(0.5, 0.3))
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert high == pytest.approx(value(near, kind="height", line=(0.5, 0.3)), abs=1e-6)
    assert peak < 10_000_000


def test_height_in_periodic_bounds_goes_by_the_nearest_image() -> None:
    bounds = contained((0, -1, 0), (2, 3, 0.6), "periodic")
    now = reading(blocks={"a": box((1, 0, 0), (2, 0.5, 0.6))})
    assert value(now, bounds, kind="height", line=(0.01, 0.6)) == pytest.approx(0.5, abs=0.05 * D)


def test_height_without_fluid_is_the_ground() -> None:
    now = reading(blocks=BLOCKS)
    assert value(now, kind="height", line=(9.0, 0.3)) == 0.0
    assert value(now, kind="height", line=(9.0, 0.3), floor=-0.2) == -0.2
    assert value(now, OPEN, kind="height", line=(9.0, 0.3)) == pytest.approx(0.0, abs=1e-6)


def test_height_over_a_body_under_water_begins_at_its_top() -> None:
    rock: dict[str, Any] = {"kind": "box", "size": (0.6, 0.3, 0.6), "position": (1.0, 0.35, 0.3)}
    start = filled(TANK, bodies(rock=rock), blocks={"a": box((0, 0, 0), (2, 0.9, 0.6), carve=True)})
    none = np.zeros(0, np.float32)
    now = Reading(start.position, start.velocity, none, start.phase, {})
    fields: dict[str, Any] = {"blocks": BLOCKS}
    over = {"kind": "height", "line": (1.0, 0.3)}
    assert value((now, fields), **over) == pytest.approx(0.2, abs=0.1 * D)  # two layers under the rock
    assert value((now, fields), **over, floor=0.5) == pytest.approx(0.9, abs=0.05 * D)


def spray() -> NDArray[np.float64]:
    """A drop of four far ahead, and a lone particle in the cell that touches the front's."""
    drop = np.array([[2.8, 0.5, 0.3], [2.8, 0.6, 0.3], [2.8, 0.5, 0.4], [2.9, 0.5, 0.3]])
    return np.concatenate([drop, [[2.098, 0.598, 0.3]]])


@pytest.mark.parametrize("dimension", [2, 3])
def test_the_front_is_the_bulk_s(dimension: int) -> None:
    """Neither a drop, though it has neighbours, nor a lone particle, though it is near, is the front."""
    now = reading(spray(), dimension=dimension, blocks=BLOCKS)
    assert value(now, kind="front") == pytest.approx(1.95)
    assert value(now, kind="front", direction=(2, 0, 0), origin=(0.5, 0, 0)) == pytest.approx(1.45)
    assert value(now, kind="front", direction=(0, 1, 0)) == pytest.approx(0.85)
    # A tongue of two layers above the bottom layers does not count where the depth is one spacing.
    tongue = {**BLOCKS, "tongue": box((2, 0.2, 0), (2.5, 0.4, 0.6))}
    now = reading(spray(), dimension=dimension, blocks=tongue)
    assert value(now, kind="front") == pytest.approx(2.45)
    assert value(now, kind="front", depth=D) == pytest.approx(1.95)


@pytest.mark.parametrize("dimension", [2, 3])
@pytest.mark.parametrize(
    "place", [(1.62, 0.3, 0.31), (1.5, 0.0, 0.3), (2.0, 0.2, 0.3), (2.0, 0.0, 0.0), (0.0, 0.0, 0.3)]
)
def test_pressure_of_rest_is_read_within_and_on_walls(dimension: int, place: tuple[float, ...]) -> None:
    surface = 0.9 if place[0] < 0.8 else 0.5
    pressure = value(reading(dimension=dimension, blocks=BLOCKS), kind="pressure", position=place)
    assert pressure == pytest.approx(RHO_G * (surface - place[1]), rel=1e-3)


def test_pressure_in_the_air_is_none() -> None:
    now = reading(blocks=BLOCKS)
    assert value(now, kind="pressure", position=(1.6, 0.8, 0.3)) == 0.0
    assert value(now, kind="pressure", position=(9.0, 9.0, 9.0)) == 0.0


def test_forces_come_from_the_walls() -> None:
    now = reading(blocks=BLOCKS)[0]._replace(force={"keel": np.array([1.0, -2.0, 3.5])})
    got = gauge((now, {"blocks": BLOCKS}), kind="force", body="keel")
    assert got == {"gauge_g_x": 1.0, "gauge_g_y": -2.0, "gauge_g_z": 3.5}


@pytest.mark.parametrize("dimension", [2, 3])
def test_volume_and_speed_in_a_box(dimension: int) -> None:
    now = reading(dimension=dimension, blocks=BLOCKS)
    part: dict[str, Any] = {"lower": (1.0, 0.0, -1.0), "upper": (1.5, 0.2, 1.0)}
    volume = 0.5 * 0.2 * (0.6 if dimension == 3 else 1.0)
    assert value(now, kind="volume", **part) == pytest.approx(volume)
    got = gauge(now, kind="speed", **part)
    assert got["gauge_g_x"] == pytest.approx(0.1)
    assert got["gauge_g_y"] == 0.0
    assert got["gauge_g_z"] == pytest.approx(2.0 * 1.25 if dimension == 3 else 2.5)
    assert got["gauge_g"] == pytest.approx(2.5, rel=0.01)
    empty = gauge(now, kind="speed", lower=(5, 5, 5), upper=(6, 6, 6))
    assert set(empty.values()) == {0.0}


def test_a_gauge_may_count_one_phase() -> None:
    blocks = {**BLOCKS, "high": {**BLOCKS["high"], "phase": "oil"}}
    now = reading(blocks=blocks, phases={"oil": {"density": 900.0}})
    whole: dict[str, Any] = {"kind": "volume", "lower": (0, 0, 0), "upper": (3, 3, 3)}
    assert value(now, **whole) == pytest.approx(0.84)
    assert value(now, **whole, phase="oil") == pytest.approx(0.24)
    assert value(now, kind="front", phase="oil") == pytest.approx(0.95)


def test_gauges_of_an_empty_fluid_are_numbers() -> None:
    params = fluid(
        blocks=BLOCKS,
        gauges={
            "h": {"kind": "height", "line": (0, 0)},
            "f": {"kind": "front"},
            "p": {"kind": "pressure", "position": (0, 0, 0)},
            "v": {"kind": "volume", "lower": (0, 0, 0), "upper": (3, 3, 3)},
            "s": {"kind": "speed", "lower": (0, 0, 0), "upper": (3, 3, 3)},
        },
    )
    nothing = Reading(np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(0), np.zeros(0, np.int32), {})
    got = Gauges(params, OPEN).read(nothing)
    assert set(got.values()) == {0.0}
    assert len(Gauges(params, OPEN)) == 5
