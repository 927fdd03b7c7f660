"""Points followed through motion that a frame alone cannot follow: expectations, and where a stream looks again."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from fingerflow.player.contract.variables import TRACK_STATUS
from fingerflow.player.motion import TRUSTED, Motion
from fingerflow.player.second_look import SecondLook
from fingerflow.player.slip_flag import SlipFlag

Array = np.ndarray[Any, Any]
DRAW = np.random.default_rng(4)
START = (300 * DRAW.random((1, 200, 2))).astype(np.float32)
NOT_CONVERGED = TRACK_STATUS.index("not_converged")


class Frame:
    """The graph `frame` as `SecondLook` sees it, of points at a known place: each is found within a pixel of the whole
    pixel nearest to its prediction; one that is not leads up to 1.5 px on, if it lies within half a ridge's period.
    """

    def __init__(self, place: Array, by_neighbours: Callable[[Array], Array] | None = None) -> None:
        self.place, self.by_neighbours, self.runs = place, by_neighbours, 0

    def __call__(self, prediction: Array) -> dict[str, Array]:
        self.runs += 1
        whole = np.round(prediction)
        off = self.place - whole
        found = (np.abs(off) <= 1).all(-1)
        near = (np.abs(off) <= 5).all(-1)
        points = np.where(found[..., None], self.place, np.nan)
        nothing = np.full_like(points, np.nan)
        return {
            "points": points,
            "status": np.where(found, 0, NOT_CONVERGED),
            "estimate": whole + np.where(near[..., None], np.clip(off, -1.5, 1.5), 0),
            "by_neighbours": self.by_neighbours(points) if self.by_neighbours else nothing,
        }


def _look(before: Motion, frame: Frame, late: Array, search: Any = None) -> tuple[SecondLook, dict[str, Array]]:
    """After a frame that was begun with the predictions `late`."""
    results = frame(late)

    def run(prediction: Array) -> dict[str, Array]:
        results.update(frame(prediction))
        return results

    look = SecondLook(before, before.number + 1, late, results)
    look.take(run, search or (lambda rows, near: np.full_like(near, np.nan)), 64)
    return look, results


def test_nothing_runs_again_while_few_are_lost() -> None:
    """A tenth of 200 may be lost: the path of each frame costs what it did."""
    place = START.copy()
    place[0, :20] += 40
    frame = Frame(place)
    look, _ = _look(Motion.at_rest(START, 0), frame, START)
    assert frame.runs == 1
    assert not look.elsewhere
    assert not look.jolted.any()


def test_a_step_of_speed_is_followed_from_the_frame_before() -> None:
    """0.6 px a frame more: two frames late that is 1.2 px, beyond what a frame is sure to reach, and 0.6 px from the
    frame before."""
    motion = Motion.at_rest(START, 0)
    for number in range(1, 12):
        motion = motion.see(START + np.float32(0.4 * number), number)
    place = motion.place + np.float32(1.0)
    motion_then = motion._replace(place=motion.place - np.float32(0.6))  # what two frames late leaves
    frame = Frame(place)
    look, results = _look(motion, frame, motion_then.expect(motion.number + 1))
    assert np.isfinite(results["points"]).all()
    assert not look.jolted.any()
    following = motion.see(results["points"], 12, results["by_neighbours"], look.jolted)
    np.testing.assert_allclose(following.speed, 0.7, atol=1e-3)  # half the weight


@pytest.mark.parametrize("step", [2.5, 4.0])
def test_a_jump_within_half_a_ridge_needs_no_search(step: float) -> None:
    """A look leads 1.5 px on at a time."""
    frame = Frame(START + np.float32(step))
    look, results = _look(Motion.at_rest(START, 0), frame, START)
    assert np.isfinite(results["points"]).all()
    assert look.elsewhere
    assert frame.runs <= 5


def test_a_jump_of_a_part_of_the_skin_is_found_by_a_search_and_by_neighbours() -> None:
    """Half of the skin jumps by 8 px, beyond what looks lead to: a search of 64 points finds the first of them, a plane
    through those the others."""
    half = START[..., :1] > 150
    jumped = START + np.where(half, np.float32(8), np.float32(0)) * np.array([1, 0], np.float32)

    def by_neighbours(points: Array) -> Array:
        there = np.isfinite(points).all(-1)[0] & half[0, :, 0]
        moved = (points - START)[0, there].mean(0) if there.any() else np.nan
        return np.where(half, START + moved, START).astype(np.float32)

    def search(rows: Array, near: Array) -> Array:
        return jumped[:, rows] + np.float32(0.7)

    frame = Frame(jumped, by_neighbours)
    motion = Motion.at_rest(START, 0)
    look, results = _look(motion, frame, START, search)
    np.testing.assert_array_equal(results["points"], jumped)
    assert look.elsewhere
    np.testing.assert_array_equal(look.jolted, half[..., 0])
    # One jolt is no motion; a second one is.
    after = motion.see(results["points"], 1, None, look.jolted)
    assert not after.speed.any()
    again = after.see(jumped + np.float32(8), 2, None, np.ones_like(look.jolted))
    np.testing.assert_allclose(again.speed[look.jolted], 4.0, rtol=1e-5)
    assert not again.speed[~look.jolted].any()


def test_a_frame_of_another_moment_costs_one_search() -> None:
    """Nothing is found: no second search, and nothing says that skin is elsewhere."""
    asked = []

    def search(rows: Array, near: Array) -> Array:
        asked.append(len(rows))
        return np.full_like(near, np.nan)

    frame = Frame(START + 100)
    look, _ = _look(Motion.at_rest(START, 0), frame, START, search)
    assert asked == [64]
    assert not look.elsewhere
    assert frame.runs == 1


def test_what_is_gone_costs_nothing() -> None:
    """After as many frames as a speed is good for."""
    motion = Motion.at_rest(START, 0)
    nothing = np.full_like(START, np.nan)
    runs = []
    for number in range(1, 8):
        frame, asked = Frame(START + 100), []

        def search(rows: Array, near: Array, asked: list[int] = asked) -> Array:
            asked.append(1)
            return np.full_like(near, np.nan)

        _look(motion, frame, START, search)
        runs.append(len(asked))
        motion = motion.see(nothing, number)
    assert runs == [1] * TRUSTED + [0] * (7 - TRUSTED)


def test_lost_points_move_with_their_neighbours() -> None:
    """Not at the speed that they had: skin at rest begins to move by 1.5 px a frame, a fourth of it unseen."""
    motion, lost = Motion.at_rest(START, 0), np.arange(200) % 4 == 0
    for number in range(1, 20):
        place = START + np.float32(1.5 * number)
        motion = motion.see(np.where(lost[:, None], np.nan, place).astype(np.float32), number, place)
    np.testing.assert_allclose(motion.expect(21), START + 1.5 * 21, atol=1e-2)


def test_new_points_have_the_speed_of_those_around_them() -> None:
    motion = Motion.at_rest(START, 0)
    speed = np.where(START[..., :1] > 150, np.float32(1.2), np.float32(0)) * np.array([1, -1], np.float32)
    for number in range(1, 30):
        motion = motion.see(START + number * speed, number)
    new = np.array([[[20, 150], [280, 150], [np.nan, np.nan]]], np.float32)
    np.testing.assert_allclose(motion.of_others(new, 27).speed[0, :2], [[0, 0], [1.2, -1.2]], atol=1e-4)
    assert not Motion.at_rest(START[:, :7], 0).of_others(new, 0).speed.any()  # of too few


def test_the_flag_of_slip_outlives_a_choice_of_other_points() -> None:
    """Other points take over the displacement of the nearest ones: on skin that is displaced by 3 px and stretched by
    2 %, to 0.25 px, which is what four neighbours some 15 px away leave of it; and the residual stays."""
    old, new = START[0].astype(float), 300 * DRAW.random((150, 2))
    std, covered = np.full(200, 0.03), np.ones(200, np.uint8)

    def slipped(points: Array) -> Array:
        return points + np.stack((3 + 0.04 * (points[:, 0] - 150), 0 * points[:, 0]), 1)

    flag = SlipFlag()
    flag.see(old, std, covered)
    for _ in range(4):
        state = flag.see(slipped(old), std, covered)
    assert state.slipping
    flag.follow_others(slipped(old), slipped(new))
    after = [flag.see(slipped(new), std[:150], covered[:150]) for _ in range(6)]
    assert all(one.slipping for one in after)
    assert after[-1].residual == pytest.approx(state.residual, rel=0.15)


def test_the_flag_is_held_where_no_old_point_is_left_until_the_contact_ends() -> None:
    old, std, covered = START[0].astype(float), np.full(200, 0.03), np.ones(200, np.uint8)
    stretched, lost = old * 1.02, np.full_like(old, np.nan)
    flag = SlipFlag()
    flag.see(old, std, covered)
    assert [flag.see(stretched, std, covered).slipping for _ in range(4)][-1]
    assert all(flag.see(lost, std, covered).slipping for _ in range(6))  # unknown is no rest
    flag.follow_others(lost, stretched)
    assert all(flag.see(stretched, std, covered).slipping for _ in range(6))
    for _ in range(3):
        ended = flag.see(stretched, std, 0 * covered)
    assert not ended.slipping
