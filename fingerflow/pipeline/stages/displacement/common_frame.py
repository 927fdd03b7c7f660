"""Common reference configuration of the skin for points that were seeded in different frames."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from fingerflow.kernels.tracking_limits import TrackStatus
from fingerflow.results.store import Values

_NEIGHBOURS = 8  # nearest points from whose displacement that of a new point is extrapolated
_FRAMES = 64  # frames read at a time
Points = NDArray[np.float64]


class CommonFrame(NamedTuple):
    """Positions of all points in the frame of the first seeding, extrapolated for points that were seeded later.

    Attributes:
        positions: (N, 2) mm. For a point seeded later: its position then, less the displacement of the points around it
            since the first seeding. These are coordinates of the skin extrapolated beyond the region that was seen.
            Gradients between two later frames, F(t) F(s)^-1, do not depend on them.
        seeded: (N,) frame in which each point was seeded.
        later: (N,) bool, True for points seeded after the first seeding.
    """

    positions: Points
    seeded: NDArray[np.intp]
    later: NDArray[np.bool_]


def common_frame(position: Values, status: Values, first: int, backward: bool) -> CommonFrame:
    """Compute the positions (N, 2) mm of all points in the frame of the first seeding, extrapolated for points seeded
    later, from `position` (F, N, 2) mm and track `status` (F, N).

    They were first seeded in frame `first` and tracked from there, forward or `backward`.

    The displacement of the surroundings is the mean over the eight nearest known points, with weights 1 / distance^2.
    It differs little between neighbouring points, so that the skin does not fold, and it stays bounded far away, unlike
    an extrapolated plane.
    """
    positions = np.array(position[slice(first, first + 1)][0], dtype=np.float64)
    later = status[slice(first, first + 1)][0] == TrackStatus.NOT_SEEDED_YET
    seeded = np.full(len(positions), first)
    if not later.any():
        return CommonFrame(positions, seeded, later)
    seeded[later] = _seedings(status, np.flatnonzero(later), backward)
    for frame in sorted(set(seeded[later].tolist()), reverse=backward):
        now, new = position[slice(frame, frame + 1)][0], np.flatnonzero(later & (seeded == frame))
        earlier = np.flatnonzero(np.isfinite(positions + now).all(1) & (seeded != frame))
        # All points were lost, as when a finger is lifted: new points then start without a displacement.
        if not len(earlier):
            positions[new] = now[new]
            continue
        distance, near = cKDTree(now[earlier]).query(now[new], k=np.arange(1, min(_NEIGHBOURS, len(earlier)) + 1))
        weight = 1 / np.maximum(distance, 1e-6) ** 2
        moved = ((now - positions)[earlier][near] * weight[..., None]).sum(1) / weight.sum(1, keepdims=True)
        positions[new] = now[new] - moved
    return CommonFrame(positions, seeded, later)


def _seedings(status: Values, later: NDArray[np.intp], backward: bool) -> NDArray[np.intp]:
    """Return the frame (L,) in which each of the L points with the indices `later` was seeded, from the track status
    (F, N) of all points.

    That is the first frame in which they are tracked, or the last one for backward tracking.
    """
    frames = np.full(len(later), -1)
    for begin in range(0, status.shape[0], _FRAMES):
        tracked = status[slice(begin, begin + _FRAMES)][:, later] == TrackStatus.TRACKED
        here = tracked.any(0)
        if backward:
            frames[here] = begin + len(tracked) - 1 - tracked[::-1].argmax(0)[here]
        else:
            here &= frames < 0
            frames[here] = begin + tracked.argmax(0)[here]
    return frames
