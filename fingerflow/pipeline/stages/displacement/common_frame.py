"""One frame for points that were chosen in several, as coordinates of the skin."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from fingerflow.kernels.tracking_limits import TrackStatus
from fingerflow.results.store import Values

_NEIGHBOURS = 8  # whose displacement is extended to a point
_FRAMES = 64  # read at a time
Points = NDArray[np.float64]


class CommonFrame(NamedTuple):
    """Where points lay in the frame of the first choice.

    Attributes:
        places: (N, 2) mm. Of a point that was chosen later it is its place then less the displacement since the first
            choice of the points around: coordinates of the skin that go on beyond what was seen. Gradients between two
            later frames, F(t) F(s)^-1, do not depend on them.
        chosen: (N,) frame in which each point was chosen.
        later: (N,) bool, whether that was not the first choice.
    """

    places: Points
    chosen: NDArray[np.intp]
    later: NDArray[np.bool_]


def common_frame(position: Values, status: Values, first: int, backward: bool) -> CommonFrame:
    """Of points at `position` (frames, N, 2) mm with a `status` (frames, N), which were first chosen in frame `first`
    and followed from there on, or back.

    The displacement of the points around is that of the eight nearest that are known, which weigh 1 / distance^2: of
    neighbouring points it differs by little, so that the skin does not fold, and it stays bounded far away, where a
    plane would run off.
    """
    places = np.array(position[slice(first, first + 1)][0], dtype=np.float64)
    later = status[slice(first, first + 1)][0] == TrackStatus.NOT_CHOSEN_YET
    chosen = np.full(len(places), first)
    if not later.any():
        return CommonFrame(places, chosen, later)
    chosen[later] = _choices(status, np.flatnonzero(later), backward)
    for frame in sorted(set(chosen[later].tolist()), reverse=backward):
        now, new = position[slice(frame, frame + 1)][0], np.flatnonzero(later & (chosen == frame))
        earlier = np.flatnonzero(np.isfinite(places + now).all(1) & (chosen != frame))
        if not len(earlier):
            continue
        distance, near = cKDTree(now[earlier]).query(now[new], k=np.arange(1, min(_NEIGHBOURS, len(earlier)) + 1))
        weight = 1 / np.maximum(distance, 1e-6) ** 2
        moved = ((now - places)[earlier][near] * weight[..., None]).sum(1) / weight.sum(1, keepdims=True)
        places[new] = now[new] - moved
    return CommonFrame(places, chosen, later)


def _choices(status: Values, later: NDArray[np.intp], backward: bool) -> NDArray[np.intp]:
    """Frames (L,) in which these points were chosen: the first, or of a recording followed backward the last, in which
    they are tracked.
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
