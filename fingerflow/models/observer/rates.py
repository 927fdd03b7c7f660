"""Sensitivity and criterion of detection from counts of answers per participant."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import ndtri

from fingerflow.models.observer.bootstrap import Samples, Statistic, bca_interval
from fingerflow.models.observer.estimate import UNKNOWN, Estimate
from fingerflow.models.observer.weighted import mean

Values = NDArray[np.float64]


@dataclass(frozen=True)
class Detection:
    """Mean over participants of `sensitivity` d' and `criterion` c, and the values of each participant, (P,).

    `hit_rate` and `false_alarm_rate` are corrected by the log-linear rule; NaN for a participant without trials of
    both kinds.
    """

    sensitivity: Estimate
    criterion: Estimate
    d_prime: Values
    bias: Values
    hit_rate: Values
    false_alarm_rate: Values
    correction: str = "log-linear (Hautus 1995): counts + 0.5, trials + 1"


def detection(
    hits: ArrayLike,
    misses: ArrayLike,
    false_alarms: ArrayLike,
    correct_rejections: ArrayLike,
    *,
    level: float = 0.95,
    resamples: int = 2000,
    seed: int = 0,
) -> Detection:
    """Compute d' = z(H) - z(F) and c = -(z(H) + z(F)) / 2 per participant, and their means with intervals.

    Rates of 0 and 1 have no finite z. All rates, not those alone, are therefore corrected by the log-linear rule:
    half a hit and half a false alarm are added, and one trial of either kind (Hautus 1995). This biases d' towards 0,
    less with more trials.

    Args:
        hits, misses, false_alarms, correct_rejections: (P,) numbers of trials, integers, one participant each.
        level, resamples, seed: of the intervals; participants are resampled.

    Raises:
        ValueError: counts that are negative, not whole or of different lengths.
    """
    counts = [
        np.asarray(count, dtype=np.float64).reshape(-1) for count in (hits, misses, false_alarms, correct_rejections)
    ]
    if len({count.size for count in counts}) > 1:
        raise ValueError(f"{[count.size for count in counts]} participants: give the four counts of each")
    if not all(((count >= 0) & (count == np.round(count))).all() for count in counts):
        raise ValueError("a count is negative or not whole: give numbers of trials, not rates")
    hit, miss, alarm, rejection = counts
    answered = (hit + miss > 0) & (alarm + rejection > 0)
    hit_rate = np.where(answered, (hit + 0.5) / (hit + miss + 1), np.nan)
    alarm_rate = np.where(answered, (alarm + 0.5) / (alarm + rejection + 1), np.nan)
    z_hit, z_alarm = ndtri(hit_rate), ndtri(alarm_rate)
    trials = (int((hit + miss).sum()), int((alarm + rejection).sum()))

    def over_participants(values: Values) -> Estimate:
        known = values[answered]
        missing = int((~answered).sum())
        if known.size == 0:
            reason = "no participant has trials of both kinds"
            return Estimate(math.nan, UNKNOWN, level, resamples, seed, trials, missing, 0, reason)
        samples = Samples((np.arange(known.size),), known.size)
        interval, reason = bca_interval(_mean_of(known), samples, level, resamples, seed)
        return Estimate(float(known.mean()), interval, level, resamples, seed, trials, missing, known.size, reason)

    sensitivity, bias = z_hit - z_alarm, -(z_hit + z_alarm) / 2
    return Detection(over_participants(sensitivity), over_participants(bias), sensitivity, bias, hit_rate, alarm_rate)


def _mean_of(values: Values) -> Statistic:
    return lambda weights: mean(values, weights)
