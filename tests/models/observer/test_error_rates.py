"""Tests that the tests of hypotheses have the stated error rate, find effects, and have intervals with the stated
coverage.

Participants differ in each simulated study. The share of 400 studies without effect that a test of alpha 0.05 rejects
has a standard error of 0.011, so 2 to 8 % is allowed.
"""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from fingerflow.models.observer import (
    FORCED_CHOICE,
    GUESSES,
    YES_NO,
    clustered_regression,
    fit_psychometric,
    one_way_anova,
    pearson,
    permutation_p,
    repeated_anova,
    spearman,
)
from tests.models.observer.error_rates import answered, counted, hold_the_truth, measured, related, share

pytestmark = pytest.mark.long

STUDIES = 400


def regression(seed: int, people: int, effect: float, own_slope: float) -> float:
    return clustered_regression(**answered(seed, people, slope=0.6 * effect, own_slope=own_slope)).p


def anova(seed: int, people: int, effect: float, groups: int) -> float:
    return repeated_anova(**measured(seed, people, groups, 2 * effect)).p


def anova_with_gaps(seed: int, people: int, effect: float, groups: int) -> float:
    return repeated_anova(**measured(seed, people, groups, 2 * effect, gaps=7 * people // 16)).p


def correlation(seed: int, people: int, effect: float, kind: Callable[..., Any]) -> float:
    return float(kind(*related(seed, people, effect=0.7 * effect)).p)


@pytest.mark.parametrize("people", [4, 16])
@pytest.mark.parametrize(
    ("p_of", "option"),
    [
        *((regression, 0.0), (regression, 0.3), (anova, 2), (anova, 7), (anova_with_gaps, 7)),
        *((correlation, pearson), (correlation, spearman)),
    ],
)
def test_a_test_keeps_its_error_rate_and_finds_an_effect(people: int, p_of: Callable[..., float], option: Any) -> None:
    assert 0.02 <= share(lambda seed: p_of(seed, people, 0.0, option), STUDIES) <= 0.08
    if people == 16:
        assert share(lambda seed: p_of(seed, people, 1.0, option), 50) > 0.9


def test_participants_who_press_and_answer_alike_are_no_effect() -> None:
    """If fast participants answer better but the rate of a trial has no effect, only an analysis of independent trials
    finds an effect.
    """

    def table(seed: int) -> tuple[np.ndarray, ...]:
        one = answered(seed, 8, own_slope=0.0)
        return one["metric"], one["answer"], one["participants"]

    def permuted(seed: int) -> float:
        metric, answer, who = table(seed)
        return permutation_p(metric[answer], metric[~answer], (who[answer], who[~answer]), 199, seed)

    assert 0.02 <= share(lambda seed: repeated_anova(*table(seed)).p, STUDIES) <= 0.08
    assert share(lambda seed: one_way_anova(*table(seed)[:2]).p, 100) > 0.5
    assert 0.02 <= share(permuted, STUDIES) <= 0.08


def test_intervals_hold_the_truth() -> None:
    """A correlation of 0.5, and a rise of the probability by 0.04 per N/s (SD 0.02 over participants, who differ in
    level and amplitude), are in 92 to 98 % of the intervals.
    """
    inside = np.zeros(2)
    for seed in range(STUDIES):
        low, high = pearson(*related(seed, 12, effect=0.5)).interval
        draw = np.random.default_rng(seed)
        who, amplitude = np.repeat(np.arange(12), 40), np.tile(np.repeat([0.0, 1.0], 20), 12)
        rate = draw.uniform(-3, 3, who.size)
        level = 0.5 + 0.1 * draw.uniform(-1, 1, 12)[who] + 0.1 * draw.uniform(-1, 1, 12)[who] * amplitude
        probability = level + (0.04 + 0.02 * draw.standard_normal(12)[who]) * rate
        found = clustered_regression(rate, draw.random(who.size) < probability, amplitude, who)
        inside += low <= 0.5 <= high, found.interval[0] <= 0.04 <= found.interval[1]
    assert ((inside / STUDIES >= 0.92) & (inside / STUDIES <= 0.98)).all(), inside


def test_intervals_of_few_participants_with_few_wrong_answers_hold_the_truth() -> None:
    """95 % are asked, and 0.9 % is the error of 600 studies. Those of shares are wider, as a few trials allow few."""
    held = hold_the_truth(600)
    assert all(0.92 <= held[name] <= 0.98 for name in ("d'", "area", "criterion"))
    assert held["false alarms"] >= 0.92


@pytest.mark.parametrize("design", [FORCED_CHOICE, YES_NO])
def test_intervals_of_the_psychometric_threshold_hold_the_truth(design: str) -> None:
    """95 % of the intervals contain the threshold, which differs between participants; the error of 400 is 1.1 %."""
    inside, errors = 0, []
    for seed in range(STUDIES):
        blocks, truth = counted(seed, GUESSES[design])
        found = fit_psychometric(**blocks, guess=GUESSES[design])
        inside += found.interval[0] <= truth <= found.interval[1]
        errors.append(found.threshold - truth)
    assert 0.915 <= inside / STUDIES <= 0.98
    assert abs(np.mean(errors)) < 0.02
