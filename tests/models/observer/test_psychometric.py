"""Tests of the psychometric curve: its recovery, and data without a curve. Coverage is in `test_error_rates`."""

import math

import numpy as np
import pytest
from scipy.special import ndtr, ndtri

from fingerflow.models.observer import fit_psychometric


def test_many_trials_find_the_curve() -> None:
    """Units of the stimulus have no influence, and a guess rate that is not that of the data moves the threshold."""
    stimuli, trials = np.linspace(-1, 3, 15), np.full(15, 4000)
    share = 0.1 + 0.85 * ndtr((stimuli - 1.0) / 0.6)
    answers = np.random.default_rng(0).binomial(trials, share)
    fit = fit_psychometric(stimuli, answers, trials, np.arange(15))
    truth = 1 + 0.6 * ndtri(0.65 / 0.85)
    assert fit.threshold == pytest.approx(truth, abs=0.03)
    assert fit.width == pytest.approx(0.6, abs=0.04)
    assert (fit.guess, fit.lapse) == (pytest.approx(0.1, abs=0.01), pytest.approx(0.05, abs=0.01))
    assert fit(fit.threshold) == pytest.approx(0.75)
    np.testing.assert_allclose(fit(stimuli), share, atol=0.015)
    there = fit_psychometric(1e3 * stimuli + 5e4, answers, trials, np.arange(15))
    assert there.threshold == pytest.approx(1e3 * fit.threshold + 5e4, abs=1)
    assert abs(fit_psychometric(stimuli, answers, trials, np.arange(15), guess=0.5).threshold - truth) > 0.05


def test_data_without_a_curve() -> None:
    for stimulus, answers, reason in (
        ([1.0, 2.0], [5, 9], "2 stimuli: 3 are needed"),
        ([1.0, 2.0, 3.0], [10, 10, 10], "30 of 30"),
        ([1.0, 2.0, 3.0], [0, 0, 0], "0 of 30"),
        ([1.0, 2.0, 3.0], [5, 5, 5], "do not change"),
        ([], [], "0 stimuli"),
    ):
        fit = fit_psychometric(stimulus, answers, [10] * len(answers), list(range(len(answers))))
        assert math.isnan(fit.threshold + fit.interval[0])
        assert reason in fit.reason
    with pytest.raises(ValueError, match="answers go from 0 to the trials"):
        fit_psychometric([1.0, 2.0, 3.0], [5, 6, 11], [10, 10, 10], [0, 1, 2])
    with pytest.raises(ValueError, match="2 stimuli, 3 answers"):
        fit_psychometric([1.0, 2.0], [5, 6, 9], [10, 10, 10], [0, 1, 2])
