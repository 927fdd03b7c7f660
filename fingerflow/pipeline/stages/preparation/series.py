"""Time derivatives of series."""

import numpy as np

from fingerflow.kernels.array_types import Series


def rate(values: Series, times: Series, window_s: float, of_std: bool = False) -> Series:
    """Return the time derivative (F, ...) per second of values (F, ...), by local parabolas (Savitzky & Golay, 1964);
    with `of_std`, its standard deviation, where `values` are standard deviations of independent errors.

    The parabola is fitted over ``window_s``. Each run of finite values is differentiated by itself; a run shorter than
    the window gives NaN.
    """
    step = float(np.median(np.diff(times))) if len(times) > 1 else np.nan
    length = max(3, 2 * round(window_s / step / 2) + 1) if np.isfinite(step) else 3
    flat, power = values.reshape(len(values), -1), 1 + of_std
    result = np.full(flat.shape, np.nan)
    if length > len(flat):
        return result.reshape(values.shape)
    weights = _slope_weights(length // 2) ** power
    for column in range(flat.shape[1]):
        finite = np.isfinite(flat[:, column]).astype(np.int8)
        for start, end in np.flatnonzero(np.diff(np.concatenate(([0], finite, [0])))).reshape(-1, 2):
            if end - start >= length:
                # This is `scipy.signal.savgol_filter(run, length, 2, deriv=1)`, whose import takes half a second: the
                # middle row of the weights for whole windows, the others for the values near both ends.
                run, half = flat[start:end, column] ** power, length // 2
                middle = np.correlate(run, weights[half], mode="valid")
                slopes = weights[:half] @ run[:length], middle, weights[half + 1 :] @ run[-length:]
                result[start:end, column] = np.concatenate(slopes) ** (1 / power) / step
    return result.reshape(values.shape)


def _slope_weights(half: int) -> Series:
    """Return the weights (L, L) of L = 2 half + 1 samples in the slope per sample of their parabola at each of them."""
    at = np.arange(-half, half + 1.0)
    bend = at**2 - (at**2).mean()  # orthogonal to the line and to the constant
    return at / (at**2).sum() + 2 * np.outer(at, bend) / (bend**2).sum()
