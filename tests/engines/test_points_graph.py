"""Tests of points tracked, judged and corrected in one call, against the same steps with the host between them."""

from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

import numpy as np
import pytest
import torch

from fingerflow.engines.capture import Captured, RecordedCall
from fingerflow.engines.check import built_in
from fingerflow.engines.engine import EngineSettings, FoundPoints, Tracked, TracksWhole
from fingerflow.engines.points_graph import check_track
from fingerflow.engines.torch import TorchEngine
from fingerflow.errors import FingerflowError
from fingerflow.kernels import tensors as kernels
from fingerflow.kernels.tracking_limits import TrackStatus
from fingerflow.tracker.recovery import rejected
from tests.engines.test_torch_together import CLOSE, COUNTS, images, noise_of, warps
from tests.fused_op import serve_in_place_of_triton
from tests.replayed_ops import record
from tests.small_trials import HEIGHT, WIDTH
from tests.standing_in import standing_in

SETTINGS = EngineSettings(window_px=15, forward_backward_limit_px=0.5)
CPU = torch.device("cpu")


@pytest.fixture(autouse=True)
def portable(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Turn off the compiled kernels, and let an op stand in for the tracking kernel of Triton."""
    monkeypatch.setattr(kernels, "serve", lambda *tensors: False)
    serve_in_place_of_triton(monkeypatch)
    with torch.inference_mode():
        yield


def given_to(engine: TorchEngine) -> list[tuple[Any, ...]]:
    """Return the arguments of `track` for three recordings of other numbers of frames and points, close together; one
    point of each has moved apart from its neighbours, and one is beyond the frame.
    """
    given = []
    for k, (key,) in enumerate(noise_of(engine)):
        random = np.random.default_rng(k)
        there = random.uniform((WIDTH / 2 - 30, HEIGHT / 2 - 25), (WIDTH / 2 + 30, HEIGHT / 2 + 25), (COUNTS[k], 2))
        there = there.astype(np.float32)
        there[3] = (2, 2)
        start, deformed = there.copy(), warps(k)
        start[6] += 6
        templates = engine.prepare(engine.key(key), there, deformed)
        place = there + random.normal(0, 0.5, there.shape).astype(np.float32)
        shown = images(engine, "topography", k, 1), place, np.zeros_like(place)
        given.append((templates, *shown, engine.neighbours(start), start, deformed))
    return given


def step_by_step(engine: TorchEngine, arguments: tuple[Any, ...]) -> Tracked:
    """Track the points of one recording, reject the outliers on the host, and correct the others."""
    templates, images, place, speed, neighbours, start, inverse_warp = arguments
    followed = engine.follow(templates, images, place, speed)
    found = followed.found
    off, uncertain = engine.outliers(neighbours, start, found)
    tracked = found.status == TrackStatus.TRACKED
    judged = rejected(found, tracked & uncertain, TrackStatus.UNCERTAIN)
    judged = rejected(judged, tracked & off, TrackStatus.OFF_NEIGHBOURS)
    return Tracked(followed, engine.correct(start, judged, templates.numbers, inverse_warp))


def leaves(tracked: Tracked) -> list[np.ndarray]:
    assert tracked.corrected is not None
    found, *after = tracked.followed
    judged, *others = tracked.corrected
    return [*found, *after, *judged, *others]


def assert_equal(ours: Tracked, theirs: Tracked) -> None:
    for one, other in zip(leaves(ours), leaves(theirs), strict=True):
        assert one.shape == other.shape
        assert one.dtype == other.dtype
        np.testing.assert_allclose(one, other, rtol=CLOSE["rtol"], atol=CLOSE["atol"])


@pytest.mark.parametrize("device", [False, True])
def test_one_call_gives_the_results_of_three(device: bool) -> None:
    """Tracking, outliers and correction in one call give what they give with the host between them, for one recording
    and for several of different lengths, also where points are padded for a device.
    """
    engine = TorchEngine(SETTINGS, CPU, transfers=standing_in()[0] if device else None)
    assert isinstance(engine, TracksWhole)
    given = given_to(engine)
    together = engine.begun("track", given)()
    statuses = set[int]()
    for ours, arguments in zip(together, given, strict=True):
        expected = step_by_step(engine, arguments)
        assert_equal(ours, expected)
        assert_equal(engine.track(*arguments), expected)
        assert expected.corrected is not None
        statuses |= set(np.unique(expected.corrected.found.status))
    assert {TrackStatus.TRACKED, TrackStatus.OFF_NEIGHBOURS} < statuses
    assert_equal(engine.track(*given[-1]), step_by_step(engine, given[-1]))


def test_one_graph_for_all_steps_and_frames() -> None:
    """Captured, the points of all frames and recordings take one replay a call, which sees new images."""
    replayed = list[str]()

    def recorded(call: Any) -> Any:
        made = record(call)
        return made._replace(replay=lambda: (replayed.append("graph"), made.replay()))

    engine, alone = TorchEngine(SETTINGS, CPU, partial(Captured, record=recorded)), TorchEngine(SETTINGS, CPU)
    given = given_to(alone)
    for call in range(4):
        shown = [(one[0], torch.round(one[1] * (1 - 0.02 * call)).to(torch.uint8), *one[2:]) for one in given]
        replayed.clear()
        ours = engine.begun("track", shown)()
        assert len(replayed) == (call >= 2)
        for one, arguments in zip(ours, shown, strict=True):
            assert_equal(one, step_by_step(alone, arguments))


def record_for_ever(call: Callable[[], Any]) -> RecordedCall:
    """Return a recording that does not see new inputs."""
    return RecordedCall(lambda: None, call())


def test_points_that_stand_still_are_noticed_at_start() -> None:
    """The check at start passes where the graph of the points sees new frames, and fails where it repeats the first."""
    frame = built_in(96, 128, 8, 48, SETTINGS.window_px)
    check_track(TorchEngine(SETTINGS, CPU), frame)
    engine = TorchEngine(SETTINGS, CPU)
    engine._points = Captured(engine._points, record)
    check_track(engine, frame)
    engine._points = Captured(engine._points._module, record_for_ever)
    with pytest.raises(FingerflowError, match="tracked and corrected in one call"):
        check_track(engine, frame)


def test_without_the_kernel_points_are_only_followed(monkeypatch: pytest.MonkeyPatch) -> None:
    engine = TorchEngine(SETTINGS, CPU)
    given = given_to(engine)
    monkeypatch.setattr(kernels, "fused_tracking_serves", lambda *tensors: False)
    for tracked, arguments in zip(engine.begun("track", given)(), given, strict=True):
        assert tracked.corrected is None
        found: FoundPoints = engine.follow(*arguments[:4]).found
        for one, other in zip(tracked.followed.found, found, strict=True):
            np.testing.assert_allclose(one, other, rtol=CLOSE["rtol"], atol=CLOSE["atol"])
