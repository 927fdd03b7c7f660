"""Test whether participants form one or two groups, by a mixture of Gaussians."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import ndtri

from fingerflow.models.observer.estimate import Values, metric_values

_FEWEST = 6
_STEPS = 100  # iterations of expectation and maximisation
_STREAM = 0x6A0  # added to the seed: data simulated with the same seed must not share random numbers


@dataclass(frozen=True)
class Groups:
    """Two groups of participants as fitted by `participant_groups`, with a test against one group; NaN if not
    computable.

    Attributes:
        groups: 2 where the bootstrap test is significant at 5 %, else 1; 0 where it cannot be determined.
        means, deviation, shares: of the two groups, the lower one first; one deviation for both.
        membership: (P,) probability of belonging to the higher group; NaN where the value is.
        border: the value at which both groups are equally likely.
        likelihood_ratio: 2 (log likelihood of two - of one group); `p`, its p-value under one group.
        participants, missing: number used, and left out as NaN.
        reason: why a number is NaN; empty otherwise.
    """

    groups: int
    means: tuple[float, float]
    deviation: float
    shares: tuple[float, float]
    membership: Values
    border: float
    likelihood_ratio: float
    p: float
    participants: int
    missing: int
    reason: str = ""


def participant_groups(values: ArrayLike, resamples: int = 1000, seed: int = 0) -> Groups:
    """Split participants into two groups by one number each, such as the median difference of divergence (Willemet et
    al. 2021, S12 A).

    The paper splits by eye because the histogram is bimodal. Here a mixture of two Gaussians with a common deviation is
    compared with one Gaussian; with two deviations the likelihood is unbounded. The likelihood ratio follows no
    tabulated distribution, so its p-value comes from samples of one Gaussian (McLachlan 1987). BIC would split 34, 19
    and 11 % of samples of 6, 10 and 15 participants of one group, and Hartigan's dip finds half as many pairs of
    groups: 22 and 45 % of 15 participants whose groups are 4 deviations apart.

    Args:
        values: (P,) one per participant; NaN is left out and counted.
        resamples, seed: of the test.

    Raises:
        ValueError: infinite values, or fewer than 100 resamples.
    """
    numbers = metric_values(values)
    if resamples < 100:
        raise ValueError(f"{resamples} resamples are too few for a test: give 100 or more")
    valid = np.isfinite(numbers)
    finite = numbers[valid]
    nan, size, missing = math.nan, finite.size, int((~valid).sum())
    if size < _FEWEST or np.ptp(finite) == 0:
        reason = f"{size} participants: {_FEWEST} are needed" if size < _FEWEST else "all participants are alike"
        pair, each = (nan, nan), np.full(numbers.shape, nan)
        return Groups(0, pair, nan, pair, each, nan, nan, nan, size, missing, reason)
    # Divide by the sample's own standard deviation, so that nothing depends on the unit.
    origin, unit = float(finite.mean()), float(finite.std())
    scaled = (finite - origin) / unit
    share, low, high, deviation, ratio = (values[0] for values in _two_groups(scaled[None]))
    draws = np.random.default_rng([seed, _STREAM]).standard_normal((resamples, size))
    draws = (draws - draws.mean(1, keepdims=True)) / draws.std(1, keepdims=True)
    p = (1 + np.count_nonzero(_two_groups(draws)[4] >= ratio - 1e-9)) / (1 + resamples)

    odds = np.log(share / (1 - share)) + (high - low) * (scaled - (low + high) / 2) / deviation**2
    membership = np.full(numbers.shape, nan)
    membership[valid] = 1 / (1 + np.exp(-np.clip(odds, -700, 700)))
    border = (low + high) / 2 - deviation**2 * math.log(share / (1 - share)) / (high - low)
    return Groups(
        groups=2 if p < 0.05 else 1,
        means=(origin + unit * float(low), origin + unit * float(high)),
        deviation=unit * float(deviation),
        shares=(1 - float(share), float(share)),
        membership=membership,
        border=origin + unit * float(border),
        likelihood_ratio=float(ratio),
        p=float(p),
        participants=size,
        missing=missing,
    )


def _two_groups(samples: Values) -> tuple[Values, Values, Values, Values, Values]:
    """Fit a mixture of two Gaussians with one common deviation to each of R samples of P values (R, P); return share of
    the higher group, lower mean, higher mean, deviation, and likelihood ratio against one Gaussian, (R,) each.

    Samples have mean 0 and variance 1. The fit is the best from three starts: higher groups of 1/4, 1/2 and 3/4.
    """
    border = np.quantile(samples, (0.75, 0.5, 0.25), axis=1)[..., None]
    # (3, R, P) initial probability of the higher group, for the three starts.
    belongs = np.where(samples > border, 0.99, 0.01)
    smallest = ndtri(0.75) * 1e-3
    for _ in range(_STEPS):
        share = belongs.mean(-1, keepdims=True).clip(1e-6, 1 - 1e-6)
        high = (belongs * samples).mean(-1, keepdims=True) / share
        low = ((1 - belongs) * samples).mean(-1, keepdims=True) / (1 - share)
        spread = (belongs * (samples - high) ** 2 + (1 - belongs) * (samples - low) ** 2).mean(-1, keepdims=True)
        variance = np.maximum(spread, smallest**2)
        upper = np.log(share) - (samples - high) ** 2 / (2 * variance)
        lower = np.log1p(-share) - (samples - low) ** 2 / (2 * variance)
        total = np.logaddexp(upper, lower)
        belongs = np.exp(upper - total)
    # Log likelihood of one Gaussian of variance 1: -1/2 per value, up to the same constant.
    ratio = 2 * ((total - np.log(variance) / 2).sum(-1) + samples.shape[1] / 2)
    best = ratio.argmax(0)[None]
    share, low, high, variance = (np.take_along_axis(part[..., 0], best, 0)[0] for part in (share, low, high, variance))
    upper_share = np.where(high < low, 1 - share, share)
    return upper_share, np.minimum(low, high), np.maximum(low, high), np.sqrt(variance), ratio.max(0)
