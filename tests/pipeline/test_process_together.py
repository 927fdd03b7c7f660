"""Tests of recordings processed together against each processed alone."""

from functools import partial, wraps
from inspect import signature
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
import xarray as xr
from torch import Tensor

from fingerflow import process
from fingerflow.engines import capture
from fingerflow.engines.capture import Captured, RecordedCall
from fingerflow.engines.engine import EngineSettings
from fingerflow.engines.torch import TorchEngine
from fingerflow.errors import FingerflowError
from fingerflow.graphs.contact_graph import ContactGraph
from fingerflow.graphs.track import TrackGraph
from fingerflow.kernels import tensors as kernels
from fingerflow.pipeline import run
from fingerflow.pipeline.run import process_together
from fingerflow.pipeline.stages.preparation import inputs
from fingerflow.synthetic import Press, write_recording
from tests.fused_op import serve_in_place_of_triton
from tests.replayed_ops import record
from tests.small_trials import edit_scene
from tests.standing_in import standing_in

_FRAME = {"frame_rate": 10.0, "frames_before_trigger": 1, "frame_shape": (96, 240), "finger": (1.8, 1.5)}
_TRIALS = (
    Press(n_frames=10, semi_axes=(1.3, 1.1), **_FRAME),
    Press(n_frames=10, semi_axes=(1.2, 1.1), shift=(-0.2, 0.1), **_FRAME),
    Press(n_frames=6, semi_axes=(1.1, 1.0), gradient=((-0.02, 0.01), (0.0, -0.03)), **_FRAME),  # fewer frames
)
_POINTS = (40, 60, 33)
# px: portable matrix products of larger batches sum in another order, and the fit of a gradient divides that
# rounding by a window.
_ROUNDING = {"position_px": 1e-4, "divergence": 2e-5, "curl": 2e-5, "real_contact_area": 0.0, "median_divergence": 2e-5}


def write_scenes(within: Path) -> list[Path]:
    """Write three trials with frames of one size but different motion, points and numbers of frames; return their scene
    files.
    """
    found = []
    for trial, points in zip(_TRIALS, _POINTS, strict=True):
        folder = within / f"trial{points}" / "recording"
        write_recording(folder, trial)
        found.append(edit_scene(folder, {"points = 700": f"points = {points}"}))
    return found


@pytest.fixture(scope="module")
def scenes(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    return write_scenes(tmp_path_factory.mktemp("trials"))


@pytest.fixture
def portable(monkeypatch: pytest.MonkeyPatch) -> None:
    """Disable the compiled kernels, as on an accelerator."""
    monkeypatch.setattr(kernels, "serve", lambda *tensors: False)


def together(scenes: list[Path], **named: Any) -> list[xr.Dataset]:
    return process_together(scenes, device="cpu", **named)


def alone(scenes: list[Path]) -> list[xr.Dataset]:
    return [process(scene, device="cpu") for scene in scenes]


def compare(found: xr.Dataset, expected: xr.Dataset, rounding: dict[str, float] | None = None) -> None:
    """Check that all variables are equal bit for bit or, with `rounding`, that the named variables agree to these
    tolerances.
    """
    assert set(found) == set(expected)
    for name in found if rounding is None else rounding:
        if rounding is None:
            np.testing.assert_array_equal(found[name].values, expected[name].values, err_msg=str(name))
        else:
            np.testing.assert_allclose(
                found[name].values, expected[name].values, rtol=0, atol=rounding[str(name)], err_msg=str(name)
            )


@pytest.fixture
def batches(monkeypatch: pytest.MonkeyPatch) -> dict[str, list[int]]:
    """Return a dictionary that records the batch size of each call of a graph."""
    seen: dict[str, list[int]] = {}
    for graph, image in ((ContactGraph, "frames"), (TrackGraph, "view")):
        sizes = seen[graph.__name__] = []
        forward = graph.forward

        @wraps(forward)
        def counted(
            *given: Any, _sizes: list[int] = sizes, _of: Any = forward, _image: str = image, **named: Any
        ) -> Any:
            _sizes.append(len(signature(_of).bind(*given, **named).arguments[_image]))
            return _of(*given, **named)

        monkeypatch.setattr(graph, "forward", counted)
    return seen


@pytest.mark.usefixtures("portable")
def test_one_call_of_a_graph_is_of_all_recordings(
    scenes: list[Path], batches: dict[str, list[int]], caplog: pytest.LogCaptureFixture
) -> None:
    expected, most = [], dict.fromkeys(batches, 0)
    for scene in scenes:
        expected += alone([scene])
        most = {name: max(most[name], len(sizes)) for name, sizes in batches.items()}
        assert max(batches["TrackGraph"]) == 1
        for sizes in batches.values():
            sizes.clear()
    found = together(scenes)
    for one, other in zip(found, expected, strict=True):
        assert one.sizes == other.sizes
        np.testing.assert_array_equal(one["status"].values, other["status"].values)
        compare(one, other, _ROUNDING)
    assert {name: max(sizes) for name, sizes in batches.items()} == {"ContactGraph": 22, "TrackGraph": 3}
    # Together they take as many calls as the longest one, except for the frames that each checks beforehand.
    assert len(batches["TrackGraph"]) <= most["TrackGraph"]
    assert sum(size > 1 for size in batches["ContactGraph"]) == 2
    assert not caplog.messages


@pytest.mark.usefixtures("portable")
def test_the_same_again_is_the_same_bit_for_bit(scenes: list[Path]) -> None:
    for one, other in zip(together(scenes), together(scenes), strict=True):
        compare(one, other)


@pytest.mark.parametrize("engine", ["native", "torch"])
def test_compiled_kernels_give_each_its_own_numbers(scenes: list[Path], engine: str) -> None:
    """Recordings processed together equal those processed alone bit for bit, in memory and in files."""
    folder = scenes[0].parent.parent
    files = [folder / f"{engine}-{place}.h5" for place in range(3)]
    expected = [process(scene, device="cpu", engine=engine) for scene in scenes]
    for found in (together(scenes, engine=engine), together(scenes, engine=engine, to=files)):
        for one, other in zip(found, expected, strict=True):
            compare(one, other)


@pytest.mark.usefixtures("portable")
def test_other_settings_are_asked_by_themselves(scenes: list[Path], batches: dict[str, list[int]]) -> None:
    limit = {"forward_backward_limit_px = 1.0": "forward_backward_limit_px = 0.5"}
    other = edit_scene(scenes[1].parent, limit, "other.toml")
    given = [scenes[0], other]
    for one, expected in zip(together(given), alone(given), strict=True):
        compare(one, expected, _ROUNDING)
    assert max(batches["TrackGraph"]) == 1


@pytest.mark.usefixtures("portable")
def test_on_a_stand_in_for_a_gpu(scenes: list[Path], monkeypatch: pytest.MonkeyPatch) -> None:
    """Results stay the same on a stand-in for a GPU: captured modules, one of them for all steps of the points, frames
    decoded and uploaded ahead by a second thread, and results copied behind the computation.
    """
    expected = alone(scenes)
    monkeypatch.setattr(capture, "_AFTER", 0)  # the recordings are short
    replayed: list[str] = []
    way, device = standing_in()
    engines: list[TorchEngine] = []

    def recorded(call: Any) -> RecordedCall:
        found = record(call)
        return found._replace(replay=lambda: (replayed.append("graph"), found.replay()))

    def engine_for(name: str, settings: EngineSettings, device: torch.device) -> TorchEngine:
        engines.append(TorchEngine(settings, device, partial(Captured, record=recorded), way))
        return engines[-1]

    monkeypatch.setattr(inputs, "engine_for", engine_for)
    monkeypatch.setattr(run, "_decodes_ahead", lambda inputs: True)
    serve_in_place_of_triton(monkeypatch)
    for one, other in zip(together(scenes), expected, strict=True):
        np.testing.assert_array_equal(one["status"].values, other["status"].values)
        compare(one, other, _ROUNDING)
    assert len(replayed) > 10
    graphs = [graph for engine in engines for graph in engine._points._graphs.values()]  # type: ignore[attr-defined]
    assert graphs
    assert None not in graphs  # all could be recorded
    assert device.order.count("copy ahead") > 2 * len(engines)
    assert device.order.count("copy back") == device.order.count("wait for back")


@pytest.mark.usefixtures("portable")
def test_what_fails_for_all_is_computed_one_by_one(scenes: list[Path], monkeypatch: pytest.MonkeyPatch) -> None:
    """A batch that does not fit in memory is computed one recording at a time."""
    expected = alone(scenes[:2])
    forward, refused = TrackGraph.forward, []

    def small(self: TrackGraph, templates: Any, view: Tensor, prediction: Tensor) -> Any:
        if len(view) > 1:
            refused.append(len(view))
            raise torch.OutOfMemoryError("no room for two")
        return forward(self, templates, view, prediction)

    monkeypatch.setattr(TrackGraph, "forward", small)
    for one, other in zip(together(scenes[:2]), expected, strict=True):
        compare(one, other, _ROUNDING)
    assert refused


@pytest.mark.usefixtures("portable")
def test_an_error_of_one_is_its_own(scenes: list[Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """An error in one recording, from its scene or from a batched call, does not affect the others."""
    forward = TrackGraph.forward

    def breaks(self: TrackGraph, templates: Any, view: Tensor, prediction: Tensor) -> Any:
        if templates.start.shape[1] == _POINTS[2] or len(view) > 1:
            raise FingerflowError("the third one")
        return forward(self, templates, view, prediction)

    monkeypatch.setattr(TrackGraph, "forward", breaks)
    missing = scenes[0].with_name("missing.toml")
    files = [tmp_path / f"{place}.h5" for place in range(4)]
    with pytest.raises(FingerflowError, match=r"missing\.toml"):
        together([scenes[0], missing, scenes[1], scenes[2]], to=files)
    assert {path.name for path in tmp_path.iterdir()} == {"0.h5", "2.h5"}
    with pytest.raises(FingerflowError, match="the third one"):
        together([scenes[2], scenes[0]], to=files[2:], overwrite=True)
    assert {path.name for path in tmp_path.iterdir()} == {"0.h5", "2.h5", "3.h5"}


@pytest.mark.usefixtures("portable")
@pytest.mark.parametrize("stop", [KeyboardInterrupt, SystemExit])
def test_an_interrupt_ends_all(
    scenes: list[Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, stop: type[BaseException]
) -> None:
    """An interrupt in a batched call ends all recordings at once, removes their files and leaves torch's modes
    unchanged.
    """

    def stops(self: TrackGraph, *given: Any) -> Any:
        raise stop

    monkeypatch.setattr(TrackGraph, "forward", stops)
    with pytest.raises(stop):
        together(scenes[:2], to=[tmp_path / "0.h5", tmp_path / "1.h5"])
    assert not list(tmp_path.iterdir())
    assert not torch.is_inference_mode_enabled()


def test_processing_no_recordings_gives_no_results() -> None:
    assert process_together([]) == []
