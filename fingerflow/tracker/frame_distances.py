"""Distances between frames in image pattern and in overall light, computed from block means."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[Any]

#: Largest number of consecutive frames after which an image that returns counts as the one before.
LONGEST = 3
# Units of distance, the least that counts: noise lies below the first; `illumination_gain` handles smaller changes.
_LEAST, _LEAST_LIGHT = 3e-3, 0.055
_TINY = np.finfo(np.float32).tiny


def divide_by_mean(blocks: Array) -> Array:
    """Divide block means (n, rows, columns) by the mean of each frame, which removes the flicker of a lamp."""
    result: Array = blocks / np.maximum(blocks.mean((1, 2), keepdims=True), _TINY)
    return result


def row_distances(blocks: Array, before: Array) -> Array:
    """Return the mean absolute difference (n, rows) of block means between pairs of frames, for each row of blocks.

    The block means are those of `divide_by_mean`.
    """
    result: Array = np.abs(blocks - before).mean(2)
    return result


def block_distances(blocks: Array, before: Array) -> Array:
    """Return the distances of each frame from the `LONGEST` + 1 frames before: one per row of blocks, and one of light.

    Args:
        blocks: (n, rows, columns) of `block_means`.
        before: (m, rows, columns) those of the frames before, as far as there are any.

    Returns:
        (n, LONGEST + 1, rows + 1): mean absolute differences of blocks over the mean of their frame, in units of the
        least that counts; in the last place that of the logarithms of the means. NaN where there is no such frame.
    """
    every = np.concatenate((before, blocks)) if len(before) else blocks
    even, light = divide_by_mean(every), np.log(np.maximum(every.mean((1, 2)), _TINY))
    result = np.full((len(blocks), LONGEST + 1, every.shape[1] + 1), np.nan, np.float32)
    for gap in range(1, LONGEST + 2):
        first = max(gap - len(before), 0)  # of `blocks`
        if first >= len(blocks):
            break
        later, earlier = slice(len(before) + first, None), slice(len(before) + first - gap, len(every) - gap)
        result[first:, gap - 1, :-1] = row_distances(even[later], even[earlier]) / _LEAST
        result[first:, gap - 1, -1] = np.abs(light[later] - light[earlier]) / _LEAST_LIGHT
    return result
