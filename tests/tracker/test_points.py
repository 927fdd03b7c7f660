"""Tests of points tracked through motion beyond the reach of one look, and of templates updated as the skin deforms."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from known_skin import Array, KnownSkin
from scipy import ndimage

from fingerflow.engines.engine import Engine, EngineSettings, FoundPoints
from fingerflow.engines.together import run_alone
from fingerflow.kernels.tracking_limits import UPDATE_PX, TrackStatus
from fingerflow.tracker.point_prediction import TRUSTED
from fingerflow.tracker.points import FASTEST_PX, MOST_FRAMES, STREAM, Points, Resolved

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


def test_lost_points_are_searched_for_only_while_their_speed_is_trusted() -> None:
    """Points that are gone cost one search in each of the first `TRUSTED` frames, while their speed is trusted, and
    none later.
    """
    engine = KnownSkin(START + 100)
    points, searches = _points(engine), []
    for _ in range(7):
        engine.searches.clear()
        _see(points)
        searches.append(len(engine.searches))
    assert searches == [1] * TRUSTED + [0] * (7 - TRUSTED)


def _stretched(by: float) -> Array:
    return np.broadcast_to(np.eye(2, dtype=np.float32) * np.float32(1 + by), (len(START), 2, 2)).copy()


@pytest.mark.parametrize(("lag", "every"), [(1, 1), (2, 2), (1, 99)])
def test_templates_are_updated_eight_frames_after_they_were_found_to_have_changed(
    monkeypatch: pytest.MonkeyPatch, lag: int, every: int
) -> None:
    """Templates are checked every eighth frame. Six of them exceed the limit, are prepared in pieces meanwhile, and are
    used from the sixteenth frame on; meanwhile no others are chosen.

    Pieces begin at the same rows, whether there is time to prepare one in every frame, in every second, or in none.
    """
    monkeypatch.setattr("fingerflow.tracker.points.ROWS", 2)
    engine = KnownSkin(START)
    points = _points(engine, lag)
    change = UPDATE_PX / (engine.settings.window_px // 2)
    updated = {}
    for index in range(1, 30):
        if index >= 3:
            engine.warp = _stretched(0)
            engine.warp[:6] = _stretched(1.1 * change / 2**0.5)[:6]
            engine.warp[6:9] = _stretched(0.9 * change / 2**0.5)[6:9]
        if points.changes(index):
            points.update_due(index)
            updated[index] = np.concatenate(engine.updates)
            engine.updates.clear()
        guess = points.expect()
        points.accept(IMAGE, points.resolve(IMAGE, guess, points.look(IMAGE, guess)), 1, index)
        if index % every == 0:
            points.prepare_ahead()
        if 6 < index < 13:
            times = min((index // every) - (6 // every), 3)
            assert engine.prepared == [2] * times
    assert list(updated) == [16]
    np.testing.assert_array_equal(updated[16], np.arange(6))
    np.testing.assert_allclose(engine.inverse[:6] @ _stretched(1.1 * change / 2**0.5)[:6], _stretched(0)[:6], atol=1e-6)


@pytest.mark.parametrize(("a_frame", "frames"), [(0.1, 8), (0.3, 2), (5.0, 1)])
def test_templates_of_fast_skin_are_checked_sooner(
    monkeypatch: pytest.MonkeyPatch, a_frame: float, frames: int
) -> None:
    """Templates are checked again after the number of frames in which the edge of a window changes by `FASTEST_PX`, at
    most eight, rounded down to a power of two; one point in twenty may be faster, or lost.
    """
    engine = KnownSkin(START)
    points = _points(engine)
    check, checked = points._plan_template_update, []

    def note(*given: Any) -> None:
        checked.append(index)
        check(*given)

    monkeypatch.setattr(points, "_plan_template_update", note)
    a_component = a_frame * FASTEST_PX / (engine.settings.window_px // 2)
    for index in range(1, 24):
        warp = _stretched(0)
        warp[:, 0, 1] += np.float32(a_component * index)
        warp[0], warp[1:4] = np.nan, warp[1:4] + 100 * index
        engine.warp = warp
        _see(points)
    first = MOST_FRAMES - 1  # frames are counted from the key frame
    assert checked[0] == first
    assert checked[1] == first + frames


def test_an_update_that_fails_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    """The error of an update that fails is raised where it is prepared, ahead of time or when it is due."""
    engine = KnownSkin(START)
    points = _points(engine)
    engine.warp = _stretched(1.1 * UPDATE_PX / (engine.settings.window_px // 2) / 2**0.5)

    def failing(*_: Any) -> Any:
        raise MemoryError("no room")

    for _ in range(MOST_FRAMES - 1):
        _see(points)
    assert not engine.prepared
    monkeypatch.setattr(engine, "prepare", failing)
    _see(points)
    with pytest.raises(MemoryError, match="no room"):
        points.prepare_ahead()
    with pytest.raises(MemoryError, match="no room"):
        points.update_due(2 * MOST_FRAMES)


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
