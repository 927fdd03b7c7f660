"""One line of a table of cases."""

from typing import NamedTuple


class Case(NamedTuple):
    """A case, the number that is given, the true one, what is stated of it, and the verdict, in short texts."""

    case: str
    number: str
    truth: str
    stated: str
    verdict: str
