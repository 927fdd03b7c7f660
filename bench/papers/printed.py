"""Comparison of a printed result with the reproduced one: whether they agree, differ, or cannot be compared."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Generic, TypeVar

Interval = tuple[float, float]
Source = TypeVar("Source")

AGREES, DIFFERS, NOT_HAD, NOT_PRINTED = "agrees", "differs", "not to be had", "not printed"
UNEXPLAINED = "not explained"
_TWO_SIDED = 1.96  # half width of a 95 % interval in standard deviations


@dataclass(frozen=True)
class Obtained:
    """Reproduced counterpart of a printed result: values as text, an interval for each printed number, the simulated
    truth, and why the two differ or nothing can be obtained.

    Attributes:
        text: values with units and deviations; empty where nothing can be obtained.
        numbers: an interval for each printed number, in its unit.
        truth: of the simulation, as text; empty where the result is no measurement.
        because: why the two differ, or why nothing can be obtained.
        agrees: whether they agree, where numbers do not decide it.
    """

    text: str
    numbers: tuple[Interval, ...] = ()
    truth: str = ""
    because: str = ""
    agrees: bool | None = None


@dataclass(frozen=True)
class Row(Generic[Source]):
    """Printed result of a paper, and the function that computes its reproduced counterpart from the simulated
    experiment.

    Attributes:
        id: of the list of printed results.
        quantity: what was printed.
        printed: its value as text; empty if none is printed.
        where: section or figure.
        numbers: intervals of the printed numbers: deviations where they are printed, otherwise the rounding.
        obtain: computes the result.
    """

    id: str
    quantity: str
    printed: str
    where: str
    numbers: tuple[Interval, ...]
    obtain: Callable[[Source], Obtained]

    def answer(self, source: Source) -> "Answer":
        """Compute the reproduced counterpart of this printed result from the simulated experiment `source`, and return
        both with a verdict: they agree if each number's interval overlaps the printed one.

        Raises ValueError if the numbers of printed and obtained results do not correspond.
        """
        found = self.obtain(source)
        if not found.text:
            verdict = NOT_HAD
        elif not self.printed:
            verdict = NOT_PRINTED
        else:
            agrees = found.agrees
            if agrees is None:
                if len(found.numbers) != len(self.numbers) or not self.numbers:
                    raise ValueError(f"{self.id}: {len(self.numbers)} printed numbers, {len(found.numbers)} obtained")
                pairs = zip(self.numbers, found.numbers, strict=True)
                agrees = all(low <= top and bottom <= high for (low, high), (bottom, top) in pairs)
            verdict = AGREES if agrees else DIFFERS
        because = found.because or UNEXPLAINED if verdict in (DIFFERS, NOT_HAD) else ""
        printed = self.printed or "not printed"
        return Answer(self.id, self.quantity, printed, self.where, found.text, found.truth, verdict, because)


@dataclass(frozen=True)
class Answer:
    """Row of the page's results table: printed and reproduced result, simulated truth, verdict (agrees, differs, or why
    not compared), and reason.
    """

    id: str
    quantity: str
    printed: str
    where: str
    obtained: str
    truth: str
    verdict: str
    because: str


def exactly(*values: float) -> tuple[Interval, ...]:
    """Return for each value the interval (value, value), as for numbers that are exact."""
    return tuple((value, value) for value in values)


def rounded(*values: float, digit: float) -> tuple[Interval, ...]:
    """Return for each printed number the interval of values that round to it, with a rounding step of `digit`."""
    return tuple((value - digit / 2, value + digit / 2) for value in values)


def within(value: float, deviation: float) -> tuple[Interval, ...]:
    """Return the interval from value - deviation to value + deviation of a printed number, as a tuple of one."""
    return ((value - deviation, value + deviation),)


def likely(value: float, deviation: float) -> Interval:
    """Return the 95 % confidence interval of a value with a standard deviation (normal distribution)."""
    return value - _TWO_SIDED * deviation, value + _TWO_SIDED * deviation


def unobtainable(because: str) -> Callable[[Any], Obtained]:
    """Return a function for `Row.obtain` that gives no result but the reason `because`, why none can be reproduced."""
    return lambda _: Obtained("", because=because)
