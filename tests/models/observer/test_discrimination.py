"""Tests of d', area under the ROC curve and criterion: values, intervals, permutations, and degenerate input."""

import math

import numpy as np
import pytest

from fingerflow.engines.engine import Array
from fingerflow.models.observer import auc, compare_auc, criterion_for_hits, d_prime, permutation_p, share_above

UNKNOWN = "4 and 0", "0 and 4", "equal within"  # reasons for no value at all, beside those for no interval
Drawn = tuple[Array, Array, tuple[Array, Array]]


def drawn(seed: int, difference: float, participants: int = 20, trials: int = 20) -> Drawn:
    """Return the metric of correct and incorrect trials (unit deviation) and their participants; trials of a
    participant share an offset of deviation 0.5.
    """
    draw = np.random.default_rng(seed)
    who = np.repeat(np.arange(participants), trials)
    right = draw.random(who.size) < 0.65
    offset = 0.5 * draw.standard_normal(participants)
    metric = (offset[who] + draw.standard_normal(who.size)) / math.hypot(1, 0.5) + difference * right
    return metric[right], metric[~right], (who[right], who[~right])


def test_values_by_hand() -> None:
    """Pairs of the area: 3 > 1, 3 > 2, 2 > 1 and a tie at 2. With p of P participants left out, the jackknife has s^2 =
    (P - 1) / P sum (d_p - mean)^2, and 2.776 s for 4 degrees of freedom.
    """
    who = [0, 1], [0, 1]
    assert d_prime([2.0, 4.0], [1.0, 3.0], who).value == pytest.approx(1 / math.sqrt(2))
    assert d_prime([1.0, 3.0], [2.0, 4.0], who).value == pytest.approx(-1 / math.sqrt(2))
    assert auc([2.0, 3.0], [1.0, 2.0], who).value == pytest.approx(3.5 / 4)
    first, second, people = drawn(1, 1.0, participants=5)
    without = np.array(
        [d_prime(first[people[0] != p], second[people[1] != p], [w[w != p] for w in people]).value for p in range(5)]
    )
    found = d_prime(first, second, people)
    reach = 2.7764451 * math.sqrt(4 / 5 * np.square(without - without.mean()).sum())
    assert found.interval == pytest.approx((found.value - reach, found.value + reach), rel=1e-6)
    assert d_prime(1e-3 * first + 1e4, 1e-3 * second + 1e4, people).interval == pytest.approx(found.interval, rel=1e-6)


def test_nan_is_left_out_and_counted() -> None:
    first, second, who = drawn(4, 1.0)
    gaps = np.where(np.arange(first.size) % 10, first, np.nan)
    kept = np.isfinite(gaps)
    found = auc(gaps, second, who)
    assert found.interval == auc(first[kept], second, (who[0][kept], who[1])).interval
    assert (found.missing, found.trials) == ((~kept).sum(), kept.sum() + second.size)
    assert found.interval[0] < found.value < found.interval[1]


def test_false_alarms_of_a_criterion() -> None:
    """The quantiles at the limits of the share above the criterion are the limits of the criterion. Few false alarms
    leave an interval that is not symmetric and stays within 0 and 1; without a criterion there are none.
    """
    first, second, who = drawn(3, 1.0)
    criterion = criterion_for_hits(first, who[0])
    shares = [(first > limit).mean() for limit in criterion.interval]
    assert shares[0] - 0.75 == pytest.approx(0.75 - shares[1], abs=2 / first.size)
    found = share_above(criterion.value, second, who[1])
    assert found.value == (second > criterion.value).mean()
    assert found.interval[0] < found.value < found.interval[1]
    few = share_above(9.0, [1.0, 2.0, 3.0, 4.0], [0, 1, 2, 3])
    assert (few.value, few.interval[0], few.trials) == (0, 0, 4)
    assert 0.3 < few.interval[1] < 0.6
    assert share_above(math.nan, [1.0, 2.0], [0, 1]).reason.startswith("0 trials")


def test_degenerate_input_has_a_clear_answer() -> None:
    several, own, none = [1.0, 2.0, 3.0, 4.0], [0, 1, 2, 3], np.array([])
    first, second, who = drawn(4, 1.0, participants=5)
    for estimate, reason in (
        (d_prime(several, none, (own, none)), "4 and 0 trials of the kinds compared: 2 of each are needed"),
        (auc(none, several, (none, own)), "0 and 4 trials"),
        (d_prime([np.nan] * 4, several, (own, own)), "0 and 4 trials"),
        (d_prime([5.0] * 4, [6.0] * 4, (own, own)), "equal within each kind of trial"),
        (auc(several, several, (["a", "a", "b", "b"], ["a", "b", "a", "b"])), "no interval from 2 participants"),
        (auc([5.0, 6.0, 7.0, 8.0], several, (own, own)), "the estimate is the same, or unknown"),
        (d_prime(first, second, (who[0], 0 * who[1])), "unknown, without any one participant"),
    ):
        assert math.isnan(estimate.value) == reason.startswith(UNKNOWN)
        assert all(map(math.isnan, estimate.interval))
        assert reason in estimate.reason
    for metric, message in (([1.0, math.inf], "infinite: mark what was not"), (several, "name that of every trial")):
        with pytest.raises(ValueError, match=message):
            auc(metric, several, (own[:2], own))


def test_permutations_within_participants() -> None:
    """A metric that differs between participants alone is not significant, one that differs within them is.
    `test_error_rates` has the share of p below 0.05 where there is nothing.
    """
    draw = np.random.default_rng(8)
    who = np.repeat([0, 1], 100)
    right = draw.random(200) < np.where(who == 0, 0.9, 0.3)
    metric = draw.standard_normal(200) - 3 * who
    groups = who[right], who[~right]
    assert auc(metric[right], metric[~right], groups).value > 0.7
    assert permutation_p(metric[right], metric[~right], groups, 999) > 0.05
    assert permutation_p(metric[right], metric[~right], (0 * groups[0], 0 * groups[1]), 999) == 0.001
    assert math.isnan(permutation_p([1.0, 2.0], [], ([0, 1], [])))


def test_paired_areas_know_what_metrics_share() -> None:
    first, second, who = drawn(9, 1.0)
    draw = np.random.default_rng(9)
    noisy = first + 0.3 * draw.standard_normal(first.size), second + 0.3 * draw.standard_normal(second.size)
    found, alone = compare_auc((first, second), noisy, who), auc(first, second, who)
    assert found.value == pytest.approx(alone.value - auc(*noisy, who).value)
    assert np.diff(found.interval) < 0.6 * np.diff(alone.interval)
    worse = compare_auc((first, second), (0.3 * first - noisy[0], 0.3 * second - noisy[1]), who)
    assert worse.interval[0] > 0
    gaps = np.where(np.arange(first.size) < 30, np.nan, first)
    same = compare_auc((gaps, second), (first, second), who)
    assert (same.value, same.missing) == (0, 30)
    assert "the estimate is the same" in same.reason
    with pytest.raises(ValueError, match="give both metrics of the same ones"):
        compare_auc((first[1:], second), (first, second), who)
