"""Linear and rank correlation of two metrics of trials, with intervals by participant if participants are given."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import stats

from fingerflow.models.observer.estimate import UNKNOWN, Interval
from fingerflow.models.observer.jackknife import jackknife_interval

Values = NDArray[np.float64]


@dataclass(frozen=True)
class Correlation:
    """Correlation coefficient of pairs of values, with interval and two-sided p-value.

    `trials` pairs were used; `missing` pairs lack a value. `participants` is 0 where pairs count as independent.
    """

    value: float
    interval: Interval
    p: float
    level: float
    trials: int
    missing: int
    reason: str = ""
    participants: int = 0


def pearson(
    first: ArrayLike, second: ArrayLike, *, participants: ArrayLike | None = None, level: float = 0.95
) -> Correlation:
    """Compute the linear correlation of pairs of values, with interval and p by Fisher's transformation z = atanh(r).

    Pairs of one participant are seldom independent. With participants, interval and p are those of Student's t on z, by
    the jackknife over participants.

    Args:
        first, second: (T,) the pairs; a pair with a NaN is left out and counted.
        participants: (T,) of the pairs; independent pairs where None.
        level: of the interval.

    Returns:
        `Correlation`. NaN, with the reason, for fewer than 4 pairs or a constant; without interval and p, with the
        reason, for fewer than 3 participants.

    Raises:
        ValueError: lengths differ, or the level is not between 0 and 1.
    """
    return _correlation(first, second, participants, level, stats.pearsonr, lambda _: 1.0)


def spearman(
    first: ArrayLike, second: ArrayLike, *, participants: ArrayLike | None = None, level: float = 0.95
) -> Correlation:
    """Compute Spearman's rank correlation of pairs of values; tied values get their mean rank.

    For independent pairs the interval is Fisher's, with the variance of ranks (1 + r^2 / 2) / (n - 3) (Bonett & Wright
    2000). Otherwise as `pearson`.
    """
    return _correlation(first, second, participants, level, stats.spearmanr, lambda value: 1 + value**2 / 2)


def _correlation(
    first: ArrayLike,
    second: ArrayLike,
    participants: ArrayLike | None,
    level: float,
    kind: Callable[..., Any],
    variance: Callable[[float], float],
) -> Correlation:
    x, y = (np.asarray(values, dtype=np.float64).reshape(-1) for values in (first, second))
    if x.size != y.size:
        raise ValueError(f"{x.size} and {y.size} values: give pairs")
    if participants is not None and np.size(participants) != x.size:
        raise ValueError(f"{np.size(participants)} participants of {x.size} pairs: name that of every pair")
    if not 0 < level < 1:
        raise ValueError(f"the level is {level:g}: give one between 0 and 1, as 0.95")
    both = np.isfinite(x) & np.isfinite(y)
    pairs, missing = int(both.sum()), int((~both).sum())
    x, y = x[both], y[both]
    if pairs < 4 or min(np.ptp(x), np.ptp(y)) == 0:
        reason = f"{pairs} pairs: 4 are needed" if pairs < 4 else "one of the two is constant"
        return Correlation(math.nan, UNKNOWN, math.nan, level, pairs, missing, reason)
    found = kind(x, y)
    value, middle = float(found.statistic), _fisher(float(found.statistic))
    if participants is None:
        reach = float(stats.norm.ppf((1 + level) / 2)) * math.sqrt(variance(value) / (pairs - 3))
        interval = math.tanh(middle - reach), math.tanh(middle + reach)
        return Correlation(value, interval, float(found.pvalue), level, pairs, missing)
    who = np.asarray(participants).reshape(-1)[both]
    names = np.unique(who)
    without = [_fisher_z_without_one(x, y, who != name, kind) for name in names]
    (low, high), p, reason = jackknife_interval(middle, without, level)
    return Correlation(value, (math.tanh(low), math.tanh(high)), p, level, pairs, missing, reason, len(without))


def _fisher_z_without_one(x: Values, y: Values, rest: NDArray[np.bool_], kind: Callable[..., Any]) -> float:
    """Return Fisher's z, atanh of the correlation, of those pairs (x, y) that the mask `rest` keeps, which leaves out
    one participant; `kind` is SciPy's function for the correlation.

    It is NaN if the correlation is undefined.
    """
    if rest.sum() < 2 or min(np.ptp(x[rest]), np.ptp(y[rest])) == 0:
        return math.nan
    return _fisher(float(kind(x[rest], y[rest]).statistic))


def _fisher(value: float) -> float:
    return math.atanh(max(min(value, 1 - 1e-15), -1 + 1e-15))
