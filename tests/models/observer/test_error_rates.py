"""Tests that the tests of hypotheses have the stated error rate, find effects, and have intervals with the stated
coverage.

Participants differ in each simulated study. The share of 400 studies without effect that a test of alpha 0.05 rejects
has a standard error of 0.011, so 2 to 8 % is allowed.
"""

import math
from functools import partial

import numpy as np
import pytest

from fingerflow.models.observer import (
    FORCED_CHOICE,
    GUESSES,
    YES_NO,
    auc,
    d_prime,
    fit_psychometric,
    mixed_model,
    one_way_anova,
    pearson,
    permutation_test,
    repeated_anova,
    spearman,
)
from tests.models.observer.error_rates import ALPHA, answered, counted, measured, related, share

pytestmark = pytest.mark.long

STUDIES = 400


@pytest.mark.parametrize("people", [4, 16])
@pytest.mark.parametrize("own_slope", [0.0, 0.3])
def test_the_mixed_model_keeps_its_error_rate(people: int, own_slope: float) -> None:
    def p_of(seed: int, slope: float = 0.0) -> float:
        return mixed_model(**answered(seed, people, slope=slope, own_slope=own_slope)).p

    assert 0.02 <= share(p_of, STUDIES) <= 0.08
    if people == 16:
        assert share(partial(p_of, slope=0.6), 50) > 0.9


@pytest.mark.parametrize(("people", "groups"), [(4, 2), (4, 7), (16, 2), (16, 7)])
def test_the_analysis_of_variance_keeps_its_error_rate(people: int, groups: int) -> None:
    def p_of(seed: int, effect: float = 0.0) -> float:
        return repeated_anova(**measured(seed, people, groups, effect)).p

    assert 0.02 <= share(p_of, STUDIES) <= 0.08
    if people == 16:
        assert share(partial(p_of, effect=2.0), 50) > 0.9


def test_participants_who_press_and_answer_alike_are_no_effect() -> None:
    """If fast participants answer better but the rate of a trial has no effect, only an analysis of independent trials
    finds an effect.
    """

    def table(seed: int) -> tuple[np.ndarray, ...]:
        one = answered(seed, 8, own_slope=0.0)
        return one["metric"], one["answer"], one["participants"]

    assert 0.02 <= share(lambda seed: repeated_anova(*table(seed)).p, STUDIES) <= 0.08
    assert share(lambda seed: one_way_anova(*table(seed)[:2]).p, 100) > 0.5

    def permuted(seed: int) -> float:
        metric, answer, who = table(seed)
        parts = (who[answer], who[~answer])
        return permutation_test(metric[answer], metric[~answer], participants=parts, permutations=199, seed=seed).p

    assert 0.02 <= share(permuted, STUDIES) <= 0.08


@pytest.mark.parametrize("people", [4, 16])
@pytest.mark.parametrize("correlation", [pearson, spearman])
def test_correlations_keep_their_error_rate(people: int, correlation: object) -> None:
    assert callable(correlation)

    def p_of(seed: int, effect: float = 0.0) -> float:
        first, second, who = related(seed, people, effect=effect)
        return float(correlation(first, second, participants=who).p)

    assert 0.02 <= share(p_of, STUDIES) <= 0.08
    if people == 16:
        assert share(partial(p_of, effect=0.7), 50) > 0.9
    alone = share(lambda seed: correlation(*related(seed, 16)[:2]).p, 100)
    assert alone > 0.1, "pairs of a participant are not independent"


def test_intervals_of_a_correlation_hold_the_truth() -> None:
    inside = 0
    for seed in range(STUDIES):
        first, second, who = related(seed, 12, effect=0.5)
        low, high = pearson(first, second, participants=who).interval
        inside += low <= 0.5 <= high
    assert 0.92 <= inside / STUDIES <= 0.98


def test_intervals_of_the_mixed_model_hold_the_truth() -> None:
    """The interval contains a rise of the probability by 0.04 per N/s (SD 0.02 over participants, who differ in level
    and amplitude) in 92 to 98 % of the studies.
    """
    inside = 0
    for seed in range(STUDIES):
        draw = np.random.default_rng(seed)
        who, amplitude = np.repeat(np.arange(12), 40), np.tile(np.repeat([0.0, 1.0], 20), 12)
        rate = draw.uniform(-3, 3, who.size)
        level = 0.5 + 0.1 * draw.uniform(-1, 1, 12)[who] + 0.1 * draw.uniform(-1, 1, 12)[who] * amplitude
        probability = level + (0.04 + 0.02 * draw.standard_normal(12)[who]) * rate
        found = mixed_model(rate, draw.random(who.size) < probability, amplitude, who)
        inside += found.interval[0] <= 0.04 <= found.interval[1]
        assert (found.p < ALPHA) == (not found.interval[0] <= 0 <= found.interval[1])
    assert 0.92 <= inside / STUDIES <= 0.98


def test_the_mixed_model_by_hand_and_where_there_is_none() -> None:
    metric, answer = [1.0, 2.0, 5.0, 7.0, math.nan, 4.0], [0, 1, 1, 1, 0, 0]
    found = mixed_model(metric, answer, [0, 0, 1, 1, 0, 0], ["a", "a", "a", "a", "a", "b"])
    # Means of the two cells: 1.5 and 6. Products 0.25 + 0.25, squares 0.5 + 2; a single b in its cell has no effect.
    assert found.effect == pytest.approx(0.5 / 2.5)
    assert (found.trials, found.participants, found.missing) == (4, 1, 2)
    assert "no interval from 1 participants" in found.reason
    assert "equal within each participant" in mixed_model([1.0, 1.0], [0, 1], [0, 0], [0, 0]).reason
    assert "equal within each participant" in mixed_model([], [], [], []).reason
    with pytest.raises(ValueError, match="give one of each a trial"):
        mixed_model([1.0], [0, 1], [0, 0], [0, 0])


def test_d_prime_has_the_sign_of_the_area() -> None:
    draw = np.random.default_rng(0)
    who = np.repeat(np.arange(10), 20), np.repeat(np.arange(10), 20)
    low, high = draw.standard_normal(200), draw.standard_normal(200) + 0.95
    down, up = (d_prime(*kinds, participants=who, resamples=200) for kinds in ((low, high), (high, low)))
    assert down.value == -up.value < -0.7
    assert down.interval[1] < 0 < up.interval[0]
    assert auc(low, high, resamples=100).value < 0.5


@pytest.mark.long
@pytest.mark.parametrize("design", [FORCED_CHOICE, YES_NO])
def test_the_guess_rate_follows_the_design(design: str) -> None:
    """At least 34 of 40 intervals contain the threshold, which differs between participants: 2 misses are expected, 6
    or more have a probability of 1/70.
    """
    inside, centres = 0, []
    for seed in range(40):
        blocks, truth = counted(seed, GUESSES[design])
        found = fit_psychometric(**blocks, guess=GUESSES[design])
        inside += found.interval[0] <= truth <= found.interval[1]
        centres.append(found.threshold - truth)
    assert inside >= 34
    assert abs(np.mean(centres)) < 0.1


def test_a_wrong_guess_rate_moves_the_threshold() -> None:
    """A guess rate of 0.5 biases the threshold of yes-no answers, which start at 0.1."""
    blocks, truth = counted(0, None, people=40, trials=100)
    answers = blocks["answers"].reshape(40, 7).sum(0)
    right, wrong = (fit_psychometric(blocks["stimulus"][:7], answers, [4000] * 7, guess=guess) for guess in (None, 0.5))
    assert abs(right.threshold - truth) < 0.2
    assert wrong.threshold - truth > 0.05
