"""Whether skin in contact begins to slip: what the best rigid motion of its points leaves, against its noise."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[Any]

_FEWEST = 8  # points in contact
_RAISED = 2.0  # times the noise; skin that sticks shows 1.0 to 1.3
_NEAREST = 4  # points, by their distance, of which another one takes its displacement
_FRAMES = 3  # in a row, before the flag is raised or taken back


class SlipState(NamedTuple):
    """Of a frame.

    Attributes:
        residual: px, root mean square of a component; NaN where fewer than 8 points are in contact.
        slipping: whether it has been above twice its noise for three frames.
    """

    residual: float
    slipping: bool


class SlipFlag:
    """The flag of a stream. It comes two frames after the first that shows slip, beside the frame's own latency.

    Displacement counts from where each point was when it was touched. Skin that spreads under a growing normal force is
    not rigid either: the flag says that skin in contact deforms, which under a steady force is partial slip. On trials
    of `fingerflow.synthetic.PartialSlip` it comes when 6 to 15 % of the contact have slipped, a fifth of the way to
    full slip; on a contact 4 mm long that is seen by windows of 15 px at 22 %. Skin that slides as a whole is rigid;
    what it was stretched by before stays, and with it the flag. Where other points are chosen meanwhile, each takes
    over the displacement of the old ones nearest to it. Where nothing tells it, as those are lost, nothing takes the
    flag back before the contact ends.

    Attributes:
        slipping: what the last frame said.
    """

    def __init__(self) -> None:
        self._touched: Array = np.empty((0, 2))
        self._run = 0
        self._held = False  # the points that have shown slip are gone
        self.slipping = False

    def follow_others(self, before: Array, points: Array) -> None:
        """Other points (N, 2) px are followed from now on, chosen in a frame in which those until now lay at `before`
        (M, 2) px, NaN where lost.
        """
        moved = before - self._touched if len(self._touched) else np.full_like(before, np.nan)
        known, given = np.isfinite(moved).all(-1), np.isfinite(points).all(-1)
        self._touched = np.full(points.shape, np.nan)
        if known.sum() >= _FEWEST:
            apart = np.square(points[given, None] - before[None, known]).sum(-1)
            nearest = np.argpartition(apart, _NEAREST - 1, axis=1)[:, :_NEAREST]
            weight = 1 / (np.take_along_axis(apart, nearest, axis=1) + 1)[..., None]
            by_nearest = (weight * moved[known][nearest]).sum(1) / weight.sum(1)
            self._touched[given] = points[given] - by_nearest
        else:
            self._held |= self.slipping

    def see(self, points: Array, std: Array, covered: Array) -> SlipState:
        """A frame, in their order.

        Args:
            points: (N, 2) px, NaN where lost.
            std: (N,) px, standard deviation of a component.
            covered: (N,) whether the gross contact covers each.
        """
        if not len(self._touched):
            self._touched = np.full(points.shape, np.nan)
        # As complex numbers: over an axis of two NumPy takes several times as long.
        place, touched = (
            np.ascontiguousarray(points, np.float64).view(np.complex128)[:, 0],
            self._touched.view(np.complex128)[:, 0],
        )
        known = np.isfinite(place)
        covered = covered.astype(bool, copy=False)
        begins = covered & known & np.isnan(touched)
        if begins.any():
            touched[begins] = place[begins]
        touched[~covered] = np.nan
        used = np.flatnonzero(known & np.isfinite(touched) & np.isfinite(std))
        residual, noise = math.nan, math.nan
        if len(used) >= _FEWEST:
            residual = rigid_residual_rms(touched[used], place[used])
            some = std[used].astype(np.float64)
            noise = math.sqrt(float(some @ some) / len(some))
        self._held &= bool(covered.any())
        # Too few points say nothing, neither that skin slips nor that it does not, until the contact ends.
        unknown = self._held or (math.isnan(residual) and covered.any())
        above = self.slipping if unknown and self.slipping else residual > _RAISED * noise
        self._run = self._run + 1 if above != self.slipping else 0
        if self._run >= _FRAMES:
            self.slipping, self._run = above, 0
        return SlipState(residual, self.slipping)


def rigid_residual_rms(before: Array, after: Array) -> float:
    """Root mean square of a component of what the best rigid motion of points (N,), x + i y, leaves (Procrustes)."""
    start, end = before - before.mean(), after - after.mean()
    product = np.vdot(start, end)
    off = end - start * (product / abs(product) if product else 1)
    return math.sqrt(float(np.vdot(off, off).real) / (2 * len(off)))
