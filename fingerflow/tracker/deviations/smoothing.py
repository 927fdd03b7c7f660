"""Variance of fields by the finite gauge length of the fits: at points, and of medians over the contact."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fingerflow.engines.engine import FrameFields
from fingerflow.kernels.array_types import Array
from fingerflow.kernels.arrays import squared_distances

_INSIDE = 1 / 3
_BESIDE = 11.0  # per gauge length
_SHARE = 0.2
# Variances of divergence, curl, exx, eyy and exy by independent errors of the elements of a gradient.
_ELEMENTS = np.array((2, 2, 1, 1, 1 / 2))


class SmoothingErrors:
    """Estimator of the mean square error of divergence and curl that smoothing over the gauge length causes.

    The error is a share k of the difference D to a fit over twice the gauge length, from two parts, whose squares add:

    - a fit keeps 384 J4(k)/k^4 of a wave's slope, k = pi gauge / wavelength, so that the share is 1/3 for long waves,
      which is taken, 0.42 for waves of two gauge lengths, 0.78 for waves of one;
    - a fit has the gradient at the centroid of its points, which at the border of the cloud lies beside the place by a
      length that grows with the gauge length, b = 0.15 of it on a straight border. The share is 1 for a field that is
      linear across the border, and exp(b / l) for one that falls inwards as exp(-x / l): 11 b = 1.7 for a third of a
      gauge length l.

    D is noisy, and smoothing may happen to vanish where it changes its sign: the variance is k^2 times the mean of
    D^2 - s^2 over the points within half a gauge length, s^2 the variance of the field by the errors of points, or
    times that of the point where it is larger.

    Args:
        gauge_mm: gauge length.
        positions: (N, 2) mm, positions by which points are neighbours; NaN for points without one.
    """

    def __init__(self, gauge_mm: float, positions: Array) -> None:
        self._places, self._neighbours = positions.T / gauge_mm, _Neighbours.within(gauge_mm, positions)

    def variance(self, reference: Array, displacement: Array, fields: FrameFields, wide: FrameFields) -> Array:
        """Return the variance (n, 2, N) of divergence and curl by smoothing at N points in n frames; 0 where no
        neighbour is fitted.

        Args:
            reference: (N, 2) or (n, N, 2) mm, positions from which displacement counts; NaN for points that are not
                fitted.
            displacement: (n, N, 2) mm.
            fields: divergence and curl with their standard deviations by the errors of points.
            wide: the same with twice the gauge length.
        """
        fitted = np.isfinite(reference).all(-1)
        valid = fitted & np.isfinite(displacement[..., 0] + displacement[..., 1])
        mass, x, y = self._neighbours.sums(valid, *(np.where(valid, values, 0) for values in self._places))
        # Of points from the centroids of their fits.
        along, across = (sums / np.maximum(mass, 1e-12) - at for sums, at in zip((x, y), self._places, strict=True))
        share = np.nan_to_num(_INSIDE**2 + _BESIDE**2 * (along * along + across * across))[:, None]
        plain, noise, broad = (
            np.stack([getattr(of, f"{name}{ending}") for name in ("divergence", "curl")], axis=1, dtype=np.float64)
            for of, ending in ((fields, ""), (fields, "_std"), (wide, ""))
        )
        square = np.square(plain - broad) - np.square(noise)
        known = fitted & np.isfinite(square[:, 0])  # curl is known of the same points
        square = np.where(known[:, None], square, 0.0)
        *totals, weight = self._neighbours.sums(*square.swapaxes(0, 1), known)
        mean = np.stack(totals, axis=1) / np.maximum(weight, 1e-12)[:, None]
        return share * np.maximum(np.maximum(mean, square), 0)


class _Neighbours(NamedTuple):
    """Weights of a fit over the gauge length around each of N points: numbers of the neighbours (M,), which the point
    itself is among, their weights (M,), and where those of each point start (N,).
    """

    number: NDArray[np.intp]
    weight: NDArray[np.float32]
    start: NDArray[np.intp]

    @classmethod
    def within(cls, gauge_mm: float, positions: Array) -> _Neighbours:
        """Find the neighbours of points at `positions` (N, 2); points at NaN have no weight."""
        positions = positions.astype(np.float32)
        distance = squared_distances(positions, positions)
        reach = np.float32(gauge_mm / 2) ** 2
        near = distance < reach  # False for NaN
        np.fill_diagonal(near, True)
        point, number = near.nonzero()
        weight = np.square(np.fmax(1 - distance[point, number] / reach, 0))  # 0 for NaN
        return cls(number, weight, np.searchsorted(point, np.arange(len(positions))))

    def sums(self, *values: Array) -> NDArray[np.float64]:
        """Return the weighted sums over the neighbours of several arrays of values (..., N), stacked.

        They are float32, as the variance of a variance is larger. A product with a matrix of all weights would be
        shared by threads of BLAS, which then wait for the next one at full load.
        """
        rows = np.stack([part.astype(np.float32) for part in values])
        return np.add.reduceat(rows.take(self.number, axis=-1) * self.weight, self.start, axis=-1).astype(np.float64)


def smoothing_variance(difference: Array, of_points: Array, since_onset: Array) -> Array:
    """Return the variance (n, 5) of the medians of divergence, curl, exx, eyy and exy over the contact that is due to
    the gauge length of the fits.

    Skin that sticks and skin that slips have different fields, and a median lies in the flank of what the fits blur
    between them: on slides and in a rolling contact errors are as large as the difference D to medians with twice the
    gauge length.

    Since the onset of contact fields rise smoothly to the border. Medians are those of sharpened displacements
    (`kernels.field_limits.SHARPENED`), so that the error in a dense cloud of points is proportional to the fourth power
    of the gauge length, a fifteenth of D. More is left by fits to points that lie irregularly, which take the curvature
    of the displacement for gradients of all directions, so that the four elements of a displacement gradient err alike,
    and by one-sided fits at the border. It is a fifth of D, RMS over the elements.

    Args:
        difference: (n, 5) D.
        of_points: (n, 5) variance of the medians by the errors of points, which is subtracted from D^2.
        since_onset: (n, 1) whether displacements count from the onsets of contact.
    """
    square = np.square(difference) - of_points
    of_elements = np.square(_SHARE) * (square / _ELEMENTS).mean(1, keepdims=True) * _ELEMENTS
    return np.maximum(np.where(since_onset, of_elements, square), 0)
