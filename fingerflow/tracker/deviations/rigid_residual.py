"""Deviations of what the best rigid motion of all points leaves of their displacements."""

import numpy as np

from fingerflow.kernels.array_types import Array
from fingerflow.kernels.arrays import nanmedian

# Measured on presses, slides and partial slips of real prints: the error of the rigid motion of least squares over the
# median deviation of the points, and that of the median length over their mean deviation by curvature within windows,
# which pulls all skin beside slip alike, and by the time of onset, most of which is that of single points.
_OF_MOTION, _OF_CURVATURE, _OF_ONSET = 0.5, 1.4, 0.25
#: Median length of a vector with two components of the deviation 1.
MEDIAN_LENGTH = float(np.sqrt(2 * np.log(2)))


def residual_deviations(
    length: Array, median: Array, square: Array, noise: Array, curvature: Array
) -> tuple[Array, Array]:
    """Return two standard deviations, mm: that of a component of the residual displacement of N points in n frames
    (n, N), and that of the median length of these residuals (n,).

    Noise adds sqrt(median^2 + b^2) - median at most to a length whose median would be b without a residual.

    Args:
        length: (n, N) mm, of the residuals, NaN where unknown.
        median: (n,) mm, of it.
        square: (n, N) mm^2, mean square error of a displacement component.
        noise, curvature: (n, N) mm^2, parts of it by image noise and by displacement that is curved within windows; the
            rest is by the time of onset.
    """
    known = np.isfinite(length)
    deviation = np.sqrt(np.where(known, square, np.nan))
    parts = np.where(known, np.maximum((noise, curvature, square - noise - curvature), 0), 0)
    by_noise, by_curvature, by_onset = np.sqrt(parts).sum(2) / np.maximum(known.sum(1), 1)
    alone = MEDIAN_LENGTH * by_noise
    added = alone**2 / np.maximum(np.maximum(median, alone), 1e-12)
    of_median = np.sqrt(added**2 + (_OF_CURVATURE * by_curvature) ** 2 + (_OF_ONSET * by_onset) ** 2)
    return np.hypot(deviation, _OF_MOTION * nanmedian(deviation)[:, None]), of_median
