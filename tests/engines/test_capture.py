"""Tests of modules replayed as recorded graphs against the same modules called.

A recording of the tests replays ops of the processor into the same tensors, as a CUDA graph does: values that were read
while it was recorded cannot change.
"""

import logging
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor, nn

from fingerflow.engines import choice
from fingerflow.engines.capture import Captured, RecordedCall
from fingerflow.engines.check import BuiltIn, built_in, check_frames
from fingerflow.engines.engine import Engine, EngineSettings, FrameEllipse
from fingerflow.engines.torch import TorchEngine
from fingerflow.errors import FingerflowError
from fingerflow.kernels import tensors as kernels
from fingerflow.kernels.tensors import serving
from tests.replayed_ops import record

CPU = torch.device("cpu")
SETTINGS = EngineSettings(window_px=15, gauge_length_mm=2.0)
SIZE = (96, 128, 8, 24)
CALLS = 5  # of each method: the first two are ordinary calls, the others are replayed


def record_for_ever(call: Callable[[], Any]) -> RecordedCall:
    """Return a recording that does not see new inputs."""
    return RecordedCall(lambda: None, call())


def record_nothing(call: Callable[[], Any]) -> RecordedCall:
    raise RuntimeError("operation not permitted when stream is capturing\nmore")


def captured(how: Callable[[Callable[[], Any]], RecordedCall]) -> TorchEngine:
    return TorchEngine(SETTINGS, CPU, partial(Captured, record=how))


@pytest.fixture(autouse=True)
def portable(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Turn off the compiled kernels, which do not serve on an accelerator."""
    monkeypatch.setattr(kernels, "serve", lambda *tensors: False)
    with torch.inference_mode():
        yield


@pytest.fixture
def frame() -> BuiltIn:
    return built_in(*SIZE, SETTINGS.window_px)


def results(engine: Engine, frame: BuiltIn, number: int) -> list[Any]:
    """Return all results of the built-in frame as a list of arrays.

    With a larger `number` the frame has less contact, is darker, and its points are expected further away.
    """
    darker, further = 1 - 0.03 * number, np.float32(0.05 * number)
    light = engine.light(frame.empty.astype(np.float32), None)
    view = frame.contact[None].copy()
    view[:, : 30 + 4 * number] = frame.empty[: 30 + 4 * number]
    contact = engine.contact(engine.images(view), light, np.array([0.4 + 0.02 * number], np.float32))
    topography = np.round(frame.topography * darker).astype(np.uint8)
    key = engine.key(engine.images(frame.key[None]))
    straight = np.broadcast_to(np.eye(2, dtype=np.float32), (len(frame.points), 2, 2)).copy()
    templates = engine.prepare(key, frame.points, straight + further / 50)
    place = frame.expected + further
    found = engine.follow(templates, engine.images(topography[None]), place, np.zeros_like(place)).found
    corrected = engine.correct(frame.points, found, templates.numbers, straight)
    outliers = engine.outliers(engine.neighbours(frame.points), frame.points, found)
    ellipse = FrameEllipse(*(np.array(one, np.float32) for one in ([[6, 5]], [[5, 4]], [further])))
    moved = 0.1 * np.nan_to_num(found.points - frame.points)
    fields = engine.fields(0.1 * np.nan_to_num(frame.points), moved, ellipse, 1e-4 * np.nan_to_num(found.covariance))
    given = [*contact, templates.numbers, *found, *corrected.found, *corrected[1:], *outliers, *fields]
    return [one for one in given if one is not None]


def test_each_frame_has_its_own_results(frame: BuiltIn) -> None:
    ordinary, replayed = TorchEngine(SETTINGS, CPU), captured(record)
    before: list[Any] = []
    for number in range(CALLS):
        given = results(replayed, frame, number)
        for ours, theirs in zip(given, results(ordinary, frame, number), strict=True):
            # Replayed ops may take other library calls for the same sums.
            np.testing.assert_allclose(ours, theirs, rtol=1e-4, atol=1e-4)
        if before:
            same = [np.array_equal(one, other, equal_nan=True) for one, other in zip(given, before, strict=True)]
            assert not all(same)
            assert not np.array_equal(given[1], before[1])  # area of real contact
        before = given
    for module in (replayed._contact, replayed._key, replayed._track, replayed._deformation, replayed._fields):
        assert any(graph is not None for graph in module._graphs.values()), module._module


def test_two_frames_differ_at_start(frame: BuiltIn) -> None:
    check_frames(TorchEngine(SETTINGS, CPU), frame)
    check_frames(captured(record), frame)
    check_frames(captured(record_nothing), frame)
    with pytest.raises(FingerflowError, match="not its own"):
        check_frames(captured(record_for_ever), frame)


def test_contact_alone_that_stands_still_is_noticed(frame: BuiltIn) -> None:
    engine = TorchEngine(SETTINGS, CPU)
    engine._contact = Captured(engine._contact, record_for_ever)
    with pytest.raises(FingerflowError, match="not its own"):
        check_frames(engine, frame)


def test_what_cannot_be_recorded_is_called(frame: BuiltIn, caplog: pytest.LogCaptureFixture) -> None:
    engine, ordinary = captured(record_nothing), TorchEngine(SETTINGS, CPU)
    with caplog.at_level(logging.WARNING):
        for number in range(CALLS):
            for ours, theirs in zip(results(engine, frame, number), results(ordinary, frame, number), strict=True):
                np.testing.assert_array_equal(ours, theirs)
    assert "TrackGraph is not captured as a graph and computed call by call: operation not permitted" in caplog.text
    assert len(caplog.messages) == len(set(caplog.messages))  # each module says it once


@pytest.mark.parametrize("way", ["record", "for ever"])
def test_the_engine_of_a_gpu_is_checked(
    way: str, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    """The engine of a GPU captures its modules if their numbers pass the check, and calls them without capture
    otherwise, with a warning.
    """
    made = TorchEngine

    def on_processor(settings: EngineSettings, device: torch.device, *modules: Any) -> TorchEngine:
        assert device.type == "cuda"
        assert modules in ((), (Captured,))
        return captured(record if way == "record" else record_for_ever) if modules else made(settings, CPU)

    monkeypatch.setattr("fingerflow.engines.torch.TorchEngine", on_processor)
    with caplog.at_level(logging.WARNING):
        engine = choice.engine_for("auto", SETTINGS, torch.device("cuda"))
    assert isinstance(engine._track, Captured) == (way == "record")  # type: ignore[attr-defined]
    assert len(caplog.messages) == (way != "record")
    choice._captures.cache_clear()


def test_a_gpu_that_computes_other_numbers_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    """No engine is made for a GPU whose positions are wrong with capture and without."""
    made = TorchEngine

    def on_processor(settings: EngineSettings, device: torch.device, *modules: Any) -> TorchEngine:
        engine = captured(record_for_ever) if modules else made(settings, CPU)
        follow = engine.follow
        monkeypatch.setattr(engine, "follow", lambda *given: _shifted(follow(*given)))
        return engine

    monkeypatch.setattr("fingerflow.engines.torch.TorchEngine", on_processor)
    choice._captures.cache_clear()
    with pytest.raises(FingerflowError):
        choice.engine_for("auto", SETTINGS, torch.device("cuda"))
    choice._captures.cache_clear()


def _shifted(found: Any) -> Any:
    """Return the result of `Engine.follow` with each point 5 px off."""
    return found._replace(found=found.found._replace(points=found.found.points + 5.0))


def test_triton_serves_only_where_a_c_compiler_is(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Triton builds the launchers of its kernels with a C compiler; without one the portable form is computed."""
    monkeypatch.setattr(serving, "find_spec", lambda name: name)
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.delenv("CC", raising=False)
    serving._has_triton.cache_clear()
    assert not serving._has_triton()
    (tmp_path / "gcc").touch(mode=0o755)
    serving._has_triton.cache_clear()
    assert serving._has_triton()
    serving._has_triton.cache_clear()


class Scaled(nn.Module):
    """Returns the sum of the given numbers times a factor, by default two, and the numbers."""

    factor = 2.0

    def forward(self, values: Tensor, factor: float | None = None) -> tuple[Tensor, Tensor]:
        return (factor or self.factor) * values.sum(0, keepdim=True), values


def test_the_graphs_that_are_kept() -> None:
    """A module keeps one graph for each signature, recorded after two calls, and at most eight; the value of a number
    is part of the signature.
    """
    module = Captured(Scaled(), record)
    assert module.factor == 2.0
    for size in range(1, 12):
        for count in range(4):
            assert len(module._graphs) == min(size - 1 + (count > 2), 8)
            total, same = module(torch.full((size,), float(count)))
            assert total.item() == 2 * count * size
            assert same.tolist() == [count] * size
    assert module(torch.ones(11), 5.0)[0].item() == 55
    assert module(torch.ones(11, dtype=torch.int64))[0].item() == 22


def test_results_of_threads_are_their_own() -> None:
    module = Captured(Scaled(), record)
    with ThreadPoolExecutor(4) as workers:
        found = list(workers.map(lambda number: module(torch.full((500,), float(number)))[0].item(), range(200)))
    assert found == [1000.0 * number for number in range(200)]


@pytest.mark.gpu
@pytest.mark.skipif(not torch.cuda.is_available(), reason="no CUDA device here: graphs were replayed by the processor")
def test_replayed_graphs_agree_with_ordinary_calls_on_a_gpu(frame: BuiltIn) -> None:
    device = torch.device("cuda")
    ordinary, replayed = TorchEngine(SETTINGS, device), TorchEngine(SETTINGS, device, Captured)
    check_frames(replayed, frame)
    for number in range(CALLS):
        for ours, theirs in zip(results(replayed, frame, number), results(ordinary, frame, number), strict=True):
            np.testing.assert_allclose(ours, theirs, rtol=1e-4, atol=1e-4)
    assert any(graph is not None for graph in replayed._track._graphs.values())
