"""Tests of the compiled median against SciPy, with every instruction set of this processor."""

import pytest
import torch

from fingerflow.kernels import tensors as kernels
from tests.kernels.kernel_images import images
from tests.kernels.scipy_median import scipy_median

pytestmark = pytest.mark.skipif(not kernels.serve(), reason="the compiled kernels were not built or are turned off")

SHAPES = [(1, 1), (1, 300), (300, 1), (2, 3), (5, 8), (37, 41), (64, 129), (33, 800), (130, 65), (20, 1300)]


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
