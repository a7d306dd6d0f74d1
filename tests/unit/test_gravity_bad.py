"""Gravity refuses what cannot be right in one clear line, and warns of what is odd."""

import logging
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tianim.errors import BlowupError, SceneError
from tianim.scene import build, scene_from
from tianim.validate.gravity import simulated

Scene = dict[str, Any]
SOFT: Scene = {"softening": {"length": 0.05}}


def scene(**fields: Any) -> Scene:
    """A scene file's data with one gravity system."""
    return {"tianim": 1, "duration": 0, "systems": {"stars": {"kind": "gravity", **fields}}}


def listed(*rows: Scene) -> Scene:
    return {"components": {"all": {"kind": "bodies", "bodies": list(rows)}}}


def plummer(**fields: Any) -> Scene:
    return {"components": {"all": {"kind": "plummer", "count": 50, "mass": 1.0, **fields}}}


REFUSED: dict[str, tuple[Scene, tuple[str, ...]]] = {
    "zero mass": (plummer(mass=0.0), ("systems.stars.components.all", "mass 0", "massless: true")),
    "negative mass": (plummer(mass=-1.0), ("mass -1", "greater than 0")),
    "negative mass of a body": (listed({"mass": -2.0}), ("bodies.0", "mass -2")),
    "mass of the massless": (plummer(massless=True), ("massless is true",)),
    "coincident stars without softening": (
        listed({"mass": 1.0, "position": [5, 0, 0]}, {"mass": 1.0}, {"mass": 2.0, "position": [5, 0, 0]}),
        ("stars 0 and 2", "at one place", "softening.length"),
    ),
    "a massless star on a massive one": (
        listed({"mass": 1.0}, {"massless": True}, {"mass": 1.0, "position": [1, 0, 0]}),
        ("stars 0 and 1", "at one place"),
    ),
    "softening larger than the system": (
        {**plummer(truncation=5.0), "softening": {"length": 50.0}},
        ("softening.length: 50 is larger than the whole system", "radius"),
    ),
    "not a number": (listed({"mass": 1.0, "position": [float("nan"), 0, 0]}), ("position.0", "finite")),
    "block steps of another integrator": (
        {**plummer(), "integrator": "rk4", "time_step": {"kind": "block"}},
        ("block steps are leapfrog's, not rk4's",),
    ),
    "an unknown integrator": ({**plummer(), "integrator": "leepfrog"}, ("did you mean 'leapfrog'",)),
    "an unknown component": (
        {**plummer(), "diagnostics": {"rings": [{"component": "disk", "edges": [1, 2]}]}},
        ("no component 'disk'; there are all",),
    ),
    "rings that do not rise": (
        {**plummer(), "diagnostics": {"rings": [{"component": "all", "edges": [2, 1]}]}},
        ("edges must rise: 1 comes after 2",),
    ),
    "a step of nothing": ({**plummer(), "time_step": {"kind": "fixed", "length": 0}}, ("greater than 0",)),
    "no such accuracy": ({**plummer(), "solver": {"accuracy": 0.0}}, ("accuracy",)),
}  # fmt: skip


@pytest.mark.parametrize("name", REFUSED)
def test_refused_in_one_line(name: str) -> None:
    fields, words = REFUSED[name]
    with pytest.raises(SceneError) as caught:
        build(scene_from(scene(**fields)))
    message = str(caught.value)
    for word in words:
        assert word in message, message
    assert len(message.splitlines()) <= 2


def test_bounds_must_be_open() -> None:
    box = {"kind": "contained", "lower": [-1, -1, -1], "upper": [1, 1, 1]}
    with pytest.raises(SceneError, match=r"systems\.stars: gravity needs bounds of kind open, not contained"):
        scene_from({**scene(**plummer()), "bounds": box})


@pytest.mark.parametrize(
    ("column", "words"),
    [("position", "position of star 3 is not finite"), ("velocity", "velocity of star 3 is not finite"),
     ("mass", "mass of star 3 is not finite")],
)  # fmt: skip
def test_wrong_numbers_in_a_file_name_the_star(tmp_path: Path, column: str, words: str) -> None:
    rng = np.random.default_rng(1)
    stars = {"position": rng.normal(size=(9, 3)), "velocity": np.zeros((9, 3)), "mass": np.ones(9)}
    stars[column][3] = stars[column][7] = np.nan
    np.savez(tmp_path / "stars.npz", **stars)  # type: ignore[arg-type]
    fields = {"components": {"all": {"kind": "file", "path": str(tmp_path / "stars.npz")}}}
    with pytest.raises(SceneError, match=words):
        build(scene_from(scene(**fields)))


def test_coincident_stars_are_fine_when_softened_or_massless() -> None:
    pair: tuple[Scene, ...] = ({"mass": 1.0}, {"mass": 1.0}, {"mass": 1.0, "position": [1.0, 0, 0]})
    build(scene_from(scene(**listed(*pair), **SOFT)))
    probes: tuple[Scene, ...] = (
        {"massless": True},
        {"massless": True},
        {"mass": 1.0, "position": [1.0, 0, 0]},
    )
    build(scene_from(scene(**listed(*probes))))


def test_an_unbound_start_is_warned_of_in_one_line(caplog: pytest.LogCaptureFixture) -> None:
    away: tuple[Scene, ...] = (
        {"mass": 1.0, "position": [1.0, 0, 0], "velocity": [3.0, 0, 0]},
        {"mass": 1.0, "position": [-1.0, 0, 0], "velocity": [-3.0, 0, 0]},
    )
    with caplog.at_level(logging.WARNING, "tianim"):
        simulated({"all": {"kind": "bodies", "bodies": away}})
        (record,) = caplog.records
        assert "not bound" in record.getMessage()
        assert "\n" not in record.getMessage()
        caplog.clear()
        simulated(plummer()["components"], **SOFT)
        assert not caplog.records, "a cluster in balance is bound"


def test_many_stars_without_softening_are_warned_of(caplog: pytest.LogCaptureFixture) -> None:
    with caplog.at_level(logging.WARNING, "tianim"):
        simulated(plummer(count=300)["components"])
    assert "without softening" in caplog.text


def test_what_is_set_is_checked() -> None:
    system = simulated(plummer()["components"], **SOFT)
    with pytest.raises(SceneError, match="masses must be finite and not negative"):
        system.write("mass", np.full(50, -1.0))
    with pytest.raises(SceneError, match="cannot be set; position, velocity, mass can"):
        system.write("acceleration", np.zeros((50, 3)))
    system.add_force(lambda time, position, velocity: np.zeros(3))
    with pytest.raises(SceneError, match=r"a force gave shape \(3,\), must be \(50, 3\)"):
        system.step(0.0, 0.1)


@pytest.mark.parametrize("kind", ["direct", "tree"])
def test_a_place_that_is_not_a_number_ends_in_a_blow_up(kind: str) -> None:
    """Forces of such places are found somehow and without a crash; the check names the star."""
    system = simulated(plummer(count=500)["components"], **SOFT, solver={"kind": kind, "check_every": 0})
    position = system.read("position")
    position[7] = np.nan
    system.write("position", position)
    system.step(0.0, 0.01)
    with pytest.raises(BlowupError, match="particle"):
        system.check()
