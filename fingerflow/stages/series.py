"""Medians and rates of what stands beside the frames."""

import numpy as np
from numpy.typing import NDArray
from scipy.signal import savgol_filter


def nanmedian(values: NDArray[np.floating]) -> NDArray[np.float64]:
    """Medians (F, ...) over the second axis of values (F, N, ...), of what is not NaN; NaN where nothing is."""
    if values.shape[1] == 0:
        return np.full((len(values), *values.shape[2:]), np.nan)
    ordered = np.sort(values, axis=1)  # NaN last
    known = (~np.isnan(ordered)).sum(1, keepdims=True)
    middle = [np.take_along_axis(ordered, np.maximum(rank, 0), axis=1) for rank in ((known - 1) // 2, known // 2)]
    result: NDArray[np.float64] = np.where(known > 0, (middle[0] + middle[1]) / 2, np.nan).squeeze(1).astype(np.float64)
    return result


def rate(values: NDArray[np.float64], times: NDArray[np.float64], window_s: float) -> NDArray[np.float64]:
    """Time derivative (F, ...) per second: the slope of a parabola fitted over ``window_s`` (Savitzky & Golay 1964).

    Each run of finite values is differentiated by itself; a run shorter than the window gives NaN.
    """
    step = float(np.median(np.diff(times))) if len(times) > 1 else np.nan
    length = max(3, 2 * round(window_s / step / 2) + 1) if np.isfinite(step) else 3
    flat = values.reshape(len(values), -1)
    result = np.full(flat.shape, np.nan)
    for column in range(flat.shape[1]):
        finite = np.isfinite(flat[:, column])
        edges = np.flatnonzero(np.diff(np.concatenate(([0], finite.astype(np.int8), [0]))))
        for start, end in edges.reshape(-1, 2):
            if end - start >= length:
                result[start:end, column] = savgol_filter(flat[start:end, column], length, 2, deriv=1, delta=step)
    return result.reshape(values.shape)
