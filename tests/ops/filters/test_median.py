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
