"""Tests that need a GPU of CUDA, against the portable form on the processor: `pytest -m gpu` runs them."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
import torch

from bench.streams import play
from fingerflow import process
from fingerflow.engines.check import check_engine, expected_of
from fingerflow.engines.engine import EngineSettings
from fingerflow.engines.torch import TorchEngine
from tests.small_trials import write_trial
from tests.without_kernels import without_kernels

pytestmark = [pytest.mark.gpu, pytest.mark.skipif(not torch.cuda.is_available(), reason="no CUDA device here")]


@pytest.fixture
def portable(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Turn off the compiled kernels of the processor, so that it computes by the portable form."""
    without_kernels(monkeypatch)
    with torch.inference_mode():
        yield


@pytest.mark.usefixtures("portable")
def test_a_frame_has_the_numbers_of_the_processor() -> None:
    """Every number of the built-in frame on the GPU is that of the portable form on the processor."""
    settings = EngineSettings(window_px=15, gauge_length_mm=2.0)
    expected = expected_of(TorchEngine(settings, torch.device("cpu")), 96, 128, 8, 64)
    check_engine(TorchEngine(settings, torch.device("cuda")), expected)


def test_a_press(tmp_path: Path) -> None:
    """A press processed on the GPU has the points, areas and medians of the processor."""
    scene = write_trial(tmp_path / "press")
    ours, theirs = process(scene, device="cuda"), process(scene, device="cpu")
    assert ours.attrs["engine"] == "torch"
    assert (ours["status"].values == theirs["status"].values).mean() > 0.98  # a point may lie at a limit
    both = np.isfinite(ours["position_px"].values) & np.isfinite(theirs["position_px"].values)
    apart = np.abs(ours["position_px"].values - theirs["position_px"].values)[both]
    assert np.quantile(apart, 0.99) < 2e-3
    np.testing.assert_allclose(ours["real_contact_area"].values, theirs["real_contact_area"].values, rtol=1e-3)
    np.testing.assert_allclose(ours["median_divergence"].values, theirs["median_divergence"].values, atol=2e-4)


def test_a_paced_stream(bundle_of_trials: Path) -> None:
    """A stream of 300 frames/s is played by ONNX Runtime on the GPU: every frame is processed or counted as dropped."""
    import onnxruntime

    if "CUDAExecutionProvider" not in onnxruntime.get_available_providers():
        pytest.skip("ONNX Runtime has no provider of CUDA here: pip install onnxruntime-gpu")
    summary = play(bundle_of_trials, "onnx", frames=300, rate=300, provider="cuda")
    assert "cuda" in summary["engine"].lower()
    assert summary["processed"] + summary["dropped"] == summary["frames_in"] == 300
    assert summary["processed"] > 0
