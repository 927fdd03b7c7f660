"""Confidence interval and p-value of an estimate by Student's t, from the jackknife over participants."""

import math

import numpy as np
from numpy.typing import ArrayLike
from scipy import stats

from fingerflow.models.observer.bootstrap import FEWEST_CLUSTERS
from fingerflow.models.observer.estimate import UNKNOWN, Interval


def jackknife_interval(estimate: float, without: ArrayLike, level: float) -> tuple[Interval, float, str]:
    """Return the jackknife interval of an estimate and its two-sided p-value, or the reason why both are missing.

    The p-value tests against 0. With e_p the estimate without participant p, s^2 = (P - 1) / P sum_p (e_p - mean)^2,
    and the estimate over s has Student's t distribution with P - 1 degrees of freedom.

    Args:
        estimate: of all P participants.
        without: (P,) e_p.
        level: of the interval.

    Raises:
        ValueError: the level is not between 0 and 1.
    """
    if not 0 < level < 1:
        raise ValueError(f"the level is {level:g}: give one between 0 and 1, as 0.95")
    each = np.asarray(without, dtype=np.float64)
    units = each.size
    if units < FEWEST_CLUSTERS:
        return UNKNOWN, math.nan, f"no interval from {units} participants: {FEWEST_CLUSTERS} are needed"
    error = math.sqrt((units - 1) / units * float(((each - each.mean()) ** 2).sum()))
    if not error > 1e-12 * abs(estimate):
        return UNKNOWN, math.nan, "no interval: the estimate is the same, or unknown, without any one participant"
    reach = float(stats.t.ppf((1 + level) / 2, units - 1)) * error
    return (estimate - reach, estimate + reach), float(2 * stats.t.sf(abs(estimate) / error, units - 1)), ""
