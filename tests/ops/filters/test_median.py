"""The median against SciPy and OpenCV, bit for bit; the count against the median."""

import cv2
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


@pytest.mark.parametrize("size", [3, 5, 7, 9, 13])
def test_equals_opencv(size: int) -> None:
    frame = np.random.default_rng(size).integers(0, 256, (61, 47), dtype=np.uint8)
    filtered = median_filter(torch.from_numpy(frame)[None, None], size)
    assert np.array_equal(filtered[0, 0].numpy(), cv2.medianBlur(frame, size))


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


def test_exports_at_a_fixed_frame_size_and_runs_the_same() -> None:
    class Filter(torch.nn.Module):
        def forward(self, frames: torch.Tensor) -> torch.Tensor:
            return median_filter(frames, 5)

    frames = torch.randint(0, 256, (2, 1, 24, 17), dtype=torch.uint8, generator=torch.Generator().manual_seed(7))
    exported = torch.export.export(Filter(), (frames,)).module()
    assert torch.equal(exported(frames.flip(-1)), median_filter(frames.flip(-1), 5))
