"""Kernel of block means: means of frames over blocks and over sampled lines, on NumPy arrays."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from fingerflow.kernels.arrays import rows_in_one_piece
from fingerflow.kernels.checks import check_frames, described
from fingerflow.kernels.library import entry, threads

Array = NDArray[Any]


def block_means(frames: Array, steps: tuple[int, int], blocks: tuple[int, int]) -> tuple[Array, Array]:
    """Return the means of frames (K, 1, H, W) over the blocks of a grid (K, rows, columns) and over sampled lines of
    pixels (K, lines), float32.

    They are those of `tracker.block_means`, for frames (K, 1, H, W) of FRAME_KINDS. One line of `steps[0]` and one
    pixel of `steps[1]` is read; `blocks` are the numbers of rows and columns of blocks.

    Raises:
        TypeError, ValueError: wrong dtype, or more blocks than are read.
    """
    check_frames(frames)
    read = [len(range(step // 2, side, step)) for side, step in zip(frames.shape[2:], steps, strict=True)]
    if not all(1 <= count <= most for count, most in zip(blocks, read, strict=True)):
        raise ValueError(f"{blocks} blocks of {read} lines and pixels that are read: give 1 to as many")
    means, lines = np.empty((len(frames), *blocks), np.float32), np.empty((len(frames), read[0]), np.float32)
    entry("block_means")(
        **described(rows_in_one_piece(frames)),
        down=steps[0],
        along=steps[1],
        rows=blocks[0],
        columns=blocks[1],
        blocks=means,
        lines=lines,
        threads=threads(),
    )
    return means, lines
