"""Vibration of the whole image, as of a camera or its mount, found by the motion that all points have in common."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from fingerflow.kernels.arrays import nanmedian

Values = Any  # array with frames along the first axis, in memory or in a file

#: Number of frames of a result that are read at a time.
FRAMES_READ = 64
_WINDOW = 12  # frames, the period of which a smooth path has half
_LEAST_FRAMES = 3 * _WINDOW
_COMPARED = 150  # least number of points of which steps are taken, if there are as many; at most twice as many
_FEWEST = 12  # least number of points in contact, and of points beside it, of whose steps the medians are compared
# Least root mean square of a component, in px, in each quarter of the frames, largest share of it by which skin in
# contact and beside it differ, and least share of the largest quarter in every quarter: a jerk of the finger has less.
_LEAST_PX, _DIFFERS, _STEADY = 0.02, 0.5, 0.25


def vibration(
    position: Values, in_contact: Values, frames: NDArray[np.intp], mm_per_px: float
) -> tuple[NDArray[np.float64], float]:
    """Return the displacement (F, 2) mm of the image by vibration, and its root mean square, px; 0 in all frames if
    there is none.

    It is what a smooth path leaves of the median path of the points, if skin in contact and skin beside it have it in
    common: glass holds the skin in contact, so that a finger that trembles moves the skin beside it alone. Next to
    frames that do not count it is off by up to half.

    Args:
        position: (F, N, 2) mm, NaN for points not tracked.
        in_contact: (F, N) bool.
        frames: numbers of the usable frames.
    """
    result, steps = np.zeros((position.shape[0], 2)), np.full((len(frames), 3, 2), np.nan)
    some = slice(None, None, max(1, position.shape[1] // _COMPARED))
    before = np.full(position[:1][:, some].shape, np.nan)
    for first in range(int(frames[0]), int(frames[-1]) + 1, FRAMES_READ):
        rows = np.flatnonzero((frames >= first) & (frames < first + FRAMES_READ))
        if not len(rows):
            continue
        read = slice(first, first + FRAMES_READ)
        here, inside = (values[read][frames[rows] - first][:, some] for values in (position, in_contact))
        moved, before = np.diff(here, axis=0, prepend=before), here[-1:]
        seen = np.isfinite(moved[..., 0])
        for side, group in enumerate((seen, seen & inside, seen & ~inside)):
            medians = nanmedian(np.where(group[..., None], moved, np.nan))
            steps[rows, side] = np.where(group.sum(1)[:, None] >= _FEWEST, medians, np.nan)
    both = np.isfinite(steps).all((1, 2))
    if both.sum() <= _LEAST_FRAMES:
        return result, 0.0
    # Of the steps, as the path has a jump where a group begins.
    fast = _fast(np.nan_to_num(steps[1:]))[both[1:], 1:]  # the first step is not known
    quarters = [np.square(part).mean(0).max() for part in np.array_split(fast[:, 1], 4)]
    size, differs = np.sqrt(min(quarters)), np.sqrt(np.square(fast[:, 1] - fast[:, 0]).mean(0).max())
    steady = size > _STEADY * np.sqrt(max(quarters))
    if size > _LEAST_PX * mm_per_px and differs < _DIFFERS * size and steady:
        result[frames] = _fast(np.nan_to_num(steps[:, 0]).cumsum(0))
    return result, float(np.sqrt(np.square(result).mean(0).sum())) / mm_per_px


def vibration_warning(vibration_px: float, counted: str) -> str:
    """Return the warning of a vibration; `counted` says what contains it."""
    return (
        f"the whole image vibrates, by {vibration_px:.2g} px RMS: {counted}. Check what shakes the camera: a fan, a "
        "motor, a loose mount"
    )


def _fast(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return what is left of series (F, ...) beside smooth ones: those whose sum of squared third differences, weighted
    so that a period of `_WINDOW` frames is halved, plus that of the squared deviations is least (Whittaker 1923).
    """
    columns = values.reshape(len(values), -1)
    # Both ends go on by linear prediction, as a smooth series could follow a vibration up to its end.
    columns = _predicted(_predicted(columns)[::-1])[::-1]
    # A series that is mirrored at its ends, less the line between them, is periodic and smooth there.
    line = columns[0] + np.linspace(0, 1, len(columns))[:, None] * (columns[-1] - columns[0])
    odd = np.concatenate((columns - line, (line - columns)[-2:0:-1]))
    turns = 2 - 2 * np.cos(2 * np.pi * np.fft.rfftfreq(len(odd)))  # the factor of a second difference
    share = turns**3 / (turns**3 + (2 - 2 * np.cos(2 * np.pi / _WINDOW)) ** 3)
    fast = np.fft.irfft(np.fft.rfft(odd, axis=0) * share[:, None], len(odd), axis=0)[_WINDOW : len(columns) - _WINDOW]
    return fast.reshape(values.shape)


def _predicted(columns: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return series (F, C) with `_WINDOW` values more, each predicted from as many before it."""
    parts = np.lib.stride_tricks.sliding_window_view(columns, _WINDOW + 1, axis=0)
    result = np.concatenate((columns, np.zeros((_WINDOW, columns.shape[1]))))
    for k, part in enumerate(parts.swapaxes(0, 1)):
        weights = np.linalg.lstsq(part[:, :-1], part[:, -1], rcond=1e-6)[0]
        for frame in range(len(columns), len(result)):
            result[frame, k] = result[frame - _WINDOW : frame, k] @ weights
    return result
