"""The cases of `tianim validate` as tests: one a case, the long ones marked slow."""

from collections.abc import Iterable, Mapping

import pytest
from _pytest.mark import ParameterSet

from tianim.validate import Case


def as_tests(cases: Iterable[Case]) -> list[ParameterSet]:
    """Parameters for a test that takes a `case`."""
    return [
        pytest.param(case, id=case.name.replace(" ", "_"), marks=[pytest.mark.slow] if case.slow else [])
        for case in cases
    ]


def assert_passes(case: Case) -> None:
    measured = case.run()
    lower, upper = case.range()
    assert case.passed(measured), (
        f"{case.name}: {measured:g} is not in {lower:g} to {upper:g} ({case.source})"
    )


# How many times as far beyond its limit as it is known to be a case may come out.
WORSE = 2.0


def assert_passes_or_is_known(case: Case, short: Mapping[str, tuple[float, str]]) -> None:
    """As `assert_passes`; what is in `short` may fail, by WORSE times as much as that says at most."""
    if case.name not in short:
        assert_passes(case)
        return
    beyond, why = short[case.name]
    measured = case.run()
    assert abs(case.error(measured)) < WORSE * beyond, f"{measured:g} ({why})"
    if not case.passed(measured):
        pytest.xfail(f"{measured:g}: {why}")
