"""Tests that the tests of hypotheses have the stated error rate, find effects, and have intervals with the stated
coverage.

Participants differ in each simulated study. The share of 400 studies without effect that a test of alpha 0.05 rejects
has a standard error of 0.011, so 2 to 8 % is allowed.
"""

import numpy as np
import pytest

from fingerflow.models import observer
from fingerflow.models.observer import FORCED_CHOICE, GUESSES, YES_NO, permutation_p, repeated_anova
from tests.models.observer.error_rates import ALPHA, P_OF, answered, counted, hold_the_truth, related, share

pytestmark = pytest.mark.long

STUDIES = 400


@pytest.mark.parametrize("people", [4, 16])
@pytest.mark.parametrize("name", P_OF)
def test_a_test_keeps_its_error_rate_and_finds_an_effect(people: int, name: str) -> None:
    p_of, large, _, _ = P_OF[name]
    assert 0.02 <= share(people, p_of, 0.0, STUDIES) <= 0.08
    if people == 16:
        assert share(people, p_of, large, 50) > 0.9


def test_participants_who_press_and_answer_alike_are_no_effect() -> None:
    """If fast participants answer better but the rate of a trial has no effect, only an analysis of independent trials
    finds an effect.
    """

    def p_of(seed: int) -> tuple[float, float, float]:
        table = answered(seed, 8, own_slope=0.0)
        metric, answer, who = table["metric"], table["answer"], table["participants"]
        split = metric[answer], metric[~answer], (who[answer], who[~answer])
        one_way = observer.one_way_anova(metric, answer).p
        return repeated_anova(metric, answer, who).p, permutation_p(*split, 199, seed), one_way

    repeated, permuted, independent = (np.array([p_of(seed) for seed in range(STUDIES)]) < ALPHA).mean(0)
    assert 0.02 <= repeated <= 0.08
    assert 0.02 <= permuted <= 0.08
    assert independent > 0.5


def test_intervals_hold_the_truth() -> None:
    """A correlation of 0.5, and a rise of the probability by 0.04 per N/s (SD 0.02 over participants, who differ in
    level and amplitude), are in 92 to 98 % of the intervals.
    """
    inside = np.zeros(2)
    for seed in range(STUDIES):
        low, high = observer.pearson(*related(seed, 12, effect=0.5)).interval
        draw = np.random.default_rng(seed)
        who, amplitude = np.repeat(np.arange(12), 40), np.tile(np.repeat([0.0, 1.0], 20), 12)
        rate = draw.uniform(-3, 3, who.size)
        level = 0.5 + 0.1 * draw.uniform(-1, 1, 12)[who] + 0.1 * draw.uniform(-1, 1, 12)[who] * amplitude
        probability = level + (0.04 + 0.02 * draw.standard_normal(12)[who]) * rate
        found = observer.clustered_regression(rate, draw.random(who.size) < probability, amplitude, who)
        inside += low <= 0.5 <= high, found.interval[0] <= 0.04 <= found.interval[1]
    assert ((inside / STUDIES >= 0.92) & (inside / STUDIES <= 0.98)).all(), inside


def test_intervals_of_few_participants_with_few_wrong_answers_hold_the_truth() -> None:
    """Intervals are of 95 %; the share that covers has a standard error of 0.9 % over 600 studies. Intervals of false
    alarms cover more, as a share of few trials takes few values.
    """
    held = hold_the_truth(600)
    assert all(0.92 <= held[name] <= 0.98 for name in ("d'", "area", "criterion"))
    assert held["false alarms"] >= 0.92


@pytest.mark.parametrize("design", [FORCED_CHOICE, YES_NO])
def test_intervals_of_the_psychometric_threshold_hold_the_truth(design: str) -> None:
    """95 % of the intervals contain the threshold, which differs between participants; the error of 400 is 1.1 %."""
    inside, errors = 0, []
    for seed in range(STUDIES):
        blocks, truth = counted(seed, GUESSES[design])
        found = observer.fit_psychometric(**blocks, guess=GUESSES[design])
        inside += found.interval[0] <= truth <= found.interval[1]
        errors.append(found.threshold - truth)
    assert 0.915 <= inside / STUDIES <= 0.98
    assert abs(np.mean(errors)) < 0.02
