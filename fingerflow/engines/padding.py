"""Arrays of several recordings as one: those of fewer points are filled up with points that are NaN, or 0."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from itertools import accumulate, pairwise

import numpy as np

from fingerflow.engines.engine import Array


def filled(array: Array, points: int, axis: int = 0) -> Array:
    """Return an array with so many points along an axis."""
    missing = points - array.shape[axis]
    if not missing:
        return array
    shape = list(array.shape)
    shape[axis] = missing
    nothing = np.nan if array.dtype.kind == "f" else 0
    return np.concatenate((array, np.full(shape, nothing, array.dtype)), axis=axis)


def stacked(arrays: Sequence[Array]) -> Array:
    """Return arrays (N, ...) of B recordings as one (B, N, ...) of the most points."""
    most = max(map(len, arrays))
    return np.stack([filled(one, most) for one in arrays])


def parts(counts: Iterable[int]) -> list[slice]:
    """Return where each of several parts of so many elements lies in all of them."""
    return [slice(*ends) for ends in pairwise(accumulate(counts, initial=0))]
