"""Tests of the touches of points."""

import numpy as np

from fingerflow.kernels.result_records import FrameEllipse
from fingerflow.tracker.onset import Touches


def test_a_touch_begins_where_the_border_passes() -> None:
    """A touch begins where the border passes the point: here a circle of 1, 2 and 3 mm over points that move by 0.1 mm
    per frame.

    The touch of a point that was lost before begins where the point is found again. If the ellipse passes before or
    after the frames that show the contact, the touch begins at the nearer of both positions; in the middle of both
    if the point has moved outward through the ellipse, as over a lobe of the contact.
    """
    radius = np.arange(1.0, 4)
    border = FrameEllipse(np.zeros((3, 2)), np.stack((radius, radius), 1), np.zeros(3))
    start = np.array([1.2, 1.5, 2.6, 2.6, 0.7, 2.9, 0.5])
    position = np.zeros((3, len(start), 2))
    position[..., 0] = start + 0.1 * np.arange(3)[:, None]
    position[1, 3], position[1:, 6, 0] = np.nan, (2.2, 3.4)
    covered = position[..., 0] < radius[:, None]
    covered[:, 4], covered[:, 5] = [False, True, True], [False, True, True]
    covered[:, 6] = [False, False, True]
    # The border reaches x = start + 0.1 t at the time t with 1 + t = x.
    passed = start + 0.1 * (start - 1) / 0.9
    passed[3], passed[4], passed[5], passed[6] = position[2, 3, 0], position[0, 4, 0], position[1, 5, 0], 2.8
    touch = Touches(len(start))
    place, *_ = touch.add_frames(np.arange(3), covered, position, np.zeros(covered.shape, np.float32), border)
    np.testing.assert_allclose(place[-1, :, 0], passed, atol=1e-12)
