"""Tests of groups of participants, correlations, regression and analysis of variance."""

import math

import numpy as np
import pytest
from scipy import stats

from fingerflow.models.observer import (
    clustered_regression,
    one_way_anova,
    participant_groups,
    pearson,
    repeated_anova,
    spearman,
)


def test_two_groups_are_found() -> None:
    """The likelihood ratio and the membership are those of the fitted mixture, and the unit has no influence."""
    draw = np.random.default_rng(0)
    values = np.append(draw.normal(10, 1.5, 10), draw.normal(20, 1.5, 8))
    found = participant_groups(values, resamples=200)
    assert (found.groups, found.p < 0.01) == (2, True)
    assert found.means == pytest.approx((10, 20), abs=1.5)
    assert found.shares == pytest.approx((10 / 18, 8 / 18), abs=0.02)
    assert (found.membership > 0.5).tolist() == [False] * 10 + [True] * 8
    assert 12 < found.border < 18
    shifted = participant_groups(1e-3 * values + 100, resamples=200)
    assert shifted.p == found.p
    assert shifted.border == pytest.approx(1e-3 * found.border + 100)
    pairs = zip(found.shares, found.means, strict=True)
    parts = [share * stats.norm.pdf(values, mean, found.deviation) for share, mean in pairs]
    two, one = np.log(sum(parts)).sum(), stats.norm.logpdf(values, values.mean(), values.std()).sum()
    assert found.likelihood_ratio == pytest.approx(2 * (two - one), abs=1e-9)
    np.testing.assert_allclose(found.membership, parts[1] / sum(parts), atol=1e-9)


def test_one_group_is_mostly_left_whole() -> None:
    """At a level of 5 %, at most 6 of 40 samples of one Gaussian are split: 2 are expected, 7 or more have a
    probability of 1/200.
    """
    draw = np.random.default_rng(1)
    split = [participant_groups(draw.normal(5, 2, 18), resamples=100, seed=k).groups == 2 for k in range(40)]
    assert sum(split) <= 6
    few = participant_groups([1.0, 2.0, np.nan, 3.0])
    assert (few.groups, few.missing) == (0, 1)
    assert "3 participants: 6 are needed" in few.reason
    assert "alike" in participant_groups([1.0] * 8).reason


def test_correlations_are_those_of_scipy_with_participants_as_units() -> None:
    draw = np.random.default_rng(4)
    x, who = draw.standard_normal(30), np.repeat(np.arange(6), 5)
    y = np.where(np.arange(30) == 7, np.nan, x + draw.standard_normal(30))
    for kind, reference in ((pearson, stats.pearsonr), (spearman, stats.spearmanr)):
        found = kind(x, y, who)
        known = np.isfinite(y)
        assert found.value == reference(x[known], y[known]).statistic
        assert (found.trials, found.missing, found.participants) == (29, 1, 6)
        kept = [known & (who != name) for name in range(6)]
        without = np.arctanh([reference(x[one], y[one]).statistic for one in kept])
        reach = 2.5705818 * math.sqrt(5 / 6 * np.square(without - without.mean()).sum())
        assert np.arctanh(found.interval) == pytest.approx(np.arctanh(found.value) + np.array([-reach, reach]))
    for first, second, people, reason in (
        ([1.0, 2.0, 3.0], [1.0, 2.0, 3.0], [0, 1, 2], "3 pairs: 4 are needed"),
        ([1.0] * 5, [1.0, 2.0, 3.0, 4.0, 5.0], range(5), "constant"),
        (np.arange(6.0), np.arange(6.0) ** 2, [0, 0, 0, 1, 1, 1], "no interval from 2 participants: 3 are needed"),
    ):
        assert reason in pearson(first, second, list(people)).reason
    with pytest.raises(ValueError, match="6 and 6 values, 1 participants"):
        pearson(np.arange(6), np.arange(6), [1])


def test_the_regression_by_hand_and_where_there_is_none() -> None:
    """Means of the cells of a, 1.5 and 6; b and c have 2 and 1.5: products 0.25 + 0.25 + 0 + 0.25, squares 0.5 + 2 + 2
    + 0.5. A single trial in its cell has no effect.
    """
    metric = [1.0, 2.0, 5.0, 7.0, math.nan, 4.0, 1.0, 3.0, 1.0, 2.0]
    answer, condition = [0, 1, 1, 1, 0, 0, 1, 1, 0, 1], [0, 0, 1, 1, 0, 5, 0, 0, 0, 0]
    found = clustered_regression(metric, answer, condition, list("aaaaabbbcc"))
    assert found.value == pytest.approx((0.5 + 0.5) / (0.5 + 2 + 2 + 0.5))
    assert (found.trials, found.participants, found.missing) == (8, 3, 2)
    assert (found.p < 0.05) == (not found.interval[0] <= 0 <= found.interval[1])
    assert "from 1 participants" in clustered_regression([1.0, 2.0], [0, 1], [0, 0], [0, 0]).reason
    for metric, answer in (([1.0, 1.0], [0, 1]), ([], [])):
        assert "equal within each" in clustered_regression(metric, answer, [0] * len(answer), [0] * len(answer)).reason
    with pytest.raises(ValueError, match="give one of each a trial"):
        clustered_regression([1.0], [0, 1], [0, 0], [0, 0])


def test_one_way_analysis_of_variance() -> None:
    draw = np.random.default_rng(6)
    groups = np.repeat(["low", "middle", "high"], [20, 25, 30])
    values = draw.standard_normal(75) + np.repeat([0.0, 0.5, 1.0], [20, 25, 30])
    found = one_way_anova(values, groups)
    assert (found.degrees, found.trials) == ((2, 72), {"low": 20, "middle": 25, "high": 30})
    assert found.eta_squared == pytest.approx(found.f * 2 / (found.f * 2 + 72))
    assert one_way_anova(np.where(np.arange(75) == 0, np.nan, values), groups).missing == 1
    assert "do not vary" in one_way_anova([1.0, 1.0, 2.0, 2.0], ["a", "a", "b", "b"]).reason
    assert "two of two trials" in one_way_anova([1.0, 2.0, 3.0], ["a", "a", "b"]).reason
    assert math.isnan(one_way_anova([], []).f)


def test_participants_who_lack_a_group_count_in_the_others() -> None:
    """A participant who lacks one of two groups is left out; one who lacks one of four counts in the other three."""
    draw = np.random.default_rng(9)
    who, group = np.repeat(np.arange(7), 8), np.tile(np.repeat(np.arange(4), 2), 7)
    values = np.where((who == 6) & (group == 0), np.nan, draw.standard_normal(56) + 0.4 * group)
    pair = group < 2
    two, four = repeated_anova(values[pair], group[pair], who[pair]), repeated_anova(values, group, who)
    assert (two.degrees, two.participants, two.trials, two.missing) == ((1, 5), 6, {"0": 12, "1": 12}, 4)
    assert (four.degrees, four.participants, four.missing) == ((3, 17), 7, 2)
    assert 1 / 3 <= four.epsilon <= 1
    assert four.p >= stats.f.sf(four.f, *four.degrees)


@pytest.mark.parametrize(
    ("values", "groups", "who", "reason"),
    [
        ([1.0, 2.0], [0, 1], ["a", "a"], "2 groups, 1 participants with trials in two"),
        ([1.0, 2.0], [0, 0], ["a", "b"], "1 groups, 0 participants"),
        ([1.0, 2.0, 2.0, 3.0], [0, 1, 0, 1], ["a", "a", "b", "b"], "do not vary over participants"),
        ([math.nan] * 2, [0, 1], ["a", "b"], "0 groups"),
        (range(12), [0, 1, 0, 1, 0, 1, 2, 3, 2, 3, 2, 3], list("aabbccddeeff"), "without a participant in common"),
    ],
)
def test_repeated_measures_that_cannot_be_formed(values: list, groups: list, who: list, reason: str) -> None:
    found = repeated_anova(values, groups, who)
    assert math.isnan(found.f)
    assert reason in found.reason
    with pytest.raises(ValueError, match="name that of every value"):
        repeated_anova(values, [0], who)
