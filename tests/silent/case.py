"""A case that must not give a wrong result without a warning."""

from typing import NamedTuple


class Case(NamedTuple):
    """The case, a number of its result, the true number, the statement of the result, and the verdict."""

    case: str
    number: str
    truth: str
    stated: str
    verdict: str
