"""Effect of overlapping windows on the variance of a gradient that is fitted to the displacements of points."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[Any]

_FITS = 48  # number of points around which the factor is computed


def overlap_gain(positions: Array, window_px: int, gauge_px: float) -> float:
    """Return the factor by which the errors that points share in overlapping windows raise the variance of a gradient
    fitted over the gauge length, compared with independent errors: the median over some of the points.

    Errors of two points correlate by the share that their windows have in common. The factor is that of
    `OverlapErrors.variance_gain`, for displacements that count from the same frame.

    Args:
        positions: (N, 2) px, positions of the points; NaN for no point.
        window_px: side of a window.
        gauge_px: gauge length of the fits.
    """
    valid = positions[np.isfinite(positions).all(-1)].astype(np.float64)
    gains = []
    for centre in valid[:: max(1, len(valid) // _FITS)]:
        weight = 1 - np.square(valid - centre).sum(1) / (gauge_px / 2) ** 2
        near, weight = valid[weight > 0], np.square(weight[weight > 0])
        lever = weight[:, None] * (near - weight @ near / weight.sum())
        common = np.clip(1 - abs(near[:, None] - near) / window_px, 0, 1).prod(-1)
        alone = float(np.square(lever).sum())
        if alone > 0:
            gains.append(float(((common @ lever) * lever).sum()) / alone)
    return max(float(np.median(gains)), 1.0) if gains else 1.0
