"""Statistics of R bootstrap resamples at once; weights say how often a resample contains each trial."""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

Values = NDArray[np.float64]


def auc_statistic(correct: Values, incorrect: Values) -> Callable[[Values, Values], Values]:
    """Return a function that computes areas under the ROC (R,) from weights (R, n_1), (R, n_2) of two classes."""
    values = np.concatenate([correct, incorrect])
    order = np.argsort(values, kind="stable")
    starts = np.flatnonzero(np.diff(values[order], prepend=-np.inf) > 0)
    is_correct = order < correct.size

    def area(first: Values, second: Values) -> Values:
        ranked = np.concatenate([first, second], axis=1)[:, order]
        hits = np.where(is_correct, ranked, 0)
        misses = ranked - hits
        if starts.size < values.size:  # equal values are one step of the curve
            hits, misses = (np.add.reduceat(some, starts, axis=1) for some in (hits, misses))
        below = misses.cumsum(1) - misses / 2
        result: Values = (hits * below).sum(1) / (hits.sum(1) * misses.sum(1))
        return result

    return area


def mean(values: Values, weights: Values) -> Values:
    """Return the means (R,) of values (N,) under R sets of weights (R, N)."""
    result: Values = weights @ values / weights.sum(1)
    return result


def deviation(values: Values, weights: Values) -> Values:
    """Return standard deviations (R,) of values (N,) under weights (R, N), with n - 1; NaN if no two values differ."""
    # Centred on the whole sample's mean: sums of squares of values far from 0 would lose precision.
    centred = values - values.mean()
    count = weights.sum(1)
    middle = weights @ centred / count
    variance = (weights @ centred**2 - count * middle**2) / (count - 1)
    rounding = 1e-13 * (np.abs(centred).max() ** 2 + np.finfo(np.float64).tiny)
    return np.sqrt(np.where(variance > rounding, variance, np.nan))
