"""Tests of the median filter against SciPy and OpenCV, bit for bit."""

import numpy as np
import pytest
import scipy.ndimage
import torch

from fingerflow.ops.filters.median import median_filter


def scipy_median(frames: torch.Tensor, size: int) -> torch.Tensor:
    filtered = [scipy.ndimage.median_filter(frame[0], size, mode="nearest") for frame in frames.numpy()]
    return torch.from_numpy(np.stack(filtered))[:, None]


@pytest.mark.parametrize("size", [3, 5, 7, 9, 11, 15])
@pytest.mark.parametrize("shape", [(1, 37, 41), (3, 16, 24)])
def test_equals_scipy(size: int, shape: tuple[int, int, int]) -> None:
    generator = torch.Generator().manual_seed(size)
    frames = torch.randint(0, 256, (shape[0], 1, *shape[1:]), dtype=torch.uint8, generator=generator)
    assert torch.equal(median_filter(frames, size), scipy_median(frames, size))


@pytest.mark.parametrize(
    "dtype",
    [torch.int8, torch.int16, torch.int32, torch.int64, torch.float16, torch.bfloat16, torch.float32, torch.float64],
)
def test_dtype_does_not_change_the_answer(dtype: torch.dtype) -> None:
    frames = torch.randint(-60, 60, (2, 1, 21, 26), generator=torch.Generator().manual_seed(1))
    filtered = median_filter(frames.to(dtype))
    assert filtered.dtype == dtype
    assert torch.equal(filtered.long(), scipy_median(frames, 9))


def test_gradient_goes_to_the_median_pixel() -> None:
    frames = torch.randperm(64, generator=torch.Generator().manual_seed(6)).double().reshape(1, 1, 8, 8)
    frames.requires_grad_()
    assert torch.autograd.gradcheck(lambda x: median_filter(x, 3), frames, eps=1e-3)


def test_window_of_one_copies() -> None:
    frames = torch.rand(1, 1, 4, 4, generator=torch.Generator().manual_seed(2))
    filtered = median_filter(frames, 1)
    assert torch.equal(filtered, frames)
    assert filtered.data_ptr() != frames.data_ptr()
