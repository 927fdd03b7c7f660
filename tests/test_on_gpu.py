"""Tests that need a GPU of CUDA, against the portable form on the processor: `pytest -m gpu` runs them, those of the
kernels of Triton, and the study of `tests/study`.
"""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
import torch
from tests.pipeline.test_process_together import write_scenes

from bench.streams import play
from bench.suites import gpu
from fingerflow import process
from fingerflow.engines.capture import Captured
from fingerflow.engines.check import built_in
from fingerflow.engines.choice import engine_for
from fingerflow.engines.torch import TorchEngine
from fingerflow.kernels import tensors as kernels
from fingerflow.pipeline.run import process_together
from tests.engines.test_capture import CALLS, SIZE, results
from tests.engines.test_points_graph import SETTINGS, given_to, leaves, step_by_step

pytestmark = [
    pytest.mark.gpu,
    pytest.mark.skipif(not torch.cuda.is_available(), reason="no CUDA device here: a stand-in was tested in its place"),
]
CPU, CUDA = torch.device("cpu"), torch.device("cuda")
# Sums in float32 are taken in another order; lengths in px, covariances and statistics of templates relative.
CLOSE = {"rtol": 1e-3, "atol": 1e-3, "equal_nan": True}


@pytest.fixture
def portable(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Turn off the compiled kernels of the processor, so that it computes by the portable form."""
    monkeypatch.setattr(kernels, "serve", lambda *tensors: False)
    with torch.inference_mode():
        yield


@pytest.mark.usefixtures("portable")
@pytest.mark.parametrize("captured", [False, True])
def test_a_frame_has_the_numbers_of_the_portable_form(captured: bool) -> None:
    """Each result of a frame on the GPU, call by call and captured, is that of the portable form on the processor."""
    frame = built_in(*SIZE, SETTINGS.window_px)
    there = TorchEngine(SETTINGS, CUDA, Captured) if captured else TorchEngine(SETTINGS, CUDA)
    here = TorchEngine(SETTINGS, CPU)
    for number in range(CALLS if captured else 2):
        for ours, theirs in zip(results(there, frame, number), results(here, frame, number), strict=True):
            np.testing.assert_allclose(ours, theirs, **CLOSE)
    if captured:
        for module in (there._contact, there._key, there._fields):
            assert any(graph is not None for graph in module._graphs.values()), module._module


@pytest.mark.usefixtures("portable")
def test_points_of_several_recordings_in_one_graph() -> None:
    """Points of three recordings, tracked, judged and corrected in one captured graph with the kernel of Triton, are
    those of the portable form step by step.
    """
    there, here = TorchEngine(SETTINGS, CUDA, Captured), TorchEngine(SETTINGS, CPU)
    given, expected = given_to(there), [step_by_step(here, one) for one in given_to(here)]
    for _ in range(CALLS):
        for ours, theirs in zip(there.begun("track", given)(), expected, strict=True):
            if ours.corrected is None:
                pytest.skip("kernels of Triton do not serve here: pip install fingerflow-engine[gpu]")
            for one, other in zip(leaves(ours), leaves(theirs), strict=True):
                np.testing.assert_allclose(one, other, **CLOSE)
    assert any(graph is not None for graph in there._points._graphs.values())


def test_recordings_together(tmp_path: Path) -> None:
    """Three recordings processed together on the GPU have the points, areas and medians of each on the processor."""
    scenes = write_scenes(tmp_path)
    for ours, scene in zip(process_together(scenes, device="cuda"), scenes, strict=True):
        theirs = process(scene, device="cpu")
        assert ours.attrs["engine"] == "torch"
        assert (ours["status"].values == theirs["status"].values).mean() > 0.98  # a point may lie at a limit
        both = np.isfinite(ours["position_px"].values) & np.isfinite(theirs["position_px"].values)
        apart = np.abs(ours["position_px"].values - theirs["position_px"].values)[both]
        assert np.quantile(apart, 0.99) < 2e-3
        np.testing.assert_allclose(ours["real_contact_area"].values, theirs["real_contact_area"].values, rtol=1e-3)
        np.testing.assert_allclose(ours["median_divergence"].values, theirs["median_divergence"].values, atol=2e-4)


def test_the_engine_of_this_gpu_is_captured() -> None:
    assert isinstance(engine_for("auto", SETTINGS, CUDA)._contact, Captured)  # type: ignore[attr-defined]


def test_the_rows_of_the_benchmark() -> None:
    """Each way of each step gives the numbers of the processor, and the counts are those of the form that runs here."""
    rows = gpu.run(quick=True)
    form = "fused" if kernels.fused_serves(torch.empty(0, device=CUDA)) else "portable"
    assert {row["form"] for row in rows} == {form}
    assert {row["way"] for row in rows} == {gpu.PEER, *gpu.WAYS}
    for row in rows:
        limit = 2.0 if row["work"] == "contact" else 0.05  # px of an area; grey levels, px
        assert float(row["deviation"]) < limit, row  # type: ignore[arg-type]


def test_a_paced_stream(bundle_of_trials: Path) -> None:
    """A stream of 300 frames/s is played by ONNX Runtime on the GPU: every frame is processed or counted as dropped."""
    import onnxruntime

    if "CUDAExecutionProvider" not in onnxruntime.get_available_providers():
        pytest.skip("ONNX Runtime has no provider of CUDA here: pip install onnxruntime-gpu")
    summary = play(bundle_of_trials, "onnx", frames=300, rate=300, provider="cuda")
    print(summary["engine"], summary["rate_hz"], summary["latency_ms"])
    assert "cuda" in summary["engine"].lower()
    assert summary["processed"] + summary["dropped"] == summary["frames_in"] == 300
    assert summary["processed"] > 0
