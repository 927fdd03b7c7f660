"""One case that must not be wrong in silence."""

from typing import NamedTuple


class Case(NamedTuple):
    """What was tried, a number of the result, its truth, what the result states, and the verdict."""

    case: str
    number: str
    truth: str
    stated: str
    verdict: str
