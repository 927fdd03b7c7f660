"""The compiled count of a window: the portable one bit for bit, and the median itself."""

from collections.abc import Callable

import pytest
import torch
from kernel_images import SHAPES, images

from fingerflow import kernels
from fingerflow.ops.median import median_above, median_filter

pytestmark = pytest.mark.skipif(not kernels.serve(), reason="the compiled kernels were not built or are turned off")

Portable = Callable[[Callable[[], object]], torch.Tensor]
DTYPES = [torch.uint8, torch.uint16, torch.float32]


@pytest.mark.parametrize("dtype", DTYPES)
@pytest.mark.parametrize("size", [1, 3, 5, 9, 15])
@pytest.mark.parametrize("shape", SHAPES)
def test_same_as_the_portable_op(
    portable: Portable, instruction_set: int, shape: tuple[int, int, int], size: int, dtype: torch.dtype
) -> None:
    frames = images(shape, dtype, "random", highest=250)
    thresholds = torch.linspace(90.0, 160.0, max(1, shape[0]), dtype=torch.float64)[: shape[0]]
    above = median_above(frames, thresholds, size)
    assert above.dtype == torch.bool
    assert torch.equal(above, portable(lambda: median_above(frames, thresholds, size)))


@pytest.mark.parametrize("dtype", DTYPES)
def test_is_the_median_above(dtype: torch.dtype) -> None:
    frames = images((2, 60, 70), dtype, "random", highest=250)
    thresholds = torch.tensor([120.0, 131.5])
    medians = median_filter(frames, 9).double()
    assert torch.equal(median_above(frames, thresholds, 9), medians > thresholds.reshape(-1, 1, 1, 1))


@pytest.mark.parametrize("dtype", DTYPES)
@pytest.mark.parametrize(
    "threshold", [0.1, -0.5, 0, 7, 254.99999999, -1e300, 1e300, torch.inf, -torch.inf, torch.nan, 16777217.0]
)
def test_compares_as_torch_does(portable: Portable, dtype: torch.dtype, threshold: float) -> None:
    frames = images((2, 9, 12), dtype, "random", highest=8)
    if dtype == torch.float32:
        frames = frames / 10 + torch.tensor([0.0, 1e-8, 16777216.0, torch.nan, torch.inf, -torch.inf]).repeat(2)
    limits = [torch.full((2,), threshold, dtype=torch.float64).to(kind) for kind in (torch.float64, torch.float32)]
    for limit in (threshold, *limits):
        ours = median_above(frames, limit, 3)
        assert torch.equal(ours, portable(lambda t=limit: median_above(frames, t, 3)))


def test_threshold_of_a_scalar_tensor(portable: Portable) -> None:
    frames = images((1, 20, 20), torch.float32, "random")
    limit = torch.tensor(100.1, dtype=torch.float64)
    assert torch.equal(median_above(frames, limit, 3), portable(lambda: median_above(frames, limit, 3)))


def test_views_are_read_where_they_are(portable: Portable) -> None:
    frames = images((4, 50, 90), torch.uint8, "random")[::2, :, 3:40, 11:77]
    assert torch.equal(median_above(frames, 128.0, 5), portable(lambda: median_above(frames, 128.0, 5)))


def test_refuses_what_does_not_fit() -> None:
    frames = torch.zeros(2, 1, 8, 8)
    with pytest.raises(ValueError, match="17 was asked for"):
        kernels.median_above(frames, torch.zeros(2, dtype=torch.float64), 17)
    with pytest.raises(ValueError, match="thresholds is"):
        kernels.median_above(frames, torch.zeros(3, dtype=torch.float64), 3)
    with pytest.raises(TypeError, match="float64"):
        kernels.median_above(frames.double(), torch.zeros(2, dtype=torch.float64), 3)
