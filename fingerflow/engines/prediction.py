"""Prediction of point positions from frame to frame within one engine call, as in `tracker.point_prediction`."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from fingerflow.engines.engine import TRACKED, Array, TrackedPoints
from fingerflow.kernels.tracking_limits import SPEED_FRAMES, SPEED_WEIGHT


class MotionState(NamedTuple):
    """Motion of N points at a frame: positions (N, 2) px, speeds (N, 2) px per frame, mask (N,) of found points."""

    place: Array
    speed: Array
    seen: Array

    @classmethod
    def begin(cls, place: Array, speed: Array) -> MotionState:
        """Return the motion before the first frame, given positions and speeds; all points count as found."""
        return cls(place, speed, np.ones(len(place), bool))

    def expect(self) -> Array:
        """Return the positions (N, 2) px at which the points are expected in the next frame."""
        guess: Array = (self.place + self.speed).astype(np.float32)
        return guess

    def see(self, found: TrackedPoints) -> MotionState:
        """Return the motion after one more frame, given the tracking result `found` (1, N) of that frame.

        The latest displacement has half the weight in a speed: the displacement between two positions alone would carry
        their noise on. A lost point is predicted along its speed, which decays over some four frames. A point that is
        found again may lie beside its prediction; this difference is no motion and leaves its speed unchanged.
        """
        guess, tracked = self.expect(), found.status[0] == TRACKED
        missed = np.where((tracked & self.seen)[:, None], found.estimate[0] - guess, np.float32(0))
        lasting = np.where(tracked, np.float32(1), np.float32(1 - 1 / SPEED_FRAMES))[:, None]
        place = np.where(tracked[:, None], found.estimate[0], guess)
        return MotionState(
            place, (self.speed * lasting + np.float32(SPEED_WEIGHT) * missed).astype(np.float32), tracked
        )
