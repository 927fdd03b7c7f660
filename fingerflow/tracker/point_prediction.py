"""Prediction of point positions in later frames, from the latest position and speed of each point."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from fingerflow.kernels.array_types import Array
from fingerflow.kernels.arrays import is_finite, nanmedian, squared_distances
from fingerflow.kernels.tracking_limits import SPEED_FRAMES, SPEED_WEIGHT

TRUSTED = int(SPEED_FRAMES)  # largest number of frames over which a speed is extrapolated
_NEVER = 10**6  # number of missing frames of a point that does not exist
_AROUND = 8  # number of nearest points from which a new point takes its speed


class PointMotion(NamedTuple):
    """Position and speed of N points after a frame: measured, predicted from neighbours, or extrapolated.

    A speed is the mean of the displacements, the latest one with half the weight: the displacement between two
    positions alone would carry their noise on into all predicted frames.

    Attributes:
        position: (N, 2) px, NaN where there is no point.
        speed: (N, 2) px a frame.
        missing: (N,) frames for which a point was not found, 0 if it was found.
        valid: (N,) whether a point was found or its position was predicted from its neighbours.
        jolted: (N,) whether its position is off any predicted motion, as found by a search.
    """

    position: Array
    speed: Array
    missing: Array
    valid: Array
    jolted: Array

    @classmethod
    def at_rest(cls, points: Array) -> PointMotion:
        """Create the motion of points (N, 2) px that are at rest."""
        valid = is_finite(points)
        return cls(points, np.zeros_like(points), np.where(valid, 0, _NEVER), valid, np.zeros_like(valid))

    def seeded(self, points: Array) -> PointMotion:
        """Create the motion of newly seeded points (N, 2) px, with the speed of tracked points nearby.

        The speed is the median, by component, over the eight nearest points that were found; 0 if there are fewer.
        """
        motion = PointMotion.at_rest(points)
        seen, new = (self.missing == 0).nonzero()[0], motion.valid.nonzero()[0]
        if len(seen) >= _AROUND:
            distance = squared_distances(points[new], self.position[seen])
            nearest = seen[np.argpartition(distance, _AROUND - 1, axis=1)[:, :_AROUND]]
            motion.speed[new] = nanmedian(self.speed[nearest])
        return motion

    def expect(self, frames: int = 1) -> Array:
        """Predict the positions (N, 2) px of the points `frames` frames ahead."""
        return self.position + self.speed * np.float32(min(frames, TRUSTED))

    def update(
        self, points: Array, frames: int = 1, by_neighbours: Array | None = None, jolted: Array | None = None
    ) -> PointMotion:
        """Return the motion updated by the positions of the points measured in a later frame; a lost point takes the
        position predicted from its neighbours, else one extrapolated from its speed.

        Args:
            points: (N, 2) px, NaN where lost.
            frames: since the last one.
            by_neighbours: (N, 2) px, positions predicted from the neighbours; NaN where too few are known.
            jolted: (N,) points whose position is off any predicted motion.
        """
        points = points.copy()
        valid = is_finite(points)
        lost = (~valid).nonzero()[0]
        missing = np.zeros(len(valid), self.missing.dtype)
        if len(lost):
            missing[lost] = np.minimum(self.missing[lost] + frames, _NEVER)
            if by_neighbours is not None:
                predicted = lost[is_finite(self.position[lost]) & is_finite(by_neighbours[lost])]
                points[predicted] = by_neighbours[predicted]
                valid[predicted] = True
        jolted = np.zeros(len(valid), bool) if jolted is None else jolted & valid
        # A point that is found again may lie off its prediction. One such jolt is not taken for motion; two in a row
        # are.
        moved = valid & self.valid & (self.jolted | ~jolted)
        change = (points - self.position) / np.float32(frames) - self.speed
        change *= np.float32(SPEED_WEIGHT)
        change[~moved] = 0
        change += self.speed
        if len(lost) and len(gone := lost[~valid[lost]]):
            points[gone] = self.expect(frames)[gone]
            change[gone] = self.speed[gone] * np.float32(1 - 1 / SPEED_FRAMES)
        return PointMotion(points, change, missing, valid, jolted)

    def followed(self, position: Array, speed: Array, points: Array, frames: int, by_neighbours: Array) -> PointMotion:
        """Return the motion after `frames` frames tracked in one engine call, which gave the final positions `position`
        and speeds `speed` (N, 2).

        Points lost in the last frame (`points`) take the position predicted from their neighbours where there is one.
        Other arguments are those of `update`.
        """
        after = self.update(points, frames, by_neighbours)
        predicted = (after.valid & (after.missing > 0))[:, None]
        position, speed = np.where(predicted, after.position, position), np.where(predicted, after.speed, speed)
        return after._replace(position=position, speed=speed)
