"""One runtime for the whole test session: a process can start the compiler only once."""

import pytest

from tianim import runtime


@pytest.fixture(scope="session", autouse=True)
def started_runtime() -> None:
    """Two threads, as the smallest machine that the project promises to serve."""
    runtime.start(threads=2)
