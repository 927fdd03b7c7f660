"""Error of divergence and curl at points by the finite gauge length, estimated from the data."""

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.spatial import cKDTree

from fingerflow.ops.fields.local_fit import local_gradients
from fingerflow.ops.fields.strain import curl, divergence

Array = NDArray[np.floating]

_AT_BORDER = 0.15  # centroid offset, in gauge lengths, of fits on the straight border of a uniform cloud


class SmoothingErrors:
    """Estimator of the mean square error of divergence and curl that smoothing over the gauge length causes.

    The error is a share k of the difference D to a fit over twice the gauge length:

    - inside a cloud of points k is 1/2. A fit keeps 384 J4(k)/k^4 of a wave's slope, k = pi gauge / wavelength, so that
      the share is 1/3 for long waves, 0.42 for waves of two gauge lengths, 0.78 for waves of one;
    - at the border of the cloud k is 1. A fit has the gradient at the centroid of its points, which there lies beside
      the place by a length that grows with the gauge length: the error is proportional to it.

    Between both, k grows with the offset of the centroid. D is noisy, and smoothing may happen to vanish where it
    changes its sign: the variance is the mean of k^2 (D^2 - s^2) over the points within half a gauge length, s^2 the
    variance of the field by the errors of points.

    Args:
        reference: (N, 2) mm, positions from which displacement counts; NaN for points that are not fitted.
        positions: (N, 2) mm, positions by which points are neighbours.
        gauge_mm: gauge length.
    """

    def __init__(self, reference: Array, positions: Array, gauge_mm: float) -> None:
        self._reference, self._gauge = torch.from_numpy(reference.astype(np.float64))[None], gauge_mm
        valid = np.flatnonzero(np.isfinite(positions).all(1))
        near = cKDTree(positions[valid]).query_pairs(gauge_mm / 2, output_type="ndarray")
        pairs = valid[np.concatenate((near, near[:, ::-1], np.arange(len(valid))[:, None].repeat(2, 1)))]
        distance = np.square(positions[pairs[:, 0]] - positions[pairs[:, 1]]).sum(1) / (gauge_mm / 2) ** 2
        size = len(positions)
        self._weights = coo_array((np.square(1 - distance), pairs.T), shape=(size, size)).tocsr()

    def variance(self, displacement: Array, fields: Array, deviation: Array) -> NDArray[np.float64]:
        """Return the variance (n, 2, N) of divergence and curl by smoothing at N points in n frames; 0 where no
        neighbour is fitted.

        Args:
            displacement: (n, N, 2) mm.
            fields: (n, 2, N) divergence and curl.
            deviation: (n, 2, N) their standard deviations by the errors of points.
        """
        moved = torch.from_numpy(displacement.astype(np.float64))
        fit, wide = (
            local_gradients(self._reference, moved, gauge_length=length) for length in (self._gauge, 2 * self._gauge)
        )
        difference = fields - torch.stack((divergence(wide.gradient), curl(wide.gradient)), dim=1).numpy()
        offset = fit.centroid_offset.numpy()[:, None] / (_AT_BORDER * self._gauge)
        share = (1 + np.clip(offset, 0, 1)) / 2
        square = share**2 * (difference**2 - deviation.astype(np.float64) ** 2)
        finite = np.isfinite(square)
        total = self._sum_neighbours(np.where(finite, square, 0.0))
        weight = self._sum_neighbours(finite.astype(np.float64))
        return np.maximum(total, 0) / np.maximum(weight, 1e-12)

    def _sum_neighbours(self, values: Array) -> Array:
        """Return the weighted sums (n, 2, N) of values (n, 2, N) over the neighbours of each point."""
        frames, fields, points = values.shape
        return (self._weights @ values.reshape(frames * fields, points).T).T.reshape(values.shape)
