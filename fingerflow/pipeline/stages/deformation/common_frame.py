"""Common reference configuration of the skin for points that were seeded in different frames."""

import numpy as np
from scipy.spatial import cKDTree

from fingerflow.kernels.tracking_limits import TrackStatus
from fingerflow.pipeline.stages.array_types import Numbers, Points
from fingerflow.results.store import Values
from fingerflow.tracker.vibration import FRAMES_READ

_NEIGHBOURS = 8  # nearest points from whose displacement that of a new point is extrapolated


def common_frame(position: Values, status: Values, first: int, backward: bool) -> tuple[Points, Numbers]:
    """Return the positions (N, 2) mm of all points in the frame of the first seeding, extrapolated for points seeded
    later, and the frames (N,) in which they were seeded, from `position` (F, N, 2) mm and track `status` (F, N).

    They were first seeded in frame `first` and tracked from there, forward or `backward`. The position of a point
    seeded later is that in its first frame, less the displacement of the points around it since the first seeding.
    These are coordinates of the skin extrapolated beyond the region that was seen. Gradients between two later frames,
    F(t) F(s)^-1, do not depend on them.

    The displacement of the surroundings is the mean over the eight nearest known points, with weights 1 / distance^2.
    It differs little between neighbouring points, so that the skin does not fold, and it stays bounded far away, unlike
    an extrapolated plane.
    """
    positions = np.array(position[first : first + 1][0], dtype=np.float64)
    later = status[first : first + 1][0] == TrackStatus.NOT_SEEDED_YET
    seeded = np.full(len(positions), first)
    if not later.any():
        return positions, seeded
    seeded[later] = _seedings(status, np.flatnonzero(later), backward)
    for frame in sorted(set(seeded[later].tolist()), reverse=backward):
        now, new = position[frame : frame + 1][0], np.flatnonzero(later & (seeded == frame))
        earlier = np.flatnonzero(np.isfinite(positions + now).all(1) & (seeded != frame))
        # All points were lost, as when a finger is lifted: new points then start without a displacement.
        if not len(earlier):
            positions[new] = now[new]
            continue
        distance, near = cKDTree(now[earlier]).query(now[new], k=np.arange(1, min(_NEIGHBOURS, len(earlier)) + 1))
        weight = 1 / np.maximum(distance, 1e-6) ** 2
        moved = ((now - positions)[earlier][near] * weight[..., None]).sum(1) / weight.sum(1, keepdims=True)
        positions[new] = now[new] - moved
    return positions, seeded


def _seedings(status: Values, later: Numbers, backward: bool) -> Numbers:
    """Return the frame (L,) in which each of the L points with the indices `later` was seeded, from the track status
    (F, N) of all points.

    That is the first frame in which they are tracked, or the last one for backward tracking.
    """
    frames = np.full(len(later), -1)
    for begin in range(0, status.shape[0], FRAMES_READ):
        tracked = status[begin : begin + FRAMES_READ][:, later] == TrackStatus.TRACKED
        here = tracked.any(0)
        if backward:
            frames[here] = begin + len(tracked) - 1 - tracked[::-1].argmax(0)[here]
        else:
            here &= frames < 0
            frames[here] = begin + tracked.argmax(0)[here]
    return frames
