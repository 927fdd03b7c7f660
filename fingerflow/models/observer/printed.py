"""The ideal observer as published by Willemet et al. 2021, for comparison; use `d_prime` and `auc` otherwise."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from fingerflow.models.observer.estimate import Values, metric_values

BIN = 0.05  # bin width of the normalised metric
_STEP = 0.001  # step between tested criteria, in the normalised metric


# Gaussian fitted to a histogram: amplitude in trials per bin, mean and standard deviation; NaN if one bin has all.
Gaussian = tuple[float, float, float]
NO_GAUSSIAN: Gaussian = (math.nan, math.nan, math.nan)


@dataclass(frozen=True)
class PrintedObserver:
    """Ideal observer of one metric, computed as in the supplement of Willemet et al. 2021.

    Attributes:
        scale: 0.9 quantile of the metric over all trials, by which it is normalised.
        trials: number of correct and incorrect ones.
        reason: why a number is NaN; empty otherwise.
        bins: (K + 1,) edges of the normalised metric; `counts_correct` and `counts_incorrect` (K,) trials between them.
        correct, incorrect: Gaussians fitted to those counts.
        d_prime: that of the Gaussians, see `fingerflow.models.observer.d_prime`.
        hits, false_alarms: (C,) the ROC: shares of the trials above each criterion.
        auc: area under it, by the trapezoidal rule.
    """

    scale: float
    trials: tuple[int, int]
    reason: str
    bins: Values
    counts_correct: Values
    counts_incorrect: Values
    correct: Gaussian
    incorrect: Gaussian
    d_prime: float
    hits: Values
    false_alarms: Values
    auc: float


def printed_observer(correct: ArrayLike, incorrect: ArrayLike) -> PrintedObserver:
    """Compute d' and ROC of a metric as published by Willemet et al. 2021.

    The metric is normalised by its 0.9 quantile and counted in bins of 0.05, and Gaussians are fitted to the counts.
    The paper varies the criterion from 0 to 1. A tenth of the trials is above 1, and a signed metric has trials below
    0: such a ROC does not reach its ends. Here the criterion ranges over all trials.

    Args:
        correct, incorrect: (n,) the metric, any unit; NaN is left out.

    Raises:
        ValueError: infinite values.
    """
    first, second = (group[np.isfinite(group)] for group in map(metric_values, (correct, incorrect)))
    pooled = np.concatenate([first, second])
    scale = float(np.quantile(pooled, 0.9)) if pooled.size else math.nan
    trials = (first.size, second.size)
    if min(trials) == 0 or not scale > 0:
        none, nan = np.empty(0), math.nan
        reason = (
            f"the 0.9 quantile is {scale:g}: one above 0 is needed"
            if min(trials)
            else f"{trials[0]} correct and {trials[1]} incorrect trials: both are needed"
        )
        return PrintedObserver(scale, trials, reason, none, none, none, NO_GAUSSIAN, NO_GAUSSIAN, nan, none, none, nan)
    first, second, pooled = first / scale, second / scale, pooled / scale
    bins = BIN * np.arange(math.floor(pooled.min() / BIN), math.floor(pooled.max() / BIN) + 2)
    counts = [np.histogram(group, bins)[0].astype(np.float64) for group in (first, second)]
    gaussians = [_fit_gaussian(bins, count) for count in counts]
    (_, mean, deviation), (_, other_mean, other_deviation) = gaussians
    variance = (deviation**2 + other_deviation**2) / 2
    sensitivity = (mean - other_mean) / math.sqrt(variance) if variance > 0 else math.nan
    criteria = np.arange(min(pooled.min(), 0) - _STEP, max(pooled.max(), 1) + 2 * _STEP, _STEP)
    above = [1 - np.searchsorted(np.sort(group), criteria, side="right") / group.size for group in (first, second)]
    reason = "" if math.isfinite(sensitivity) else "no Gaussian fits the counts of a kind: one bin has all"
    area = float(np.trapezoid(above[0][::-1], above[1][::-1]))
    fitted = counts[0], counts[1], gaussians[0], gaussians[1], sensitivity
    return PrintedObserver(scale, trials, reason, bins, *fitted, above[0], above[1], area)


def _fit_gaussian(bins: Values, counts: Values) -> Gaussian:
    """Fit a normal distribution to the counts of a histogram by maximum likelihood, for figure S11 A."""
    if np.count_nonzero(counts) < 2:
        return NO_GAUSSIAN
    centres = (bins[:-1] + bins[1:]) / 2
    mean = float(np.average(centres, weights=counts))
    deviation = math.sqrt(np.average((centres - mean) ** 2, weights=counts))
    return float(counts.sum()) * BIN / (deviation * math.sqrt(2 * math.pi)), mean, deviation
