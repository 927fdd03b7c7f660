"""Tests of contrast ops against NumPy's quantiles and SciPy's Gaussian, hard cases included."""

import numpy as np
import pytest
import scipy.ndimage
import torch

from fingerflow.ops.tracking.contrast import stretch_contrast, subtract_background, unsharp_mask


@pytest.mark.parametrize("dtype", [torch.uint8, torch.uint16, torch.int32, torch.float32, torch.float64])
def test_stretch_maps_quantiles_to_zero_and_one(dtype: torch.dtype) -> None:
    values = torch.randint(20, 200, (2, 1, 60, 70), generator=torch.Generator().manual_seed(0))
    flat = values.flatten(1).numpy()
    low, high = (np.quantile(flat, q, axis=1, method="inverted_cdf")[:, None, None, None] for q in (0.01, 0.99))
    expected = np.clip((values.numpy() - low) / (high - low), 0, 1)
    stretched = stretch_contrast(values.to(dtype))
    assert stretched.dtype == (torch.float64 if dtype == torch.float64 else torch.float32)
    assert np.allclose(stretched.numpy(), expected, atol=1e-6)


@pytest.mark.parametrize("sigma", [0.8, 2.0, 5.5])
def test_unsharp_mask_equals_scipy(sigma: float) -> None:
    values = torch.rand(2, 1, 40, 31, dtype=torch.float64, generator=torch.Generator().manual_seed(3))
    blurred = np.stack([scipy.ndimage.gaussian_filter(v[0], sigma, mode="nearest", truncate=4) for v in values.numpy()])
    expected = 2 * values.numpy() - blurred[:, None]
    assert np.allclose(unsharp_mask(values, sigma).numpy(), expected, atol=1e-12)


def test_background_is_subtracted_with_sign() -> None:
    frames = torch.tensor([10, 200], dtype=torch.uint8).reshape(2, 1, 1, 1).expand(2, 1, 3, 3)
    background = torch.full((1, 1, 3, 3), 50, dtype=torch.uint8)
    difference = subtract_background(frames, background)
    assert difference.dtype == torch.float32
    assert difference[:, 0, 0, 0].tolist() == [-40, 150]
    assert subtract_background(frames.to(torch.uint16), background.to(torch.uint16))[0, 0, 0, 0] == -40
