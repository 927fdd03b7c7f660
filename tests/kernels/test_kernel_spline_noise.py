"""The compiled spline coefficients and noise beside the portable ones."""

import pytest
import torch
from torch import Tensor

from fingerflow.kernels import tensors as kernels
from fingerflow.ops.filters.noise import estimate_noise
from fingerflow.ops.filters.spline import spline_coefficients

pytestmark = pytest.mark.skipif(not kernels.serve(), reason="the compiled kernels were not built or are turned off")

SHAPES = [(1, 3, 3), (2, 3, 64), (1, 64, 3), (3, 33, 35), (1, 97, 130), (0, 8, 8)]


def frames(shape: tuple[int, int, int], dtype: torch.dtype) -> Tensor:
    batch, height, width = shape
    noise = torch.rand(batch, 1, height, width, generator=torch.Generator().manual_seed(1))
    return (noise * 255).to(dtype) if dtype != torch.float32 else noise * 3 - 1


def portable(op: object, images: Tensor) -> Tensor:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(kernels, "serve", lambda *_: False)
        return op(images)  # type: ignore[operator]


@pytest.mark.parametrize("dtype", [torch.uint8, torch.uint16, torch.int32, torch.float32])
@pytest.mark.parametrize("shape", SHAPES)
def test_same_coefficients_bit_for_bit(shape: tuple[int, int, int], dtype: torch.dtype) -> None:
    images = frames(shape, dtype)
    for most in (0, 1, 2, -1):
        kernels.limit_instruction_set(most)
        assert torch.equal(spline_coefficients(images), portable(spline_coefficients, images))


@pytest.mark.parametrize("dtype", [torch.uint8, torch.uint16, torch.int32, torch.float32])
@pytest.mark.parametrize("shape", SHAPES)
def test_same_noise(shape: tuple[int, int, int], dtype: torch.dtype) -> None:
    """Sums run in another order: relative 1e-5 of float32."""
    images = frames(shape, dtype)
    found, expected = estimate_noise(images), portable(estimate_noise, images)
    assert found.dtype == expected.dtype
    torch.testing.assert_close(found, expected, rtol=1e-5, atol=1e-7)


def test_bad_pixels() -> None:
    images = frames((2, 40, 50), torch.float32)
    images[0, 0, 10, 20], images[0, 0, 30, 5] = torch.nan, -torch.inf
    images[1] = torch.nan
    torch.testing.assert_close(spline_coefficients(images), portable(spline_coefficients, images), equal_nan=True)
    torch.testing.assert_close(
        estimate_noise(images), portable(estimate_noise, images), rtol=1e-5, atol=0, equal_nan=True
    )
    assert estimate_noise(images)[1].isnan()


def test_frames_that_are_not_contiguous() -> None:
    images = frames((4, 60, 80), torch.uint8)
    for view in (images[::2, :, 3:50, 7:70], images.transpose(2, 3), images[..., ::2], images.expand(4, 1, 60, 80)):
        assert torch.equal(spline_coefficients(view), portable(spline_coefficients, view))
        torch.testing.assert_close(estimate_noise(view), portable(estimate_noise, view), rtol=1e-5, atol=0)


def test_derivatives_are_kept() -> None:
    images = frames((1, 20, 20), torch.float32).requires_grad_()
    (spline_coefficients(images).sum() + estimate_noise(images).sum()).backward()
    assert images.grad is not None


@pytest.mark.parametrize("height", [63, 130, 200, 300])
def test_noise_of_high_frames_from_some_of_their_rows(height: int) -> None:
    noisy = 100 + 3 * torch.randn(1, 1, height, 400, generator=torch.Generator().manual_seed(0))
    torch.testing.assert_close(estimate_noise(noisy), portable(estimate_noise, noisy), rtol=1e-5, atol=0)
    assert abs(estimate_noise(noisy).item() / 3 - 1) < 0.03
