"""Tests of medians and time derivatives of series."""

import numpy as np
from scipy.signal import savgol_filter

from fingerflow.pipeline.stages.preparation.series import rate

STEP = 1 / 300


def test_rates_are_those_of_savitzky_and_golay() -> None:
    """Rates equal SciPy's Savitzky-Golay filter, to the rounding of sums of numbers near 1,000."""
    values = 1e3 + np.random.default_rng(4).normal(size=(60, 2)).cumsum(0)
    values[:5, 0], values[30, 0], values[35, 0] = np.nan, np.nan, np.nan  # a run of 25, one of 4 and one of 24
    found = rate(values, STEP * np.arange(60), 10 * STEP)
    for column, runs in ((0, ((5, 30), (36, 60))), (1, ((0, 60),))):
        expected = np.full(60, np.nan)
        for first, end in runs:
            expected[first:end] = savgol_filter(values[first:end, column], 11, 2, deriv=1, delta=STEP)
        np.testing.assert_allclose(found[:, column], expected, atol=1e-8)


def test_deviations_of_rates_are_those_of_independent_errors() -> None:
    std, times = np.linspace(1, 3, 30), STEP * np.arange(30)
    spread = rate(std[:, None] * np.random.default_rng(5).normal(size=(30, 4000)), times, 0.05).std(1)
    np.testing.assert_allclose(rate(std, times, 0.05, of_std=True), spread, rtol=0.05)
