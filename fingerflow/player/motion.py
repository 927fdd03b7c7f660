"""Where points are expected in frames to come."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from .arrays import Array


class Motion(NamedTuple):
    """Where points are expected: where each was seen last, and on at its own speed.

    A speed is the mean of those seen, the last one with half the weight: that of two positions alone would carry their
    noise as many frames ahead as are asked for.

    Attributes:
        place: (1, N, 2) px in frame `number`, NaN where there is no point.
        speed: px a frame.
        seen: whether it was, in that frame.
    """

    place: Array
    speed: Array
    seen: Array
    number: int

    @classmethod
    def at_rest(cls, points: Array, number: int) -> Motion:
        """Points (1, N, 2) px of a frame."""
        return cls(points, np.zeros_like(points), np.isfinite(points), number)

    def see(self, points: Array, number: int) -> Motion:
        """After a later frame with these points, NaN where lost."""
        frames = max(1, number - self.number)  # in the frame in which they were chosen they are at rest
        seen = np.isfinite(points)
        # One that was lost may be found beside where it was expected, which is no motion.
        faster = np.where(seen & self.seen, _NEWEST * ((points - self.place) / frames - self.speed), 0)
        lasting = np.where(seen, 1, 1 - 1 / _TRUSTED).astype(points.dtype)
        moved = self.speed * min(frames, _TRUSTED)
        return Motion(np.where(seen, points, self.place + moved), self.speed * lasting + faster, seen, number)

    def without(self, points: Array) -> Motion:
        """Those that are NaN in `points` (1, N, 2) are not followed any more."""
        return self._replace(place=np.where(np.isfinite(points), self.place, np.nan).astype(points.dtype))

    def expect(self, number: int) -> Array:
        """(1, N, 2) px in a frame that may not have come yet."""
        place: Array = self.place + self.speed * min(number - self.number, _TRUSTED)
        return place


_NEWEST = 0.5  # weight of the speed seen last
_TRUSTED = 4  # frames that a speed is good for: after them a point waits for what comes


def count_known(points: Array) -> int:
    """Of points (1, N, 2), those that are not NaN."""
    return int(np.isfinite(points).all(-1).sum())
