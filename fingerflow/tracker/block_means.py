"""Statistics of a frame's pixels by which it is judged alone, or compared with others: means over blocks and lines, and
differences of neighbours.
"""

from __future__ import annotations

import functools
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fingerflow.kernels.arrays import KINDS
from fingerflow.kernels.declarations import FRAME_KINDS
from fingerflow.kernels.library import compiled, is_present

Array = NDArray[Any]

# Least side of a block (px) and largest number of blocks along a side. Blocks are wider than the period of ridges: in
# narrower ones, ridges that move by half a period per frame would seem to stand still, or to jump and return. A tear,
# or lost lines, lie in a few rows of blocks.
_BLOCK_PX, _BLOCKS = 24, 16
_ROUGH, _ROUGHER, _UNCORRELATED = 0.3, 2.0, 0.5  # limits of `is_noise`
_SAMPLES = (128, 160)  # least numbers of sampled lines, and of sampled pixels of a line; at most twice as many are read


def block_means(frames: Array) -> tuple[Array, Array]:
    """Return the means of frames (n, H, W), float32: over the rectangular blocks of a grid (n, rows, columns), of 24 x
    24 px or more, and over sampled lines of pixels (n, lines).

    There are up to 16 x 16 blocks. Some 20,000 pixels of a frame are read, every fourth of every fourth line of 512 x
    640 px. Sums are exact for integers of up to 32 bit, so that equal frames have equal means; a pixel that is NaN
    makes its own blocks NaN.

    Raises:
        ValueError: `frames` is not (n, H, W), or has no pixels.
    """
    if frames.ndim != 3 or 0 in frames.shape[1:]:
        raise ValueError(f"frames have shape {frames.shape}: give (n, H, W)")
    (down, along), (rows, columns) = _grid(*frames.shape[1:])
    if is_present() and KINDS[frames.dtype] in FRAME_KINDS:
        grid = {"down": down, "along": along, "rows": rows, "columns": columns}
        blocks, lines = compiled("block_means")(frames=frames[:, None], **grid)
        return blocks, lines
    sums = frames[:, down // 2 :: down, along // 2 :: along].astype(np.float64)
    lines = sums.mean(2)
    sums, lines_each = _sums(sums, 1, rows)
    sums, pixels_each = _sums(sums, 2, columns)
    blocks = sums / (lines_each[:, None] * pixels_each)
    return blocks.astype(np.float32), lines.astype(np.float32)


def is_noise(frames: Array, roughness: float) -> Array:
    """Return the mask (n,) of frames (n, H, W) that are noise without a picture: neighbouring pixels, along lines and
    across them, differ by more than `roughness` in units of the mean, and nearly as much as pixels far apart.

    The mean squared difference of independent pixels is twice their variance. Of prints with ridges down to 4 px apart
    it is less than 0.1 of the variance, however fast a contact grows or slides.
    """
    pixels, right, below = _neighbours(frames)
    limit = (roughness / pixels.shape[1] * np.add.reduce(pixels, 1)) ** 2
    noise: Array = _square(pixels, right) > limit
    if np.logical_or.reduce(noise):
        least = np.minimum(_square(pixels, right), _square(pixels, below))
        noise = least > np.maximum(limit, _UNCORRELATED * pixels.var(1))
    return noise


def noise_roughness(glass: Array) -> float:
    """Return the least roughness of noise, 0.3 or twice that of the empty glass (H, W): the pixels of a colour camera
    differ.
    """
    pixels, right, _ = _neighbours(glass[None])
    return max(_ROUGH, float(_ROUGHER * np.sqrt(_square(pixels, right)[0]) / max(pixels.mean(), 1)))


def _neighbours(frames: Array) -> list[Array]:
    """Return some 1500 pixels of frames, and their neighbours along lines and across them, as (n, pixels)."""
    count, height, width = frames.shape
    down, along = max(1, height // 32), max(1, width // 48)
    grids = []
    for y, x in ((0, 0), (0, width > 1), (height > 1, 0)):
        grid = frames[:, y : max(height - 1, 1) + y : down, x : max(width - 1, 1) + x : along].reshape(count, -1)
        grids.append(grid.astype(np.float32) if grid.dtype.kind != "f" else np.nan_to_num(grid, posinf=0, neginf=0))
    return grids


def _square(pixels: Array, neighbours: Array) -> Array:
    difference = neighbours - pixels
    return np.add.reduce(difference * difference, 1) / pixels.shape[1]


@functools.cache
def _grid(height: int, width: int) -> tuple[tuple[int, int], tuple[int, int]]:
    """Return, for frames of `height` x `width` px, the steps at which lines and the pixels of a line are sampled, and
    the numbers of rows and columns of blocks into which a frame is divided.
    """
    sides = height, width
    down, along = (max(1, side // samples) for side, samples in zip(sides, _SAMPLES, strict=True))
    read = (len(range(step // 2, side, step)) for side, step in zip(sides, (down, along), strict=True))
    rows, columns = (min(max(1, side // _BLOCK_PX), _BLOCKS, count) for side, count in zip(sides, read, strict=True))
    return (down, along), (rows, columns)


def _sums(values: Array, axis: int, pieces: int) -> tuple[Array, Array]:
    """Split an axis of `values` into `pieces` parts of equal length; return the sums over each part, by which the axis
    shrinks to `pieces`, and the number of values in each part.

    Neighbouring pieces share a value where the axis is no multiple of their number.
    """
    side = values.shape[axis]
    parts = [range(piece * side // pieces, -(-(piece + 1) * side // pieces)) for piece in range(pieces)]
    sums = np.stack([np.take(values, part, axis).sum(axis) for part in parts], axis)
    return sums, np.array([len(part) for part in parts])
