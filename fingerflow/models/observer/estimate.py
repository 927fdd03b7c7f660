"""Estimate of a statistic, and its interval with participants as units, by the jackknife."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import stats

Values = NDArray[np.float64]
Interval = tuple[float, float]

LEVEL = 0.95
UNKNOWN: Interval = (math.nan, math.nan)
_NONE = UNKNOWN, math.nan  # interval and p-value that cannot be computed
_FEWEST = 3  # participants that an interval needs


@dataclass(frozen=True)
class Estimate:
    """Estimated statistic with its interval of 95 % and two-sided p-value; NaN where they cannot be computed.

    `trials` of `participants` were used; `missing` lack a value. `reason` says why a number is NaN, or what to know.
    """

    value: float
    interval: Interval = UNKNOWN
    p: float = math.nan
    trials: int = 0
    missing: int = 0
    participants: int = 0
    reason: str = ""


def metric_values(values: ArrayLike) -> Values:
    """Return the values (n,) of a metric; raise ValueError if one is infinite."""
    column = np.asarray(values, dtype=np.float64).reshape(-1)
    if np.isinf(column).any():
        raise ValueError("a metric is infinite: mark what was not measured with NaN")
    return column


def jackknife(estimate: float, without: ArrayLike) -> tuple[Interval, float, str]:
    """Return the interval of an estimate and its p-value against 0 by Student's t, or the reason why both are missing.

    With e_p the estimate without participant p, s^2 = (P - 1) / P sum_p (e_p - mean)^2, and the estimate over s has P -
    1 degrees of freedom.

    Args:
        estimate: of all P participants.
        without: (P,) e_p.
    """
    each = np.asarray(without, dtype=np.float64)
    if each.size < _FEWEST:
        return *_NONE, f"no interval from {each.size} participants: {_FEWEST} are needed"
    error = math.sqrt((each.size - 1) / each.size * float(((each - each.mean()) ** 2).sum()))
    if not error > 1e-12 * abs(estimate):
        return *_NONE, "no interval: the estimate is the same, or unknown, without any one participant"
    student = stats.t(each.size - 1)
    reach = float(student.ppf((1 + LEVEL) / 2)) * error
    return (estimate - reach, estimate + reach), float(2 * student.sf(abs(estimate) / error)), ""
