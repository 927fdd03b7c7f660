"""Tests of copies to and from a device, on a stand-in whose copies are made only when somebody waits for them."""

from collections.abc import Iterator

import numpy as np
import pytest
import torch

from fingerflow.engines.check import BuiltIn, built_in
from fingerflow.engines.engine import EngineSettings
from fingerflow.engines.together import Call, Steps, run_alone, run_together
from fingerflow.engines.torch import TorchEngine
from fingerflow.engines.transfers import Transfers, transfers_of
from fingerflow.kernels import tensors as kernels
from tests.standing_in import standing_in

CPU = torch.device("cpu")
MIXED = [
    np.arange(5, dtype=np.uint8),
    np.array([[1.5, np.nan], [-0.0, 1e30]], np.float32),
    np.array([True, False, True]),
    np.zeros((0, 2), np.float32),
    np.arange(3),
    np.float64(2.5) * np.ones(()),
    np.arange(24, dtype=np.uint8).reshape(4, 6)[1:3, ::2],
]


def transfers() -> list[Transfers]:
    return [transfers_of(CPU), standing_in()[0]]


@pytest.mark.parametrize("way", transfers())
def test_arrays_come_back_as_they_were_sent(way: Transfers) -> None:
    """Arrays of any type, size and memory layout keep values, shapes and types on the way to the device and back."""
    there = way.send(MIXED)
    (back, doubled) = way.fetch(there), way.fetch([one + one for one in there])
    for one, other, twice in zip(MIXED, back(), doubled(), strict=True):
        np.testing.assert_array_equal(one, other, strict=True)
        np.testing.assert_array_equal(np.asarray(one + one), twice)
    assert way.fetch([])() == []
    assert way.send([]) == []


def test_one_copy_for_all_arrays_that_lie_in_one_buffer() -> None:
    """Results that lie in one buffer are copied back as they lie; a small part of a large buffer is packed before."""
    way, device = standing_in()
    whole = way.send([np.arange(1000.0), np.arange(3.0)])
    assert [one.tolist() for one in way.fetch(whole)()] == [list(range(1000)), list(range(3))]
    assert way.fetch(whole[1:])()[0].base.nbytes < 1000
    assert device.order.count("copy back") == 2


def test_frames_are_there_when_the_computation_asks_for_them() -> None:
    """Frames are copied on a stream of their own, and the computation waits for those that it asks for, not for later
    ones.
    """
    way, device = standing_in()
    first, second = (way.send_ahead(np.full((2, 3), value, np.uint8)) for value in (7, 9))
    assert [len(device_stream.left) for device_stream in (way._ahead,)] == [4]
    assert first().tolist() == [[7] * 3] * 2
    assert len(way._ahead.left) == 2  # the copy of the second, and its event
    assert second().tolist() == [[9] * 3] * 2
    assert second().tolist() == first().tolist() or not way._ahead.left
    assert device.order == ["copy ahead", "copy ahead"]  # the host has waited for nothing


def test_results_are_waited_for_in_the_order_in_which_they_are_asked_for() -> None:
    """The host waits for the results of an earlier computation while those of a later one are still on the way."""
    way, device = standing_in()
    older, newer = (way.fetch([torch.full((3,), value)]) for value in (1.0, 2.0))
    assert older()[0].tolist() == [1, 1, 1]
    assert way._back.left  # the newer results are not copied yet
    assert newer()[0].tolist() == [2, 2, 2]
    assert device.order == ["copy back", "copy back", "wait for back", "wait for back"]


SETTINGS = EngineSettings(window_px=15, gauge_length_mm=2.0)


@pytest.fixture
def frame(monkeypatch: pytest.MonkeyPatch) -> Iterator[BuiltIn]:
    """Turn off the compiled kernels, which do not serve on an accelerator, and return a built-in frame."""
    monkeypatch.setattr(kernels, "serve", lambda *tensors: False)
    with torch.inference_mode():
        yield built_in(96, 128, 8, 24, SETTINGS.window_px)


def recording(engine: TorchEngine, frame: BuiltIn, number: int) -> Steps[list[np.ndarray]]:
    """Measure contact and positions in three batches of frames, which are uploaded one batch ahead."""
    shown = [np.round(frame.topography * (1 - 0.02 * number - 0.01 * k)).astype(np.uint8)[None] for k in range(3)]
    light = engine.light(frame.empty.astype(np.float32), None)
    templates = yield Call(engine.prepare, (engine.key(engine.images(frame.key[None])), frame.points, None))
    place, found = frame.expected, []
    ahead = engine.images_ahead(shown[0])
    for k in range(3):
        images = ahead()
        if k < 2:
            ahead = engine.images_ahead(shown[k + 1])
        followed = yield Call(engine.follow, (templates, images, place, np.zeros_like(place), None))
        contact = yield Call(engine.contact, (images, light, np.full(1, 0.3 + 0.02 * number, np.float32)))
        place = followed.place
        found += [*followed.found, *contact]
    return found


def test_recordings_on_a_device_have_the_numbers_of_the_processor(frame: BuiltIn) -> None:
    """Recordings computed together on a device that copies behind have the numbers of each by itself."""
    way, device = standing_in()
    engine, alone = TorchEngine(SETTINGS, CPU, transfers=way), TorchEngine(SETTINGS, CPU)
    assert engine.computes_behind
    assert not alone.computes_behind
    together = run_together([recording(engine, frame, number) for number in range(4)])
    assert device.order.count("copy ahead") == 4 * (1 + 3)  # of each recording the key frame and three batches
    for number, ours in enumerate(together):
        for one, other in zip(ours, run_alone(recording(alone, frame, number)), strict=True):
            np.testing.assert_allclose(one, other, rtol=1e-4, atol=1e-4)


def test_the_host_does_not_wait_for_the_newest_calls(frame: BuiltIn) -> None:
    """Whenever the host waits for the results of one half of the recordings, newer results, those of the other half,
    are on the way too.
    """
    way, device = standing_in()
    engine = TorchEngine(SETTINGS, CPU, transfers=way)
    run_together([recording(engine, frame, number) for number in range(4)])
    on_the_way, at_waits = 0, list[int]()
    for call in device.order:
        if call == "wait for back":
            at_waits.append(on_the_way)
        on_the_way += {"copy back": 1, "wait for back": -1}.get(call, 0)
    begun = at_waits.index(2)
    assert begun == 4  # the noise of each key frame is waited for at once
    assert set(at_waits[begun:-1]) == {2}
    assert at_waits[-1] == 1  # nothing newer is left to compute
