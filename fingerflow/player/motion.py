"""Where points are expected in frames to come."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from .arrays import Array


class Motion(NamedTuple):
    """Where points are expected: where each was seen last, or by its neighbours, and on at its own speed.

    A speed is the mean of those seen, the last one with half the weight: that of two positions alone would carry their
    noise as many frames ahead as are asked for.

    Attributes:
        place: (1, N, 2) px in frame `number`, NaN where there is no point.
        speed: px a frame.
        missing: (1, N) for how many frames it was not found, 0 where it was.
        known: (1, N) whether it was found, or its neighbours said where it is.
        jolted: (1, N) whether that was not where any motion leads: a search has found it, or its neighbours.
    """

    place: Array
    speed: Array
    missing: Array
    known: Array
    jolted: Array
    number: int

    @classmethod
    def at_rest(cls, points: Array, number: int) -> Motion:
        """Points (1, N, 2) px of a frame."""
        known = np.isfinite(points).all(-1)
        missing = np.where(known, 0, _NEVER)
        return cls(points, np.zeros_like(points), missing, known, np.zeros_like(known), number)

    def of_others(self, points: Array, number: int) -> Motion:
        """Points (1, N, 2) px of a frame with the speed that those nearest to them have that are followed now.

        It is the median of the nearest ones, of each component; where fewer are known they are at rest.
        """
        others = Motion.at_rest(points, number)
        seen, given = np.flatnonzero(self.missing[0] == 0), np.flatnonzero(others.known[0])
        if len(seen) < _AROUND:
            return others
        apart = np.square(points[0][given, None] - self.place[0][None, seen]).sum(-1)
        nearest = seen[np.argpartition(apart, _AROUND - 1, axis=1)[:, :_AROUND]]
        others.speed[0, given] = np.median(self.speed[0, nearest], axis=1)
        return others

    def see(
        self, points: Array, number: int, by_neighbours: Array | None = None, jolted: Array | None = None
    ) -> Motion:
        """After a later frame.

        Args:
            points: (1, N, 2) px, NaN where lost.
            number: of the frame.
            by_neighbours: (1, N, 2) px where the neighbours of each expect it, NaN where too few are known.
            jolted: (1, N) of those for which this is not where any motion leads.
        """
        frames = max(1, number - self.number)  # in the frame in which they were chosen they are at rest
        seen = np.isfinite(points).all(-1)
        if by_neighbours is not None:
            there = seen[..., None] | ~np.isfinite(self.place)
            points = np.where(there, points, by_neighbours).astype(points.dtype)
        known = np.isfinite(points).all(-1)
        jolted = np.zeros_like(known) if jolted is None else jolted & known
        # One that was lost may be found beside where it was expected, and one jolt is no motion: two are.
        moved = known & self.known & (self.jolted | ~jolted)
        faster = np.where(moved[..., None], _NEWEST * ((points - self.place) / frames - self.speed), 0)
        lasting = np.where(known, 1, 1 - 1 / TRUSTED).astype(points.dtype)[..., None]
        place = np.where(known[..., None], points, self.place + self.speed * min(frames, TRUSTED))
        missing = np.where(seen, 0, np.minimum(self.missing + frames, _NEVER))
        return Motion(place, self.speed * lasting + faster, missing, known, jolted, number)

    def without(self, points: Array) -> Motion:
        """Those that are NaN in `points` (1, N, 2) are not followed any more."""
        return self._replace(place=np.where(np.isfinite(points), self.place, np.nan).astype(points.dtype))

    def expect(self, number: int) -> Array:
        """(1, N, 2) px in a frame that may not have come yet."""
        place: Array = self.place + self.speed * min(number - self.number, TRUSTED)
        return place


_NEWEST = 0.5  # weight of the speed seen last
_NEVER = 10**6  # frames: a point that there is not
_AROUND = 8  # points from which others take their speed
TRUSTED = 4  # frames that a speed is good for: after them a point waits for what comes


def count_known(points: Array) -> int:
    """Of points (1, N, 2), those that are not NaN."""
    return int(np.isfinite(points).all(-1).sum())
