"""Variance of displacements by touches that began at another time than was seen."""

import numpy as np
from scipy.special import ndtr

from fingerflow.kernels.array_types import Array, Mask, Points
from fingerflow.kernels.result_records import FrameEllipse
from fingerflow.tracker.contact_border import BORDER_MM
from fingerflow.tracker.deviations.onset_time import ELLIPSE_MM


class UnseenTouches:
    """Points on the border in the first frame of a recording, which may have touched earlier or later than was seen.

    Args:
        position: (N, 2) mm, in the first frame.
        seen: (N,) whether the contact covers each point there.
        border: of the apparent contact there, one ellipse.
    """

    def __init__(self, position: Points, seen: Mask, border: FrameEllipse) -> None:
        depth = border.inside(position[None])[0]
        self._doubtful = np.flatnonzero(abs(depth) < 3 * BORDER_MM)
        self._depth, self._seen = depth[self._doubtful], seen[self._doubtful]
        self._position = position[self._doubtful]

    def variance(self, position: Points, displacement: Points, border: FrameEllipse) -> Array:
        """Return the variance (n, N) mm^2 of a displacement component in n frames, 0 for points not on the border, from
        positions and displacements (n, N, 2) mm and the border in these frames.

        With the depth d of a point at its onset, a border off by b = `BORDER_MM` leaves it outside with the probability
        Phi(-d/b). Such a point enters once it has moved inwards by about b, if it does: of a displacement u that leads
        inwards by c, the share min(1, b/c) is from before. A point that was not seen in contact in the first frame, at
        a depth d, touched with the probability Phi(d/b): then it has also moved as far as from there to its onset.
        """
        result = np.zeros(position.shape[:2])
        position, displacement = position[:, self._doubtful], displacement[:, self._doubtful]
        then = np.where(self._seen, self._depth, 0)
        inwards = np.maximum(np.nan_to_num(border.inside(position) - then), 0) + ELLIPSE_MM
        later = ndtr(-then / BORDER_MM) - ndtr(-(then + inwards) / BORDER_MM)
        share = np.minimum(1, BORDER_MM / inwards)
        earlier = np.where(self._seen, 0, ndtr(self._depth / BORDER_MM))
        before = np.square(position - displacement - self._position).sum(-1)
        variance = (later * np.square(share) * np.square(displacement).sum(-1) + earlier * before) / 2
        result[:, self._doubtful] = np.nan_to_num(variance)
        return result
