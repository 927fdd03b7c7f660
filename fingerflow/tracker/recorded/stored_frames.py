"""Reading of what a run has stored of its frames, a few frames at a time, as it may lie in a file."""

from typing import Any

import numpy as np

from fingerflow.kernels.array_types import Numbers, Points
from fingerflow.tracker.vibration import FRAMES_READ


def runs_of_frames(frames: int) -> list[Numbers]:
    """Split the frame indices 0 to `frames` - 1 into arrays of `FRAMES_READ` consecutive indices."""
    return [np.arange(first, min(first + FRAMES_READ, frames)) for first in range(0, frames, FRAMES_READ)]


def values_at(values: Any, frames: Numbers, points: Numbers | None = None) -> Points:
    """Return the values (..., P, ...) of P points, each taken from `values` (F, N, ...) in the frame that `frames`
    (..., P) gives for it; `points` are the indices of the points, by default all.
    """
    points = np.broadcast_to(np.arange(frames.shape[-1]) if points is None else points, frames.shape)
    result = np.empty((*frames.shape, *values.shape[2:]), dtype=np.float64)
    for indices in runs_of_frames(values.shape[0]):
        here = np.nonzero((frames >= indices[0]) & (frames <= indices[-1]))
        if len(here[0]):
            result[here] = values[indices][frames[here] - indices[0], points[here]]
    return result
