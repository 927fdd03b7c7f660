"""Padding of arrays to equal numbers of points, so that recordings can be stacked.

Added points are NaN, or 0 in integer arrays.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from itertools import accumulate, pairwise

import numpy as np

from fingerflow.engines.engine import Array


def filled(array: Array, points: int, axis: int = 0) -> Array:
    """Pad an array to `points` entries along an axis, with NaN for floating point, else 0."""
    missing = points - array.shape[axis]
    if not missing:
        return array
    shape = list(array.shape)
    shape[axis] = missing
    nothing = np.nan if array.dtype.kind == "f" else 0
    return np.concatenate((array, np.full(shape, nothing, array.dtype)), axis=axis)


def stacked(arrays: Sequence[Array], points: int = 0) -> Array:
    """Stack one array (N, ...) of each of B recordings to (B, N, ...), padded to the largest N, or to `points`."""
    most = max(points, *map(len, arrays))
    return np.stack([filled(one, most) for one in arrays])


def parts(counts: Iterable[int]) -> list[slice]:
    """Return the slice of each part in a concatenation; `counts` are the lengths of the parts."""
    return [slice(*ends) for ends in pairwise(accumulate(counts, initial=0))]
