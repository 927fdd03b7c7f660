"""Tests of the compiled median against SciPy, with every instruction set of this processor."""

import numpy as np
import pytest
import scipy.ndimage
import torch

from fingerflow.kernels import tensors as kernels
from tests.kernels.kernel_images import images

pytestmark = pytest.mark.skipif(not kernels.serve(), reason="the compiled kernels were not built or are turned off")

SHAPES = [(1, 1), (1, 300), (300, 1), (2, 3), (5, 8), (37, 41), (64, 129), (33, 800), (130, 65), (20, 1300)]


def scipy_median(frames: torch.Tensor, size: int) -> torch.Tensor:
    filtered = [scipy.ndimage.median_filter(frame[0], size, mode="nearest") for frame in frames.numpy()]
    return torch.from_numpy(np.stack(filtered))[:, None]


@pytest.mark.parametrize("dtype", [torch.uint8, torch.uint16])
@pytest.mark.parametrize("size", range(3, 33, 2))
@pytest.mark.parametrize("shape", SHAPES)
def test_random_frames_equal_scipy(
    instruction_sets: list[int], size: int, shape: tuple[int, int], dtype: torch.dtype
) -> None:
    """The median equals SciPy's for all window sizes: smaller windows use networks of minima and maxima, windows of 13
    px and more use tables.
    """
    frames = images((1, *shape), dtype, "random")
    expected = scipy_median(frames, size)
    for most in instruction_sets:
        kernels.limit_instruction_set(most)
        assert torch.equal(kernels.median(frames, size), expected)


@pytest.mark.parametrize("size", [5, 9])
def test_windows_at_the_edge_of_the_majority(instruction_set: int, size: int) -> None:
    """The median of 0/1 frames with about half ones is their majority: by the zero-one principle this tests whether a
    min/max network selects the median.
    """
    generator = np.random.default_rng(size)
    frames = (generator.random((4, 1, 200, 300)) < 0.5).astype(np.uint8)
    frames[2] = scipy.ndimage.median_filter(frames[2, 0], 5)  # patches in place of single pixels
    frames[3, 0] = np.add.outer(np.arange(200) // 4, np.arange(300) // 4) % 2
    kernel = np.ones(size)
    ones = scipy.ndimage.convolve1d(frames.astype(int), kernel, axis=2, mode="nearest")
    ones = scipy.ndimage.convolve1d(ones, kernel, axis=3, mode="nearest")
    assert np.array_equal(kernels.median(torch.from_numpy(frames), size), ones > size * size // 2)


def test_callers_in_many_threads_get_their_own_answer() -> None:
    from concurrent.futures import ThreadPoolExecutor

    frames = images((8, 120, 200), torch.uint8, "random")
    expected = scipy_median(frames, 9)
    with ThreadPoolExecutor(4) as pool:
        for _ in range(5):
            found = list(pool.map(lambda frame: kernels.median(frame[None], 9), frames))
            assert torch.equal(torch.cat(found), expected)
