"""Permutation test of an area under the ROC."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.stats import rankdata

from fingerflow.models.observer.bootstrap import Participants, samples_of

# Added to the seed: data simulated with the same seed must not share random numbers with the permutations.
_STREAM = 0x9E2A
_AT_ONCE = 4_000_000  # largest number of permuted labels in memory


@dataclass(frozen=True)
class PermutationTest:
    """Result of `permutation_test`: area under the ROC, two-sided p-value, and numbers of trials used and missing."""

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
    (first, second), samples, missing = samples_of((correct, incorrect), participants)
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
    # Within participants the expected area is not 1/2: participants who answer better may have larger metrics.
    share = np.bincount(blocks, is_correct) / np.bincount(blocks)
    expected = (float(share[blocks] @ ranks) - first.size * (first.size + 1) / 2) / (first.size * second.size)
    as_far = np.count_nonzero(np.abs(areas - expected) >= abs(area - expected) - 1e-12)
    return PermutationTest((1 + as_far) / (1 + permutations), area, permutations, seed, trials, missing)
