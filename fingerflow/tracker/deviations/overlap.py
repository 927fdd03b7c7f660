"""Correlation of tracking errors between points whose windows overlap, and what it does to a fitted gradient."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from fingerflow.kernels.array_types import Array
from fingerflow.kernels.arrays import squared_distances

# Correlation of displacements whose references are 0, 1, and 2 or more frames apart. The reference is the position in
# one frame, or a mean of those in two frames, x + s (y - x) with s uniform from 0 to 1, of variance 2/3.
_OF_FRAMES = np.array([1.0, 0.5, 0.5])
_OF_ONSETS = np.array([1 + 1 / 2, 1 + 1 / 4, 1]) / (1 + 2 / 3)
_PAIRS = 1 << 20  # pairs of points whose correlations are computed at once, of several centres
_CENTRES = 64  # number of points around which the gain is computed; others take that of the nearest


@dataclass(frozen=True)
class OverlapErrors:
    """Displacement errors of P points that correlate because the windows in which the points are tracked overlap.

    Tracking errors come from pixel noise in a window and correlate by the share that two windows have in common: on a
    press correlations are 0.2, 0.4 and 0.6 to 0.75 where the share is a fifth, two fifths and two thirds. Half of a
    displacement's noise is that of its reference, which differs where points count from different frames. If the
    reference is a mean of two positions, anywhere between them, it is two fifths (`_OF_ONSETS`). Errors of the time of
    onset are independent: those of neighbours on a press correlate by less than 0.1.

    Args:
        since: (P,) frame from which the displacement of a point counts.
        positions_px: (P, 2) position then, px of the topographic view; NaN for points without one.
        noise: (P,) mm^2, variance of a displacement component by image noise.
        of_onset: (P, 2, 2) mm^2, covariance of the displacement by the error of the time of onset.
        by_onsets: True if the reference is an onset between two frames.
        window_px: side of a window.
    """

    since: Array
    positions_px: Array
    noise: Array
    of_onset: Array
    by_onsets: bool
    window_px: int

    def pairs(self) -> Array:
        """Return the pairs (K, 2) of points whose windows overlap."""
        valid = np.flatnonzero(np.isfinite(self.positions_px).all(-1))
        x, y = self.positions_px[valid].T
        near = (abs(x[:, None] - x) <= self.window_px) & (abs(y[:, None] - y) <= self.window_px)
        return valid[np.argwhere(np.triu(near, 1))]

    @cached_property
    def _shared_part(self) -> Array:
        """Return the part (P,) of the standard deviation of each displacement that image noise causes: errors of onset
        are independent.
        """
        of_onset = np.trace(self.of_onset, axis1=1, axis2=2) / 2
        return np.nan_to_num(np.sqrt(self.noise / np.maximum(self.noise + of_onset, 1e-30))).astype(np.float32)

    def between(self, first: Array, second: Array) -> NDArray[np.float32]:
        """Return the correlations (...) of the displacement errors of points (...) with those of other points."""
        later = np.minimum(abs(self.since[first] - self.since[second]), 2)
        result = np.take(_OF_ONSETS if self.by_onsets else _OF_FRAMES, later).astype(np.float32)
        # Coordinate by coordinate, as operations over an axis of two take several times as long.
        for values in self.positions_px.T / self.window_px:
            result *= np.fmax(1 - abs(values[first] - values[second]), 0)  # 0 for NaN
        return result * self._shared_part[first] * self._shared_part[second]

    def variance_gain(self, gauge_px: float) -> NDArray[np.float32]:
        """Return the factor (P,) by which these correlations raise the variance of a gradient fitted around each point.

        A plane fit over `gauge_px` weights the error e_j of a point at distance d_j from the centroid with w_j d_j
        (`local_gradients`). The factor is the sum of w_j w_k d_j . d_k r_jk over all pairs of points over the sum of
        w_j^2 d_j^2, with r the correlations. It changes slowly over the skin, so that fits to independent errors whose
        variances are larger by it have the variance of fits to correlated errors. For the same reason it is computed
        around some of the points.
        """
        valid = np.flatnonzero(np.isfinite(self.positions_px).all(-1))
        positions = self.positions_px[valid]
        centres = positions[:: max(1, len(valid) // _CENTRES)]
        away = squared_distances(centres, positions)
        result = np.ones(len(self.positions_px), np.float32)
        if not len(valid):
            return result
        weight = np.square(np.maximum(1 - away / (gauge_px / 2) ** 2, 0))
        most = int((weight > 0).sum(1).max())
        near = np.argpartition(-weight, most - 1, axis=1)[:, :most]  # of the others the weight is 0
        gains, together = np.ones(len(centres)), max(1, _PAIRS // most**2)
        for part in (slice(first, first + together) for first in range(0, len(centres), together)):
            some, weights = near[part], np.take_along_axis(weight[part], near[part], 1)[..., None]
            middle = (weights * positions[some]).sum(1, keepdims=True) / weights.sum(1, keepdims=True)
            lever = weights * (positions[some] - middle)
            shared = self.between(valid[some[:, :, None]], valid[some[:, None]])
            shared[:, np.arange(most), np.arange(most)] = 1
            alone = np.maximum(np.square(lever).sum((1, 2)), 1e-30)
            gains[part] = np.maximum(((shared @ lever) * lever).sum((1, 2)) / alone, 1)
        result[valid] = gains[away.argmin(0)]
        return result
