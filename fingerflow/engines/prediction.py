"""Where an engine expects points from frame to frame within one call, by the rule of `tracker.motion`."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from fingerflow.engines.engine import Array, FoundPoints
from fingerflow.kernels.tracking_limits import SPEED_FRAMES, SPEED_WEIGHT, TrackStatus


class Course(NamedTuple):
    """Place and speed (N, 2) px of points after a frame, and whether (N,) they were found in it."""

    place: Array
    speed: Array
    seen: Array

    @classmethod
    def begin(cls, place: Array, speed: Array) -> Course:
        """Before the first frame."""
        return cls(place, speed, np.ones(len(place), bool))

    def expect(self) -> Array:
        """(N, 2) px in the next frame."""
        guess: Array = (self.place + self.speed).astype(np.float32)
        return guess

    def see(self, found: FoundPoints) -> Course:
        """After the next frame, of which `found` (1, N) has what it shows.

        The latest displacement has half the weight in a speed: that of two positions alone would carry their noise on.
        A point that is lost is expected on where its speed leads, for some four frames; one that was lost may be found
        beside where it was expected, which is no motion.
        """
        guess, tracked = self.expect(), found.status[0] == TrackStatus.TRACKED
        missed = np.where((tracked & self.seen)[:, None], found.estimate[0] - guess, np.float32(0))
        lasting = np.where(tracked, np.float32(1), np.float32(1 - 1 / SPEED_FRAMES))[:, None]
        place = np.where(tracked[:, None], found.estimate[0], guess)
        return Course(place, (self.speed * lasting + np.float32(SPEED_WEIGHT) * missed).astype(np.float32), tracked)
