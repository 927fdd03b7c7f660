"""Correlation of tracking errors between points whose windows overlap, and what it does to a fitted gradient."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array, csr_array
from scipy.spatial import cKDTree

Array = NDArray[np.floating]
Indices = NDArray[np.integer]

# Correlation of displacements whose references are 0, 1, and 2 or more frames apart. The reference is the position in
# one frame, or a mean of those in two frames, x + s (y - x) with s uniform from 0 to 1, of variance 2/3.
_OF_FRAMES = np.array([1.0, 0.5, 0.5])
_OF_ONSETS = np.array([1 + 1 / 2, 1 + 1 / 4, 1]) / (1 + 2 / 3)


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

    since: Indices
    positions_px: Array
    noise: Array
    of_onset: Array
    by_onsets: bool
    window_px: int

    def pairs(self) -> Indices:
        """Return the pairs (K, 2) of points whose windows overlap."""
        valid = np.flatnonzero(np.isfinite(self.positions_px).all(-1))
        near = cKDTree(self.positions_px[valid]).query_pairs(self.window_px, p=np.inf, output_type="ndarray")
        return valid[near].astype(np.int64)

    def between(self, first: Indices, second: Indices) -> NDArray[np.float32]:
        """Return the correlations (K,) of the displacement errors of points with those of other points."""
        of_onset = np.trace(self.of_onset, axis1=1, axis2=2) / 2
        share = np.sqrt(self.noise / np.maximum(self.noise + of_onset, 1e-30))
        distance = np.abs(self.positions_px[first] - self.positions_px[second]) / self.window_px
        later = np.minimum(abs(self.since[first] - self.since[second]), 2)
        common = np.clip(1 - distance, 0, 1).prod(-1) * np.take(_OF_ONSETS if self.by_onsets else _OF_FRAMES, later)
        return np.nan_to_num(common * share[first] * share[second]).astype(np.float32)

    def variance_gain(self, gauge_px: float) -> NDArray[np.float32]:
        """Return the factor (P,) by which these correlations raise the variance of a gradient fitted around each point.

        A plane fit over `gauge_px` weights the error e_j of a point at distance d_j from the centroid with w_j d_j
        (`local_gradients`). The factor is the sum of w_j w_k d_j . d_k r_jk over all pairs of points over the sum of
        w_j^2 d_j^2, with r the correlations. It changes slowly over the skin, so that fits to independent errors whose
        variances are larger by it have the variance of fits to correlated errors.
        """
        valid = np.flatnonzero(np.isfinite(self.positions_px).all(-1))
        positions, size = self.positions_px[valid], len(valid)
        near = cKDTree(positions).query_pairs(gauge_px / 2, output_type="ndarray")
        first, second = (np.concatenate((near, near[:, ::-1], np.arange(size)[:, None].repeat(2, 1)))).T
        offset = positions[second] - positions[first]
        weight = np.square(1 - np.square(offset).sum(1) / (gauge_px / 2) ** 2)

        def sums(values: Array) -> NDArray[np.float64]:
            return np.bincount(first, values, size).astype(np.float64)

        mass = sums(weight)
        between = np.full(len(self.positions_px), -1)
        between[valid] = np.arange(size)
        pairs = self.pairs()
        both = between[np.concatenate((pairs, pairs[:, ::-1]))].T
        shared = csr_array((np.tile(self.between(*pairs.T), 2), both), shape=(size, size))
        alone, together = np.zeros((2, size))
        for axis in range(2):
            lever = weight * (offset[:, axis] - (sums(weight * offset[:, axis]) / mass)[first])
            levers = coo_array((lever, (first, second)), shape=(size, size)).tocsr()
            alone += sums(lever * lever)
            together += ((levers @ shared) * levers).sum(1)
        result = np.ones(len(self.positions_px), np.float32)
        result[valid] = np.maximum(1 + together / np.maximum(alone, 1e-30), 1)
        return result
