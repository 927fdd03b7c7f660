"""Time derivatives of series."""

import numpy as np
from numpy.typing import NDArray


def rate(
    values: NDArray[np.float64], times: NDArray[np.float64], window_s: float, of_std: bool = False
) -> NDArray[np.float64]:
    """Return the time derivative (F, ...) per second of values (F, ...), by local parabolas (Savitzky & Golay, 1964);
    with `of_std`, its standard deviation, where `values` are standard deviations of independent errors.

    The parabola is fitted over ``window_s``. Each run of finite values is differentiated by itself; a run shorter than
    the window gives NaN.
    """
    step = float(np.median(np.diff(times))) if len(times) > 1 else np.nan
    length = max(3, 2 * round(window_s / step / 2) + 1) if np.isfinite(step) else 3
    flat, slopes = values.reshape(len(values), -1), _slope_deviations if of_std else _slopes
    result = np.full(flat.shape, np.nan)
    for column in range(flat.shape[1]):
        finite = np.isfinite(flat[:, column])
        edges = np.flatnonzero(np.diff(np.concatenate(([0], finite.astype(np.int8), [0]))))
        for start, end in edges.reshape(-1, 2):
            if end - start >= length:
                result[start:end, column] = slopes(flat[start:end, column], length // 2) / step
    return result.reshape(values.shape)


def _slopes(values: NDArray[np.float64], half: int) -> NDArray[np.float64]:
    """Return the slope per sample at each of n values, by parabolas fitted over 2 half + 1 neighbouring samples.

    The first and last parabola give the slopes at the ends, as in `scipy.signal.savgol_filter(values, 2 * half + 1, 2,
    deriv=1)`, whose import takes half a second.
    """
    at = np.arange(-half, half + 1.0)
    bend = at**2 - (at**2).mean()  # orthogonal to the line and to the constant
    middle = np.correlate(values, at, mode="valid") / (at**2).sum()
    first, last = (samples @ bend / (bend**2).sum() for samples in (values[: len(at)], values[-len(at) :]))
    before, after = middle[0] + 2 * first * at[:half], middle[-1] + 2 * last * at[half + 1 :]
    return np.concatenate((before, middle, after))


def _slope_deviations(std: NDArray[np.float64], half: int) -> NDArray[np.float64]:
    """Return the standard deviations of `_slopes` of n values with independent errors of standard deviations `std`."""
    at = np.arange(-half, half + 1.0)
    bend = at**2 - (at**2).mean()
    weights = np.square(at / (at**2).sum() + 2 * np.outer(at, bend) / (bend**2).sum())
    variance, length = std**2, len(at)
    middle = np.correlate(variance, weights[half], mode="valid")
    ends = weights[:half] @ variance[:length], weights[half + 1 :] @ variance[-length:]
    return np.sqrt(np.concatenate((ends[0], middle, ends[1])))
