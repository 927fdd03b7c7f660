"""Tests of means of blocks and lines: the compiled form against NumPy's and against torch's adaptive pooling."""

from typing import Any

import numpy as np
import pytest
import torch
from torch.nn.functional import adaptive_avg_pool2d

from fingerflow.kernels import tensors as kernels
from fingerflow.tracker import block_means as module
from fingerflow.tracker.block_means import block_means, strip_differences
from tests.kernels.kernel_images import images

SHAPES = [(2, 512, 640), (1, 480, 500), (3, 150, 37), (2, 1, 1), (1, 1, 900), (2, 700, 3), (0, 60, 70), (1, 131, 321)]


def portable(frames: np.ndarray, monkeypatch: pytest.MonkeyPatch, function: Any = block_means, *settings: int) -> Any:
    with monkeypatch.context() as patch:
        patch.setattr(module, "is_present", lambda: False)
        return function(frames, *settings)


@pytest.mark.parametrize("dtype", [*kernels.FRAME_KINDS, torch.float64, torch.int16])
@pytest.mark.parametrize("shape", SHAPES)
def test_compiled_block_means_agree_with_the_portable_form(
    monkeypatch: pytest.MonkeyPatch, shape: tuple[int, int, int], dtype: torch.dtype
) -> None:
    """Means of integers are equal bit for bit; sums of floats run in another order, and torch adds in float32."""
    frames = images(shape, dtype, "random")
    found = block_means(frames[:, 0].numpy())
    for one, other in zip(found, portable(frames[:, 0].numpy(), monkeypatch), strict=True):
        assert one.dtype == other.dtype == np.float32
        assert one.shape == other.shape
        if dtype.is_floating_point:
            np.testing.assert_allclose(one, other, rtol=2e-7)
        else:
            assert np.array_equal(one, other)
    for apart in (1, 2) if len(frames) else ():
        squares = portable(frames[:, 0].numpy(), monkeypatch, strip_differences, apart)
        np.testing.assert_allclose(strip_differences(frames[:, 0].numpy(), apart), squares, rtol=1e-5, atol=1e-7)
    down, along = (max(1, side // samples) for side, samples in zip(shape[1:], (128, 160), strict=True))
    sampled = frames[:, 0].numpy()[:, down // 2 :: down, along // 2 :: along]
    rows, columns = (min(max(1, side // 24), 16, read) for side, read in zip(shape[1:], sampled.shape[1:], strict=True))
    pooled = adaptive_avg_pool2d(torch.from_numpy(sampled.astype(np.float32)), (rows, columns))
    blocks, lines = found
    np.testing.assert_allclose(blocks, pooled.numpy(), rtol=1e-5)
    np.testing.assert_allclose(lines, sampled.mean(2), rtol=2e-7)


def test_views_and_threads(monkeypatch: pytest.MonkeyPatch) -> None:
    frames = images((6, 300, 400), torch.uint16, "random").numpy()[:, 0]
    before = torch.get_num_threads()
    try:
        for threads in (1, 2, 7):
            torch.set_num_threads(threads)
            for part in (np.s_[:, 20:280, 30:], np.s_[::2, ::-1], np.s_[..., ::3], np.s_[:, ::3]):
                for one, other in zip(block_means(frames[part]), portable(frames[part], monkeypatch), strict=True):
                    assert np.array_equal(one, other)
    finally:
        torch.set_num_threads(before)


def test_frames_of_another_shape_are_refused() -> None:
    for shape in ((60, 70), (2, 0, 70), (2, 1, 60, 70)):
        with pytest.raises(ValueError, match=r"give \(n, H, W\)"):
            block_means(np.zeros(shape, np.uint8))
