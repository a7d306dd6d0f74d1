"""What springs do not bear: plastic yield, tears, the strain limit; and too many substeps."""

from typing import Any

import numpy as np
import pytest

from tianim.errors import SceneError
from tianim.spatial.bodies import Bodies
from tianim.system import Bounds, World
from tianim.systems.springs import SpringsParams, SpringSystem
from tianim.systems.springs.assembly import BENDING

SINGLE = 1e-6  # rest lengths are float32


def spring(**more: Any) -> SpringSystem:
    """A mass on a spring of 10 N/m and 1 m, without gravity."""
    piece = {
        "kind": "network", "points": ((0.0, 0.0, 0.0), (1.0, 0.0, 0.0)), "mass": 1.0,
        "springs": ({"between": (0, 1), "stiffness": 10.0},), **more,
    }  # fmt: skip
    return system({"pair": piece}, pins={"a": {"piece": "pair", "points": (0,)}}, gravity=(0.0, 0.0, 0.0))


def system(pieces: dict[str, Any], **more: Any) -> SpringSystem:
    params = SpringsParams.model_validate({"kind": "springs", "solver": "explicit", "pieces": pieces, **more})
    return SpringSystem("one", params, World(Bounds(), Bodies({}), 1))


def sheet(solver: str, **more: Any) -> SpringSystem:
    """A soft sheet that hangs from two corners."""
    piece = {
        "kind": "sheet",
        "segments": (12, 12),
        "v": (0.0, -1.0, 0.0),
        "stretch": 20.0,
        "shear": 2.0,
        **more,
    }
    return system(
        {"sheet": piece},
        solver=solver,
        pins={
            "a": {"piece": "sheet", "points": "left_bottom"},
            "b": {"piece": "sheet", "points": "right_bottom"},
        },
    )


def run(one: SpringSystem, until: float, longest: float = 1.0 / 120.0) -> float:
    """Go on; the largest strain on the way, stretched only."""
    worst, dt = 0.0, min(one.max_step(), longest)
    for step in range(round(until / dt)):
        one.step(step * dt, dt)
        worst = max(worst, float(one.report.strains(one.read("position"))[0].max()))
    return worst


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_what_yields_has_another_rest_length(sign: float) -> None:
    """Drawn to a strain of 0.3 with a yield of 0.1, l' = 1.3 / 1.1; pressed, l' = 0.7 / 0.9."""
    one = spring(yield_strain=0.1)
    x = one.read("position")
    x[1, 0] = 1.0 + 0.3 * sign
    one.write("position", x)
    one.step(0.0, 1e-6)
    rest = (1.0 + 0.3 * sign) / (1.0 + 0.1 * sign)
    assert one.limits.springs().rest_length == pytest.approx([rest], rel=1e-5)
    assert one.report.elastic(one.read("position")) == pytest.approx(5.0 * (0.1 * rest) ** 2, rel=1e-4)


def test_both_rows_of_a_spring_yield_alike() -> None:
    one = spring(yield_strain=0.1)
    x = one.read("position")
    x[1] = (1.1, 0.7, 0.2)
    one.write("position", x)
    one.step(0.0, 1e-6)
    rows = one.points.row.to_numpy()
    np.testing.assert_array_equal(rows[0], rows[1])


def test_below_its_yield_nothing_changes() -> None:
    plain, limited = spring(), spring(yield_strain=0.5, tear_strain=0.6)
    for one in (plain, limited):
        x = one.read("position")
        x[1, 0] = 1.3
        one.write("position", x)
        run(one, 1.0)
    np.testing.assert_array_equal(plain.read("position"), limited.read("position"))


def test_a_torn_spring_lets_go() -> None:
    """Thrown faster than the spring bears, the mass flies on at the speed that it had then."""
    one = spring(tear_strain=0.2)
    v = one.read("velocity")
    v[1, 0] = 2.0
    one.write("velocity", v)
    run(one, 1.0, 1e-3)
    speed = one.read("velocity")[1, 0]
    # Energy: what is left of v^2 / 2 when the spring is 0.2 longer, 10 / 2 x 0.04; torn within a step after.
    assert speed == pytest.approx(np.sqrt(4.0 - 0.4), rel=2e-3)
    assert one.diagnostics()["torn"] == 1.0
    assert one.diagnostics()["elastic_energy"] == 0.0


def test_triangles_with_a_torn_edge_are_not_shown() -> None:
    one = sheet("explicit", tear_strain=0.25)
    run(one, 1.0)
    torn = int(one.diagnostics()["torn"])
    assert torn > 0
    shown, all_of_them = one.snapshot()[0].triangles, one.whole.pieces["sheet"].triangles  # type: ignore[union-attr]
    ends = one.whole.springs.ends[one.limits.springs().stiffness == 0.0]
    pairs = {tuple(sorted(pair)) for pair in ends.tolist()}

    def hurt(triangle: Any) -> bool:
        return any(tuple(sorted((int(triangle[k]), int(triangle[k - 1])))) in pairs for k in range(3))

    np.testing.assert_array_equal(shown, [t for t in all_of_them if not hurt(t)])
    assert len(shown) < len(all_of_them)


@pytest.mark.parametrize("solver", ["explicit", "projective"])
def test_no_spring_is_stretched_beyond_its_limit(solver: str) -> None:
    """Provot's sheet: hung from two corners, too soft by far."""
    assert run(sheet(solver), 0.5) > 0.3
    assert run(sheet(solver, strain_limit=0.1), 0.5) < 0.1 + SINGLE


def test_the_limit_keeps_the_momentum() -> None:
    one = spring(strain_limit=0.1)
    free = SpringsParams.model_validate({**one.params.model_dump(), "pins": {}})
    one = SpringSystem("one", free, World(Bounds(), Bodies({}), 1))
    v = one.read("velocity")
    v[1] = (3.0, 1.0, 0.0)
    one.write("velocity", v)
    run(one, 1.0)
    total = one.read("velocity").sum(axis=0)
    np.testing.assert_allclose(total, [3.0, 1.0, 0.0], atol=1e-9)


def test_a_restored_state_remembers_what_gave_way() -> None:
    one, other = spring(yield_strain=0.1), spring(yield_strain=0.1)
    v = one.read("velocity")
    v[1, 0] = 2.0
    one.write("velocity", v)
    run(one, 0.5)
    other.restore({name: np.array(array) for name, array in one.state().items()})
    assert other.limits.springs().rest_length == pytest.approx(one.limits.springs().rest_length)
    assert one.limits.springs().rest_length[0] != pytest.approx(1.0, abs=SINGLE)


def test_too_many_substeps_are_refused() -> None:
    one = spring()
    with pytest.raises(
        SceneError, match=r"one: a frame would need 6,000 substeps.*most_substeps, 5,000.*softer"
    ):
        one.check_substeps(6000)
    one.check_substeps(5000)


@pytest.mark.parametrize("solver", ["explicit", "projective", "xpbd"])
def test_bending_ends_where_a_sheet_is_torn(solver: str) -> None:
    """A strip that is pulled in two: its halves, turned against each other, do not bend."""
    piece = {
        "kind": "sheet", "size": (1.0, 0.1), "segments": (10, 1), "stretch": 20.0, "shear": 2.0, "bend": 1e-3,
        "tear_strain": 0.3,
    }  # fmt: skip
    one = system({"strip": piece}, solver=solver, gravity=(0.0, 0.0, 0.0), air={"density": 0.0})
    x = one.read("position")
    right = x[:, 0] > 0.55
    assert 0 < right.sum() < len(x)
    x[right, 0] += 0.1
    one.write("position", x)
    one.step(0.0, 1e-7)
    assert one.diagnostics()["torn"] > 0
    x[right] = (x[right] - [0.6, 0.0, 0.0]) @ np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    assert one.report.bending(x) == pytest.approx(0.0, abs=1e-12)
    row, start, neighbour = (a.to_numpy() for a in (one.points.row, one.points.start, one.points.neighbour))
    rows = np.repeat(np.arange(len(x)), np.diff(start))
    across = right[rows] != right[neighbour[: len(rows)]]
    assert across.any()
    assert (row[: len(rows)][across, BENDING] == 0.0).all()
    assert (row[: len(rows)][~across, BENDING] != 0.0).any()
    other = system({"strip": piece}, solver=solver, gravity=(0.0, 0.0, 0.0), air={"density": 0.0})
    other.restore(one.state())
    assert other.report.bending(x) == pytest.approx(0.0, abs=1e-12)
