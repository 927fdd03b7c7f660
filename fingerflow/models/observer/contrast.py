"""Comparison of metrics: permutation test of one area under the ROC, and paired difference of two."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.stats import rankdata

from fingerflow.models.observer.bootstrap import Participants, Values, bca_interval, samples_of
from fingerflow.models.observer.estimate import UNKNOWN, Estimate
from fingerflow.models.observer.weighted import auc_statistic

# Added to the seed: data simulated with the same seed must not share random numbers with the permutations.
_STREAM = 0x9E2A
_AT_ONCE = 4_000_000  # labels in memory


@dataclass(frozen=True)
class PermutationTest:
    """Two-sided `p` of `auc` under permuted answers; `trials` correct and incorrect, `missing` were NaN."""

    p: float
    auc: float
    permutations: int
    seed: int
    trials: tuple[int, int]
    missing: int
    reason: str = ""


def permutation_test(
    correct: ArrayLike,
    incorrect: ArrayLike,
    *,
    participants: Participants = None,
    permutations: int = 5000,
    seed: int = 0,
) -> PermutationTest:
    """Test whether the metric separates correct from incorrect trials, permuting answers within each participant.

    The p-value is (1 + number of permutations whose area deviates from its expectation at least as much as the observed
    area) / (1 + permutations), never 0. Arguments as in `auc`.

    Raises:
        ValueError: fewer than 100 permutations, or as in `auc`.
    """
    if permutations < 100:
        raise ValueError(f"{permutations} permutations are too few for a p-value: give 100 or more")
    arrays = [np.asarray(kind, dtype=np.float64).reshape(-1) for kind in (correct, incorrect)]
    (first, second), samples, missing = samples_of(arrays, participants)
    trials = (first.size, second.size)
    if min(trials) == 0:
        reason = f"{first.size} correct and {second.size} incorrect trials: 1 of each is needed"
        return PermutationTest(np.nan, np.nan, permutations, seed, trials, missing, reason)
    # Without participants all trials form one block, in which they are exchangeable.
    blocks = np.concatenate(samples.units) if samples.participants else np.zeros(sum(trials), np.intp)
    ranks = rankdata(np.concatenate([first, second]))
    order = np.argsort(blocks, kind="stable")
    is_correct = (np.arange(ranks.size) < first.size)[order].astype(np.float64)
    ranks, blocks = ranks[order], blocks[order]

    draw = np.random.default_rng([seed, _STREAM])
    sums = []
    rows = max(1, _AT_ONCE // ranks.size)
    for start in range(0, permutations, rows):
        keys = blocks + draw.random((min(rows, permutations - start), ranks.size))
        sums.append(is_correct[np.argsort(keys, axis=1)] @ ranks)
    areas = (np.concatenate(sums) - first.size * (first.size + 1) / 2) / (first.size * second.size)
    area = float((is_correct @ ranks - first.size * (first.size + 1) / 2) / (first.size * second.size))
    # Within participants the expected area is not 1/2: those who answer better may have larger metrics.
    share = np.bincount(blocks, is_correct) / np.bincount(blocks)
    expected = (float(share[blocks] @ ranks) - first.size * (first.size + 1) / 2) / (first.size * second.size)
    as_far = np.count_nonzero(np.abs(areas - expected) >= abs(area - expected) - 1e-12)
    return PermutationTest((1 + as_far) / (1 + permutations), area, permutations, seed, trials, missing)


def compare_auc(
    first: tuple[ArrayLike, ArrayLike],
    second: tuple[ArrayLike, ArrayLike],
    *,
    participants: Participants = None,
    level: float = 0.95,
    resamples: int = 2000,
    seed: int = 0,
) -> Estimate:
    """Estimate the area under the ROC of one metric minus that of another, in the same trials.

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
    kinds: list[tuple[Values, Values]] = []
    for one, other in zip(first, second, strict=True):
        pair = tuple(np.asarray(values, dtype=np.float64).reshape(-1) for values in (one, other))
        if pair[0].size != pair[1].size:
            raise ValueError(f"{pair[0].size} and {pair[1].size} trials of a kind: give both metrics of the same ones")
        both = np.isfinite(pair[0]) & np.isfinite(pair[1])
        kinds.append((np.where(both, pair[0], np.nan), np.where(both, pair[1], np.nan)))
    (one_correct, other_correct), (one_incorrect, other_incorrect) = kinds
    one, samples, missing = samples_of([one_correct, one_incorrect], participants)
    other, _, _ = samples_of([other_correct, other_incorrect], participants)

    def estimate(value: float, interval: tuple[float, float], reason: str) -> Estimate:
        return Estimate(value, interval, level, resamples, seed, samples.sizes, missing, samples.participants, reason)

    if min(samples.sizes) == 0:
        return estimate(np.nan, UNKNOWN, f"{samples.sizes[0]} correct and {samples.sizes[1]} incorrect trials: 1 each")
    first_area, second_area = auc_statistic(*one), auc_statistic(*other)

    def difference(correct: Values, incorrect: Values) -> Values:
        return first_area(correct, incorrect) - second_area(correct, incorrect)

    whole = float(difference(*(np.ones((1, size)) for size in samples.sizes))[0])
    return estimate(whole, *bca_interval(difference, samples, level, resamples, seed))
