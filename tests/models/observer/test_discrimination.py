"""Tests of d', area under the ROC curve and criterion: values, coverage of the intervals, and degenerate input."""

import math
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.special import ndtr, ndtri

from fingerflow.models.observer import (
    auc,
    compare_auc,
    criterion_for_hits,
    d_prime,
    permutation_test,
)

Values = NDArray[np.float64]
Drawn = tuple[Values, Values, tuple[NDArray[Any], NDArray[Any]]]


def drawn(seed: int, difference: float, participants: int = 20, trials: int = 20, spread: float = 0.5) -> Drawn:
    """Return the metric of correct and incorrect trials (unit deviation) and their participants; trials of a
    participant share an offset of deviation `spread`.
    """
    draw = np.random.default_rng(seed)
    who = np.repeat(np.arange(participants), trials)
    right = draw.random(who.size) < 0.65
    offset = spread * draw.standard_normal(participants)
    metric = (offset[who] + draw.standard_normal(who.size)) / math.hypot(1, spread) + difference * right
    return metric[right], metric[~right], (who[right], who[~right])


def test_values_by_hand() -> None:
    assert d_prime([2.0, 4.0], [1.0, 3.0]).value == pytest.approx(1 / math.sqrt(2))
    assert d_prime([1.0, 3.0], [2.0, 4.0]).value == pytest.approx(-1 / math.sqrt(2))
    # Pairs: 3 > 1, 3 > 2, 2 > 1 and a tie at 2.
    assert auc([2.0, 3.0], [1.0, 2.0]).value == pytest.approx(3.5 / 4)
    assert auc([1.0, 2.0], [2.0, 3.0]).value == pytest.approx(0.5 / 4)


def test_the_area_is_that_of_all_pairs() -> None:
    draw = np.random.default_rng(0)
    first, second = draw.integers(0, 12, 57) + 1.0, draw.integers(0, 12, 41) * 1.0
    pairs = (first[:, None] > second) + 0.5 * (first[:, None] == second)
    assert auc(first, second, resamples=100).value == pytest.approx(pairs.mean(), abs=1e-14)


def test_intervals_hold_the_truth_as_often_as_they_say() -> None:
    """Intervals of 95 % contain the truth in 92 to 98 % of 500 draws of 20 participants."""
    truth = 1.0, float(ndtr(1 / math.sqrt(2)))
    hits = np.zeros(2)
    for seed in range(500):
        first, second, who = drawn(seed, 1.0)
        for k, estimator in enumerate((d_prime, auc)):
            low, high = estimator(first, second, participants=who, resamples=400, seed=seed).interval
            hits[k] += low <= truth[k] <= high
    assert ((hits / 500 > 0.92) & (hits / 500 < 0.98)).all(), hits / 500


def test_trials_alone_are_too_sure_where_participants_differ() -> None:
    first, second, who = drawn(3, 0.5, spread=2.0)
    clustered = criterion_for_hits(first, participants=who[0])
    alone = criterion_for_hits(first)
    assert np.diff(clustered.interval) > 2 * np.diff(alone.interval)
    assert (clustered.participants, alone.participants) == (20, 0)
    assert auc(first, second, participants=who).value == auc(first, second).value


def test_the_criterion_for_hits_is_recovered() -> None:
    errors, hits = [], 0
    for seed in range(100):
        first, _, who = drawn(seed, 1.0)
        found = criterion_for_hits(first, 0.75, participants=who[0], resamples=400)
        truth = 1 + float(ndtri(0.25))
        errors.append(found.value - truth)
        hits += found.interval[0] <= truth <= found.interval[1]
    assert abs(np.mean(errors)) < 0.05
    assert 88 <= hits <= 99
    assert (first > found.value).mean() == pytest.approx(0.75, abs=0.005)


def test_the_criterion_is_numpys_quantile() -> None:
    values = np.random.default_rng(1).standard_normal(38)
    assert criterion_for_hits(values, 0.6, resamples=100).value == pytest.approx(np.quantile(values, 0.4), abs=1e-14)


def test_the_same_seed_gives_the_same_interval_and_stands_in_the_result() -> None:
    first, second, who = drawn(4, 1.0)
    one, again, other = (d_prime(first, second, participants=who, resamples=300, seed=seed) for seed in (7, 7, 8))
    assert one == again
    assert one.interval != other.interval
    assert (one.seed, one.resamples, one.level) == (7, 300, 0.95)
    assert one.trials == (first.size, second.size)
    wide = d_prime(first, second, participants=who, level=0.99).interval
    assert wide[0] < one.interval[0] < one.interval[1] < wide[1]


def test_d_prime_of_nothing_contains_zero() -> None:
    first, second, who = drawn(5, 0.0)
    low, high = d_prime(first, second, participants=who).interval
    assert low < 0 < high


def test_many_trials_have_the_textbook_interval() -> None:
    """With many trials the intervals have the widths of Hanley & McNeil's standard error of the binormal area and of
    the large-sample error of d'.
    """
    draw = np.random.default_rng(11)
    first, second = draw.standard_normal(6000) + 1, draw.standard_normal(4000)
    low, high = d_prime(first, second, resamples=400).interval
    assert high - low == pytest.approx(2 * 1.96 * math.sqrt(1 / 6000 + 1 / 4000 + 1 / (4 * 9998)), rel=0.12)
    area = float(ndtr(1 / math.sqrt(2)))
    first_pair, second_pair = area / (2 - area), 2 * area**2 / (1 + area)
    variance = area * (1 - area) + 5999 * (first_pair - area**2) + 3999 * (second_pair - area**2)
    low, high = auc(first, second, resamples=400).interval
    assert high - low == pytest.approx(2 * 1.96 * math.sqrt(variance / 24e6), rel=0.12)


def test_neither_unit_nor_origin_matter() -> None:
    first, second, who = drawn(6, 1.0)
    here = d_prime(first, second, participants=who)
    there = d_prime(1e-3 * first + 1e4, 1e-3 * second + 1e4, participants=who)
    assert there.value == pytest.approx(here.value, rel=1e-6)
    assert there.interval == pytest.approx(here.interval, rel=1e-6)


def test_nan_is_left_out_and_counted() -> None:
    first, second, who = drawn(7, 1.0)
    gaps = first.copy()
    gaps[::10] = np.nan
    kept = np.isfinite(gaps)
    found = auc(gaps, second, participants=who)
    assert found.value == auc(first[kept], second).value
    assert found.missing == (~kept).sum()
    assert found.trials == (kept.sum(), second.size)


def test_degenerate_input_has_a_clear_answer() -> None:
    several = [1.0, 2.0, 3.0, 4.0]
    for estimate, reason in (
        (d_prime(several, []), "4 and 0 trials of the kinds compared: 2 of each are needed"),
        (auc([], several), "0 and 4 trials"),
        (d_prime([1.0], [2.0]), "1 and 1 trials"),
        (d_prime([np.nan] * 4, several), "0 and 4 trials"),
        (d_prime([5.0] * 4, [5.0] * 4), "equal within each kind of trial"),
        (d_prime([5.0] * 4, [6.0] * 4), "equal within each kind of trial"),
    ):
        assert math.isnan(estimate.value)
        assert all(map(math.isnan, estimate.interval))
        assert reason in estimate.reason
    two = auc([2.0], [1.0])
    assert two.value == 1
    assert "no interval from 1 trials of a class: 3 are needed" in two.reason
    apart = auc([5.0, 6.0, 7.0, 8.0], several)
    assert apart.value == 1
    assert "every resample gives the same number" in apart.reason
    assert math.isnan(apart.interval[0])
    assert auc([5.0] * 4, [5.0] * 4).value == 0.5
    pair = auc(several, several, participants=(["a", "a", "b", "b"], ["a", "b", "a", "b"]))
    assert "no interval from 2 participants" in pair.reason


def test_input_that_cannot_be() -> None:
    several = [1.0, 2.0, 3.0]
    with pytest.raises(ValueError, match="infinite: mark what was not measured with NaN"):
        auc([1.0, math.inf], several)
    with pytest.raises(ValueError, match="name the participant of every trial"):
        auc(several, several, participants=([1, 2], [1, 2, 3]))
    with pytest.raises(ValueError, match="level is 95"):
        auc(several, several, level=95)
    with pytest.raises(ValueError, match="10 resamples are too few"):
        auc(several, several, resamples=10)
    with pytest.raises(ValueError, match="share of hits is 75"):
        criterion_for_hits(several, 75)


def test_permutations_within_participants() -> None:
    """Permutations within participants give no significance to a metric that only differs between participants;
    permutations over all trials do.
    """
    draw = np.random.default_rng(8)
    who = np.repeat([0, 1], 100)
    right = draw.random(200) < np.where(who == 0, 0.9, 0.3)
    metric = draw.standard_normal(200) - 3 * who
    groups = who[right], who[~right]
    assert permutation_test(metric[right], metric[~right], permutations=999).p == 0.001
    within = permutation_test(metric[right], metric[~right], participants=groups, permutations=999)
    assert within.p > 0.05
    assert within.auc > 0.7


def test_permutation_p_is_uniform_where_there_is_nothing() -> None:
    values = []
    for seed in range(200):
        first, second, who = drawn(seed, 0.0, participants=8)
        values.append(permutation_test(first, second, participants=who, permutations=199, seed=seed).p)
    assert np.mean(np.array(values) <= 0.1) == pytest.approx(0.1, abs=0.06)
    assert np.median(values) == pytest.approx(0.5, abs=0.12)
    found = permutation_test(*drawn(0, 1.0)[:2], permutations=999)
    assert found.p == 0.001
    assert (found.permutations, found.seed) == (999, 0)
    nothing = permutation_test([1.0, 2.0], [])
    assert math.isnan(nothing.p)
    assert "2 correct and 0 incorrect" in nothing.reason
    with pytest.raises(ValueError, match="5 permutations are too few"):
        permutation_test([1.0], [2.0], permutations=5)


def test_paired_areas_know_what_metrics_share() -> None:
    first, second, who = drawn(9, 1.0)
    draw = np.random.default_rng(9)
    noisy = first + 0.3 * draw.standard_normal(first.size), second + 0.3 * draw.standard_normal(second.size)
    found = compare_auc((first, second), noisy, participants=who)
    alone = auc(first, second, participants=who)
    assert found.value == pytest.approx(alone.value - auc(*noisy).value)
    assert np.diff(found.interval) < 0.6 * np.diff(alone.interval)
    worse = compare_auc((first, second), (0.3 * first - noisy[0], 0.3 * second - noisy[1]), participants=who)
    assert worse.interval[0] > 0
    same = compare_auc((first, second), (first, second), participants=who)
    assert same.value == 0
    assert "same number" in same.reason


def test_a_trial_without_one_of_two_metrics_is_left_out_of_both() -> None:
    first, second, _ = drawn(10, 1.0)
    gaps = first.copy()
    gaps[:30] = np.nan
    found = compare_auc((gaps, second), (first, second), resamples=200)
    assert found.value == 0
    assert found.missing == 30
    with pytest.raises(ValueError, match="give both metrics of the same ones"):
        compare_auc((first[1:], second), (first, second))
