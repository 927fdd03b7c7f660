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
@pytest.mark.parametrize("shape", [(1, 37, 41), (3, 16, 24), (2, 50, 33)])
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


def test_uint16_keeps_its_upper_half() -> None:
    frames = torch.randint(0, 65536, (1, 1, 20, 31), generator=torch.Generator().manual_seed(2))
    filtered = median_filter(frames.to(torch.uint16), 5)
    assert filtered.dtype == torch.uint16
    assert torch.equal(filtered.long(), scipy_median(frames, 5))


def test_commutes_with_a_monotone_map() -> None:
    frames = torch.rand(1, 1, 30, 30, dtype=torch.float64, generator=torch.Generator().manual_seed(3))
    assert torch.equal(median_filter(frames.exp(), 7), median_filter(frames, 7).exp())


def test_gradient_goes_to_the_median_pixel() -> None:
    frames = torch.randperm(64, generator=torch.Generator().manual_seed(6)).double().reshape(1, 1, 8, 8)
    frames.requires_grad_()
    assert torch.autograd.gradcheck(lambda x: median_filter(x, 3), frames, eps=1e-3)


def test_empty_batch_and_empty_frame() -> None:
    assert median_filter(torch.zeros(0, 1, 8, 8, dtype=torch.uint8)).shape == (0, 1, 8, 8)
    assert median_filter(torch.zeros(2, 1, 0, 8)).shape == (2, 1, 0, 8)


def test_window_of_one_copies() -> None:
    frames = torch.rand(1, 1, 4, 4, generator=torch.Generator().manual_seed(2))
    filtered = median_filter(frames, 1)
    assert torch.equal(filtered, frames)
    assert filtered.data_ptr() != frames.data_ptr()


@pytest.mark.parametrize("size", [3, 5, 9])
def test_nan_spoils_exactly_its_windows(size: int) -> None:
    frames = torch.rand(1, 1, 30, 34, generator=torch.Generator().manual_seed(1))
    spoiled = frames.clone()
    spoiled[0, 0, 11, 17] = torch.nan
    spoiled[0, 0, 0, 33] = torch.nan
    filtered, clean = median_filter(spoiled, size), median_filter(frames, size)
    half = size // 2
    expected = torch.zeros(30, 34, dtype=torch.bool)
    expected[11 - half : 12 + half, 17 - half : 18 + half] = True
    expected[: 1 + half, 33 - half :] = True
    assert torch.equal(filtered[0, 0].isnan(), expected)
    assert torch.equal(filtered[0, 0][~expected], clean[0, 0][~expected])


def test_infinities_are_ordered_as_numbers() -> None:
    frames = torch.zeros(1, 1, 5, 5)
    frames[..., 1:4, 1:4] = torch.tensor([[-torch.inf, 1, 2], [3, 4, 5], [torch.inf, torch.inf, 6]])
    assert median_filter(frames, 3)[0, 0, 2, 2] == 4
