"""What metrics hold of springs: contacts by every solver, and what passes through what."""

from typing import Any

import pytest

from tianim.system import Bounds
from tianim.validate.build import OPEN, built
from tianim.validate.springs_scenes import DOWN, STILL, network, run, springs

FLOOR = {"floor": {"kind": "plane"}}
CLOTH = {"kind": "sheet", "size": (0.2, 0.2), "segments": (4, 4), "origin": (0.0, 0.004, 0.0)}
ROPE = {"kind": "rope", "points": ((0.0, 0.004, 0.0), (0.2, 0.004, 0.0)), "segments": 8}


def contacts(system: Any) -> float:
    return float(system.diagnostics()["contacts"])


@pytest.mark.parametrize(
    ("piece", "points", "solver"),
    [(CLOTH, 25, "explicit"), (CLOTH, 25, "projective"), (ROPE, 9, "strands")],
    ids=("explicit", "projective", "strands"),
)
def test_what_lies_on_the_floor_is_in_contact(piece: Any, points: int, solver: str) -> None:
    system = springs(piece, FLOOR, gravity=DOWN, solver=solver)
    assert contacts(system) == 0.0
    run(system, 0.5)
    assert contacts(system) == points


def test_sides_of_the_bounds_are_touched_too_and_pins_are_not_counted() -> None:
    tank = Bounds("contained", (-1.0, 0.0, -1.0), (1.0, 2.0, 1.0))
    pins = {"held": {"piece": "p", "points": [0]}}
    places = [(0.0, 0.002, 0.0), (0.0, 0.002, 0.5), (0.998, 1.0, 0.0), (0.0, 1.0, 0.0)]
    system = run(springs(network(places), bounds=tank, pins=pins, solver="explicit"), 1e-3)
    assert contacts(system) == 2.0


def crossing(fabric: Any = (), **fields: Any) -> Any:
    """A square that a narrow one, upright, goes through by two sides and a diagonal."""
    sheet = {"kind": "sheet", "segments": (1, 1), "shear": 10.0, **dict(fabric)}
    pieces = {
        "lying": {**sheet, "size": (1.0, 1.0)},
        "upright": {
            **sheet, "size": (0.2, 1.0), "origin": (0.3, -0.5, 0.4),
            "u": (0.0, 0.0, 1.0), "v": (0.0, 1.0, 0.0),
        },
    }  # fmt: skip
    return built("springs", OPEN, pieces=pieces, gravity=(0.0, 0.0, 0.0), air=STILL, **fields)


def test_passes_are_counted_on_request() -> None:
    assert "self_intersections" not in crossing().diagnostics()
    assert crossing(report={"self_intersections": True}).diagnostics()["self_intersections"] == 3.0


def test_what_is_stitched_does_not_pass_through_itself() -> None:
    system = crossing(
        report={"self_intersections": True},
        stitches={
            f"seam_{chr(97 + k)}": {
                "first": {"piece": "lying", "points": [k]}, "second": {"piece": "upright", "points": [k]},
            }
            for k in range(4)
        },
    )  # fmt: skip
    assert system.diagnostics()["self_intersections"] == 0.0


def test_what_is_torn_passes_through_nothing() -> None:
    system = crossing({"tear_strain": 0.5}, report={"self_intersections": True})
    x = system.read("position")
    x[[4, 6], 1] -= 2.0  # the lower corners of the upright one
    system.write("position", x)
    assert system.diagnostics()["self_intersections"] == 3.0
    run(system, 1e-5)
    assert system.diagnostics()["self_intersections"] == 0.0
