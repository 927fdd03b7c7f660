"""Tests of means of blocks and lines: the compiled form against NumPy's."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
import torch

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
    """Means of integers are equal bit for bit; sums of floats run in another order."""
    frames = images(shape, dtype, "random")
    for one, other in zip(block_means(frames[:, 0].numpy()), portable(frames[:, 0].numpy(), monkeypatch), strict=True):
        assert one.dtype == other.dtype == np.float32
        if dtype.is_floating_point:
            np.testing.assert_allclose(one, other, rtol=2e-7)
        else:
            assert np.array_equal(one, other)
    for apart in (1, 2) if len(frames) else ():
        squares = portable(frames[:, 0].numpy(), monkeypatch, strip_differences, apart)
        np.testing.assert_allclose(strip_differences(frames[:, 0].numpy(), apart), squares, rtol=1e-5, atol=1e-7)


def test_views_and_threads(monkeypatch: pytest.MonkeyPatch, torch_threads: Callable[[int], None]) -> None:
    frames = images((6, 300, 400), torch.uint16, "random").numpy()[:, 0]
    for threads in (1, 2, 7):
        torch_threads(threads)
        for part in (np.s_[:, 20:280, 30:], np.s_[::2, ::-1], np.s_[..., ::3], np.s_[:, ::3]):
            for one, other in zip(block_means(frames[part]), portable(frames[part], monkeypatch), strict=True):
                assert np.array_equal(one, other)
