"""Groups of participants, correlations, analysis of variance, the mixed model."""

import math
import sys

import numpy as np
import pytest
from scipy import stats

from fingerflow.errors import FingerflowError
from fingerflow.models.observer import mixed_model, one_way_anova, participant_groups, pearson, spearman


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
    """At 5 %, 40 samples of one Gaussian: 2 expected, 7 or more once in two hundred times."""
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


def test_too_few_to_split() -> None:
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


def test_the_mixed_model_separates_participants_from_the_effect() -> None:
    pytest.importorskip("statsmodels", reason="statsmodels is the extra `study`")
    draw = np.random.default_rng(7)
    who = np.repeat(np.arange(24), 20)
    amplitude = draw.uniform(0, 3, who.size)
    rate = 10 + 2 * amplitude + 3 * draw.standard_normal(24)[who] + draw.standard_normal(who.size)
    rate[:3] = np.nan
    unused = np.full(len(who), np.nan)  # a column whose name is a part of another one's leaves no row out
    found = mixed_model({"participant": who, "amplitude": amplitude, "rate": rate, "amp": unused}, "rate ~ amplitude")
    assert found.converged
    assert found.effects["amplitude"] == pytest.approx(2, abs=0.2)
    assert found.intervals["amplitude"][0] < 2 < found.intervals["amplitude"][1]
    assert found.p["amplitude"] < 1e-6
    assert found.between == pytest.approx(3, abs=1.2)
    assert found.within == pytest.approx(1, abs=0.1)
    assert (found.trials, found.participants, found.missing) == (477, 24, 3)
    with pytest.raises(FingerflowError, match="1 participants with whole rows"):
        mixed_model({"participant": np.zeros(9), "x": np.arange(9.0), "y": np.arange(9.0)}, "y ~ x")
    with pytest.raises(FingerflowError, match="no column participant"):
        mixed_model({"x": np.arange(9.0), "y": np.arange(9.0)}, "y ~ x")


def test_without_statsmodels_the_error_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "statsmodels.formula.api", None)
    with pytest.raises(FingerflowError, match=r"fingerflow-engine\[study\]"):
        mixed_model({"participant": [1, 2], "y": [1.0, 2.0]}, "y ~ 1")
