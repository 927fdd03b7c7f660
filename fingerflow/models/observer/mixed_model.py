"""Mixed model of answers: does a metric change the answer of the same participant to the same stimulus?"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from fingerflow.models.observer.estimate import UNKNOWN, Interval
from fingerflow.models.observer.jackknife import jackknife_interval


@dataclass(frozen=True)
class MixedModel:
    """Result of `mixed_model`: change of the answer's probability per unit of the metric, with interval and p-value.

    The p-value is two-sided.

    `trials` of `participants` were used; `missing` have no metric, or are alone in their participant and condition.
    """

    effect: float
    interval: Interval
    p: float
    level: float
    trials: int
    participants: int
    missing: int
    reason: str = ""


def mixed_model(
    metric: ArrayLike, answer: ArrayLike, condition: ArrayLike, participants: ArrayLike, level: float = 0.95
) -> MixedModel:
    """Fit a linear mixed model of answers over a metric, with an intercept for each participant and condition.

    The model is answer = a_pc + (b + v_p) metric + error, as for the force rate in Willemet et al. 2021, figure S5 I.
    a_pc is an intercept of participant p in condition c, so neither fast participants who answer well nor amplitudes
    that are answered well count as an effect of the rate. v_p, of mean 0, is how participant p differs from the effect
    b. With x and y the metric and the answer less their means in each participant and condition,

        b = sum_p S_p / sum_p Q_p,  S_p = sum x y,  Q_p = sum x^2.

    Interval and p are those of Student's t by the jackknife over participants, which includes v_p. Nothing is assumed
    of the errors, so answers of 0 and 1 are allowed.

    Of 120 simulated studies without effect, of 16 participants whose slopes are equal, or differ, p was below 0.05 in
    4 and 6 %. With an intercept and a slope of each participant it was in 1 and 6 % by MixedLM of statsmodels and in 5
    and 15 % by its BinomialBayesMixedGLM: `python -m tests.models.observer.error_rates 120`.

    Args:
        metric: (T,) in any unit; NaN is left out and counted.
        answer: (T,) True or 1 where correct.
        condition, participants: (T,) of the trials.
        level: of the interval.

    Returns:
        `MixedModel`. NaN, with the reason, where the metric does not vary within a participant and condition; without
        interval and p for fewer than 3 participants in which it does.

    Raises:
        ValueError: lengths differ, or the level is not between 0 and 1.
    """
    columns = [np.asarray(one).reshape(-1) for one in (metric, answer, condition, participants)]
    if len({one.size for one in columns}) > 1:
        raise ValueError(f"columns have {[one.size for one in columns]} values: give one of each a trial")
    known = np.isfinite(columns[0].astype(np.float64))
    x, y = (one[known].astype(np.float64) for one in columns[:2])
    stimuli, stimulus = np.unique(columns[2][known], return_inverse=True)
    who, person = np.unique(columns[3][known], return_inverse=True)
    cell = person * stimuli.size + stimulus
    count = np.bincount(cell, minlength=who.size * stimuli.size).clip(1)
    for one in (x, y):
        one -= (np.bincount(cell, one, count.size) / count)[cell]
    paired = count[cell] > 1
    people, person = np.unique(who[person[paired]], return_inverse=True)
    products, squares = (np.bincount(person, x[paired] * one[paired]) for one in (y, x))
    trials, missing = int(paired.sum()), int(known.size - paired.sum())
    total = float(squares.sum())
    if not total > 0:
        reason = "all values are equal within each participant and condition: no effect"
        return MixedModel(math.nan, UNKNOWN, math.nan, level, trials, people.size, missing, reason)
    effect = float(products.sum()) / total
    with np.errstate(invalid="ignore", divide="ignore"):
        without = (products.sum() - products) / (total - squares)
    interval, p, reason = jackknife_interval(effect, without, level)
    return MixedModel(effect, interval, p, level, trials, people.size, missing, reason)
