"""Tests of points tracked through motion beyond the reach of one look, and of templates updated as the skin deforms."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from known_skin import Array, KnownSkin
from scipy import ndimage

from fingerflow.engines.engine import Engine, EngineSettings, FoundPoints
from fingerflow.engines.together import run_alone
from fingerflow.kernels.tracking_limits import TrackStatus
from fingerflow.tracker.points import STREAM, Points, Resolved

START = (300 * np.random.default_rng(4).random((200, 2))).astype(np.float32)
IMAGE = np.zeros((1, 1, 1, 1), np.float32)


def _points(engine: KnownSkin, lag: int = 1) -> Points:
    engine.start = START
    points = Points(engine, IMAGE, START, knowledge=replace(STREAM, lag=lag))  # type: ignore[arg-type]
    engine.looks.clear()
    return points


def _see(points: Points, late: Array | None = None) -> tuple[Resolved, FoundPoints]:
    """Track the points in a frame, from their expected positions or from `late`; return the resolved and the accepted
    points.
    """
    guess = points.expect() if late is None else late
    resolved = points.resolve(IMAGE, guess, points.look(IMAGE, guess))
    return resolved, points.accept(IMAGE, resolved)


def _found(resolved: Resolved) -> Array:
    result: Array = resolved.corrected.found.status[0] == TrackStatus.TRACKED
    return result


def test_a_frame_that_loses_nothing_costs_one_look() -> None:
    engine = KnownSkin(START + np.float32(0.4))
    resolved, _ = _see(_points(engine))
    assert _found(resolved).all()
    assert (engine.looks, engine.searches) == ([200], [])
    assert resolved.jolted is None


def test_a_step_of_speed_is_followed_from_the_frame_before() -> None:
    """Points are tracked when their speed grows by 0.6 px a frame: two frames late they are 1.2 px off, beyond the
    certain reach of a look, but from the frame before only 0.6 px.
    """
    engine = KnownSkin(START)
    points = _points(engine, lag=2)
    for number in range(1, 12):
        engine.place = START + np.float32(0.4 * number)
        _see(points)
    late = points.expect() - np.float32(0.6)
    engine.place = points.motion.place + np.float32(1.0)
    resolved, _ = _see(points, late)
    assert _found(resolved).all()
    assert not engine.searches
    np.testing.assert_allclose(points.motion.speed, 0.7, atol=1e-3)  # mean of 0.4 and 1.0


@pytest.mark.parametrize(
    ("gone", "far", "searches"),
    [(200, 4.0, []), (20, 40.0, [20]), (200, 100.0, [64])],
    ids=["a jump within half a ridge", "few points gone", "a frame of another moment"],
)
def test_what_is_lost_costs_one_search(gone: int, far: float, searches: list[int]) -> None:
    """A jump of up to 4 px needs no search, because a look moves by up to 1.5 px several times. A tenth of the points,
    if gone, are searched for once; their loss is not taken for a jump. A frame of another moment, in which the search
    finds nothing, costs no second search.
    """
    place = START.copy()
    place[:gone] += np.float32(far)
    engine = KnownSkin(place)
    resolved, _ = _see(_points(engine))
    assert engine.searches == searches
    np.testing.assert_array_equal(_found(resolved), np.arange(200) >= (gone if searches else 0))


def test_a_jump_of_a_part_of_the_skin_is_found_by_a_search_and_by_neighbours() -> None:
    """If half of the skin jumps by 8 px, beyond the reach of a look, a search of 64 points finds some of them, and a
    plane through these the others.
    """
    half = START[:, 0] > 150
    jumped = START + np.where(half, np.float32(8), np.float32(0))[:, None] * np.array([1, 0], np.float32)

    def by_neighbours(points: Array) -> Array:
        there = np.isfinite(points).all(-1) & half
        moved = (points - START)[there].mean(0) if there.any() else np.full(2, np.nan)
        return np.where(half[:, None], START + moved, START)

    engine = KnownSkin(jumped, by_neighbours)
    points = _points(engine)
    resolved, found = _see(points)
    np.testing.assert_array_equal(found.points[0], jumped)
    assert engine.searches == [64]
    np.testing.assert_array_equal(resolved.jolted, half)
    assert not points.motion.speed.any()  # one jolt is no motion


@pytest.mark.parametrize("count", [0, 1])
def test_points_without_neighbours_are_followed(make_engine: Callable[[EngineSettings], Engine], count: int) -> None:
    engine = make_engine(EngineSettings())
    rng = np.random.default_rng(0)
    view = np.clip(ndimage.gaussian_filter(rng.standard_normal((80, 90)), 2) * 250 + 120, 0, 255).astype(np.uint8)
    start = np.array([[45, 40]], np.float32)[:count]
    points = Points(engine, engine.images(view[None]), start)
    found = run_alone(points.follow(engine.images(np.roll(view, 1, axis=1)[None].repeat(3, axis=0))))
    assert (found.status == TrackStatus.TRACKED).all()
    np.testing.assert_allclose(found.points, np.broadcast_to(start + np.float32([1, 0]), found.points.shape), atol=1e-3)
