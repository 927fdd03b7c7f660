"""Tests that numbers are rounded to two digits of their deviation."""

import math

import pytest

from fingerflow.schema.rounding import format_interval, format_uncertainty


@pytest.mark.parametrize(
    ("value", "spread", "said"),
    [
        (33.4123, 0.5178, "33.41 ± 0.52"),
        (7935.2, 112.0, "7940 ± 110"),
        (1.2345, 0.0996, "1.23 ± 0.10"),  # 0.0996 is 0.10 in two digits, not 0.100
        (-0.0001, 0.2, "0.00 ± 0.20"),
        (0.02371, math.nan, "0.0237"),
        (0.85, 1e-17, "0.850"),  # the deviation of equal numbers is a rounding error
        (0.0, 0.0, "0"),
        (math.nan, 0.1, "–"),
    ],
)
def test_two_digits_of_the_deviation(value: float, spread: float, said: str) -> None:
    assert format_uncertainty(value, spread) == said


@pytest.mark.parametrize(
    ("value", "low", "high", "said"),
    [
        (0.8312, 0.7344, 0.9018, "0.831 (0.734 to 0.902)"),
        (21.94, 17.2, 31.4, "21.9 (17.2 to 31.4)"),
        (0.5, math.nan, math.nan, "0.500"),
        (0.5, 0.2, math.inf, "0.500"),
        (math.nan, 0.1, 0.2, "–"),
    ],
)
def test_two_digits_of_half_the_interval(value: float, low: float, high: float, said: str) -> None:
    assert format_interval(value, low, high) == said
