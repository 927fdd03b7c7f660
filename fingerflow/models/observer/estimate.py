"""A number with its interval, and all that is needed to get the same one again."""

import math
from dataclasses import dataclass

Interval = tuple[float, float]
UNKNOWN: Interval = (math.nan, math.nan)


@dataclass(frozen=True)
class Estimate:
    """What an estimator of this package gives.

    Attributes:
        value: NaN where it cannot be had.
        interval: lower and upper limit; NaN where they cannot be had.
        level: of the interval, as 0.95.
        resamples, seed: of the bootstrap or permutation behind it.
        trials: how many it rests on, one count a class (correct, incorrect), and `missing`, how many were NaN.
        participants: how many were resampled; 0 where trials were.
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
