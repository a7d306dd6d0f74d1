"""The cases of `tianim validate` as tests: one a case, the long ones marked slow."""

from collections.abc import Iterable

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
