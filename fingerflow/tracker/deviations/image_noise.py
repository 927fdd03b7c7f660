"""Variance of displacements by image noise."""

import numpy as np

from fingerflow.kernels.array_types import Array
from fingerflow.tracker.onset import Touching


def noise_variance(now: Array, touch: Touching, adds_up: bool = False) -> Array:
    """Return the variance (F, N) px^2, due to image noise, of a component of each point's displacement since its touch
    began, given the variance `now` (F, N) of the present positions.

    The reference is a weighted mean of the positions in two frames. In the frame in which a touch begins, the later of
    them is the position `now` itself. Half of a position's variance is noise of the key frame's template, the same in
    every frame. It cancels in the difference of two positions, unless one of them is that of the key frame, which is
    exact.

    If the template is the previous frame, the variance of a position `adds_up` over the frames, and that of a
    difference is the difference of both.
    """
    rest = np.square(1 - touch.share)  # squared weight of the frame before the touch
    if adds_up:
        return abs(now - touch.variance) + rest * abs(touch.variance - touch.earlier)
    then = np.where(touch.variance > 0, touch.variance, now)
    earlier = np.where(touch.earlier > 0, touch.earlier, now)
    return (np.where(touch.begins, rest * now, now + np.square(touch.share) * then) + rest * earlier) / 2
