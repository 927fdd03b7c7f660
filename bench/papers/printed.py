"""Comparison of a printed result with the reproduced one, by what the simulation knew of it beforehand.

Settings and equations hold or differ, and numbers that were put into the simulation are read back or differ: neither is
evidence. A prediction is right where the 95 % interval of each number lies within a factor of 2 of print, wrong where
one lies outside, and undecided otherwise: a vague result meets any printed interval.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, Generic, Literal, TypeVar

Interval = tuple[float, float]
Source = TypeVar("Source")

Basis = Literal["setting or equation", "put in", "predicted"]
SETTING: Basis = "setting or equation"
PUT_IN: Basis = "put in"
PREDICTED: Basis = "predicted"

HOLDS, READ_BACK, DIFFERS = "holds", "read back", "differs"
RIGHT, WRONG, UNDECIDED = "right", "wrong", "undecided"
NOT_HAD, NOT_PRINTED = "not to be had", "not printed"
FACTOR = 2.0  # largest ratio of predicted and printed numbers, either way, that counts as equivalent
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
        agrees: whether they agree, where numbers do not decide it; None without numbers where nothing decides it.
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
        basis: what the simulation knew of the result.
    """

    id: str
    quantity: str
    printed: str
    where: str
    numbers: tuple[Interval, ...]
    obtain: Callable[[Source], Obtained]
    basis: Basis = SETTING

    def answer(self, source: Source) -> "Answer":
        """Compute the reproduced counterpart of this printed result from the simulated experiment `source`, and return
        both with a verdict; that of a prediction states its ratio to each printed number.

        Raises ValueError if the numbers of printed and obtained results do not correspond.
        """
        found = self.obtain(source)
        if not found.text:
            verdict = NOT_HAD
        elif not self.printed:
            verdict = NOT_PRINTED
        else:
            agrees = found.agrees
            if agrees is None and (self.numbers or found.numbers):
                if len(found.numbers) != len(self.numbers):
                    raise ValueError(f"{self.id}: {len(self.numbers)} printed numbers, {len(found.numbers)} obtained")
                agrees = (equivalent if self.basis == PREDICTED else meet)(self.numbers, found.numbers)
                if self.basis == PREDICTED:
                    ratios = (f"{sum(b) / sum(a):.2g}" for a, b in zip(self.numbers, found.numbers, strict=True))
                    found = replace(found, text=f"{', '.join(ratios)} × print: {found.text}")
            names = {SETTING: (HOLDS, DIFFERS), PUT_IN: (READ_BACK, DIFFERS), PREDICTED: (RIGHT, WRONG)}[self.basis]
            verdict = UNDECIDED if agrees is None else names[not agrees]
        because = found.because or UNEXPLAINED if verdict in (DIFFERS, WRONG, UNDECIDED, NOT_HAD) else ""
        return Answer(
            self.id, self.quantity, self.printed or "not printed", self.where, found.text, found.truth, verdict,
            because, self.basis,
        )  # fmt: skip


def meet(printed: tuple[Interval, ...], obtained: tuple[Interval, ...]) -> bool:
    """Return True if every printed interval overlaps the obtained one."""
    return all(low <= top and bottom <= high for (low, high), (bottom, top) in zip(printed, obtained, strict=True))


def equivalent(printed: tuple[Interval, ...], obtained: tuple[Interval, ...]) -> bool | None:
    """Return True if all obtained intervals lie within a factor of 2 of the middle of the printed ones, False if one
    lies outside, else None.
    """
    inside = []
    for (low, high), (bottom, top) in zip(printed, obtained, strict=True):
        least, most = sorted(factor * (low + high) / 2 for factor in (1 / FACTOR, FACTOR))
        if top < least or bottom > most:
            return False
        inside.append(least <= bottom and top <= most)
    return True if all(inside) else None


@dataclass(frozen=True)
class Answer:
    """Row of the page's results table: printed and reproduced result, simulated truth, verdict, reason, and what the
    simulation knew of the result.
    """

    id: str
    quantity: str
    printed: str
    where: str
    obtained: str
    truth: str
    verdict: str
    because: str
    basis: Basis


#: Rows of numbers that the simulation was given or tuned to, and of numbers that it was not.
put_in = partial(Row, basis=PUT_IN)
predicted = partial(Row, basis=PREDICTED)


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
