"""Axes and units of the files: what turns, what is scaled, and the way back."""

import numpy as np
import pytest

from tianim.export.axes import Axes
from tianim.frame import Array, Lines, Points

HALF = np.sqrt(np.float32(0.5))


def part() -> Points:
    data: dict[str, Array] = {
        "velocity": np.array([[1, 2, 3]], np.float32),
        "normal": np.array([[0, 1, 0]], np.float32),
        "color": np.array([[0.1, 0.2, 0.3]], np.float32),
        "orientation": np.array([[0, HALF, 0, HALF]], np.float32),
        "cell": np.array([[1, 2, 3]], np.int32),
        "radius": np.array([0.5], np.float32),
        "density": np.array([1000], np.float32),
    }
    units = {"velocity": "m/s", "density": "kg/m^3"}
    return Points("p", np.array([[4, 5, 6]], np.float32), data, units)


def test_z_up_turns_what_points_somewhere_and_nothing_else() -> None:
    turned = Axes("z").apply(part())
    np.testing.assert_array_equal(turned.position, [[4, -6, 5]])
    expected = {
        "velocity": [[1, -3, 2]],
        "normal": [[0, 0, 1]],  # up in the file
        "orientation": [[0, 0, HALF, HALF]],  # a turn about up stays one
    }
    for name, values in part().data.items():
        np.testing.assert_array_equal(turned.data[name], expected.get(name, values), err_msg=name)


def test_scale_counts_lengths_and_speeds_and_nothing_else() -> None:
    scaled = Axes(scale=100.0).apply(part())
    np.testing.assert_array_equal(scaled.position, [[400, 500, 600]])
    expected = {"velocity": [[100, 200, 300]], "radius": [50]}
    for name, values in part().data.items():
        np.testing.assert_array_equal(scaled.data[name], expected.get(name, values), err_msg=name)


def test_data_of_cells_are_converted_too() -> None:
    segments, push = np.array([[0, 1]], np.int32), np.array([[1, 2, 3]], np.float32)
    rope = Lines("rope", np.zeros((2, 3), np.float32), segments, {}, {"push": push}, {"push": "m/s^2"})
    found = Axes("z", 10.0).apply(rope)
    assert isinstance(found, Lines)
    np.testing.assert_array_equal(found.cell_data["push"], [[10, -30, 20]])


@pytest.mark.parametrize("axes", [Axes("z"), Axes("y", 4.0), Axes("z", 0.125)])
def test_the_way_back_is_exact(axes: Axes) -> None:
    there = axes.apply(part())
    back = axes.undo(there)
    assert there.position.tobytes() != back.position.tobytes() == part().position.tobytes()
    for name, values in part().data.items():
        assert back.data[name].tobytes() == values.tobytes(), name
