"""Fit of growth laws: the time constant of a relaxation."""

import numpy as np

from fingerflow.models.growth_laws import relaxation


def test_relaxation_time_in_any_unit() -> None:
    """The fitted time is the true one within its deviation, for areas as small as in km²."""
    time = np.linspace(0, 6, 200)
    noise = np.random.default_rng(0).normal(0, 0.02, time.size)
    law = relaxation(time, 1e-9 * (3 - np.exp(-time / 1.5) + noise))
    assert abs(law.exponent - 1.5) < 3 * law.exponent_std < 0.3
