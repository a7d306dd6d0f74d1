"""The solver xpbd: lines and colours, honest stiffness and damping, walls, tears, and what stays the same."""

import subprocess
import sys
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from pydantic import ValidationError

from tianim.systems.springs.bends import bends_of
from tianim.systems.springs.colours import in_colours, lines_of
from tianim.validate.springs_scenes import (
    DOWN,
    GRAVITY,
    crossings,
    network,
    pinned,
    places,
    run,
    speeds,
    spin,
    springs,
)

Floats = NDArray[np.float64]

STEP = 1.0 / 1200.0
CALM = {"density": 0.0, "drag": 10.0}


def xpbd(piece: Any, bodies: Any = None, step: float | None = None, **fields: Any) -> Any:
    """A system that the solver xpbd steps."""
    if step is not None:
        fields["time_step"] = {"largest": step}
    return springs(piece, bodies, solver="xpbd", **fields)


def sheet(across: int, **more: Any) -> dict[str, Any]:
    """A square metre that stands upright."""
    return {"kind": "sheet", "segments": (across, across), "v": (0.0, 1.0, 0.0), **more}


def test_a_sheet_falls_into_its_rows_columns_and_diagonals() -> None:
    whole = xpbd(sheet(6)).whole
    lines = lines_of(whole.springs.ends, whole.position)
    assert sorted(s for springs_of, _ in lines for s in springs_of) == list(range(len(whole.springs.ends)))
    for springs_of, points in lines:
        assert len(set(points)) == len(springs_of) + 1
        for s, pair in zip(springs_of, pairwise(points), strict=True):
            assert sorted(pair) == sorted(whole.springs.ends[s].tolist())
    # Seven rows and columns, eleven diagonals either way.
    assert len(lines) == 7 + 7 + 11 + 11
    _, starts = in_colours([points for _, points in lines], whole.count)
    assert len(starts) - 1 == 4


def test_a_ring_is_a_line_without_its_last_spring() -> None:
    turn = np.linspace(0.0, 2.0 * np.pi, 12, endpoint=False)
    x = np.stack([np.cos(turn), np.sin(turn), 0.0 * turn], axis=1)
    ends = np.array([(k, (k + 1) % 12) for k in range(12)], np.int32)
    assert sorted(len(own) for own, _ in lines_of(ends, x)) == [1, 11]


def test_nothing_of_one_colour_shares_a_point() -> None:
    rng = np.random.default_rng(3)
    points = [rng.choice(60, size=rng.integers(2, 6), replace=False).tolist() for _ in range(300)]
    order, starts = in_colours(points, 60)
    assert sorted(order.tolist()) == list(range(300))
    sizes = []
    for begin, end in pairwise(starts.tolist()):
        inside = [i for k in order[begin:end] for i in points[k]]
        assert len(set(inside)) == len(inside)
        sizes.append(len(inside))
    # No more than one greater degree would need, and none that is nearly empty.
    degree = max(sum(i in row for row in points) for i in range(60))
    assert len(sizes) <= 4 * degree
    assert in_colours([], 5)[1].tolist() == [0]


def test_colours_are_of_like_sizes() -> None:
    """A star first, then springs apart, which greedily would all be of the first colour."""
    points = [[0, k] for k in range(1, 5)] + [[2 * k, 2 * k + 1] for k in range(3, 23)]
    _, starts = in_colours(points, 50)
    assert np.ptp(np.diff(starts)) <= 1


@pytest.mark.parametrize("iterations", [1, 4])
def test_momentum_is_kept(iterations: int) -> None:
    """Of a sheet with bending; spin is lost as by every implicit Euler step, by O(h)."""
    lost = []
    for step in (STEP, 0.25 * STEP):
        one = xpbd(
            sheet(8, bend=1e-3, velocity=(1.0, 2.0, 3.0), spin=(3.0, 6.0, 1.5)), step=step,
            xpbd={"iterations": iterations},
        )  # fmt: skip
        before, turning = one.read("mass") @ speeds(one), spin(one)
        run(one, 0.2)
        np.testing.assert_allclose(one.read("mass") @ speeds(one), before, rtol=1e-10)
        lost.append(float(np.linalg.norm(spin(one) - turning) / np.linalg.norm(turning)))
    assert lost[0] < 0.02
    assert lost[1] < 0.5 * lost[0]


def oscillation(damping: float, step: float) -> tuple[float, float]:
    """Of a mass of 1 kg on 100 N/m: half periods' mean over the law's, and the rate of decay [1/s]."""
    piece = network([(0.0, 0.0, 0.0), (1.1, 0.0, 0.0)], [(0, 1, 100.0, 1.0, damping)])
    one = xpbd(piece, step=step, pins=pinned([0]))
    seen = [(0.0, 0.1)]
    for k in range(round(2.0 / step)):
        one.step(k * step, step)
        seen.append(((k + 1) * step, float(places(one)[1, 0]) - 1.0))
    time, x = np.array(seen).T
    when = crossings(time, x)
    omega = np.sqrt(100.0 - 0.25 * damping**2)
    size = [np.abs(x[(time >= a) & (time <= b)]).max() for a, b in pairwise(when)]
    rate = np.log(size[0] / size[-1]) / ((len(size) - 1) * np.pi / omega)
    return float((when[-1] - when[0]) / (len(when) - 1) * omega / np.pi), float(rate)


def test_a_spring_has_its_period_and_its_damping() -> None:
    """Steps of implicit Euler take h omega^2 / 2 more than the damper's c / 2 m, and nothing else."""
    for damping, step in ((0.0, STEP), (1.0, STEP), (1.0, 0.25 * STEP)):
        period, rate = oscillation(damping, step)
        # Second order in h omega, and a part of the first beside the damper: 2 h c / m.
        assert period == pytest.approx(1.0, abs=(10.0 * step) ** 2 + 2.0 * step * damping)
        assert rate == pytest.approx(0.5 * damping + 50.0 * step, abs=0.02 * 50.0 * STEP)


def elongation(piece: Any, pins: Any, step: float | None = None, **fields: Any) -> float:
    """How far the lowest point hangs below 1 m, calmed [m]."""
    one = xpbd(piece, step=step, pins=pins, gravity=DOWN, air=CALM, **fields)
    run(one, 1.0)
    assert np.abs(speeds(one)).max() < 1e-3
    return float(-places(one)[:, 1].min())


def test_a_hanging_rope_is_as_long_as_the_law_says() -> None:
    """In one pass, however many points: its springs are one line."""
    for cells in (8, 64):
        rope = {
            "kind": "rope", "points": [(0.0, 0.0, 0.0), (0.0, -1.0, 0.0)], "segments": cells, "stretch": 100.0
        }  # fmt: skip
        law = 0.1 * GRAVITY / (2.0 * 100.0)
        assert elongation(rope, pinned("first")) - 1.0 == pytest.approx(law, rel=1e-3)


def test_a_hanging_sheet_converges() -> None:
    """Sag over rho g L / 2 Y: 1.0010 at the default step, 0.9997 and 0.9989 at shorter ones."""
    law = 0.2 * GRAVITY / 2000.0
    for step in (None, 0.5 * STEP):
        found = elongation(sheet(16, velocity=(0.0, 0.0, 0.0)), pinned("top"), step)
        assert found / law == pytest.approx(1.0, abs=5e-3)


@pytest.mark.slow
def test_a_draped_corner_converges() -> None:
    """Lowest point of a sheet between two corners: nearer to the converged one with each shorter step."""
    pins = pinned("left_top", "right_top")
    reference = elongation(sheet(8), pins, STEP / 16.0)
    errors = [abs(elongation(sheet(8), pins, step) - reference) for step in (4.0 * STEP, STEP)]
    assert errors[1] < 0.5 * errors[0]
    assert errors[1] < 1e-3


def test_bending_is_that_of_the_energy() -> None:
    """The differences give the Q that other solvers have, and a bent strip starts to go back as fast."""
    one = xpbd(sheet(6, bend=1e-4, stretch=1e-3, shear=1e-4))
    points, S, strength = bends_of(one.whole)
    Q = np.zeros((one.count, one.count))
    for row, s, (weight, _) in zip(points, S, strength, strict=True):
        np.add.at(Q, (row[:, None], row[None, :]), weight * s[:, None] * s[None, :])
    np.testing.assert_allclose(Q, one.whole.bending.toarray(), atol=1e-12 * np.abs(Q).max())
    x = places(one)
    x[:, 2] += 0.01 * x[:, 1] ** 2
    one.write("position", x)
    step = 1e-6
    one.step(0.0, step)
    expected = (-one.whole.bending @ x)[:, 2] / one.read("mass")
    np.testing.assert_allclose(speeds(one)[:, 2] / step, expected, atol=1e-3 * np.abs(expected).max())


def test_a_hinge_swings_with_its_period() -> None:
    """Two flaps on a pinned edge: theta'' = -k theta / I each way, I = m r^2 of one, the other held."""
    points = [(0.0, 0.0, 0.0), (0.0, 0.0, 1.0), (1.0, 0.0, 0.5), (-1.0, 0.0, 0.5)]
    hinge = {"points": (0, 1, 2, 3), "stiffness": 10.0, "angle": 0.0}
    one = xpbd(
        {**network(points, [(0, 2, 1e4, None, 0.0), (1, 2, 1e4, None, 0.0)]), "hinges": [hinge]},
        pins=pinned([0, 1, 3]),
    )
    x = places(one)
    x[2] = (np.cos(0.1), np.sin(0.1), 0.5)
    one.write("position", x)
    seen: list[tuple[float, float]] = [(0.0, 0.1)]
    run(one, 3.0, lambda time, system: seen.append((time, places(system)[2, 1])), frames=300)
    when = crossings(*np.array(seen).T)
    assert float(np.diff(when).mean()) == pytest.approx(np.pi / np.sqrt(10.0), rel=5e-3)


def slide(angle: float) -> float:
    """How far a small sheet slides down a slope in half a second, mu = 0.5 [m]."""
    a = np.radians(angle)
    down, normal = np.array([np.cos(a), -np.sin(a), 0.0]), np.array([np.sin(a), np.cos(a), 0.0])
    piece = {
        "kind": "sheet", "size": (0.2, 0.2), "segments": (4, 4), "origin": tuple((0.002 * normal).tolist()),
        "u": tuple(down.tolist()),
    }  # fmt: skip
    floor = {"floor": {"kind": "plane", "normal": tuple(normal.tolist())}}
    one = xpbd(piece, floor, gravity=DOWN, contact={"friction": 0.5, "thickness": 0.002})
    start = places(one)
    run(one, 0.5)
    return float(((places(one) - start) @ down).mean())


def test_friction_sticks_below_its_angle_and_slides_by_the_law_above() -> None:
    """The angle is 26.57 deg."""
    assert abs(slide(26.0)) < 1e-6
    a = np.radians(30.0)
    law = 0.125 * GRAVITY * (np.sin(a) - 0.5 * np.cos(a))
    assert slide(30.0) == pytest.approx(law, rel=0.01)


def test_what_is_put_into_a_wall_comes_out_without_speed() -> None:
    floor = {"floor": {"kind": "plane"}}
    one = xpbd(network([(0.0, 0.05, 0.0)]), floor, contact={"thickness": 0.002})
    one.write("position", np.array([[0.0, -0.05, 0.0]]))
    run(one, 0.1)
    assert places(one)[0, 1] == pytest.approx(0.002, abs=1e-6)
    np.testing.assert_allclose(speeds(one), 0.0, atol=1e-6)


def test_nothing_goes_through_a_thin_wall() -> None:
    wall = {"wall": {"kind": "box", "size": (0.004, 10.0, 10.0)}}
    piece = network([(-0.3 - 0.01 * k, 0.3 * k, 0.0) for k in range(10)], velocity=(200.0, 0.0, 0.0))
    one = xpbd(piece, wall, contact={"friction": 0.0})
    run(one, 0.05)
    assert (places(one)[:, 0] < 0.0).all()


def torn_in_two() -> Any:
    """A bent sheet whose halves are thrown apart; it tears between them."""
    one = xpbd(sheet(8, bend=1e-2, tear_strain=0.1, density=1.0))
    x = places(one)
    x[:, 2] += 0.05 * np.abs(x[:, 0] - 0.5)
    one.write("position", x)
    one.write("velocity", np.where(x[:, :1] > 0.55, 1.0, -1.0) * np.array([[40.0, 0.0, 0.0]]))
    run(one, 0.02)
    return one


def test_a_torn_sheet_keeps_no_forces_across_its_tear() -> None:
    """Neither springs nor bending: each half keeps its momentum."""
    one = torn_in_two()
    assert one.diagnostics()["torn"] >= 9.0
    half = places(one)[:, 0] > 0.5
    ends = one.whole.springs.ends[one.limits.springs().stiffness > 0.0]
    assert (half[ends[:, 0]] == half[ends[:, 1]]).all()
    before = one.read("mass")[half] @ speeds(one)[half]
    run(one, 0.05)
    np.testing.assert_allclose(one.read("mass")[half] @ speeds(one)[half], before, atol=1e-10)


def test_a_restored_state_goes_on_with_the_same_bytes() -> None:
    def falling() -> Any:
        return xpbd(
            {"kind": "sheet", "segments": (8, 8), "origin": (-0.5, 0.3, -0.5), "tear_strain": 0.05},
            {"ball": {"kind": "sphere", "radius": 0.28}}, gravity=DOWN,
        )  # fmt: skip

    one, other = falling(), falling()
    run(one, 0.2)
    other.restore({name: np.array(array) for name, array in one.state().items()})
    for system in (one, other):
        run(system, 0.05, start=0.2)
    assert places(one).tobytes() == places(other).tobytes()


PROGRAM = """
import sys
from tianim import runtime
runtime.start(threads=int(sys.argv[1]))
from tianim.validate.springs_scenes import DOWN, places, run, springs
sheet = {"kind": "sheet", "segments": (72, 72), "origin": (-0.5, 0.3, -0.5), "bend": 1e-5}
system = springs(sheet, {"ball": {"kind": "sphere", "radius": 0.28}}, gravity=DOWN, solver="xpbd")
run(system, 0.1)
assert system.solver._crew.tasks_for(system.count) == int(sys.argv[1])
import hashlib
print(hashlib.sha256(places(system).tobytes()).hexdigest())
"""


@pytest.mark.slow
def test_bytes_do_not_depend_on_the_number_of_threads() -> None:
    found = {
        subprocess.run(
            [sys.executable, "-c", PROGRAM, threads], capture_output=True, text=True, check=True
        ).stdout.split()[-1]
        for threads in ("1", "2")
    }  # fmt: skip
    assert len(found) == 1


def test_solids_are_refused() -> None:
    with pytest.raises(ValidationError, match="solids need explicit steps, not xpbd"):
        xpbd({"kind": "solid"})
