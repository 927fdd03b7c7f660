"""Gradients fitted to points whose windows overlap have the deviation that is stated for them."""

import numpy as np
import torch
from scipy.ndimage import uniform_filter

from fingerflow.ops.fields.local_fit import local_gradients
from fingerflow.ops.fields.strain import divergence
from fingerflow.ops.fields.strain_uncertainty import divergence_std
from fingerflow.tracker.deviations.overlap import OverlapErrors

WINDOW, GAUGE, SIDE, DRAWS = 25, 49.0, 160, 400  # px


def _points() -> np.ndarray:
    """Return points (N, 2), at least 6 px apart, at random whole pixels."""
    random, kept = np.random.default_rng(2), np.zeros((0, 2))
    for place in random.integers(0, SIDE, (4000, 2)).astype(float):
        if not len(kept) or np.hypot(*(kept - place).T).min() >= 8:
            kept = np.concatenate((kept, place[None]))
    return kept


def test_the_variance_gain_is_that_of_overlapping_windows() -> None:
    """Errors are means of white noise over windows, which correlate by the share of two windows that overlaps. 400
    draws of fields that a few dozen independent windows decide: 5 %. Counted as independent, errors are 1.7 times the
    deviation.
    """
    points, random = _points(), np.random.default_rng(3)
    noise = random.normal(size=(DRAWS, SIDE, SIDE, 2))
    means = uniform_filter(noise, (1, WINDOW, WINDOW, 1), mode="wrap") * WINDOW
    column, row = points.astype(int).T
    errors = torch.from_numpy(means[:, row, column])
    count = len(points)
    overlap = OverlapErrors(np.zeros(count, int), points, np.ones(count), np.zeros((count, 2, 2)), False, WINDOW)
    inside = np.abs(points - SIDE / 2).max(1) < SIDE / 2 - GAUGE / 2
    z = []
    for gain in (overlap.variance_gain(GAUGE), np.ones(count)):
        variance = torch.from_numpy(gain.astype(np.float64))[None]
        fit = local_gradients(torch.from_numpy(points)[None], errors, gauge_length=GAUGE, variance=variance)
        assert fit.covariance is not None
        ratio = (divergence(fit.gradient) / divergence_std(fit.covariance))[:, inside]
        z.append(float(ratio.square().mean().sqrt()))
    assert abs(z[0] - 1) < 0.07
    assert z[1] > 1.3
