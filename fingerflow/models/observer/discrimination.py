"""How well a metric discriminates correct from incorrect trials: d', area under the ROC, and criterion.

Participants are the units of all intervals, which are those of the jackknife and Student's t. Coverage of intervals of
95 % in 600 simulated studies of 8 participants with 56 trials, a fifth of them wrong
(`python -m tests.models.observer.error_rates`): d' 94 %, area 97 %, criterion 96 %, its false alarms 99 %.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import ndtr, ndtri
from scipy.stats import rankdata

from fingerflow.models.observer.estimate import LEVEL, Estimate, Values, jackknife, metric_values
from fingerflow.models.observer.printed import PrintedObserver, printed_observer
from fingerflow.models.observer.trials_table import Trials

Participants = tuple[ArrayLike, ArrayLike]  # participant of each correct and of each incorrect trial
Units = NDArray[np.intp]  # number of the participant of each trial
# Function from values and units of each kind of trials, and from weights (R, P) of the participants in R samples, to
# the statistic (R,).
Statistic = Callable[[list[Values], list[Units], Values], Values]

_HITS = 0.75  # share of the correct trials above the criterion
_MOST_LACKING = 0.5  # largest share of trials without a metric that excludes them from the others
# Added to the seed: data simulated with the same seed must not share random numbers with the permutations.
_STREAM = 0x9E2A


@dataclass(frozen=True)
class MetricSummary:
    """Ideal-observer statistics of one metric; `printed` has them as in the paper, and `false_alarms` is the share of
    incorrect trials above the criterion.
    """

    d_prime: Estimate
    auc: Estimate
    criterion: Estimate
    false_alarms: Estimate
    printed: PrintedObserver


def observe(
    trials: Trials, metrics: Sequence[str] | None = None, permutations: int = 2000, seed: int = 0
) -> dict[str, MetricSummary]:
    """Compute how well each metric of a table of trials separates correct from incorrect trials: d', area under the
    ROC with p by permutation, and criterion, by metric name (ideal observer, Willemet et al. 2021).

    Metrics are compared on common trials: one that lacks a metric is missing in all. A metric that lacks in more than
    half of the trials excludes none from the others.

    Args:
        trials: of `read_trials`, after `leave_out_moved` where trials of fingers that slid are to be left out.
        metrics: names; all where None.
        permutations, seed: of p.

    Raises:
        FingerflowError: a metric that the table does not have.
    """
    who, summaries = trials.participants(), {}
    names = tuple(trials.metrics if metrics is None else metrics)
    lacking = np.array([np.isnan(np.concatenate(trials.split(name))) for name in names]).reshape(len(names), -1)
    common = ~lacking[lacking.mean(1) <= _MOST_LACKING].any(0)
    kinds = np.split(common, [int(trials.answer.sum())])
    for name in names:
        correct, incorrect = (np.where(*pair, np.nan) for pair in zip(kinds, trials.split(name), strict=True))
        criterion = criterion_for_hits(correct, who[0])
        summaries[name] = MetricSummary(
            d_prime(correct, incorrect, who),
            replace(auc(correct, incorrect, who), p=permutation_p(correct, incorrect, who, permutations, seed)),
            criterion,
            share_above(criterion.value, incorrect, who[1]),
            printed_observer(correct, incorrect),
        )
    return summaries


def d_prime(correct: ArrayLike, incorrect: ArrayLike, participants: Participants) -> Estimate:
    """Estimate the sensitivity d': the difference in mean metric of correct and incorrect trials, in standard
    deviations.

    d' = (mu_1 - mu_2) / ((s_1^2 + s_2^2) / 2)^(1/2) (Willemet et al. 2021, ideal observer).

    d' is negative where correct trials have the smaller metric, as the area under the ROC is then below 1/2. Means and
    variances (with n - 1) are those of the trials; the paper takes both from Gaussians fitted to a histogram
    (`printed_observer`).

    Args:
        correct, incorrect: (n,) the metric in correct and incorrect trials, any unit; NaN is left out and counted.
        participants: participant of each correct and incorrect trial, (n,) each.

    Returns:
        `Estimate`. NaN with the reason for fewer than two trials of a kind, or a metric that does not vary.

    Raises:
        ValueError: infinite values, or participants that do not match.
    """
    return _estimated((correct, incorrect), participants, 2, _d_prime)


def auc(correct: ArrayLike, incorrect: ArrayLike, participants: Participants) -> Estimate:
    """Estimate the area under the ROC: the probability that a correct trial has a larger metric than an incorrect one.

    Ties count half. 1/2 is chance; below 1/2 correct trials have the smaller metric. The value is NaN, with the reason,
    if a kind has no trial. The interval is that of the normal quantile of the area. There is none if the two kinds do
    not overlap. Arguments and errors are those of `d_prime`.
    """
    area = [math.nan]

    def quantile(values: list[Values], *rest: Any) -> Values:
        least = 0.5 / math.prod(group.size for group in values)
        areas = _area(values, *rest)
        area[0] = float(areas[0])
        return ndtri(areas.clip(least, 1 - least))

    found = _estimated((correct, incorrect), participants, 1, quantile)
    return replace(found, value=area[0], interval=tuple(ndtr(found.interval).tolist()))


def compare_auc(
    first: tuple[ArrayLike, ArrayLike], second: tuple[ArrayLike, ArrayLike], participants: Participants
) -> Estimate:
    """Estimate the difference between the areas under the ROC of two metrics of the same trials.

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
        [np.asarray(group, dtype=np.float64).reshape(-1) for group in both] for both in zip(first, second, strict=True)
    ]
    for left, right in pairs:
        if left.size != right.size:
            raise ValueError(f"{left.size} and {right.size} trials of a kind: give both metrics of the same ones")
    valid = [np.isfinite(left) & np.isfinite(right) for left, right in pairs]
    others = [right[both] for both, (_, right) in zip(valid, pairs, strict=True)]
    kinds = [np.where(both, left, np.nan) for both, (left, _) in zip(valid, pairs, strict=True)]
    return _estimated(kinds, participants, 1, lambda values, *rest: _area(values, *rest) - _area(others, *rest))


def criterion_for_hits(correct: ArrayLike, participants: ArrayLike) -> Estimate:
    """Estimate the metric value that 75 % of the correct trials exceed, as in Willemet et al. 2021.

    The criterion is in the metric's unit, interpolated linearly between trials; no distribution is assumed. The
    interval has the quantiles at the limits of the share of trials above it (Woodruff 1952).

    Raises:
        ValueError: as in `auc`.
    """
    known = np.asarray(correct, dtype=np.float64).reshape(-1)
    known = known[np.isfinite(known)]
    value = float(np.quantile(known, 1 - _HITS)) if known.size > 1 else math.nan
    share = _estimated((correct,), (participants,), 2, partial(_share, value))
    limits = np.clip(1 - _HITS + share.value - np.array(share.interval[::-1]), 0, 1)
    interval = np.quantile(known, limits) if np.isfinite(limits).all() else limits
    return replace(share, value=value, interval=(float(interval[0]), float(interval[1])), p=math.nan)


def share_above(criterion: float, values: ArrayLike, participants: ArrayLike) -> Estimate:
    """Estimate the share of trials whose metric exceeds a criterion: of incorrect trials, the false alarms.

    The interval is Wilson's for as many independent trials as would have the deviation of the jackknife, at most those
    that there are (as Korn & Graubard 1998): a handful of false alarms has no normal distribution. Without a criterion
    (NaN) nothing is known. Errors are those of `auc`.
    """
    from statsmodels.stats.proportion import proportion_confint  # of the extra `study`

    found = _estimated((np.asarray(values) + 0 * criterion,), (participants,), 1, partial(_share, criterion))
    if not found.trials:
        return found
    share, variance = found.value, (float(np.diff(found.interval)[0]) / 4) ** 2
    trials = min(found.trials, share * (1 - share) / variance) if variance > 0 else found.trials
    low, high = proportion_confint(share * trials, trials, 1 - LEVEL, "wilson")
    return replace(found, interval=(min(float(low), share), max(float(high), share)), p=math.nan, reason="")


def permutation_p(
    correct: ArrayLike, incorrect: ArrayLike, participants: Participants, permutations: int = 5000, seed: int = 0
) -> float:
    """Test whether the metric separates correct from incorrect trials, permuting answers within each participant.

    Return (1 + number of permutations whose area under the ROC deviates from its expectation at least as much as the
    observed one) / (1 + permutations), never 0; NaN where a kind has no trials. Arguments as in `auc`.
    """
    values, units, people, _ = _finite((correct, incorrect), participants)
    if not (values[0].size and values[1].size):
        return math.nan
    person = np.concatenate(units)
    order = np.argsort(person, kind="stable")
    person, ranks = person[order], rankdata(np.concatenate(values))[order]
    is_correct = (order < values[0].size).astype(np.float64)
    # Within participants the expected area is not 1/2: participants who answer better may have larger metrics.
    share = np.bincount(person, is_correct, people) / np.bincount(person, minlength=people)
    expected = float(share[person] @ ranks)
    draw = np.random.default_rng([seed, _STREAM])
    drawn = (is_correct[np.argsort(person + draw.random(person.size))] @ ranks for _ in range(permutations))
    reach = abs(is_correct @ ranks - expected) - 1e-9
    return float((1 + sum(abs(total - expected) >= reach for total in drawn)) / (1 + permutations))


def _estimated(
    kinds: Sequence[ArrayLike], participants: Sequence[ArrayLike], fewest: int, statistic: Statistic
) -> Estimate:
    values, units, people, missing = _finite(kinds, participants)
    sizes = [group.size for group in values]
    nothing = Estimate(math.nan, trials=sum(sizes), missing=missing, participants=people)
    if min(sizes) < fewest:
        counts = " and ".join(map(str, sizes))
        return replace(nothing, reason=f"{counts} trials of the kinds compared: {fewest} of each are needed")
    with np.errstate(divide="ignore", invalid="ignore"):
        value, *without = statistic(values, units, np.vstack((np.ones(people), 1 - np.eye(people)))).tolist()
    if not math.isfinite(value):
        return replace(nothing, reason="all values are equal within each kind of trial: no d'")
    interval, p, reason = jackknife(value, without)
    return replace(nothing, value=value, interval=interval, p=p, reason=reason)


def _finite(
    kinds: Sequence[ArrayLike], participants: Sequence[ArrayLike]
) -> tuple[list[Values], list[Units], int, int]:
    """Return the finite values of each kind of trials, the number of each trial's participant, how many participants
    there are, and how many trials were NaN.
    """
    values = [metric_values(group) for group in kinds]
    shapes = [np.shape(who) for who in participants], [group.shape for group in values]
    if shapes[0] != shapes[1]:
        raise ValueError(f"participants have shapes {shapes[0]}, the trials {shapes[1]}: name that of every trial")
    valid = [np.isfinite(group) for group in values]
    names = [np.asarray(who)[keep] for who, keep in zip(participants, valid, strict=True)]
    people, units = np.unique(np.concatenate(names), return_inverse=True)
    finite = [group[keep] for group, keep in zip(values, valid, strict=True)]
    missing = sum(int((~keep).sum()) for keep in valid)
    return finite, np.split(units, np.cumsum([name.size for name in names])[:-1]), people.size, missing


def _d_prime(values: list[Values], units: list[Units], weights: Values) -> Values:
    def moments(group: Values, unit: Units) -> tuple[Values, Values]:
        mean = group.mean()
        # Subtract the mean of the whole sample first: sums of squares of values far from 0 would lose precision.
        centred = group - mean
        sums = [weights @ np.bincount(unit, centred**power, weights.shape[1]) for power in (0, 1, 2)]
        variance = (sums[2] - sums[1] ** 2 / sums[0]) / (sums[0] - 1)
        rounding = 1e-13 * (np.abs(centred).max() ** 2 + np.finfo(np.float64).tiny)
        return mean + sums[1] / sums[0], np.where(variance > rounding, variance, np.nan)

    (mean, variance), (other_mean, other_variance) = map(moments, values, units)
    return (mean - other_mean) / np.sqrt((variance + other_variance) / 2)


def _area(values: list[Values], units: list[Units], weights: Values) -> Values:
    people, (correct, incorrect) = weights.shape[1], values
    # Pairs of a correct trial of participant p with a smaller incorrect one of q; equal ones count half.
    wins = np.zeros((people, people))
    for q in range(people):
        ranked = np.sort(incorrect[units[1] == q])
        below = np.searchsorted(ranked, correct, "left") + np.searchsorted(ranked, correct, "right")
        wins[:, q] = np.bincount(units[0], below / 2, people)
    counts = [weights @ np.bincount(unit, minlength=people) for unit in units]
    return ((weights @ wins) * weights).sum(1) / math.prod(counts)


def _share(criterion: float, values: list[Values], units: list[Units], weights: Values) -> Values:
    above, number = (np.bincount(units[0], by, weights.shape[1]) for by in (values[0] > criterion, None))
    return (weights @ above) / (weights @ number)
