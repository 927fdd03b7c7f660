"""Tests of the touches of points, added in batches of frames."""

import numpy as np

from fingerflow.tracker.contact_border import Border
from fingerflow.tracker.onset import LASTING, Touches

FRAMES, POINTS = 40, 200


def test_runs_of_frames_are_counted_as_frame_after_frame() -> None:
    """Batches of frames give the same touches as single frames. With an unknown border a touch begins half way from the
    previous frame, and in the first frame at its position there.
    """
    random = np.random.default_rng(1)
    covered = (random.random((FRAMES, POINTS)) < 0.4).astype(np.uint8)
    position, variance = random.normal(size=(FRAMES, POINTS, 2)), random.random((FRAMES, POINTS)).astype(np.float32)
    border = Border(np.full((FRAMES, 2), np.nan), np.full((FRAMES, 2), np.nan), np.full(FRAMES, np.nan))
    begun = np.concatenate((position[:1], (position[1:] + position[:-1]) / 2))
    touch, length = Touches(POINTS), np.zeros(POINTS, int)
    start, first = np.full((2, POINTS), -1)
    for some in np.split(np.arange(FRAMES), [1, 3, 20]):
        place, _, spread, earlier, touching, begins = touch.add_frames(
            some, covered[some], position[some], variance[some], border.at(some)
        )
        for k, frame in enumerate(some):
            before = length
            length = np.where(before == LASTING, LASTING, np.where(covered[frame] > 0, before + 1, 0))
            now = (length == 1) & (before == 0)
            start, first = np.where(now, frame, start), np.where(now & (first < 0), frame, first)
            np.testing.assert_array_equal(begins[k], now)
            np.testing.assert_array_equal(touching[k], length > 0)
            known, points = length > 0, np.arange(POINTS)
            np.testing.assert_allclose(place[k], np.where(known[:, None], begun[start, points], np.nan), rtol=1e-12)
            np.testing.assert_array_equal(spread[k], np.where(known, variance[start, points], np.nan))
            nothing = np.where(start > 0, variance[start - 1, points], 0)
            np.testing.assert_array_equal(earlier[k], np.where(known, nothing, np.nan))
        np.testing.assert_array_equal(touch.length, length)
        np.testing.assert_array_equal(touch.start, start)
        np.testing.assert_array_equal(touch.first, first)
    assert (first >= 0).mean() > 0.9
    np.testing.assert_allclose(touch.first_place[first >= 0], begun[first, np.arange(POINTS)][first >= 0], rtol=1e-12)


def test_a_touch_begins_where_the_border_passes() -> None:
    """A touch begins where the border passes the point: here a circle of 1, 2 and 3 mm over points that move by 0.1 mm
    per frame.

    The touch of a point that was lost before begins where the point is found again. If the ellipse passes before or
    after the frames that show the contact, the touch begins at the nearer of both positions.
    """
    radius = np.arange(1.0, 4)
    border = Border(np.zeros((3, 2)), np.stack((radius, radius), 1), np.zeros(3))
    start = np.array([1.2, 1.5, 2.6, 2.6, 0.7, 2.9])
    position = np.zeros((3, len(start), 2))
    position[..., 0] = start + 0.1 * np.arange(3)[:, None]
    position[1, 3] = np.nan
    covered = position[..., 0] < radius[:, None]
    covered[:, 4], covered[:, 5] = [False, True, True], [False, True, True]
    # The border reaches x = start + 0.1 t at the time t with 1 + t = x.
    passed = start + 0.1 * (start - 1) / 0.9
    passed[3], passed[4], passed[5] = position[2, 3, 0], position[0, 4, 0], position[1, 5, 0]
    touch = Touches(len(start))
    place, *_ = touch.add_frames(np.arange(3), covered, position, np.zeros(covered.shape, np.float32), border)
    np.testing.assert_allclose(place[-1, :, 0], passed, atol=1e-12)
