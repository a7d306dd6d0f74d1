"""Springs that start inside bodies or out of bounds are refused in one line; what touches is not."""

from typing import Any

import pytest

from tianim.errors import SceneError
from tianim.spatial.bodies import Bodies, Sphere
from tianim.system import Bounds, World
from tianim.systems.springs import SpringsParams, SpringSystem


def sheet_at(height: float, bounds: Bounds | None = None, **more: Any) -> SpringSystem:
    """A sheet of 5 x 5 points above the middle of a ball of 0.5 m."""
    piece = {"kind": "sheet", "segments": (4, 4), "origin": (-0.5, height, -0.5), "v": (0.0, 0.0, 1.0)}
    params = SpringsParams.model_validate({"kind": "springs", "pieces": {"cloth": piece}, **more})
    return SpringSystem("main", params, World(bounds or Bounds(), Bodies({"ball": Sphere(radius=0.5)}), 1))


def test_points_in_a_body_are_refused() -> None:
    with pytest.raises(
        SceneError, match=r"pieces\.cloth: 5 points start inside a body, the deepest by 0.1 m"
    ):
        sheet_at(0.4)


@pytest.mark.parametrize("height", [0.5, 0.499])
def test_what_touches_may(height: float) -> None:
    """Down to the thickness that contact keeps, 2 mm."""
    sheet_at(height)


def test_what_is_held_there_may() -> None:
    sheet_at(0.4, pins={"all": {"piece": "cloth", "points": "all"}})
    with pytest.raises(SceneError, match="inside a body"):
        sheet_at(0.4, pins={"later": {"piece": "cloth", "points": "all", "start": 1.0}})


def test_points_out_of_bounds_are_refused() -> None:
    bounds = Bounds("contained", (-0.4, 0.0, -1.0), (0.4, 1.0, 1.0))
    with pytest.raises(
        SceneError, match=r"10 points start out of bounds, the deepest by 0.1 m at \(-0.5, 0.6"
    ):
        sheet_at(0.6, bounds)
