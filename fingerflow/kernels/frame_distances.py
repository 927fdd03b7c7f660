"""Kernel of the distances between frames, on NumPy arrays."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from fingerflow.kernels.arrays import in_one_piece
from fingerflow.kernels.checks import check_axes, check_like, checked
from fingerflow.kernels.library import entry, threads

Array = NDArray[Any]


def frame_distances(now: Array, before: Array, bands: int, most: float) -> Array:
    """Return the mean absolute differences (n, bands + 1) of the grey levels of n pairs of sampled frames (n, lines,
    pixels), float32: of each band of lines, and of all lines. A difference counts as `most` at most.

    Raises:
        ValueError: wrong dtype, inconsistent shapes, frames without a pixel, or not 1 to `lines` bands.
    """
    check_axes("now", now, 3)
    check_like("now", now, "float32", now.shape)
    pairs, lines, pixels = now.shape
    if not pixels or not 1 <= bands <= lines:
        raise ValueError(f"{bands} bands of {lines} lines of {pixels} pixels: give 1 to {lines}, and pixels")

    distances = np.empty((pairs, bands + 1), np.float32)
    entry("frame_distances")(
        now=in_one_piece(now),
        before=checked("before", before, "float32", now.shape),
        pairs=pairs,
        lines=lines,
        pixels=pixels,
        bands=bands,
        most=most,
        distances=distances,
        threads=threads(),
    )
    return distances
