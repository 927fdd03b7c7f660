"""Distances between frames in image pattern and in brightness, computed from sampled pixels."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from fingerflow.kernels.array_types import Array
from fingerflow.kernels.library import compiled, is_present

#: Largest number of consecutive frames in which an image may jump away; if it returns later, no jump is detected.
LONGEST = 3
_BANDS = 8  # number of groups of lines that are compared separately: a tear, or lost lines, lie in a few of them
# Units of the distances of image pattern and log brightness: the least distances that count. Noise lies below the
# first, and `illumination_gain` handles changes of light smaller than the second.
_LEAST, _LEAST_LIGHT = 1e-2, 0.15
_MOST = 0.3  # difference of a pixel, in units of the mean, beyond which it counts as this: salt and pepper
_TINY = np.finfo(np.float32).tiny


class PixelSamples(NamedTuple):
    """Grey levels of sampled pixels (n, lines, pixels) of n frames, divided by their mean in each frame, and the
    logarithm (n,) of that mean.

    Single pixels, unlike means over blocks, show a motion of a tenth of a pixel. The division removes the flicker of a
    lamp.
    """

    pattern: Array
    light: Array

    @classmethod
    def of(cls, *pixels: Array) -> PixelSamples:
        """Return the samples of sampled pixels (n, lines, pixels) of frames, float32, one array after another
        (`block_means`); pixels that are not finite count as 0.
        """
        sampled = np.concatenate(pixels)
        if not np.isfinite(np.add.reduce(sampled, None)):
            sampled = np.nan_to_num(sampled, nan=0.0, posinf=0.0, neginf=0.0)
        mean = np.maximum(np.add.reduce(sampled, (1, 2)) / sampled[0].size, _TINY)
        sampled /= mean[:, None, None]
        return cls(sampled, np.log(mean))

    def rows(self, frames: slice) -> PixelSamples:
        """Return the samples of the frames in a slice."""
        return PixelSamples(self.pattern[frames], self.light[frames])

    def after(self, before: PixelSamples | None) -> PixelSamples:
        """Return the samples of a sequence that consists of the frames of `before` (None for none) followed by those of
        this object.
        """
        return self if before is None else PixelSamples(*map(np.concatenate, zip(before, self, strict=True)))


def squared_distances(samples: PixelSamples, before: PixelSamples) -> Array:
    """Return squared distances (n, bands + 2) between n pairs of frames: the squares of the mean absolute difference of
    their image patterns, in each band of lines and in the whole view, and of the difference of their log brightness.

    The unit is the least distance that counts, 0.01 in pattern and 0.15 in the logarithm of the light.

    A distance is the mean absolute difference of the patterns, of each band of lines and, in the last place but one, of
    the whole view; in the last place it is that of the light.
    """
    bands = min(_BANDS, samples.pattern.shape[1])
    result = np.empty((len(samples.light), bands + 2), np.float32)
    result[:, :-1] = _pattern_distances(samples.pattern, before.pattern, bands)
    result[:, :-1] /= _LEAST
    result[:, -1] = (samples.light - before.light) / _LEAST_LIGHT
    return np.square(result, out=result)


def _pattern_distances(now: Array, before: Array, bands: int) -> Array:
    """Return the mean absolute differences (n, bands + 1) of n pairs of image patterns (n, lines, pixels): of each band
    of lines, and of all lines.
    """
    if is_present():
        return compiled("frame_distances")(now=now, before=before, bands=bands, most=_MOST)
    difference = np.minimum(np.abs(now - before), np.float32(_MOST)).mean(2)
    edges = np.arange(bands + 1) * difference.shape[1] // bands
    of_bands = np.add.reduceat(difference, edges[:-1], axis=1) / np.diff(edges)
    return np.concatenate((of_bands, difference.mean(1, keepdims=True)), axis=1)


def squared_distances_before(samples: PixelSamples, before: PixelSamples | None) -> Array:
    """Return the squared image distances (n, LONGEST + 1, rows) of n frames from each of the `LONGEST` + 1 frames that
    precede them, nearest first; a row is a band of lines, the whole view or the brightness.

    Rows are those of `squared_distances`. They are NaN where there is no such frame. `before` has the samples of the
    frames before, as far as there are any.
    """
    sequence = samples.after(before)
    count, earlier = len(samples.light), len(sequence.light) - len(samples.light)
    parts = []
    for gap in range(1, LONGEST + 2):
        first = max(gap - earlier, 0)  # index in `samples` of the first frame with a frame this far before it
        later = slice(earlier + first, earlier + count)
        before_later = slice(later.start - gap, max(later.stop - gap, 0))
        squares = squared_distances(sequence.rows(later), sequence.rows(before_later))
        parts.append(np.full((count, squares.shape[1]), np.nan, np.float32))
        parts[-1][first:] = squares[: max(count - first, 0)]
    return np.stack(parts, axis=1)
