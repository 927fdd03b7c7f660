"""Relations of columns of a table of trials, with participants as units: correlations, and the effect on answers."""

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import stats

from fingerflow.models.observer.estimate import LEVEL, Estimate, jackknife


def pearson(first: ArrayLike, second: ArrayLike, participants: ArrayLike) -> Estimate:
    """Compute the linear correlation of pairs of values.

    Pairs of one participant are seldom independent: interval and p are those of Student's t on Fisher's z = atanh(r),
    by the jackknife over participants.

    Args:
        first, second: (T,) the pairs; a pair with a NaN is left out and counted.
        participants: (T,) of the pairs.

    Returns:
        `Estimate`. NaN, with the reason, for fewer than 4 pairs or a constant; without interval and p, with the
        reason, for fewer than 3 participants.

    Raises:
        ValueError: lengths differ.
    """
    return _correlation(first, second, participants, stats.pearsonr)


def spearman(first: ArrayLike, second: ArrayLike, participants: ArrayLike) -> Estimate:
    """Compute Spearman's rank correlation of pairs of values (tied ones get their mean rank), as `pearson`."""
    return _correlation(first, second, participants, stats.spearmanr)


def clustered_regression(
    metric: ArrayLike, answer: ArrayLike, condition: ArrayLike, participants: ArrayLike
) -> Estimate:
    """Fit answers by least squares over a metric, with an intercept for each participant and condition.

    The model is answer = a_pc + b metric + error, as for the force rate in Willemet et al. 2021, figure S5 I, and the
    estimate is b. a_pc is the intercept of participant p in condition c, so neither fast participants who answer well
    nor amplitudes that are answered well count as an effect of the rate. Standard errors are those of clusters (OLS of
    statsmodels), which are the participants: errors of one participant may depend on each other, and their slopes may
    differ; interval and p are those of Student's t with P - 1 degrees of freedom. The intercepts lie within clusters
    and are no estimated numbers of the factor (T - 1) / (T - K) on the variance: with them as columns, statsmodels
    gives an error that is larger by the root of (T - 1) / (T - 1 - C) for C of them. Nothing is assumed of the errors,
    so answers of 0 and 1 are allowed.

    Of 500 simulated studies without effect, of 4 and of 16 participants, p was below 0.05 in 4 and 6 % with equal
    slopes and in 4 and 5 % with slopes of their own. With an intercept and a slope of each participant, of 16
    participants, it was in 1 and 6 % of 120 by MixedLM of statsmodels and in 5 and 15 % by its BinomialBayesMixedGLM.

    Args:
        metric: (T,) in any unit; NaN is left out and counted.
        answer: (T,) True or 1 where correct.
        condition, participants: (T,) of the trials.

    Returns:
        `Estimate`; trials without a metric, or alone in their participant and condition, are missing. NaN, with the
        reason, where the metric does not vary within a participant and condition, or for fewer than 3 participants.

    Raises:
        ValueError: lengths differ.
    """
    from statsmodels.regression.linear_model import OLS  # of the extra `study`

    columns = [np.asarray(column).reshape(-1) for column in (metric, answer, condition, participants)]
    if len({column.size for column in columns}) > 1:
        raise ValueError(f"columns have {[column.size for column in columns]} values: give one of each a trial")
    valid = np.isfinite(columns[0].astype(np.float64))
    x, y = (column[valid].astype(np.float64) for column in columns[:2])
    stimulus, person = (np.unique(column[valid], return_inverse=True)[1] for column in columns[2:])
    cell = np.unique(person * (stimulus.max(initial=0) + 1) + stimulus, return_inverse=True)[1]
    count = np.bincount(cell)
    for column in (x, y):
        column -= (np.bincount(cell, column) / count)[cell]
    paired = count[cell] > 1
    x, y, person = x[paired], y[paired], person[paired]
    people = np.unique(person).size
    nothing = Estimate(math.nan, trials=x.size, missing=valid.size - x.size, participants=people)
    if not x.any():
        return replace(nothing, reason="all values are equal within each participant and condition: no effect")
    if people < 3:
        return replace(nothing, reason=f"no effect from {people} participants: 3 are needed")
    fit = OLS(y, x).fit(cov_type="cluster", cov_kwds={"groups": person}, use_t=True)
    low, high = fit.conf_int(1 - LEVEL)[0]
    return replace(nothing, value=float(fit.params[0]), interval=(float(low), float(high)), p=float(fit.pvalues[0]))


def _correlation(
    first: ArrayLike, second: ArrayLike, participants: ArrayLike, coefficient: Callable[..., Any]
) -> Estimate:
    x, y = (np.asarray(values, dtype=np.float64).reshape(-1) for values in (first, second))
    who = np.asarray(participants).reshape(-1)
    if not x.size == y.size == who.size:
        raise ValueError(f"{x.size} and {y.size} values, {who.size} participants: give pairs, and that of every pair")
    both = np.isfinite(x) & np.isfinite(y)
    x, y, who = x[both], y[both], who[both]
    names = np.unique(who)
    nothing = Estimate(math.nan, trials=x.size, missing=both.size - x.size, participants=names.size)
    if x.size < 4 or min(np.ptp(x), np.ptp(y)) == 0:
        return replace(nothing, reason=f"{x.size} pairs: 4 are needed" if x.size < 4 else "one of the two is constant")

    def fisher(chosen: NDArray[np.bool_]) -> float:
        if chosen.sum() < 2 or min(np.ptp(x[chosen]), np.ptp(y[chosen])) == 0:
            return math.nan
        value = float(coefficient(x[chosen], y[chosen]).statistic)
        return math.atanh(max(min(value, 1 - 1e-15), -1 + 1e-15))

    interval, p, reason = jackknife(fisher(who == who), [fisher(who != name) for name in names])
    value, (low, high) = float(coefficient(x, y).statistic), interval
    return replace(nothing, value=value, interval=(math.tanh(low), math.tanh(high)), p=p, reason=reason)
