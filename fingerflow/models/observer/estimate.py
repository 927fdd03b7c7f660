"""Estimate of a statistic, and its interval with participants as units: by the jackknife, or by the bootstrap."""

import math
import warnings
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import stats

Values = NDArray[np.float64]
Interval = tuple[float, float]
# Function from the weights (R, P), how often each participant counts in R samples, to the statistic (R,).
Statistic = Callable[[Values], Values]

LEVEL = 0.95
UNKNOWN: Interval = (math.nan, math.nan)
_NONE = UNKNOWN, math.nan  # interval and p-value that cannot be computed
_FEWEST = 3  # participants that an interval needs
_AT_ONCE = 10_000_000  # largest number of drawn participants that are compared at a time
# Added to the seed: data simulated with the same seed must not share random numbers with the resampling.
_STREAM = 0x0B007


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


def bootstrap(
    estimate: float, statistic: Statistic, participants: int, resamples: int, seed: int
) -> tuple[Interval, float, str]:
    """Return the bias-corrected and accelerated (BCa) interval of a statistic from resamples of whole participants, no
    p-value (NaN), and a text that explains a missing interval or dropped resamples.

    The interval of `scipy.stats.bootstrap` is too narrow for few participants; its normal quantile z is therefore
    replaced by that of Student's t times (P / (P - 1))^(1/2) (Hesterberg 2015).

    Raises:
        ValueError: fewer than 100 resamples.
    """
    if resamples < 100:
        raise ValueError(f"{resamples} resamples are too few for an interval: give 100 or more")
    if participants < _FEWEST:
        return *_NONE, f"no interval from {participants} participants: {_FEWEST} are needed"
    people = np.arange(participants)

    def resampled(drawn: NDArray[np.intp], axis: int) -> Values:
        with np.errstate(divide="ignore", invalid="ignore"):
            often = (drawn[..., None] == people).sum(axis - 1).astype(np.float64)
            return statistic(often.reshape(-1, participants)).reshape(drawn.shape[:-1])

    reach = stats.t.ppf((1 + LEVEL) / 2, participants - 1) * math.sqrt(participants / (participants - 1))
    options: dict[str, Any] = {"vectorized": True, "confidence_level": 1 - 2 * stats.norm.sf(reach)}
    drawn = stats.bootstrap(
        (people,), resampled, n_resamples=resamples, method="percentile", batch=max(1, _AT_ONCE // participants**2),
        rng=np.random.default_rng([seed, _STREAM]), **options,
    )  # fmt: skip
    finite = drawn.bootstrap_distribution[np.isfinite(drawn.bootstrap_distribution)]
    if finite.size < resamples / 2:
        return *_NONE, f"no interval: {resamples - finite.size} of {resamples} resamples lack a class or a spread"
    if np.abs(finite - estimate).max() <= 1e-12 * max(abs(estimate), 1):
        return *_NONE, "no interval: every resample gives the same number"
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", stats.DegenerateDataWarning)
        trimmed = replace(drawn, bootstrap_distribution=finite)
        corrected = stats.bootstrap(
            (people,), resampled, n_resamples=0, bootstrap_result=trimmed, method="BCa", **options
        )
    low, high = corrected.confidence_interval
    if not (math.isfinite(low) and math.isfinite(high)):
        return *_NONE, "no interval: the estimate is unknown without one of the participants"
    reason = "" if finite.size == resamples else f"{resamples - finite.size} of {resamples} resamples lacked a class"
    # Where the statistic takes few values, a quantile may lie slightly on the wrong side of the estimate.
    return (float(min(low, estimate)), float(max(high, estimate))), math.nan, reason
