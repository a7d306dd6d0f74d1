"""A case: a number that we measure, one that is published or follows from the law, how near they must be."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

Comparison = Literal["equal", "below", "above", "between"]


@dataclass(frozen=True)
class Figure:
    """The plot that a case is a point of: several cases with one `Figure` make a curve.

    `x_label` and `y_label` name the quantity and its unit.
    """

    name: str
    x_label: str
    y_label: str


@dataclass(frozen=True)
class Case:
    """One check of the physics.

    system      kind of system
    name        what is checked, in words
    run         runs it and gives the measured number
    expected    the published or exact number; two of them, a lower and an upper one, for `between`
    tolerance   how far measured may be from expected, in the unit of both; for `equal` alone
    source      where the expected number is from
    comparison  equal: within tolerance; below, above: the limit is `expected`; between: both limits
    slow        takes more than some seconds
    unit        of the number, "" for none
    figure, x   the plot that it is a point of, and where on its horizontal axis
    """

    system: str
    name: str
    run: Callable[[], float]
    expected: float | tuple[float, float]
    source: str
    tolerance: float = 0.0
    comparison: Comparison = "equal"
    slow: bool = False
    unit: str = ""
    figure: Figure | None = None
    x: float = 0.0

    def title(self) -> str:
        """The name, and in words what is allowed where `expected` is a limit."""
        words = {"equal": "", "below": ", at most", "above": ", at least", "between": ", between"}
        return self.name + words[self.comparison]

    def range(self) -> tuple[float, float]:
        """The lowest and the highest number that passes."""
        if isinstance(self.expected, tuple):
            return self.expected
        if self.comparison == "below":
            return -math.inf, self.expected
        if self.comparison == "above":
            return self.expected, math.inf
        return self.expected - self.tolerance, self.expected + self.tolerance

    def error(self, measured: float) -> float:
        """Measured less expected; where a limit is expected, how far it lies beyond the limit."""
        if self.comparison == "equal" and not isinstance(self.expected, tuple):
            return measured - self.expected
        lower, upper = self.range()
        return min(measured - lower, 0.0) + max(measured - upper, 0.0)

    def passed(self, measured: float) -> bool:
        """Whether a number is finite and near enough."""
        lower, upper = self.range()
        return math.isfinite(measured) and lower <= measured <= upper
