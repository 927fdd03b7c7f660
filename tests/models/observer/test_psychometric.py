"""Tests of the psychometric curve: its recovery, its interval, and data without a curve."""

import math

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.special import ndtr, ndtri

from fingerflow.models.observer import fit_psychometric

STIMULI = np.linspace(0, 3, 7)
TRIALS = np.full(7, 40)
TRUTH = 1.2 + 0.5 * float(ndtri(0.25 / 0.48))  # stimulus with 75 % correct answers on the curve below


def answered(seed: int, overdispersion: float = 0.02) -> NDArray[np.int64]:
    """Return the numbers of correct answers (7,) of a curve from 0.5 to 0.98 with middle 1.2 and width 0.5; with
    `overdispersion` the probability of a block is random.
    """
    draw = np.random.default_rng(seed)
    share = 0.5 + 0.48 * ndtr((STIMULI - 1.2) / 0.5)
    if overdispersion:
        total = 1 / overdispersion - 1
        share = draw.beta(share * total, (1 - share) * total)
    return draw.binomial(TRIALS, share)


def test_the_interval_contains_the_estimate_and_mostly_the_truth() -> None:
    inside = []
    for seed in range(8):
        fit = fit_psychometric(STIMULI, answered(seed), TRIALS, guess=0.5)
        assert fit.interval[0] < fit.threshold < fit.interval[1]
        assert fit(fit.threshold) == pytest.approx(0.75)
        inside.append(fit.interval[0] <= TRUTH <= fit.interval[1])
    assert sum(inside) >= 6


def test_many_trials_find_the_curve() -> None:
    trials = np.full(15, 4000)
    stimuli = np.linspace(-1, 3, 15)
    share = 0.1 + 0.85 * ndtr((stimuli - 1.0) / 0.6)
    answers = np.random.default_rng(0).binomial(trials, share)
    fit = fit_psychometric(stimuli, answers, trials, share=0.6)
    assert fit.threshold == pytest.approx(1 + 0.6 * ndtri(0.5 / 0.85), abs=0.03)
    assert fit.width == pytest.approx(0.6, abs=0.04)
    assert fit.guess == pytest.approx(0.1, abs=0.01)
    assert fit.lapse == pytest.approx(0.05, abs=0.01)
    assert fit.overdispersion < 2e-3
    np.testing.assert_allclose(fit(stimuli), share, atol=0.015)
    assert (fit.trials, fit.stimuli, fit.share, fit.level) == (60000, 15, 0.6, 0.95)


def test_unsteady_participants_have_wider_intervals() -> None:
    steady = np.round(TRIALS * (0.5 + 0.48 * ndtr((STIMULI - 1.2) / 0.5)))
    unsteady = steady + np.array([0, 5, -6, 6, -6, 1, -5])
    calm, rough = (fit_psychometric(STIMULI, counts, TRIALS, guess=0.5) for counts in (steady, unsteady))
    assert rough.overdispersion > 2 * calm.overdispersion
    assert np.diff(rough.interval) > 1.2 * np.diff(calm.interval)


def test_units_of_the_stimulus_do_not_matter() -> None:
    answers = answered(3)
    here = fit_psychometric(STIMULI, answers, TRIALS, guess=0.5)
    there = fit_psychometric(1e3 * STIMULI + 5e4, answers, TRIALS, guess=0.5)
    assert there.threshold == pytest.approx(1e3 * here.threshold + 5e4, abs=1)
    assert there.interval[1] == pytest.approx(1e3 * here.interval[1] + 5e4, abs=15)


def test_a_falling_curve() -> None:
    answers = np.array([39, 38, 36, 28, 12, 4, 1])
    fit = fit_psychometric(STIMULI, answers, TRIALS, share=0.5)
    assert fit.width < 0
    assert 1.5 < fit.threshold < 2
    assert fit.interval[0] < fit.threshold < fit.interval[1]


def test_a_limit_that_the_data_do_not_set_is_infinite() -> None:
    fit = fit_psychometric(STIMULI, [20, 21, 19, 22, 22, 24, 25], TRIALS, share=0.9, guess=0.5)
    assert fit.interval[1] == math.inf
    assert fit.interval[0] < fit.threshold


def test_data_without_a_curve() -> None:
    for stimulus, answers, trials, reason in (
        ([1.0, 2.0], [5, 9], [10, 10], "2 stimuli: 3 are needed"),
        ([1.0, 2.0, 3.0], [10, 10, 10], [10, 10, 10], "30 of 30"),
        ([1.0, 2.0, 3.0], [0, 0, 0], [10, 10, 10], "0 of 30"),
        ([], [], [], "0 stimuli"),
    ):
        fit = fit_psychometric(stimulus, answers, trials)
        assert math.isnan(fit.threshold)
        assert math.isnan(fit.interval[0])
        assert reason in fit.reason
    with pytest.raises(ValueError, match="answers go from 0 to the trials"):
        fit_psychometric([1.0, 2.0, 3.0], [5, 6, 11], [10, 10, 10])
    with pytest.raises(ValueError, match=r"the share is 0\.4 and guesses 0\.5"):
        fit_psychometric([1.0, 2.0, 3.0], [5, 6, 9], [10, 10, 10], share=0.4, guess=0.5)
    with pytest.raises(ValueError, match="give one each"):
        fit_psychometric([1.0, 2.0], [5, 6, 9], [10, 10, 10])
