"""Kernel of the distances between frames, on NumPy arrays."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from fingerflow.kernels.arrays import in_one_piece, rows_in_one_piece
from fingerflow.kernels.checks import check_axes, check_frames, check_like, checked, described
from fingerflow.kernels.library import entry, threads

Array = NDArray[Any]


def frame_patterns(frames: Array, steps: tuple[int, int], least: float) -> tuple[Array, Array]:
    """Sample one line of `steps[0]` and one pixel of `steps[1]` of frames (n, 1, H, W) of FRAME_KINDS; return the samples
    (n, lines, pixels) divided by their mean in each frame, and these means (n,), which are `least` at least, float32.

    Pixels that are not finite count as 0.

    Raises:
        TypeError, ValueError: wrong dtype or shape, or steps beyond the frame.
    """
    check_frames(frames)
    if not all(1 <= step <= side for side, step in zip(frames.shape[2:], steps, strict=True)):
        raise ValueError(f"steps of {steps} px in frames of {tuple(frames.shape[2:])}: give 1 to as many")
    read = [len(range(step // 2, side, step)) for side, step in zip(frames.shape[2:], steps, strict=True)]
    patterns, means = np.empty((len(frames), *read), np.float32), np.empty(len(frames), np.float32)
    entry("frame_patterns")(
        **described(rows_in_one_piece(frames)),
        down=steps[0],
        along=steps[1],
        least=least,
        patterns=patterns,
        means=means,
        threads=threads(),
    )
    return patterns, means


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
