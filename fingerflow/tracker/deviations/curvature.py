"""Variance of a tracked position by displacement that is curved within the window of the point.

A window matches where the displacement, weighted by the slopes of its texture, is that of its centre on average. The
tracker corrects for a uniform mean over the window, with second derivatives that are fitted over several windows. At
the edge of slip the displacement bends within one window, and both assumptions fail: the correction is off by about as
much as it should be. The error of a position component has a standard deviation of about `_SHARE` of what second
derivatives of their size shift the mean of the window by, (n^2 - 1) / 24 times the root of the sum of their squares for
a window of n px. All of them count, and not only the Laplacian, as a texture weights them differently.

The share is from slides and presses of other seeds and ways than those of the table in `docs/accuracy.md`.
"""

import numpy as np
from numpy.typing import NDArray

from fingerflow.engines.engine import Engine
from fingerflow.kernels.array_types import Array

_SHARE = 0.8
_GAUGE = 2.0  # windows, gauge length of the fits
_EVERY = 4  # frames between two evaluations


class Curvature:
    """Variance of the positions of N points by displacement that is curved within their windows, frame by frame.

    The first and every fourth frame are evaluated. The frames behind have the variance of the latest of them, which
    goes on to grow where it has grown: an edge of slip that comes near bends the displacement within a few frames.

    Args:
        engine: computes the fits, and gives the side of a window.
        start: (N, 2) px, positions in the key frame; NaN for no point.
    """

    def __init__(self, engine: Engine, start: Array) -> None:
        self._engine, self._start, self._frames = engine, start, 0
        self._latest, self._growth = np.zeros((2, 1, len(start)), np.float32)  # growth is that in a frame

    def update(self, points: Array) -> NDArray[np.float32]:
        """Return the variance (n, N) px^2 of a position component in the next n frames, in which the points lie at
        `points` (n, N, 2) px, NaN for lost ones; it is 0 where too few neighbours are known.
        """
        number = self._frames + np.arange(len(points))
        self._frames += len(points)
        result = np.empty(points.shape[:2], np.float32)
        due = points[number % _EVERY == 0]
        evaluated = iter(curvature_variance(self._engine, self._start, due)[:, None] if len(due) else due)
        for row, behind in enumerate((number % _EVERY).tolist()):
            if not behind:
                latest = next(evaluated)
                self._growth = np.maximum(latest - self._latest, 0) / np.float32(_EVERY)
                self._latest = latest
            result[row] = self._latest + np.float32(behind) * self._growth
        return result


def curvature_variance(engine: Engine, start: Array, points: Array) -> NDArray[np.float32]:
    """Return the variance (n, N) px^2 of a position component of N points in n frames by displacement that is curved
    within their windows; 0 where too few neighbours are known.

    Args:
        engine: computes the fits, and gives the side of a window.
        start: (N, 2) px, positions in the key frame; NaN for no point.
        points: (n, N, 2) px, positions in the n frames; NaN for lost points.
    """
    window = engine.settings.window_px
    valid = np.isfinite(start[:, 0] + start[:, 1]).nonzero()[0]
    result = np.zeros(points.shape[:2], np.float32)
    if not len(valid):
        return result
    positions = start[valid]

    def gradient(values: Array) -> Array:
        return engine.fit(positions, values, positions, _GAUGE * window)[0]

    slopes = gradient(points[:, valid] - positions)
    # Each component by itself, as the graph of a bundle fits two values.
    squares = sum(np.add.reduce(np.square(gradient(slopes[:, :, part])), (-2, -1)) for part in range(2))
    squares[np.isnan(squares)] = 0
    result[:, valid] = (_SHARE * (window**2 - 1) / 24) ** 2 * squares
    return result
