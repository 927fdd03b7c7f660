"""Horizontal axis of curves: normal force if it varies monotonically, else time."""

import numpy as np
import xarray as xr
from numpy.typing import NDArray
from scipy.ndimage import median_filter

from fingerflow.errors import FingerflowError
from fingerflow.schema.variable_record import Variable
from fingerflow.schema.variables import VARIABLES

_LEAST_CHANGE = 0.1  # a force is constant if it changes by less than this share of its largest value
_ABOVE_NOISE = 10.0  # a force is constant if it changes by less than this many standard deviations of a sample
_LARGEST_RETURN = 0.03  # largest decrease of a force that counts as rising, as a share of its range
_SMOOTHED = 5  # samples of a median filter that removes single outliers
_MAD_TO_STD = 1.4826


def abscissa(result: xr.Dataset, against: str | None = None) -> tuple[str, NDArray[np.float64], str]:
    """Return the horizontal axis for curves of a result: name of its variable, values (F,) of the frames, and label.

    Args:
        result: a data set with `time`.
        against: "time", or a variable of the frames such as "normal_force"; None for the normal force where that only
            rises or only falls, else time.

    Raises:
        FingerflowError: the result has no such variable with one value a frame.
    """
    name = against or ("normal_force" if varies(result, "normal_force") and is_monotonic(result) else "time")
    if name not in result or result[name].dims != ("frame",):
        raise FingerflowError(
            f"against {name!r}: the result has no such variable of the frames; choose one of "
            + ", ".join(sorted(str(key) for key in result.variables if result[key].dims == ("frame",)))
        )
    # Record for a variable that is not one of fingerflow.
    foreign = Variable(name, ("frame",), str(result[name].attrs.get("units", "1")), "")
    variable = VARIABLES.get(name, foreign)
    return name, np.asarray(variable.shown_values(result[name].values.astype(np.float64))), variable.axis_label


def varies(result: xr.Dataset, force: str) -> bool:
    """Return True if a force of the result, such as "normal_force", varies over the frames by more than a tenth of its
    largest value and more than ten times its noise.
    """
    if force not in result:
        return False
    smoothed = _smoothed(result, force)
    if len(smoothed) < 3:
        return False
    span = float(smoothed.max() - smoothed.min())
    return span > max(_LEAST_CHANGE * float(np.abs(smoothed).max()), _ABOVE_NOISE * _noise(result, force))


def is_monotonic(result: xr.Dataset) -> bool:
    """Return True if the normal force varies and only rises or only falls, apart from noise.

    Reversals of up to 3 % of its range or 3 times its noise are ignored.
    """
    smoothed = _smoothed(result, "normal_force")
    least = max(_LARGEST_RETURN * float(smoothed.max() - smoothed.min()), 3 * _noise(result, "normal_force"))
    falls = float((np.maximum.accumulate(smoothed) - smoothed).max())
    rises = float((smoothed - np.minimum.accumulate(smoothed)).max())
    return min(falls, rises) <= least


def _smoothed(result: xr.Dataset, force: str) -> NDArray[np.float64]:
    values = result[force].values.astype(np.float64)
    finite = values[np.isfinite(values)]
    return median_filter(finite, _SMOOTHED, mode="nearest") if len(finite) else finite


def _noise(result: xr.Dataset, force: str) -> float:
    """Return the standard deviation of the noise in a force of the result, from second differences over the frames,
    which ignore a steady rise.
    """
    second = np.diff(result[force].values.astype(np.float64), 2)
    second = second[np.isfinite(second)]
    return float(_MAD_TO_STD * np.median(np.abs(second)) / np.sqrt(6)) if len(second) else 0.0
