"""Tests of the expected positions of points: by the mean of their displacements and by their neighbours, not by
chance.
"""

from typing import Any

import numpy as np

from fingerflow.tracker.point_prediction import PointMotion

Array = np.ndarray[Any, Any]
START = (300 * np.random.default_rng(4).random((200, 2))).astype(np.float32)


def _moving() -> tuple[PointMotion, Array, Array]:
    """Return the motion of five points after 60 frames, of which every third was seen, with their positions and speeds
    (5, 2); the last point is NaN.
    """
    start = np.array([[10, 20], [30, 40], [50, 60], [70, 80], [np.nan, np.nan]], np.float32)
    speed = np.array([[1, 0], [2, -1], [0.5, -3], [0, 0], [0, 0]], np.float32)
    motion = PointMotion.at_rest(start)
    np.testing.assert_array_equal(motion.expect(2), start)
    for frames in range(3, 61, 3):
        motion = motion.see(start + frames * speed, 3)
    return motion, start + 60 * speed, speed


def test_points_are_expected_where_they_move() -> None:
    """Each point is expected at its own speed, up to 4 frames ahead."""
    motion, place, speed = _moving()
    for ahead, frames in ((0, 0), (1, 1), (4, 4), (5, 4), (100, 4)):
        assert motion.expect(ahead).dtype == np.float32
        np.testing.assert_allclose(motion.expect(ahead), place + frames * speed, rtol=1e-5)


def test_lost_points_go_on_and_come_to_rest() -> None:
    motion, place, speed = _moving()
    seen = place + speed
    seen[1] = np.nan
    motion = motion.see(seen)
    np.testing.assert_allclose(motion.expect(0), place + speed, rtol=1e-5)
    for _ in range(58):
        motion = motion.see(np.full_like(place, np.nan))
    rest = place + speed + 4 * speed  # the sum 1 + 3/4 + 9/16 ...
    rest[1] -= speed[1]  # lost a frame before the others
    np.testing.assert_allclose(motion.expect(), rest, rtol=1e-5)
    motion = motion.see(rest + 0.8)  # found 0.8 px beside its expected position, which is no motion
    np.testing.assert_allclose(motion.expect(4), rest + 0.8, rtol=1e-5)


def test_noise_is_not_taken_for_motion() -> None:
    """The position expected 4 frames ahead has 3.2 times the noise of a position, with weights 3, -1, -1/2, -1/4 ...;
    from the last two positions alone, with weights 5 and -4, it would have 6.4 times the noise.
    """
    generator = np.random.default_rng(3)
    start = np.full((5000, 2), 100.0)
    motion = PointMotion.at_rest(start)
    for _ in range(12):
        motion = motion.see(start + 0.05 * generator.standard_normal(start.shape))
    assert np.std(motion.expect(100) - start) < 3.5 * 0.05


def test_lost_points_move_with_their_neighbours() -> None:
    """Lost points move with their neighbours and not at their last speed: skin at rest begins to move by 1.5 px a
    frame, and a fourth of its points are not seen.
    """
    motion, lost = PointMotion.at_rest(START), np.arange(200) % 4 == 0
    for number in range(1, 20):
        place = START + np.float32(1.5 * number)
        motion = motion.see(np.where(lost[:, None], np.nan, place).astype(np.float32), 1, place)
    np.testing.assert_allclose(motion.expect(2), START + 1.5 * 21, atol=1e-2)
    assert (motion.missing == np.where(lost, 19, 0)).all()


def test_new_points_have_the_speed_of_those_around_them() -> None:
    motion = PointMotion.at_rest(START)
    speed = np.where(START[:, :1] > 150, np.float32(1.2), np.float32(0)) * np.array([1, -1], np.float32)
    for number in range(1, 30):
        motion = motion.see(START + number * speed)
    new = np.array([[20, 150], [280, 150], [np.nan, np.nan]], np.float32)
    seeded = motion.seeded(new)
    np.testing.assert_allclose(seeded.speed[:2], [[0, 0], [1.2, -1.2]], atol=1e-4)
    np.testing.assert_array_equal(seeded.place, new)
    assert not PointMotion.at_rest(START[:7]).seeded(new).speed.any()  # too few points around
