"""Variance of a median over the contact by the finite gauge length."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[Any]


def smoothing_variance(difference: Any, of_points: Any, single: Any, values: Array) -> Array:
    """Return the variance (...) of medians of fields over the contact that is due to the gauge length of the fits.

    The error by smoothing is proportional to the square of the gauge length, and so a third of the difference D to the
    median with twice the length. The noise s of a single fit shifts a median that lies in the flank of a distribution:
    by s at most, and by s^2 / w where the distribution is wider, w the range between its quantiles of 40 and 60 %. With
    twice the length little of this noise is left, so that up to this size all of D is error.

    Args:
        difference: (...) D.
        of_points: (...) variance of the median by the errors of points, which is subtracted from D^2.
        single: (...) s.
        values: (..., N) values of the fields at points, NaN where unknown; NaN is returned for no points at all.
    """
    if not values.shape[-1]:
        return np.full(values.shape[:-1], np.nan)
    ordered = np.sort(values, axis=-1)  # NaN last
    last = np.maximum(np.isfinite(values).sum(-1, keepdims=True) - 1, 0)
    low, high = (np.take_along_axis(ordered, (share * last).astype(int), -1)[..., 0] for share in (0.4, 0.6))
    noise = single * np.minimum(1, single / np.maximum(high - low, 1e-12))
    square = np.maximum(np.square(difference) - of_points, 0)
    return np.fmax(square / 9, np.minimum(square, noise**2))
