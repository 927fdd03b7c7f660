"""How well a metric discriminates correct from incorrect trials: d', area under the ROC, and criterion.

Participants are the units of all intervals. Coverage of intervals of 95 % in 600 simulated studies of 8 participants
with 56 trials, a fifth of them wrong (`python -m tests.models.observer.error_rates`): d' by the jackknife 94 % (by the
bootstrap 90 %: its resamples have fewer different incorrect trials, which spread less), area 94 % and criterion 93 % by
the bootstrap. The area has the bootstrap as intervals of Student's t can exceed 1, and so has the criterion, as the
jackknife of a quantile tells nothing.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.stats import rankdata

from fingerflow.models.observer.estimate import Estimate, Interval, Statistic, Values, bootstrap, jackknife
from fingerflow.models.observer.printed import PrintedObserver, printed_observer
from fingerflow.models.observer.trials_table import Trials

Participants = tuple[ArrayLike, ArrayLike]  # participant of each correct and of each incorrect trial

_HITS = 0.75  # share of the correct trials above the criterion
# Added to the seed: data simulated with the same seed must not share random numbers with the permutations.
_STREAM = 0x9E2A


@dataclass(frozen=True)
class MetricSummary:
    """Ideal-observer statistics of one metric; `printed` has them as in the paper."""

    d_prime: Estimate
    auc: Estimate
    criterion: Estimate
    printed: PrintedObserver


def observe(
    trials: Trials, metrics: Sequence[str] | None = None, resamples: int = 2000, seed: int = 0
) -> dict[str, MetricSummary]:
    """Compute how well each metric of a table of trials separates correct from incorrect trials: d', area under the
    ROC with p by permutation, and criterion, by metric name (ideal observer, Willemet et al. 2021).

    Args:
        trials: of `read_trials`, after `leave_out_moved` where trials of fingers that slid are to be left out.
        metrics: names; all where None.
        resamples, seed: of the bootstrap and of the permutations.

    Raises:
        FingerflowError: a metric that the table does not have.
    """
    who = trials.participants()
    summaries = {}
    for name in trials.metrics if metrics is None else metrics:
        correct, incorrect = trials.split(name)
        summaries[name] = MetricSummary(
            d_prime(correct, incorrect, who),
            replace(
                auc(correct, incorrect, who, resamples, seed), p=permutation_p(correct, incorrect, who, resamples, seed)
            ),
            criterion_for_hits(correct, who[0], resamples, seed),
            printed_observer(correct, incorrect),
        )
    return summaries


def d_prime(correct: ArrayLike, incorrect: ArrayLike, participants: Participants) -> Estimate:
    """Estimate the sensitivity d': the difference in mean metric of correct and incorrect trials, in standard
    deviations.

    d' = (mu_1 - mu_2) / ((s_1^2 + s_2^2) / 2)^(1/2) (Willemet et al. 2021, ideal observer).

    d' is negative where correct trials have the smaller metric, as the area under the ROC is then below 1/2. Means and
    variances (with n - 1) are those of the trials; the paper takes both from Gaussians fitted to a histogram
    (`printed_observer`). Interval and p are those of the jackknife.

    Args:
        correct, incorrect: (n,) the metric in correct and incorrect trials, any unit; NaN is left out and counted.
        participants: participant of each correct and incorrect trial, (n,) each.

    Returns:
        `Estimate`. NaN with the reason for fewer than two trials of a kind, or a metric that does not vary.

    Raises:
        ValueError: infinite values, or participants that do not match.
    """
    return _estimated(
        (correct, incorrect), participants, 2, _d_prime, lambda value, statistic, people: jackknife(
            value, statistic(1 - np.eye(people))))  # fmt: skip


def auc(
    correct: ArrayLike, incorrect: ArrayLike, participants: Participants, resamples: int = 2000, seed: int = 0
) -> Estimate:
    """Estimate the area under the ROC: the probability that a correct trial has a larger metric than an incorrect one.

    Ties count half. 1/2 is chance; below 1/2 correct trials have the smaller metric. The value is NaN, with the reason,
    if a kind has no trial. There is no interval if the two kinds do not overlap, because every resample then gives the
    same area. The interval is that of the bootstrap; other arguments and errors are those of `d_prime`.
    """
    return _estimated((correct, incorrect), participants, 1, _area, partial(bootstrap, resamples=resamples, seed=seed))


def compare_auc(
    first: tuple[ArrayLike, ArrayLike],
    second: tuple[ArrayLike, ArrayLike],
    participants: Participants,
    resamples: int = 2000,
    seed: int = 0,
) -> Estimate:
    """Estimate the difference between the areas under the ROC of two metrics of the same trials.

    Both areas are computed on the same resamples, so that variation common to the metrics cancels.

    Args:
        first, second: (correct, incorrect) of either metric; the n-th trial of each is the same trial. Trials that
            lack one of the metrics are left out of both, and counted.
        participants: of the trials, (correct, incorrect).
        resamples, seed: of the bootstrap.

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
    right_values = [right[both] for both, (_, right) in zip(valid, pairs, strict=True)]

    def difference(values: list[Values], units: list[NDArray[np.intp]], people: int) -> Statistic:
        first_area, second_area = _area(values, units, people), _area(right_values, units, people)
        return lambda weights: first_area(weights) - second_area(weights)

    kinds = [np.where(both, left, np.nan) for both, (left, _) in zip(valid, pairs, strict=True)]
    return _estimated(kinds, participants, 1, difference, partial(bootstrap, resamples=resamples, seed=seed))


def criterion_for_hits(correct: ArrayLike, participants: ArrayLike, resamples: int = 2000, seed: int = 0) -> Estimate:
    """Estimate the metric value that 75 % of the correct trials exceed, as in Willemet et al. 2021.

    The criterion is in the metric's unit, interpolated linearly between trials; no distribution is assumed.

    Raises:
        ValueError: as in `auc`.
    """

    def quantile(values: list[Values], units: list[NDArray[np.intp]], _: int) -> Statistic:
        order = np.argsort(values[0], kind="stable")
        ranked, unit = values[0][order], units[0][order]

        def resampled(weights: Values) -> Values:
            counts = weights[:, unit].cumsum(1)
            target = (1 - _HITS) * (counts[:, -1] - 1)
            lower = np.floor(target)
            # The k-th smallest of the resampled values is the first one whose cumulative count exceeds k.
            low, high = (
                ranked[np.argmax(counts > np.minimum(rank, counts[:, -1] - 1)[:, None], axis=1)]
                for rank in (lower, lower + 1)
            )
            return np.asarray(low + (target - lower) * (high - low))

        return resampled

    return _estimated((correct,), (participants,), 2, quantile, partial(bootstrap, resamples=resamples, seed=seed))


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
    kinds: Sequence[ArrayLike],
    participants: Sequence[ArrayLike],
    fewest: int,
    make_statistic: Callable[[list[Values], list[NDArray[np.intp]], int], Statistic],
    make_interval: Callable[[float, Statistic, int], tuple[Interval, float, str]],
) -> Estimate:
    values, units, people, missing = _finite(kinds, participants)
    sizes = [group.size for group in values]
    nothing = Estimate(math.nan, trials=sum(sizes), missing=missing, participants=people)
    if min(sizes) < fewest:
        counts = " and ".join(map(str, sizes))
        return replace(nothing, reason=f"{counts} trials of the kinds compared: {fewest} of each are needed")
    statistic = make_statistic(values, units, people)
    with np.errstate(divide="ignore", invalid="ignore"):
        value = float(statistic(np.ones((1, people)))[0])
        if not math.isfinite(value):
            return replace(nothing, reason="all values are equal within each kind of trial: no d'")
        interval, p, reason = make_interval(value, statistic, people)
    return replace(nothing, value=value, interval=interval, p=p, reason=reason)


def _finite(
    kinds: Sequence[ArrayLike], participants: Sequence[ArrayLike]
) -> tuple[list[Values], list[NDArray[np.intp]], int, int]:
    """Return the finite values of each kind of trials, the number of each trial's participant, how many participants
    there are, and how many trials were NaN.
    """
    values = [np.asarray(group, dtype=np.float64).reshape(-1) for group in kinds]
    if any(np.isinf(group).any() for group in values):
        raise ValueError("a metric is infinite: mark what was not measured with NaN")
    shapes = [np.shape(who) for who in participants], [group.shape for group in values]
    if shapes[0] != shapes[1]:
        raise ValueError(f"participants have shapes {shapes[0]}, the trials {shapes[1]}: name that of every trial")
    valid = [np.isfinite(group) for group in values]
    names = [np.asarray(who)[keep] for who, keep in zip(participants, valid, strict=True)]
    people, units = np.unique(np.concatenate(names), return_inverse=True)
    finite = [group[keep] for group, keep in zip(values, valid, strict=True)]
    missing = sum(int((~keep).sum()) for keep in valid)
    return finite, np.split(units, np.cumsum([name.size for name in names])[:-1]), people.size, missing


def _d_prime(values: list[Values], units: list[NDArray[np.intp]], people: int) -> Statistic:
    def moments(group: int) -> Callable[[Values], tuple[Values, Values]]:
        mean = values[group].mean()
        # Subtract the mean of the whole sample first: sums of squares of values far from 0 would lose precision.
        centred = values[group] - mean
        sums = np.stack([np.bincount(units[group], centred**power, people) for power in (0, 1, 2)], axis=1)
        rounding = 1e-13 * (np.abs(centred).max() ** 2 + np.finfo(np.float64).tiny)

        def resampled(weights: Values) -> tuple[Values, Values]:
            count, first, second = (weights @ sums).T
            variance = (second - first**2 / count) / (count - 1)
            return mean + first / count, np.where(variance > rounding, variance, np.nan)

        return resampled

    kinds = moments(0), moments(1)

    def statistic(weights: Values) -> Values:
        (mean, variance), (other_mean, other_variance) = (group(weights) for group in kinds)
        return np.asarray((mean - other_mean) / np.sqrt((variance + other_variance) / 2))

    return statistic


def _area(values: list[Values], units: list[NDArray[np.intp]], people: int) -> Statistic:
    correct, incorrect = values
    # Pairs of a correct trial of participant p with a smaller incorrect one of q; equal ones count half.
    wins = np.zeros((people, people))
    for q in range(people):
        ranked = np.sort(incorrect[units[1] == q])
        below = np.searchsorted(ranked, correct, "left") + np.searchsorted(ranked, correct, "right")
        wins[:, q] = np.bincount(units[0], below / 2, people)
    counts = [np.bincount(unit, minlength=people) for unit in units]
    return lambda weights: ((weights @ wins) * weights).sum(1) / ((weights @ counts[0]) * (weights @ counts[1]))
