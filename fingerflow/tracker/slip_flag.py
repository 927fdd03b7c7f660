"""Detect slip in a stream: points in contact deviate from a rigid motion by more than noise."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[Any]

_FEWEST = 8  # points in contact
_RAISED = 2.0  # times the noise; sticking skin has 1.0 to 1.3
_NEAREST = 4  # old points from which a new one takes its displacement, weighted by distance
_FRAMES = 3  # in a row, before the flag is raised or withdrawn


class SlipState(NamedTuple):
    """Slip residual and slip flag of a frame.

    Attributes:
        residual: px, root mean square of a component; NaN where fewer than 8 points are in contact.
        slipping: the flag, which changes after three frames in a row above, or not above, twice the noise.
    """

    residual: float
    slipping: bool


class SlipFlag:
    """Slip flag of a stream, raised when points in contact no longer move as a rigid body.

    It is raised two frames after the first frame that shows slip, plus the latency of a frame. Displacement counts from
    the position of each point when its contact began. Skin that spreads under a growing normal force is not rigid
    either: the flag means that skin in contact deforms, which under a steady force is partial slip. On trials of
    `fingerflow.synthetic.PartialSlip` it is raised when 6 to 15 % of the contact have slipped, a fifth of the way to
    full slip; in a contact 4 mm long, tracked with windows of 15 px, at 22 %. Skin that slides as a whole is rigid: its
    earlier stretch stays, and with it the flag. At a reseeding each new point takes over the displacement of the
    nearest old points. If too few of these are known, the flag is not withdrawn before the contact ends.

    Attributes:
        slipping: the flag after the last frame.
    """

    def __init__(self) -> None:
        self._touched: Array = np.empty((0, 2))
        self._run = 0
        self._held = False  # True if the points that have shown slip are lost: the flag stays until the contact ends
        self.slipping = False

    def follow_others(self, before: Array, points: Array) -> None:
        """Transfer displacements since contact onset from the previous points to newly seeded points (N, 2) px.

        In the frame of the seeding the previous points lay at `before` (M, 2) px, NaN where lost.
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
        """Add the next frame, and return the slip residual and slip flag of that frame.

        Args:
            points: (N, 2) px, NaN where lost.
            std: (N,) px, standard deviation of a component.
            covered: (N,) whether the apparent (gross) contact covers each.
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
        # Too few points in contact neither raise the flag nor withdraw it.
        unknown = self._held or (math.isnan(residual) and covered.any())
        above = self.slipping if unknown and self.slipping else residual > _RAISED * noise
        self._run = self._run + 1 if above != self.slipping else 0
        if self._run >= _FRAMES:
            self.slipping, self._run = above, 0
        return SlipState(residual, self.slipping)


def rigid_residual_rms(before: Array, after: Array) -> float:
    """Return the RMS residual per component after the best rigid motion of `before` onto `after` (Procrustes).

    Points (N,) are x + i y.
    """
    start, end = before - before.mean(), after - after.mean()
    product = np.vdot(start, end)
    off = end - start * (product / abs(product) if product else 1)
    return math.sqrt(float(np.vdot(off, off).real) / (2 * len(off)))
