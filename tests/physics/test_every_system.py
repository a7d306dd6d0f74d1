"""What every system must do, over the SYSTEMS table: a new kind needs an example in `every_system.py`."""

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import every_system
import numpy as np
import pytest
from every_system import EXAMPLES, Example, digest, examples_of, make, run
from pydantic import ValidationError

from tianim.errors import BlowupError, SceneError
from tianim.frame import Points
from tianim.lang import ti
from tianim.systems import SYSTEMS

# An estimate before anything is allocated may be off by this factor.
MEMORY_FACTOR = 2.0
# Kinds whose lists of neighbours get their length in the first step.
FIRST_STEP_LISTS = ("fluid",)
MANY = 100_000  # particles at which what each takes outweighs what all share

ALL = [
    pytest.param(kind, example, id=f"{kind}-{example.note.replace(' ', '_')}")
    for kind in SYSTEMS
    for example in EXAMPLES.get(kind, ())
]
every_example = pytest.mark.parametrize(("kind", "example"), ALL)
every_kind = pytest.mark.parametrize("kind", list(SYSTEMS))


@every_kind
def test_every_kind_has_an_example(kind: str) -> None:
    assert examples_of(kind)


def test_a_kind_without_an_example_says_what_to_do() -> None:
    with pytest.raises(KeyError, match=r"'sand' has no example: add .* to EXAMPLES in .*every_system\.py"):
        examples_of("sand")


@every_example
def test_steps_stay_finite(kind: str, example: Example) -> None:
    system = run(make(kind, example))
    system.check()
    for part in system.snapshot():
        for values in (part.position, *part.data.values()):
            assert np.isfinite(values).all()
    assert system.max_step() > 0.0


@every_example
def test_the_same_seed_gives_the_same_bytes_and_another_other_ones(kind: str, example: Example) -> None:
    first = digest(run(make(kind, example)))
    assert digest(run(make(kind, example))) == first
    assert (digest(run(make(kind, example, seed=2))) != first) is example.random


@pytest.fixture(scope="module")
def on_one_thread() -> dict[str, str]:
    """Digests from a process with one worker."""
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(path for path in sys.path if path)}
    done = subprocess.run(
        [sys.executable, every_system.__file__, "1"],
        capture_output=True, text=True, check=False, env=environment, cwd=Path(__file__).parent, timeout=300,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    return dict(json.loads(done.stdout))


@every_kind
def test_one_thread_and_two_give_the_same_bytes(kind: str, on_one_thread: dict[str, str]) -> None:
    for k, example in enumerate(examples_of(kind)):
        assert digest(run(make(kind, example))) == on_one_thread[f"{kind}-{k}"], example.note


@every_example
def test_diagnostics_are_of_now(kind: str, example: Example) -> None:
    system = run(make(kind, example), 2)
    system.check()
    system.diagnostics()  # what was measured here must not be told again
    run(system, 2, first=2)
    fresh = make(kind, example)
    fresh.restore({name: np.array(array) for name, array in system.state().items()})
    assert dict(system.diagnostics()) == dict(fresh.diagnostics())


@every_example
def test_a_restored_state_goes_on_as_if_never_stopped(kind: str, example: Example) -> None:
    system = run(make(kind, example), 6)
    saved = {name: np.array(array) for name, array in system.state().items()}
    straight_on = digest(run(system, 6, first=6))
    resumed = make(kind, example, seed=1)
    run(resumed, 2)  # what it held before must not matter
    resumed.restore(saved)
    assert digest(run(resumed, 6, first=6)) == straight_on


@every_example
@pytest.mark.parametrize("count", [0, 1])
def test_none_and_one(kind: str, example: Example, count: int) -> None:
    if count < example.fewest:
        with pytest.raises(ValidationError):
            make(kind, example, more=example.sized(count))
        return
    system = run(make(kind, example, more=example.sized(count)), 4)
    system.check()
    assert all(np.isfinite(value) for value in system.diagnostics().values())
    assert len(system.snapshot()[0].position) == count
    again = make(kind, example, more=example.sized(count))
    again.restore(system.state())
    assert digest(again) == digest(system)


@every_kind
@pytest.mark.parametrize(
    "wrong",
    [{"no_such_field": 1}, {"kind": "other"}, {"count": -1}, {"count": 2.5}, {"count": "ten"},
     {"count": True}, {"time_step": 0.0}, {"time_step": float("nan")}, {"time_step": float("inf")},
     {"time_step": "1e-2 s"}],
    ids=str,
)  # fmt: skip
def test_bad_parameters_are_refused(kind: str, wrong: dict[str, Any]) -> None:
    model, valid = SYSTEMS[kind].params, {"kind": kind, **examples_of(kind)[0].params}
    model.model_validate(valid)
    with pytest.raises(ValidationError):
        model.model_validate({**valid, **wrong})


@every_example
def test_what_it_shows(kind: str, example: Example) -> None:
    """Positions (n, 3) float32, data of as many rows, ids that rise and stay with their particle."""
    system = run(make(kind, example))
    position = system.read("position")
    seen = 0
    for part in system.snapshot():
        count = len(part.position)
        assert part.position.dtype == np.float32
        assert part.position.shape == (count, 3)
        for name, values in part.data.items():
            assert len(values) == count, name
            assert values.dtype in (np.float32, np.int32), name
        cells = {} if isinstance(part, Points) else part.cell_data
        assert set(part.units) <= {*part.data, *cells}
        if isinstance(part, Points) or "id" in part.data:
            ids = part.data["id"]
            assert ids.dtype == np.int32
            assert np.all(np.diff(ids) >= 1 if example.flows else np.diff(ids) == 1)
            rows = np.searchsorted(system.read("id"), ids) if example.flows else ids
            np.testing.assert_array_equal(part.position, position[rows].astype(np.float32))
            velocity = system.read("velocity").astype(np.float32)
            np.testing.assert_array_equal(part.data["velocity"], velocity[rows])
            seen += count
    assert seen == len(position)
    assert example.flows or seen == system.params.particle_count()


@every_example
def test_a_snapshot_is_a_copy(kind: str, example: Example) -> None:
    system = run(make(kind, example), 2)
    before = system.snapshot()
    kept = [part.position.copy() for part in before]
    run(system, 2, first=2)
    for part, position in zip(before, kept, strict=True):
        np.testing.assert_array_equal(part.position, position)
    pairs = zip(before, system.snapshot(), strict=True)
    assert not all(np.array_equal(a.position, b.position) for a, b in pairs)


@every_example
def test_what_nobody_wants_is_not_shown(kind: str, example: Example) -> None:
    shown = make(kind, example, fields=frozenset({"id"})).snapshot()
    assert all(set(part.data) <= {"id"} for part in shown)
    assert not any(part.cell_data for part in shown if not isinstance(part, Points))


@every_example
def test_diagnostics_are_finite_numbers_under_the_same_names(kind: str, example: Example) -> None:
    system = make(kind, example)
    at_start = system.diagnostics()
    later = run(system, 3).diagnostics()
    assert at_start.keys() == later.keys()
    for name, value in later.items():
        assert isinstance(value, float), name
        assert np.isfinite(value), name


@every_example
def test_arrays_are_read_and_set(kind: str, example: Example) -> None:
    system = run(make(kind, example), 3)
    before = digest(system)
    assert "position" in system.arrays()
    for name in system.arrays():
        values = system.read(name)
        assert len(values) == len(system.read("position"))
        assert values.dtype in (np.float32, np.float64, np.int32)
        try:
            system.write(name, values)
        except SceneError as error:
            assert "cannot be set" in str(error)  # noqa: PT017  (some arrays may be set)
    assert digest(system) == before
    with pytest.raises(SceneError, match=r"shape .*must be"):
        system.write("position", np.zeros((3, 2), np.float32))
    for access in (system.read, lambda name: system.write(name, np.zeros(1))):
        with pytest.raises(SceneError, match="no array 'colour'; there are"):
            access("colour")


@every_example
@pytest.mark.parametrize("wrong", [np.nan, np.inf, 1e30])
def test_a_blow_up_names_the_lowest_particle(kind: str, example: Example, wrong: float) -> None:
    system = run(make(kind, example), 2)
    velocity = system.read("velocity")
    velocity[[9, 5, 7], 0] = wrong
    system.write("velocity", velocity)
    with pytest.raises(BlowupError, match="one: particle 5: "):
        system.check()


def array_bytes(thing: Any, seen: set[int]) -> int:
    """Bytes of the arrays that an object of ours holds, its own objects' included."""
    if id(thing) in seen:
        return 0
    seen.add(id(thing))
    if isinstance(thing, np.ndarray):
        return thing.nbytes
    if hasattr(thing, "to_numpy") and hasattr(thing, "shape"):
        return int(np.prod(thing.shape)) * ti.lang.util.to_numpy_type(thing.dtype)().itemsize
    if isinstance(thing, dict):
        return sum(array_bytes(value, seen) for value in thing.values())
    if isinstance(thing, list | tuple):
        return sum(array_bytes(value, seen) for value in thing)
    if type(thing).__module__.startswith("tianim."):
        return array_bytes(vars(thing), seen) if hasattr(thing, "__dict__") else 0
    return 0


@every_example
def test_memory_is_estimated(kind: str, example: Example) -> None:
    system = make(kind, example, more=example.sized(MANY))
    if kind in FIRST_STEP_LISTS:
        run(system, 1)
    held = array_bytes(system, set())
    estimate = system.params.memory_bytes()
    assert held / MEMORY_FACTOR < estimate < held * MEMORY_FACTOR, (
        f"{held:,} bytes held, {estimate:,} estimated"
    )


@every_kind
def test_time_is_estimated(kind: str) -> None:
    params = make(kind, examples_of(kind)[0]).params
    assert params.seconds_per_step() > 0.0
    assert params.largest_step() > 0.0
