"""How far frames are from those before them, whatever moves in them and however the lamp flickers."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[Any]

#: Frames in a row, at most, after which a picture that comes back counts as the one before.
LONGEST = 3
# Least distances that count: below the first lies noise, and light that changes by less is what `light_gain` is for.
_LEAST, _LEAST_LIGHT = 3e-3, 0.055
_TINY = np.finfo(np.float32).tiny


def evened(blocks: Array) -> Array:
    """(n, rows, columns) block means over the mean of their frame: a lamp that flickers changes none."""
    result: Array = blocks / np.maximum(blocks.mean((1, 2), keepdims=True), _TINY)
    return result


def row_distances(blocks: Array, before: Array) -> Array:
    """(n, rows) mean absolute differences of rows of evened blocks."""
    result: Array = np.abs(blocks - before).mean(2)
    return result


def block_distances(blocks: Array, before: Array) -> Array:
    """How far each frame is from the `LONGEST` + 1 before it: in rows of blocks, and in its light.

    Args:
        blocks: (n, rows, columns) of `block_means`.
        before: (m, rows, columns) those of the frames before, as far as there are any.

    Returns:
        (n, LONGEST + 1, rows + 1): mean absolute differences of blocks over the mean of their frame, in units of what
        counts at least; and the last, that of the logarithms of the means, likewise. NaN where there is no such frame.
    """
    every = np.concatenate((before, blocks)) if len(before) else blocks
    even, light = evened(every), np.log(np.maximum(every.mean((1, 2)), _TINY))
    result = np.full((len(blocks), LONGEST + 1, every.shape[1] + 1), np.nan, np.float32)
    for gap in range(1, LONGEST + 2):
        first = max(gap - len(before), 0)  # of `blocks`
        if first >= len(blocks):
            break
        later, earlier = slice(len(before) + first, None), slice(len(before) + first - gap, len(every) - gap)
        result[first:, gap - 1, :-1] = row_distances(even[later], even[earlier]) / _LEAST
        result[first:, gap - 1, -1] = np.abs(light[later] - light[earlier]) / _LEAST_LIGHT
    return result
