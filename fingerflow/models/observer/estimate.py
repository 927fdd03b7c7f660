"""Estimate of a statistic: value, confidence interval, and the bootstrap settings that reproduce it."""

import math
from dataclasses import dataclass

Interval = tuple[float, float]
UNKNOWN: Interval = (math.nan, math.nan)


@dataclass(frozen=True)
class Estimate:
    """Estimated statistic with confidence interval, bootstrap settings, and numbers of trials and participants.

    Attributes:
        value: NaN where it cannot be computed.
        interval: lower and upper limit; NaN where they cannot be computed.
        level: of the interval, as 0.95.
        resamples, seed: of the bootstrap or permutation behind it.
        trials: number used, one count per class (correct, incorrect); `missing` counts those that were NaN.
        participants: number resampled; 0 where trials were resampled.
        reason: why a number is NaN, or what to know about it; empty otherwise.
    """

    value: float
    interval: Interval
    level: float
    resamples: int
    seed: int
    trials: tuple[int, ...]
    missing: int = 0
    participants: int = 0
    reason: str = ""
