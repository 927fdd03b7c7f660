"""Estimate how well a metric discriminates correct from incorrect trials: d', area under the ROC, and criterion."""

import math
from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import ArrayLike

from fingerflow.models.observer.bootstrap import Participants, Statistic, Values, bca_interval, samples_of
from fingerflow.models.observer.estimate import UNKNOWN, Estimate


def d_prime(
    correct: ArrayLike,
    incorrect: ArrayLike,
    *,
    participants: Participants = None,
    level: float = 0.95,
    resamples: int = 2000,
    seed: int = 0,
) -> Estimate:
    """Estimate the sensitivity d': the difference in mean metric of correct and incorrect trials, in standard
    deviations.

    d' = (mu_1 - mu_2) / ((s_1^2 + s_2^2) / 2)^(1/2) (Willemet et al. 2021, ideal observer).

    d' is negative where correct trials have the smaller metric, as the area under the ROC is then below 1/2. Means and
    variances (with n - 1) are those of the trials; the paper takes both from Gaussians fitted to a histogram
    (`printed_observer`).

    Args:
        correct, incorrect: (n,) the metric in correct and incorrect trials, any unit; NaN is left out and counted.
        participants: participant of each correct and incorrect trial, (n,) each. The bootstrap then draws whole
            participants; without them each trial counts as independent, which it seldom is.
        level: of the interval.
        resamples, seed: of the bootstrap; intervals by BCa, see `bca_interval`.

    Returns:
        `Estimate`. NaN with the reason for fewer than two trials of a kind, or a metric that does not vary.

    Raises:
        ValueError: infinite values, participants that do not match, level or resamples out of range.
    """

    def of(values: list[Values]) -> Statistic:
        def statistic(first: Values, second: Values) -> Values:
            variance = (_deviation(values[0], first) ** 2 + _deviation(values[1], second) ** 2) / 2
            return (_mean(values[0], first) - _mean(values[1], second)) / np.sqrt(variance)

        return statistic

    return _estimate((correct, incorrect), of, 2, participants, level, resamples, seed)


def auc(
    correct: ArrayLike,
    incorrect: ArrayLike,
    *,
    participants: Participants = None,
    level: float = 0.95,
    resamples: int = 2000,
    seed: int = 0,
) -> Estimate:
    """Estimate the area under the ROC: the probability that a correct trial has a larger metric than an incorrect one.

    Ties count half. 1/2 is chance; below 1/2 correct trials have the smaller metric. The value is NaN, with the reason,
    if a kind has no trial. There is no interval if the two kinds do not overlap, because every resample then gives the
    same area. Arguments and errors are those of `d_prime`.
    """
    return _estimate(
        (correct, incorrect), lambda values: _auc_statistic(*values), 1, participants, level, resamples, seed
    )


def compare_auc(
    first: tuple[ArrayLike, ArrayLike],
    second: tuple[ArrayLike, ArrayLike],
    *,
    participants: Participants = None,
    level: float = 0.95,
    resamples: int = 2000,
    seed: int = 0,
) -> Estimate:
    """Estimate the difference between the areas under the ROC of two metrics of the same trials.

    Both areas are computed on the same resamples, so that variation common to the metrics cancels.

    Args:
        first, second: (correct, incorrect) of either metric; the n-th trial of each is the same trial. Trials that
            lack one of the metrics are left out of both, and counted.
        participants: of the trials, (correct, incorrect).

    Returns:
        `Estimate` of the difference: its interval excludes 0 where the metrics differ at that level.

    Raises:
        ValueError: the metrics have different numbers of trials, or as in `auc`.
    """
    pairs = [
        [np.asarray(kind, dtype=np.float64).reshape(-1) for kind in pair] for pair in zip(first, second, strict=True)
    ]
    for one, other in pairs:
        if one.size != other.size:
            raise ValueError(f"{one.size} and {other.size} trials of a kind: give both metrics of the same ones")
    known = [np.isfinite(one) & np.isfinite(other) for one, other in pairs]
    kinds = [np.where(both, one, np.nan) for both, (one, _) in zip(known, pairs, strict=True)]
    others = [other[both] for both, (_, other) in zip(known, pairs, strict=True)]

    def of(values: list[Values]) -> Statistic:
        first_area, second_area = _auc_statistic(*values), _auc_statistic(*others)
        return lambda correct, incorrect: first_area(correct, incorrect) - second_area(correct, incorrect)

    return _estimate(kinds, of, 1, participants, level, resamples, seed)


def criterion_for_hits(
    correct: ArrayLike,
    hits: float = 0.75,
    *,
    participants: ArrayLike | None = None,
    level: float = 0.95,
    resamples: int = 2000,
    seed: int = 0,
) -> Estimate:
    """Estimate the metric value that a given share of the correct trials exceeds, 75 % in Willemet et al. 2021.

    The criterion is in the metric's unit, interpolated linearly between trials; no distribution is assumed.

    Raises:
        ValueError: hits is not between 0 and 1, or as in `d_prime`.
    """
    if not 0 < hits < 1:
        raise ValueError(f"the share of hits is {hits:g}: give one between 0 and 1, as 0.75")

    def of(values: list[Values]) -> Statistic:
        return lambda weights: _weighted_quantile(values[0], weights, 1 - hits)

    who = None if participants is None else (participants,)
    return _estimate((correct,), of, 2, who, level, resamples, seed)


def _estimate(
    kinds: Sequence[ArrayLike],
    statistic: Callable[[list[Values]], Statistic],
    fewest: int,
    participants: Sequence[ArrayLike] | None,
    level: float,
    resamples: int,
    seed: int,
) -> Estimate:
    """Estimate a statistic, with its bootstrap interval at `level`, from a metric's values in one or two classes of
    trials (`kinds`, such as correct and incorrect).

    The value is NaN if a class has fewer than ``fewest`` trials.
    """
    values, samples, missing = samples_of(kinds, participants)
    value, interval = math.nan, UNKNOWN
    if min(samples.sizes) < fewest:
        found = " and ".join(map(str, samples.sizes))
        reason = f"{found} trials of the kinds compared: {fewest} of each are needed"
    else:
        weighted = statistic(values)
        with np.errstate(divide="ignore", invalid="ignore"):
            value = float(weighted(*(np.ones((1, size)) for size in samples.sizes))[0])
        if math.isfinite(value):
            interval, reason = bca_interval(weighted, samples, level, resamples, seed)
        else:
            value, reason = math.nan, "all values are equal within each kind of trial: no d'"
    return Estimate(value, interval, level, resamples, seed, samples.sizes, missing, samples.participants, reason)


def _weighted_quantile(values: Values, weights: Values, share: float) -> Values:
    """Return the quantile at `share`, 0 to 1, of the values (N,) in each of R bootstrap resamples, (R,).

    `weights` (R, N) count how often a resample contains each of the N values.
    """
    order = np.argsort(values, kind="stable")
    ranked, counts = values[order], weights[:, order].cumsum(1)
    place = share * (counts[:, -1] - 1)
    lower = np.floor(place)
    upper = np.minimum(lower + 1, counts[:, -1] - 1)
    # The k-th smallest of the resampled values is the first one whose cumulative count exceeds k.
    low, high = (ranked[np.argmax(counts > rank[:, None], axis=1)] for rank in (lower, upper))
    return np.asarray(low + (place - lower) * (high - low))


def _auc_statistic(correct: Values, incorrect: Values) -> Callable[[Values, Values], Values]:
    """Return a function that computes R areas (R,) under the ROC for the given metric values of n_1 correct and n_2
    incorrect trials, from R sets of trial weights (R, n_1) and (R, n_2).
    """
    values = np.concatenate([correct, incorrect])
    order = np.argsort(values, kind="stable")
    starts = np.flatnonzero(np.diff(values[order], prepend=-np.inf) > 0)
    is_correct = order < correct.size

    def area(first: Values, second: Values) -> Values:
        ranked = np.concatenate([first, second], axis=1)[:, order]
        hits = np.where(is_correct, ranked, 0)
        misses = ranked - hits
        if starts.size < values.size:  # equal values are a single step of the curve
            hits, misses = (np.add.reduceat(some, starts, axis=1) for some in (hits, misses))
        below = misses.cumsum(1) - misses / 2
        return np.asarray((hits * below).sum(1) / (hits.sum(1) * misses.sum(1)))

    return area


def _mean(values: Values, weights: Values) -> Values:
    """Return the means (R,) of values (N,) under R sets of weights (R, N)."""
    return np.asarray(weights @ values / weights.sum(1))


def _deviation(values: Values, weights: Values) -> Values:
    """Return standard deviations (R,) of values (N,) under weights (R, N), with n - 1; NaN if no two values differ."""
    # Subtract the mean of the whole sample first: sums of squares of values far from 0 would lose precision.
    centred = values - values.mean()
    count = weights.sum(1)
    middle = weights @ centred / count
    variance = (weights @ centred**2 - count * middle**2) / (count - 1)
    rounding = 1e-13 * (np.abs(centred).max() ** 2 + np.finfo(np.float64).tiny)
    return np.sqrt(np.where(variance > rounding, variance, np.nan))
