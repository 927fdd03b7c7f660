"""Tests of groups of participants, correlations and analysis of variance."""

import math

import numpy as np
import pytest
from scipy import stats

from fingerflow.models.observer import one_way_anova, participant_groups, pearson, repeated_anova, spearman


def test_two_groups_are_found() -> None:
    draw = np.random.default_rng(0)
    values = np.append(draw.normal(10, 1.5, 10), draw.normal(20, 1.5, 8))
    found = participant_groups(values, resamples=200)
    assert found.groups == 2
    assert found.p < 0.01
    assert found.bic_two < found.bic_one
    assert found.means == pytest.approx((10, 20), abs=1.5)
    assert found.deviation == pytest.approx(1.5, abs=0.7)
    assert found.shares == pytest.approx((10 / 18, 8 / 18), abs=0.02)
    assert (found.membership > 0.5).tolist() == [False] * 10 + [True] * 8
    assert 12 < found.border < 18
    shifted = participant_groups(1e-3 * values + 100, resamples=200)
    assert shifted.p == found.p
    assert shifted.border == pytest.approx(1e-3 * found.border + 100)


def test_one_group_is_mostly_left_whole() -> None:
    """At a level of 5 %, at most 6 of 40 samples of one Gaussian are split: 2 are expected, 7 or more have a
    probability of 1/200.
    """
    draw = np.random.default_rng(1)
    split = [participant_groups(draw.normal(5, 2, 18), resamples=100, seed=k).groups == 2 for k in range(40)]
    assert sum(split) <= 6


def test_the_likelihood_ratio_is_that_of_the_fitted_mixture() -> None:
    values = np.append(np.random.default_rng(2).normal(0, 1, 12), np.random.default_rng(3).normal(4, 1, 9))
    found = participant_groups(values, resamples=100)
    parts = [
        share * stats.norm.pdf(values, mean, found.deviation)
        for share, mean in zip(found.shares, found.means, strict=True)
    ]
    two, one = np.log(sum(parts)).sum(), stats.norm.logpdf(values, values.mean(), values.std()).sum()
    assert found.likelihood_ratio == pytest.approx(2 * (two - one), abs=1e-9)
    np.testing.assert_allclose(found.membership, parts[1] / sum(parts), atol=1e-9)
    assert found.bic_one == pytest.approx(-2 * one + 2 * math.log(21))
    assert found.bic_two == pytest.approx(-2 * two + 4 * math.log(21))


def test_too_few_or_equal_participants_form_no_groups() -> None:
    few = participant_groups([1.0, 2.0, np.nan, 3.0])
    assert few.groups == 0
    assert few.missing == 1
    assert "3 participants: 6 are needed" in few.reason
    assert "alike" in participant_groups([1.0] * 8).reason
    with pytest.raises(ValueError, match="5 resamples"):
        participant_groups(np.arange(8), resamples=5)


def test_correlations_and_their_intervals() -> None:
    draw = np.random.default_rng(4)
    x = draw.standard_normal(60)
    y = 0.7 * x + draw.standard_normal(60)
    for ours, theirs in ((pearson, stats.pearsonr), (spearman, stats.spearmanr)):
        found, reference = ours(x, y), theirs(x, y)
        assert found.value == pytest.approx(reference.statistic)
        assert found.p == pytest.approx(reference.pvalue)
        assert found.interval[0] < found.value < found.interval[1]
    assert pearson(x, y).interval == pytest.approx(tuple(stats.pearsonr(x, y).confidence_interval()))
    gaps = y.copy()
    gaps[:5] = np.nan
    assert (pearson(x, gaps).trials, pearson(x, gaps).missing) == (55, 5)
    assert "one of the two is constant" in pearson(x, np.ones(60)).reason
    assert "2 pairs: 4 are needed" in spearman([1, 2], [2, 1]).reason
    assert math.isnan(spearman([1, 2], [2, 1]).value)
    assert pearson(x, 2 * x).value == pytest.approx(1)
    with pytest.raises(ValueError, match="60 and 59 values: give pairs"):
        pearson(x, y[1:])


def test_the_rank_interval_holds_the_truth() -> None:
    draw, truth, inside = np.random.default_rng(5), 6 / math.pi * math.asin(0.3), 0
    for _ in range(300):
        x = draw.standard_normal(50)
        y = 0.6 * x + 0.8 * draw.standard_normal(50)
        low, high = spearman(np.exp(x), y).interval
        inside += low <= truth <= high
    assert 0.91 < inside / 300 < 0.985


def test_one_way_analysis_of_variance() -> None:
    draw = np.random.default_rng(6)
    groups = np.repeat(["low", "middle", "high"], [20, 25, 30])
    values = draw.standard_normal(75) + np.repeat([0.0, 0.5, 1.0], [20, 25, 30])
    found = one_way_anova(values, groups)
    reference = stats.f_oneway(*(values[groups == name] for name in ("low", "middle", "high")))
    assert (found.f, found.p) == pytest.approx((reference.statistic, reference.pvalue))
    assert found.degrees == (2, 72)
    assert found.trials == {"low": 20, "middle": 25, "high": 30}
    between = found.f * 2 / (found.f * 2 + 72)
    assert found.eta_squared == pytest.approx(between)
    values[0] = np.nan
    assert one_way_anova(values, groups).missing == 1
    assert "do not vary" in one_way_anova([1.0, 1.0, 2.0, 2.0], ["a", "a", "b", "b"]).reason
    assert "two of two trials" in one_way_anova([1.0, 2.0, 3.0], ["a", "a", "b"]).reason
    assert math.isnan(one_way_anova([], []).f)


def test_repeated_measures_by_hand() -> None:
    """With two groups the analysis equals the paired t test of the participants' means, and levels of participants have
    no influence.
    """
    draw = np.random.default_rng(8)
    who, group = np.repeat(np.arange(6), 4), np.tile([0, 0, 1, 1], 6)
    values = draw.standard_normal(24) + 3 * draw.standard_normal(6)[who] + group
    means = values.reshape(6, 2, 2).mean(2)
    paired = stats.ttest_rel(means[:, 1], means[:, 0])
    found = repeated_anova(values, group, who)
    assert (found.f, found.p) == pytest.approx((paired.statistic**2, paired.pvalue))
    assert (found.degrees, found.participants, found.trials) == ((1, 5), 6, {"0": 12, "1": 12})
    shifted = repeated_anova(values + 100 * who, group, who)
    assert shifted.p == pytest.approx(found.p), "a participant's level does not count"
    gaps = np.where((who == 2) & (group == 1), np.nan, values)
    kept = who != 2
    without = repeated_anova(gaps, group, who)
    assert (without.p, without.missing) == (pytest.approx(repeated_anova(values[kept], group[kept], who[kept]).p), 4)


def test_repeated_measures_are_those_of_statsmodels() -> None:
    pytest.importorskip("statsmodels", reason="statsmodels is the extra `dev`")
    pandas = pytest.importorskip("pandas")
    from statsmodels.stats.anova import AnovaRM

    draw = np.random.default_rng(9)
    who, group = np.repeat(np.arange(7), 8), np.tile(np.repeat(np.arange(4), 2), 7)
    values = draw.standard_normal(56) + 2 * draw.standard_normal(7)[who] + 0.4 * group
    table = pandas.DataFrame({"y": values, "who": who, "group": group})
    reference = AnovaRM(table, "y", "who", ["group"], aggregate_func="mean").fit().anova_table
    found = repeated_anova(values, group, who)
    assert found.f == pytest.approx(reference["F Value"].iloc[0])
    assert found.degrees == (reference["Num DF"].iloc[0], reference["Den DF"].iloc[0])
    assert 1 / 3 <= found.epsilon <= 1
    assert found.p >= reference["Pr > F"].iloc[0]


def test_repeated_measures_that_cannot_be_formed() -> None:
    for values, groups, who, reason in (
        ([1.0, 2.0], [0, 1], ["a", "a"], "2 groups, 1 participants with trials in each"),
        ([1.0, 2.0], [0, 0], ["a", "b"], "1 groups, 2 participants"),
        ([1.0, 2.0, 2.0, 3.0], [0, 1, 0, 1], ["a", "a", "b", "b"], "do not vary over participants"),
        ([], [], [], "0 groups"),
        ([math.nan] * 2, [0, 1], ["a", "b"], "0 groups"),
    ):
        found = repeated_anova(values, groups, who)
        assert math.isnan(found.f)
        assert reason in found.reason
    with pytest.raises(ValueError, match="2 values in 1 groups"):
        repeated_anova([1.0, 2.0], [0, 1], ["a"])


def test_correlations_of_few_participants() -> None:
    x = np.arange(6.0)
    two = pearson(x, x**2, participants=[0, 0, 0, 1, 1, 1])
    assert two.value == pytest.approx(stats.pearsonr(x, x**2).statistic)
    assert math.isnan(two.p)
    assert "no interval from 2 participants: 3 are needed" in two.reason
    draw = np.random.default_rng(10)
    y = x + 3 * draw.standard_normal(6)
    three = spearman(x, y, participants=[0, 0, 1, 1, 2, 2])
    assert three.interval[0] < three.value < three.interval[1]
    assert three.participants == 3
    with pytest.raises(ValueError, match="1 participants of 6 pairs"):
        pearson(x, x, participants=[1])
