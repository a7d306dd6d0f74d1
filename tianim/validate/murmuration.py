"""To come."""

from tianim.validate.case import Case

CASES: tuple[Case, ...] = ()
