"""Tests of the self-test of engines: a wrong result of any method or graph is refused, also one that does not change
from frame to frame.
"""

from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import torch
from torch.utils._pytree import tree_map

from fingerflow.engines.bundle import Bundle, load_bundle
from fingerflow.engines.check import TOLERANCES, BuiltIn, built_in, check_engine, expected_of, numbers_of
from fingerflow.engines.choice import open_onnx
from fingerflow.engines.engine import Array, Engine, EngineSettings, FrameEllipse
from fingerflow.engines.graph_engine import GraphEngine
from fingerflow.engines.native import NativeEngine
from fingerflow.engines.torch import TorchEngine
from fingerflow.errors import FingerflowError
from fingerflow.export.portable import PortableSession
from fingerflow.export.recording_engine import ExportedGraph, RecordingEngine
from fingerflow.kernels import tensors as kernels
from fingerflow.schema.recipe import GRAPHS, GraphName
from tests.without_kernels import without_kernels

Change = Callable[[Any], Any]

SETTINGS = EngineSettings(window_px=15, gauge_length_mm=2.0)
#: Engine methods whose results are compared.
METHODS = ["contact", "detect", "track", "correct", "search", "windows", "fit", "fields"]
EVERY_FRAME = ("contact", "track", "correct", "outliers", "fields")
LONG = pytest.mark.long


def falsify(value: Any) -> Any:
    """Return a result with each array or tensor shifted by one along its longest axis, and numbers enlarged by 2 %."""
    if isinstance(value, tuple):
        parts = [falsify(one) for one in value]
        return type(value)(*parts) if hasattr(value, "_fields") else tuple(parts)
    if isinstance(value, float):
        return 1.02 * value
    if isinstance(value, torch.Tensor):
        return torch.from_numpy(falsify(value.numpy()))
    if not isinstance(value, np.ndarray):
        return value
    moved = np.roll(value, 1, int(np.argmax(value.shape))) if value.ndim else value
    return (1.02 * moved).astype(value.dtype) if value.dtype.kind == "f" else moved


def first_for_ever() -> Change:
    """Return a function that returns what it was given first, of each shape, as a replayed graph that reads no new
    input does.
    """
    kept: dict[str, Any] = {}

    def change(value: Any) -> Any:
        return kept.setdefault(str(tree_map(lambda leaf: getattr(leaf, "shape", None), value)), value)

    return change


def changed(function: Callable[..., Any], change: Change) -> Callable[..., Any]:
    return lambda *given, **named: change(function(*given, **named))


@pytest.fixture(scope="module")
def frames() -> list[BuiltIn]:
    """Return the built-in frame, and that of the reversed motion."""
    frame = built_in(96, 128, 8, 64, SETTINGS.window_px)
    return [frame, frame.reversed()]


@pytest.fixture(scope="module")
def expected() -> dict[str, Any]:
    """Return the results of both motions by torch without compiled kernels."""
    with pytest.MonkeyPatch.context() as patch, torch.inference_mode():
        without_kernels(patch)
        return expected_of(TorchEngine(SETTINGS, torch.device("cpu")), 96, 128, 8, 64)


@pytest.fixture(params=["native", "torch"])
def engine(request: pytest.FixtureRequest) -> Engine:
    if not kernels.serve():
        pytest.skip("the compiled kernels were not built or are turned off")
    return NativeEngine(SETTINGS) if request.param == "native" else TorchEngine(SETTINGS, torch.device("cpu"))


def test_right_numbers_are_accepted(engine: Engine, frames: list[BuiltIn], expected: dict[str, Any]) -> None:
    """The compiled library and torch with its kernels give the numbers of torch's portable ops; all of them are
    compared, and known for most points in at least one of both motions.
    """
    assert [row["result"] for row in check_engine(engine, expected)] == [*TOLERANCES]
    numbers = numbers_of(engine, frames[0])
    assert set(numbers) == set(TOLERANCES)
    assert all(np.isfinite(values).mean() > 0.6 for values in numbers.values())
    for name in ("off_neighbours", "uncertain"):
        assert 3 <= numbers[name].sum() < 0.2 * len(frames[0].points)


def test_graphs_of_a_recording_give_the_numbers(expected: dict[str, Any], monkeypatch: pytest.MonkeyPatch) -> None:
    """The graphs that `process --engine onnx` exports give all numbers, deviations included; torch runs them here."""

    def run_by_torch(graph: ExportedGraph, arrays: dict[str, Array]) -> Any:
        session = PortableSession(graph._graph)
        inputs = [SimpleNamespace(name=name) for name in arrays]
        return SimpleNamespace(get_inputs=lambda: inputs, run=lambda _, feed: list(session(feed).values()))

    monkeypatch.setattr(ExportedGraph, "_exported", run_by_torch)
    with torch.inference_mode():
        check_engine(RecordingEngine(SETTINGS, 1), expected)


def test_the_truth_of_both_motions(engine: Engine, frames: list[BuiltIn]) -> None:
    """Positions, areas and gradients are those of the synthetic frame."""
    results = [numbers_of(engine, frame) for frame in frames]
    for numbers, shown, stretch in zip(results, frames, (0.05, -0.05), strict=True):
        known = np.isfinite(shown.points[:, 0])
        for name in ("found", "found_updated", "corrected"):
            assert np.sqrt(np.square(numbers[name] - shown.truth)[known].mean()) < 0.05
        # The material is stretched by 1 and -0.5 %; displacements for fields are five times as large. The spatial
        # medians refer to the moved positions.
        np.testing.assert_allclose(numbers["fit"].mean(0)[0, 0], stretch, rtol=0.02)
        np.testing.assert_allclose(numbers["fit"].mean(0)[1, 1], -stretch / 2, rtol=0.02)
    np.testing.assert_allclose(results[0]["gross_area_px"], np.pi * 0.36 * 128 * 0.3 * 96, rtol=0.05)
    assert results[1]["gross_area_px"] == 0


def test_a_point_of_unknown_deviation_has_no_gradient(engine: Engine) -> None:
    reference = np.indices((9, 9), np.float32).reshape(2, -1).T * np.float32(0.2)
    covariance, one = np.full((1, 81, 2, 2), np.eye(2), np.float32), np.ones((1, 2), np.float32)
    covariance[0, 40] = np.nan
    fields = engine.fields(reference, reference[None], FrameEllipse(one, one, one[:, 0]), covariance)
    assert np.isnan(fields.divergence).nonzero()[1] == [40]


@pytest.mark.parametrize("method", METHODS)
def test_a_wrong_result_of_a_method_is_refused(
    method: str, expected: dict[str, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    if not kernels.serve():
        pytest.skip("the compiled kernels were not built or are turned off")
    engine = NativeEngine(SETTINGS)
    for change in (falsify, first_for_ever()):
        with monkeypatch.context() as patch:
            patch.setattr(engine, method, changed(getattr(engine, method), change))
            with pytest.raises(FingerflowError, match="are not the expected ones"):
                check_engine(engine, expected)


@pytest.fixture(scope="module")
def bundle(bundle_of_trials: Path) -> Bundle:
    return load_bundle(bundle_of_trials)


@pytest.fixture(scope="module")
def graphs(bundle: Bundle) -> GraphEngine:
    return open_onnx(bundle)


@pytest.mark.parametrize("name", [pytest.param(one, marks=() if one in EVERY_FRAME else LONG) for one in GRAPHS])
def test_a_wrong_graph_of_a_bundle_is_refused(
    name: GraphName, graphs: GraphEngine, bundle: Bundle, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A provider that computes any one graph wrongly, or always returns its first result, is refused."""
    sessions: Any = graphs._sessions
    right = sessions[name]

    class Wrong:
        def __init__(self, change: Change) -> None:
            self.change = change

        def __getattr__(self, attribute: str) -> Any:
            return getattr(right, attribute)

        def __call__(self, given: Any) -> Any:
            names, values = zip(*right(given).items(), strict=True)
            return dict(zip(names, self.change(values), strict=True))

    for change in (falsify, first_for_ever()):
        with monkeypatch.context() as patch:
            patch.setitem(sessions, name, Wrong(change))
            with pytest.raises(FingerflowError, match="are not the expected ones"):
                check_engine(graphs, bundle.expected)
