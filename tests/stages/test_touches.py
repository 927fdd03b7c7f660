"""Touches of points, taken up run after run of frames."""

import numpy as np

from fingerflow.tracker.onset import LASTING, Touches

FRAMES, POINTS = 40, 200


def test_runs_of_frames_are_counted_as_frame_after_frame() -> None:
    random = np.random.default_rng(1)
    covered = (random.random((FRAMES, POINTS)) < 0.4).astype(np.uint8)
    position, variance = random.normal(size=(FRAMES, POINTS, 2)), random.random((FRAMES, POINTS)).astype(np.float32)
    touch, length = Touches(POINTS), np.zeros(POINTS, int)
    start, first = np.full((2, POINTS), -1)
    for some in np.split(np.arange(FRAMES), [1, 3, 20]):
        place, spread, touching, begins = touch.go_on(some, covered[some], position[some], variance[some])
        for k, frame in enumerate(some):
            before = length
            length = np.where(before == LASTING, LASTING, np.where(covered[frame] > 0, before + 1, 0))
            now = (length == 1) & (before == 0)
            start, first = np.where(now, frame, start), np.where(now & (first < 0), frame, first)
            np.testing.assert_array_equal(begins[k], now)
            np.testing.assert_array_equal(touching[k], length > 0)
            known, points = length > 0, np.arange(POINTS)
            np.testing.assert_array_equal(place[k], np.where(known[:, None], position[start, points], np.nan))
            np.testing.assert_array_equal(spread[k], np.where(known, variance[start, points], np.nan))
        np.testing.assert_array_equal(touch.length, length)
        np.testing.assert_array_equal(touch.start, start)
        np.testing.assert_array_equal(touch.first, first)
    assert (first >= 0).mean() > 0.9
    np.testing.assert_array_equal(touch.first_place[first >= 0], position[first, np.arange(POINTS)][first >= 0])
