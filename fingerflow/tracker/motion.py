"""Where points are expected in frames to come."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fingerflow.kernels.tracking_limits import SPEED_FRAMES, SPEED_WEIGHT

Array = NDArray[Any]

TRUSTED = int(SPEED_FRAMES)  # frames that a speed is good for: after them a lost point waits for what comes
_NEVER = 10**6  # frames: a point that there is not
_AROUND = 8  # points from which new ones take their speed


class PointMotion(NamedTuple):
    """Where N points were seen last, or where their neighbours say that they are, and their speed.

    A speed is the mean of the displacements seen, the last one with half the weight: that of two positions alone would
    carry their noise as many frames ahead as are asked for.

    Attributes:
        place: (N, 2) px, NaN where there is no point.
        speed: (N, 2) px a frame.
        missing: (N,) frames for which a point was not found, 0 where it was.
        known: (N,) whether it was found, or its neighbours said where it is.
        jolted: (N,) whether that was not where any motion leads: a search has found it.
    """

    place: Array
    speed: Array
    missing: Array
    known: Array
    jolted: Array

    @classmethod
    def at_rest(cls, points: Array) -> PointMotion:
        """Points (N, 2) px that nothing is known of but where they are."""
        known = known_of(points)
        return cls(points, np.zeros_like(points), np.where(known, 0, _NEVER), known, np.zeros_like(known))

    def seeded(self, points: Array) -> PointMotion:
        """New points (N, 2) px of the same frame, with the speed of those around them.

        It is the median of the eight nearest that are found, of each component; where fewer are known, 0.
        """
        others = PointMotion.at_rest(points)
        seen, given = np.flatnonzero(self.missing == 0), np.flatnonzero(others.known)
        if len(seen) >= _AROUND:
            apart = np.square(points[given, None] - self.place[None, seen]).sum(-1)
            nearest = seen[np.argpartition(apart, _AROUND - 1, axis=1)[:, :_AROUND]]
            others.speed[given] = np.median(self.speed[nearest], axis=1)
        return others

    def expect(self, frames: int = 1) -> Array:
        """(N, 2) px so many frames ahead."""
        place: Array = self.place + self.speed * np.float32(min(frames, TRUSTED))
        return place

    def see(
        self, points: Array, frames: int = 1, by_neighbours: Array | None = None, jolted: Array | None = None
    ) -> PointMotion:
        """After a frame so many frames later.

        Args:
            points: (N, 2) px, NaN where lost.
            frames: since the last one.
            by_neighbours: (N, 2) px where the neighbours of each expect it, NaN where too few are known.
            jolted: (N,) points that are not where any motion leads.
        """
        points = points.copy()
        known = known_of(points)
        lost = np.flatnonzero(~known)
        missing = np.zeros_like(self.missing)
        if len(lost):
            missing[lost] = np.minimum(self.missing[lost] + frames, _NEVER)
            if by_neighbours is not None:
                told = lost[known_of(self.place[lost]) & known_of(by_neighbours[lost])]
                points[told] = by_neighbours[told]
                known[told] = True
        jolted = np.zeros_like(known) if jolted is None else jolted & known
        # A point that was lost may be found beside where it was expected, and one jolt is no motion: two are.
        moved = known & self.known & (self.jolted | ~jolted)
        change = (points - self.place) / np.float32(frames) - self.speed
        change *= np.float32(SPEED_WEIGHT)
        change[~moved] = 0
        change += self.speed
        if len(lost) and len(gone := lost[~known[lost]]):
            points[gone] = self.expect(frames)[gone]
            change[gone] = self.speed[gone] * np.float32(1 - 1 / SPEED_FRAMES)
        return PointMotion(points, change, missing, known, jolted)

    def followed(self, place: Array, speed: Array, points: Array, frames: int, by_neighbours: Array) -> PointMotion:
        """After frames that were followed in one call, to `place` with `speed` (N, 2): what neighbours say of points
        that are lost in the last one (`points`). Arguments as for `see`.
        """
        after = self.see(points, frames, by_neighbours)
        asked = (after.known & (after.missing > 0))[:, None]
        return after._replace(place=np.where(asked, after.place, place), speed=np.where(asked, after.speed, speed))


def known_of(points: Array) -> Array:
    """(...) bool of points (..., 2): True where both components are finite."""
    known: Array = np.isfinite(points[..., 0] + points[..., 1])
    return known
