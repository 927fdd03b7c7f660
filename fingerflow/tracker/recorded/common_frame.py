"""Coordinates of the skin that are the same for all points of a recording, whenever they were seeded."""

import numpy as np

from fingerflow.kernels.array_types import Numbers, Points
from fingerflow.kernels.tracking_limits import TrackStatus
from fingerflow.tracker.onset import interpolate_displacement
from fingerflow.tracker.recorded.stored_frames import runs_of_frames
from fingerflow.tracker.vibration import Values


def common_frame(
    position: Values, status: Values, mm_per_px: float, first: int, backward: bool
) -> tuple[Points, Numbers]:
    """Return the positions (N, 2) mm of all points in the frame of the first seeding, extrapolated for points
    seeded later, and the frames (N,) in which they were seeded.

    They were first seeded in frame `first` and tracked from there, forward or `backward`. The position of a point
    seeded later is that in its first frame, less the displacement of the points around it since the first seeding.
    These are coordinates of the skin extrapolated beyond the region that was seen. Gradients between two later
    frames, F(t) F(s)^-1, do not depend on them.

    That displacement is a mean over few points (`interpolate_displacement`). It differs little between neighbouring
    points, so that the skin does not fold, and it stays bounded far away, unlike an extrapolated plane. Where
    hardly a point is left, as after a finger was lifted, new points start without a displacement.

    Args:
        position: (F, N, 2) mm, NaN where lost.
        status: (F, N) `TrackStatus`.
        mm_per_px: of the topographic view.
        first: frame of the first seeding.
        backward: whether points were tracked from the last frame on.
    """
    positions = np.array(position[first : first + 1][0], dtype=np.float64)
    later = status[first : first + 1][0] == TrackStatus.NOT_SEEDED_YET
    waiting, frames = np.zeros(len(positions), np.intp), status.shape[0]
    for run in runs_of_frames(frames) if later.any() else ():
        waiting += (status[run] == TrackStatus.NOT_SEEDED_YET).sum(0)
    seeded = np.where(later, frames - 1 - waiting if backward else waiting, first)
    for frame in sorted(set(seeded[later].tolist()), reverse=backward):
        now, new = position[frame : frame + 1][0], np.flatnonzero(later & (seeded == frame))
        moved, _ = interpolate_displacement(now / mm_per_px, now - positions, now[new] / mm_per_px, fewest=1)
        positions[new] = now[new] - np.nan_to_num(moved)
    return positions, seeded
