"""Tests that a stream gives the same numbers in whatever order its frames begin and end, within its lag."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from scipy import ndimage

from fingerflow.engines.engine import Engine, EngineSettings
from fingerflow.schema.variables import FRAME_STATUS
from fingerflow.tracker.frame_tracker import (
    CONTACT_VIEW,
    TOPOGRAPHY_VIEW,
    Event,
    Frame,
    FrameOutcome,
    StreamTracker,
    TrackerSettings,
)

Array = np.ndarray[Any, Any]
Make = Callable[[EngineSettings], Engine]
HEIGHT, WIDTH, FRAMES = 144, 176, 30
JUMPS = 17  # frame in which all skin jumps by 6 px and stays: in doubt until the next frame
ACROSS, DOWN = np.meshgrid(np.arange(WIDTH), np.arange(HEIGHT))


@pytest.fixture(scope="module")
def frames() -> list[Array]:
    """Return frames of skin that stretches by 0.6 % a frame, so that templates are updated within eight frames."""
    rng = np.random.default_rng(0)
    skin = sum(ndimage.gaussian_filter(rng.standard_normal((400, 400)), size) * size for size in (1.8, 12.0))
    skin = 120 + 45 * skin / skin.std()
    views = []
    for k in range(FRAMES):
        moved = 6.0 * (k >= JUMPS) + 0.2 * k
        places = [200 + (one - one.mean() - moved) / (1 + 0.006 * k) for one in (DOWN, ACROSS)]
        view = ndimage.map_coordinates(skin, places, order=3)
        views.append(np.clip(np.round(view), 0, 255).astype(np.uint8)[None, None])
    return views


def played(engine: Engine, frames: list[Array], lag: int, beside: int) -> tuple[list[FrameOutcome], list[Event]]:
    """Return the outcomes and events of frames of which up to `beside`, at most the lag, have begun before the first of
    them ends.
    """
    region = np.zeros((HEIGHT, WIDTH), bool)
    region[24:-24, 24:-24] = True
    settings = TrackerSettings(
        points=80, bit_depth=8, mm_per_px=0.05, topography_to_contact=np.eye(2, 3), region=region, threshold=0.3
    )
    tracker = StreamTracker(engine, settings, np.full((HEIGHT, WIDTH), 200.0), np.zeros((HEIGHT, WIDTH)), lag)
    passed: list[Event | FrameOutcome] = []
    works = []
    for number, topography in enumerate(frames):
        frame = Frame(
            {CONTACT_VIEW: np.full((1, 1, HEIGHT, WIDTH), 190, np.uint8), TOPOGRAPHY_VIEW: topography}, number
        )
        tracker.inspect(frame)
        while works and (len(works) == beside or tracker.must_wait(frame)):
            passed += tracker.finish(works.pop(0))
        work, before = tracker.begin(frame)
        passed += before
        tracker.compute(work)
        works.append(work)
    for work in works:
        passed += tracker.finish(work)
    passed += tracker.settle()
    return [one for one in passed if isinstance(one, FrameOutcome)], [one for one in passed if isinstance(one, Event)]


def test_numbers_do_not_depend_on_which_frames_have_begun(make_engine: Make, frames: list[Array]) -> None:
    engine, lag = make_engine(EngineSettings()), 3
    (alone, events), (beside, same) = (played(engine, frames, lag, count) for count in (1, lag))
    assert len(alone) == len(beside) == FRAMES
    assert events == same
    for one, other in zip(alone, beside, strict=True):
        assert one.status == other.status == FRAME_STATUS.index("usable")
        assert one.points is not None
        assert other.points is not None
        assert one.tracked > 50
        for ours, theirs in zip(one.points, other.points, strict=True):
            np.testing.assert_array_equal(ours, theirs)
