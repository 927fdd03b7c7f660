"""Statistics of a frame's pixels by which it is judged alone, or compared with others: means over blocks and lines, and
differences of neighbours.
"""

import functools
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from fingerflow.kernels.array_types import Array
from fingerflow.kernels.arrays import KINDS
from fingerflow.kernels.declarations import FRAME_KINDS
from fingerflow.kernels.library import compiled, is_present
from fingerflow.schema.variables import DARK, DARK_SHARE, NOISE, NOT_FINITE, SATURATED, SATURATED_SHARE, USABLE
from fingerflow.tracker.frame_copies import FrameKey, frame_key

# Least side of a block (px) and largest number of blocks along a side. Blocks are wider than the period of ridges: in
# narrower ones, ridges that move by half a period per frame would seem to stand still, or to jump and return. A tear,
# or lost lines, lie in a few rows of blocks.
_BLOCK_PX, _BLOCKS = 24, 16
_ROUGH, _ROUGHER, _ALIKE = 0.2, 2.0, 1.6  # limits of `is_noise`
_TINY = np.finfo(np.float32).tiny
_PERIOD = 16  # px, after which borders of blocks of 2, 4, 8 or 16 px repeat, and every second one of 32 px
_SAMPLES = (128, 160)  # least numbers of sampled lines, and of sampled pixels of a line; at most twice as many are read
_KEPT = 64  # least number of these lines whose pixels are returned


def block_means(frames: Array) -> tuple[Array, Array, Array]:
    """Return the means of frames (n, H, W), float32: over the rectangular blocks of a grid (n, rows, columns), of 24 x
    24 px or more, and over sampled lines of pixels (n, lines); and the sampled pixels (n, kept lines, pixels), float32,
    of some of these lines.

    There are up to 16 x 16 blocks. Some 20,000 pixels of a frame are read, every fourth of every fourth line of 512 x
    640 px, and those of every second of these lines are returned. Sums are exact for integers of up to 32 bit, so that
    equal frames have equal means; a pixel that is NaN makes its own blocks NaN.

    Raises:
        ValueError: `frames` is not (n, H, W), or has no pixels.
    """
    if frames.ndim != 3 or 0 in frames.shape[1:]:
        raise ValueError(f"frames have shape {frames.shape}: give (n, H, W)")
    (down, along), (rows, columns), every = _grid(*frames.shape[1:])
    if is_present() and KINDS[frames.dtype] in FRAME_KINDS:
        grid = {"down": down, "along": along, "rows": rows, "columns": columns, "every": every}
        blocks, lines, pixels = compiled("block_means")(frames=frames[:, None], **grid)
        return blocks, lines, pixels
    sampled = frames[:, down // 2 :: down, along // 2 :: along]
    pixels, sums = sampled[:, every // 2 :: every].astype(np.float32), sampled.astype(np.float64)
    lines = sums.mean(2)
    sums, lines_each = _sums(sums, 1, rows)
    sums, pixels_each = _sums(sums, 2, columns)
    blocks = sums / (lines_each[:, None] * pixels_each)
    return blocks.astype(np.float32), lines.astype(np.float32), pixels


class InspectedFrames(NamedTuple):
    """What n frames show by themselves.

    Attributes:
        status: (n,) uint8, indices into `FRAME_STATUS`.
        keys: of the frames (`frame_key`).
        blocks, lines: means of the contact view over blocks (n, rows, columns) and over lines (n, lines).
        pixels: of each view, sampled (n, lines, pixels).
    """

    status: Array
    keys: list[FrameKey]
    blocks: Array
    lines: Array
    pixels: Sequence[Array]


class PictureCheck:
    """Detection of frames that are no picture of the contact view: dark, saturated or noise.

    Args:
        glass, dark: (H, W) contact view of the empty glass, and without light, None if it is 0.
        bit_depth: of the frames, None for floating point.

    Attributes:
        black: level without light.
        least: mean level below which a frame is dark.
        glass: (rows, columns) means over blocks of the empty glass.
        lines: (lines,) means of sampled lines of the empty glass.
    """

    def __init__(self, glass: Array, dark: Array | None, bit_depth: int | None) -> None:
        self.black = 0.0 if dark is None else float(block_means(dark[None])[0].mean())
        (self.glass,), (self.lines,), _ = block_means(glass[None])
        self.least = self.black + DARK_SHARE * (float(self.glass.mean()) - self.black)
        self._roughness = max(_ROUGH, float(_ROUGHER * np.sqrt(strip_differences(glass[None], 1).max())))
        self._top = np.inf if bit_depth is None else 2**bit_depth - 1.5
        self._tells_saturated = float((self.glass > self._top).mean()) < SATURATED_SHARE

    def inspect(self, views: Sequence[Array]) -> InspectedFrames:
        """Judge n frames by themselves, from their views (n, H, W), the contact view first."""
        blocks, lines, pixels = zip(*map(block_means, views), strict=True)
        if views[0].dtype.kind == "f":
            blocks = tuple(np.nan_to_num(means, nan=0.0, posinf=0.0, neginf=0.0) for means in blocks)
        status = self._status(views[0], blocks[0])
        for frames in views:
            if frames.dtype.kind == "f":
                status[~np.isfinite(frames).all(axis=(1, 2))] = NOT_FINITE
        return InspectedFrames(status, list(map(frame_key, zip(*blocks, strict=True))), blocks[0], lines[0], pixels)

    def _status(self, frames: Array, blocks: Array) -> Array:
        """Return the status (n,) of the contact view (n, H, W) of n frames, whose means over blocks are `blocks`."""
        size = blocks[0].size
        status = np.where(is_noise(frames, self._roughness), np.uint8(NOISE), np.uint8(USABLE))
        if self._tells_saturated:
            status[np.add.reduce(blocks > self._top, (1, 2), float) / size > SATURATED_SHARE] = SATURATED
        status[np.add.reduce(blocks, (1, 2)) / size < self.least] = DARK
        return status


def is_noise(frames: Array, roughness: float) -> Array:
    """Return the mask (n,) of frames (n, H, W) that are no picture: noise, or lines or blocks of pixels in disorder, as
    a faulty transfer leaves them.

    Neighbouring pixels, along lines or across them, differ by more than `roughness` in units of the mean, and nearly as
    much as those 2 px apart, everywhere or at the borders of blocks of 2 to 32 px. In a picture whose finest ridges
    have a period of 4 px or more, the mean squared difference at least doubles, and mostly becomes four times as large.
    """
    near = strip_differences(frames, 1)
    noise = near > roughness**2
    if np.logical_or.reduce(noise, None):
        noise &= strip_differences(frames, 2) < _ALIKE * near
    return np.logical_or.reduce(noise, 1)


def strip_differences(frames: Array, apart: int) -> Array:
    """Return the mean squared differences (n, 32) of pixels of frames (n, H, W) that are `apart` px apart, along and
    across the lines of a frame, at each of 16 places in strips of 18 columns and of 18 lines; at each, the strip with
    the largest ones, as at an edge, is left out.

    Pixels are in units of their mean, 0.5 at least and 1.5 at most: salt and pepper have little weight.
    """
    if is_present() and KINDS[frames.dtype] in FRAME_KINDS:
        return compiled("strip_differences")(frames=frames[:, None], apart=apart)
    result = []
    for across in (frames.swapaxes(1, 2), frames):
        first = np.arange(0, max(across.shape[1] - _PERIOD - 1, 1), _PERIOD * (across.shape[1] // (8 * _PERIOD) | 1))
        numbers = (first[:, None] + np.arange(_PERIOD + 2)).ravel() % across.shape[1]  # lower frames are repeated
        lines = across[:, numbers, :: max(1, across.shape[2] // 20)]
        pixels = lines.astype(np.float32) if lines.dtype.kind != "f" else np.nan_to_num(lines, posinf=0, neginf=0)
        pixels /= np.maximum(np.add.reduce(pixels, (1, 2), keepdims=True) / pixels[0].size, _TINY)
        pixels = np.minimum(np.maximum(pixels, 0.5, out=pixels), 1.5, out=pixels)
        strips = pixels.reshape(len(frames), -1, _PERIOD + 2, pixels.shape[2])
        difference = strips[:, :, apart : _PERIOD + apart] - strips[:, :, :_PERIOD]
        squares = np.add.reduce(difference * difference, 3) / difference.shape[3]
        result.append((squares.sum(1) - squares.max(1)) / max(squares.shape[1] - 1, 1))
    return np.concatenate(result, 1)


@functools.cache
def _grid(height: int, width: int) -> tuple[tuple[int, int], tuple[int, int], int]:
    """Return, for frames of `height` x `width` px, the steps at which lines and the pixels of a line are sampled, the
    numbers of rows and columns of blocks into which a frame is divided, and the step at which sampled lines are kept.
    """
    sides = height, width
    down, along = (max(1, side // samples) for side, samples in zip(sides, _SAMPLES, strict=True))
    read = [len(range(step // 2, side, step)) for side, step in zip(sides, (down, along), strict=True)]
    rows, columns = (min(max(1, side // _BLOCK_PX), _BLOCKS, count) for side, count in zip(sides, read, strict=True))
    return (down, along), (rows, columns), max(1, read[0] // _KEPT)


def _sums(values: Array, axis: int, pieces: int) -> tuple[Array, Array]:
    """Split an axis of `values` into `pieces` parts of equal length; return the sums over each part, by which the axis
    shrinks to `pieces`, and the number of values in each part.

    Neighbouring pieces share a value where the axis is no multiple of their number.
    """
    side = values.shape[axis]
    parts = [range(piece * side // pieces, -(-(piece + 1) * side // pieces)) for piece in range(pieces)]
    sums = np.stack([np.take(values, part, axis).sum(axis) for part in parts], axis)
    return sums, np.array([len(part) for part in parts])
