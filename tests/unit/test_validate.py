"""Validation itself: what passes, what a result holds, which cases run, what is plotted."""

import json
import math
from pathlib import Path
from typing import Any

import pytest

from tianim import validate
from tianim.errors import BlowupError, OutputError, SceneError
from tianim.validate import CASES, Case, Figure, result, run
from tianim.validate.plots import plot

KEYS = {"system", "check", "expected", "measured", "error", "tolerance", "passed", "source", "seconds"}
FIGURE = Figure("order_and_noise", "noise [rad]", "order parameter")


def case(measured: float = 1.0, **fields: Any) -> Case:
    given: dict[str, Any] = {
        "system": "sand",
        "name": "pile",
        "run": lambda: measured,
        "expected": 1.0,
        "source": "a book",
    }
    return Case(**{**given, **fields})


@pytest.mark.parametrize(
    ("fields", "measured", "passed", "error"),
    [
        ({"expected": 2.0, "tolerance": 0.1}, 2.1, True, 0.1),
        ({"expected": 2.0, "tolerance": 0.1}, 1.85, False, -0.15),
        ({"expected": 0.0}, 0.0, True, 0.0),
        ({"expected": 0.0}, 1e-9, False, 1e-9),
        ({"expected": 2.0, "comparison": "below"}, 1.0, True, 0.0),
        ({"expected": 2.0, "comparison": "below"}, 2.5, False, 0.5),
        ({"expected": 2.0, "comparison": "above"}, 2.0, True, 0.0),
        ({"expected": 2.0, "comparison": "above"}, -1.0, False, -3.0),
        ({"expected": (1.0, 2.0), "comparison": "between"}, 1.5, True, 0.0),
        ({"expected": (1.0, 2.0), "comparison": "between"}, 0.5, False, -0.5),
        ({"expected": (1.0, 2.0), "comparison": "between"}, 4.0, False, 2.0),
    ],
)
def test_what_passes_and_how_far_it_is_off(
    fields: dict[str, Any], measured: float, passed: bool, error: float
) -> None:
    one = case(**fields)
    assert one.passed(measured) is passed
    assert one.error(measured) == pytest.approx(error)


def test_a_limit_is_told_in_words() -> None:
    assert result(case(), 1.0, 0.0)["check"] == "pile"
    assert result(case(comparison="below"), 1.0, 0.0)["check"] == "pile, at most"
    assert result(case(comparison="above"), 1.0, 0.0)["check"] == "pile, at least"
    both = result(case(comparison="between", expected=(0.0, 2.0)), 1.0, 0.0)
    assert (both["check"], both["expected"]) == ("pile, between", [0.0, 2.0])


@pytest.mark.parametrize("comparison", ["equal", "below", "above"])
@pytest.mark.parametrize("measured", [math.nan, math.inf, -math.inf])
def test_what_is_not_finite_never_passes(measured: float, comparison: str) -> None:
    one = case(comparison=comparison, tolerance=math.inf)
    assert not one.passed(measured)
    assert result(one, measured, 0.0)["measured"] is None


@pytest.fixture
def sand(monkeypatch: pytest.MonkeyPatch) -> None:
    """A system whose cases pass, fail, blow up, and take long."""

    def burst() -> float:
        raise BlowupError("sand", 3, "not finite")

    cases = (
        case(1.02, tolerance=0.05, figure=FIGURE, x=1.0),
        case(1.2, name="slope", tolerance=0.1, figure=FIGURE, x=2.0),
        case(name="heap", run=burst, figure=FIGURE, x=3.0),
        case(name="dune", slow=True),
    )
    monkeypatch.setattr(validate, "CASES", {"sand": cases, "beach": cases[:1], "boids": ()})


@pytest.mark.usefixtures("sand")
def test_results_are_json_with_the_agreed_keys() -> None:
    results = list(run("sand"))
    assert [one["check"] for one in results] == ["pile", "slope", "heap"]
    assert [one["passed"] for one in results] == [True, False, False]
    assert results[2]["measured"] is None
    for one in results:
        assert set(one) == KEYS
        assert json.loads(json.dumps(one, allow_nan=False)) == one
    assert isinstance(results[0]["passed"], bool)


@pytest.mark.usefixtures("sand")
def test_each_case_is_named_before_it_runs() -> None:
    begun: list[tuple[int, int, str]] = []
    for number, _ in enumerate(run("sand", begins=lambda *which: begun.append(which)), 1):
        assert len(begun) == number
    assert begun == [(1, 3, "pile"), (2, 3, "slope"), (3, 3, "heap")]


@pytest.mark.usefixtures("sand")
def test_slow_cases_run_when_asked_for() -> None:
    assert [one["check"] for one in run("sand", slow=True)][-1] == "dune"


@pytest.mark.usefixtures("sand")
def test_all_systems_run_each_case_once() -> None:
    assert [one["check"] for one in run(None)] == ["pile", "slope", "heap"]


@pytest.mark.usefixtures("sand")
def test_an_unknown_system_is_refused_at_once_with_the_nearest() -> None:
    with pytest.raises(SceneError, match="'bods': did you mean 'boids'"):
        run("bods")
    with pytest.raises(SceneError, match="there are sand, beach, boids"):
        run("xyz")


@pytest.mark.usefixtures("sand")
def test_a_figure_is_written(tmp_path: Path) -> None:
    out = tmp_path / "new" / "folder"
    list(run("sand", out=out))
    files = list(out.iterdir())
    assert [file.name for file in files] == ["order_and_noise.png"]
    assert files[0].read_bytes()[:8] == b"\x89PNG\r\n\x1a\n"
    assert files[0].stat().st_size > 5000


@pytest.mark.parametrize("measured", [{}, {1.0: 0.9}, {1.0: 0.9, 2.0: 4.0}])
@pytest.mark.parametrize("comparison", ["equal", "below", "between"])
def test_any_number_of_points_is_drawn(tmp_path: Path, comparison: str, measured: dict[float, float]) -> None:
    expected = (0.0, 1.0) if comparison == "between" else 1.0
    points = {
        case(figure=FIGURE, x=x, comparison=comparison, expected=expected): value
        for x, value in measured.items()
    }
    assert plot(FIGURE, points, tmp_path).is_file()


def test_a_folder_that_is_a_file_is_told(tmp_path: Path) -> None:
    (tmp_path / "out").write_text("")
    with pytest.raises(OutputError, match=r"order_and_noise\.png: cannot be written"):
        plot(FIGURE, {case(figure=FIGURE): 1.0}, tmp_path / "out")


def test_cases_are_told_apart_and_say_their_source() -> None:
    for cases in CASES.values():
        names = [(one.system, one.name) for one in cases]
        assert len(set(names)) == len(names)
        assert all(one.source for one in cases)
        assert any(not one.slow for one in cases)
    assert set(CASES["vicsek"]) | set(CASES["couzin"]) < set(CASES["boids"])
