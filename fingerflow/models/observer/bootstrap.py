"""Bootstrap confidence intervals, bias-corrected and accelerated (BCa), that resample whole participants or trials.

Every statistic is a function of weights, the number of draws of each trial, so all resamples are computed at once.
"""

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import ndtr, ndtri
from scipy.stats import t as student

from fingerflow.models.observer.estimate import UNKNOWN, Interval

Values = NDArray[np.float64]
Weights = tuple[Values, ...]
# Function from the weights (R, n) of each sample to the statistic (R,).
Statistic = Callable[..., Values]
Participants = tuple[ArrayLike, ArrayLike] | None  # participant of each correct and of each incorrect trial

_AT_ONCE = 4_000_000  # largest number of weights in memory
# Added to the seed: data simulated with the same seed must not share random numbers with the resampling.
_STREAM = 0x0B007
# Above this number of resampling units the jackknife leaves them out in groups: their influence is small, and leaving
# out one at a time costs n^2.
_JACKKNIFED = 400
FEWEST_CLUSTERS = 3


@dataclass(frozen=True)
class Samples:
    """Resampling unit of each trial in a bootstrap: the participant of the trial, or else the trial by itself."""

    units: tuple[NDArray[np.intp], ...]
    participants: int  # number of participants, 0 where each trial is its own resampling unit

    @property
    def sizes(self) -> tuple[int, ...]:
        return tuple(units.size for units in self.units)


def samples_of(
    kinds: Sequence[ArrayLike], participants: Sequence[ArrayLike] | None
) -> tuple[list[Values], Samples, int]:
    """Remove NaN trials from the metric's values in one or more classes of trials; return the values left, the
    resampling unit of each (its participant, or itself if None are given), and the number of trials removed.

    Raises:
        ValueError: infinite values, or participants whose shapes do not match the values.
    """
    values = [np.asarray(kind, dtype=np.float64).reshape(-1) for kind in kinds]
    for sample in values:
        if np.isinf(sample).any():
            raise ValueError("a metric is infinite: mark what was not measured with NaN")
    if participants is not None and [np.shape(who) for who in participants] != [sample.shape for sample in values]:
        found, needed = ([np.shape(some) for some in which] for which in (participants, values))
        raise ValueError(f"participants have shapes {found}, the trials {needed}: name the participant of every trial")
    kept = [np.isfinite(sample) for sample in values]
    missing = sum(int((~keep).sum()) for keep in kept)
    finite = [sample[keep] for sample, keep in zip(values, kept, strict=True)]
    if participants is None:
        return finite, Samples(tuple(np.arange(sample.size) for sample in finite), 0), missing
    names = [np.asarray(who)[keep] for who, keep in zip(participants, kept, strict=True)]
    known, units = np.unique(np.concatenate(names), return_inverse=True)
    split = np.split(units, np.cumsum([name.size for name in names])[:-1])
    return finite, Samples(tuple(split), known.size), missing


def bca_interval(
    statistic: Statistic, samples: Samples, level: float, resamples: int, seed: int
) -> tuple[Interval, str]:
    """Compute the bias-corrected and accelerated (BCa) bootstrap interval of a statistic of samples at confidence
    `level`; return it with a text that explains a missing interval or dropped resamples.

    Efron's BCa takes quantiles of the bootstrap, shifted by its bias and by the acceleration from a jackknife over the
    same units. It is too narrow for few units; its normal quantiles are therefore replaced by those of Student's t
    times (n / (n - 1))^(1/2) for n units (Hesterberg 2015).

    Coverage measured on clustered Gaussians (those of `tests/models/observer`), intervals of 95 %, 2,000 resamples:
    with 20 participants 93.3 % for d' and 93.7 % for the area under the ROC (1,500 draws, error 0.6 %), with 8
    participants 94.2 and 93.0 % (500 draws, error 1 %), so about 1.5 % are missing. Student's t on the jackknife had
    94.2 and 93.9 %, and 95.8 and 95.2 %, in the same draws. That is nearer, but its intervals are symmetric about the
    estimate and can exceed an area of 1.

    Raises:
        ValueError: level or resamples are out of range.
    """
    if not 0 < level < 1:
        raise ValueError(f"the level is {level:g}: give one between 0 and 1, as 0.95")
    if resamples < 100:
        raise ValueError(f"{resamples} resamples are too few for an interval: give 100 or more")
    units = samples.participants or min(samples.sizes)
    if units < FEWEST_CLUSTERS:
        name = "participants" if samples.participants else "trials of a class"
        return UNKNOWN, f"no interval from {units} {name}: {FEWEST_CLUSTERS} are needed"
    drawn = _each(statistic, _resampled(samples, resamples, np.random.default_rng([seed, _STREAM])))
    estimate = statistic(*(np.ones((1, size)) for size in samples.sizes))[0]
    finite = drawn[np.isfinite(drawn)]
    if finite.size < resamples / 2 or not math.isfinite(estimate):
        return UNKNOWN, f"no interval: {resamples - finite.size} of {resamples} resamples lack a class or a spread"
    spread = np.abs(finite - estimate).max()
    if spread <= 1e-12 * max(abs(estimate), 1):
        return UNKNOWN, "no interval: every resample gives the same number"
    reason = "" if finite.size == resamples else f"{resamples - finite.size} of {resamples} resamples lacked a class"

    below = (np.count_nonzero(finite < estimate) + np.count_nonzero(finite == estimate) / 2) / finite.size
    bias = ndtri(np.clip(below, 0.5 / finite.size, 1 - 0.5 / finite.size))
    acceleration = _acceleration(statistic, samples)
    reach = student.ppf((1 + level) / 2, units - 1) * math.sqrt(units / (units - 1))
    shifted = bias + np.array([-reach, reach])
    quantiles = ndtr(bias + shifted / np.maximum(1 - acceleration * shifted, 1e-3))
    low, high = np.quantile(finite, quantiles)
    # Where the statistic takes few values, a quantile may lie slightly on the wrong side of the estimate.
    return (float(min(low, estimate)), float(max(high, estimate))), reason


def _each(statistic: Statistic, weights: Iterator[Weights]) -> Values:
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.concatenate([statistic(*some) for some in weights])


def _resampled(samples: Samples, resamples: int, draw: np.random.Generator) -> Iterator[Weights]:
    rows = max(1, _AT_ONCE // max(sum(samples.sizes), 1))
    for start in range(0, resamples, rows):
        count = min(rows, resamples - start)
        if samples.participants:
            often = _counts(draw, count, samples.participants)
            yield tuple(often[:, units] for units in samples.units)
        else:
            yield tuple(_counts(draw, count, size) for size in samples.sizes)


def _counts(draw: np.random.Generator, rows: int, units: int) -> Values:
    """Return how often each of n resampling units (participants or trials) occurs in each of `rows` bootstrap samples,
    (rows, n).
    """
    flat = draw.integers(0, units, (rows, units)) + units * np.arange(rows)[:, None]
    return np.bincount(flat.ravel(), minlength=rows * units).reshape(rows, units).astype(np.float64)


def _acceleration(statistic: Statistic, samples: Samples) -> float:
    """Compute the acceleration constant of a BCa interval from a jackknife: the influence on the statistic of leaving
    out each resampling unit, participant or trial (Efron & Tibshirani 1993, 14.15).
    """
    every = range(len(samples.sizes))
    # A participant is left out of all samples, a trial only of its own sample.
    parts = [(every, samples.participants)] if samples.participants else [([k], samples.sizes[k]) for k in every]
    left = [_each(statistic, _without_one(samples, changed, units)) for changed, units in parts]
    influence = np.concatenate([np.nanmean(values) - values for values in left])
    influence = influence[np.isfinite(influence)]
    second = float((influence**2).sum())
    return float((influence**3).sum()) / (6 * second**1.5) if second > 0 else 0.0


def _without_one(samples: Samples, changed: Sequence[int], units: int) -> Iterator[Weights]:
    groups = min(units, _JACKKNIFED)
    rows = max(1, _AT_ONCE // max(sum(samples.sizes), 1))
    for start in range(0, groups, rows):
        out = np.arange(start, min(start + rows, groups))
        yield tuple(
            (which % groups != out[:, None]).astype(np.float64) if k in changed else np.ones((out.size, which.size))
            for k, which in enumerate(samples.units)
        )
