"""Tests of the factor by which overlapping windows raise the variance of a fitted gradient."""

import numpy as np
import pytest

from fingerflow.pipeline.stages.displacement.shared_errors import OverlapErrors
from fingerflow.tracker.overlap_gain import overlap_gain

WINDOW, GAUGE = 21, 50.0


def scattered(spacing: float) -> np.ndarray:
    """Return positions (N, 2) px on a jittered square grid."""
    random = np.random.default_rng(3)
    grid = np.stack(np.meshgrid(*(np.arange(0, 200, spacing),) * 2), -1).reshape(-1, 2)
    return grid + random.uniform(-2, 2, grid.shape)


def test_streams_and_recordings_have_the_same_factor() -> None:
    """The factor of a stream is within 3 % the median of those of a recording: it is computed around 48 of the points,
    and the recording's fits weight about a point, not about the centroid of its neighbours.
    """
    places = scattered(9.0)
    count = len(places)
    errors = OverlapErrors(
        np.zeros(count, int), places, np.ones(count), np.zeros((count, 2, 2)), by_onsets=False, window_px=WINDOW
    )
    assert overlap_gain(places, WINDOW, GAUGE) == pytest.approx(float(np.median(errors.variance_gain(GAUGE))), rel=0.03)


def test_points_far_apart_have_no_factor() -> None:
    assert overlap_gain(scattered(24.0), WINDOW, 80.0) < 1.05
    assert overlap_gain(np.full((5, 2), np.nan), WINDOW, GAUGE) == 1
