"""Tests of the variance of medians over the contact by the finite gauge length."""

import numpy as np
import pytest

from fingerflow.tracker.median_smoothing import smoothing_variance

WIDE = np.linspace(-1, 1, 201)  # the range from the 40 % to the 60 % quantile is 0.4


def test_a_third_of_a_difference_far_above_noise_is_error() -> None:
    """The error of a fit grows with the square of the gauge length, so that the difference to twice the length is three
    errors.
    """
    assert smoothing_variance(0.3, 0.0, 0.01, WIDE) == pytest.approx(0.01)
    assert smoothing_variance(0.3, 0.05, 0.01, WIDE) == pytest.approx((0.09 - 0.05) / 9)


def test_a_difference_within_the_shift_by_noise_is_error_whole() -> None:
    """Noise of 0.2 per fit shifts the median of a distribution with a width of 0.4 by up to 0.1."""
    assert smoothing_variance(0.06, 0.0, 0.2, WIDE) == pytest.approx(0.06**2)
    assert smoothing_variance(0.2, 0.0, 0.2, WIDE) == pytest.approx(0.1**2)


def test_unknown_points_are_left_out() -> None:
    """Points that are NaN change nothing; without any point the variance is NaN."""
    values = np.stack((np.append(WIDE, np.full(50, np.nan)),) * 2)
    found = smoothing_variance(np.full(2, 0.2), np.zeros(2), np.full(2, 0.2), values)
    np.testing.assert_allclose(found, smoothing_variance(0.2, 0.0, 0.2, WIDE))
    assert np.isnan(smoothing_variance(np.zeros(2), np.zeros(2), np.zeros(2), np.zeros((2, 0)))).all()
