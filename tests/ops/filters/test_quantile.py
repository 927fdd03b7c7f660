"""Tests of quantiles against the inverse of the empirical distribution, which NumPy computes by sorting."""

import numpy as np
import pytest
import torch

from fingerflow.ops.filters.quantile import frame_quantile

FRACTIONS = [0.0, 0.01, 0.3, 0.5, 0.99, 1.0]


@pytest.mark.parametrize("fraction", FRACTIONS)
@pytest.mark.parametrize("dtype", [torch.uint8, torch.int16, torch.uint16, torch.int32])
def test_integers_exactly(dtype: torch.dtype, fraction: float) -> None:
    top = 256 if dtype == torch.uint8 else 30000
    values = torch.randint(0, top, (3, 1, 17, 23), generator=torch.Generator().manual_seed(0))
    expected = np.quantile(values.flatten(1).numpy(), fraction, axis=1, method="inverted_cdf")
    assert np.array_equal(frame_quantile(values.to(dtype), fraction).numpy(), expected)


@pytest.mark.parametrize("fraction", FRACTIONS)
@pytest.mark.parametrize("dtype", [torch.float16, torch.float32, torch.float64])
def test_floats_within_a_part_of_their_range(dtype: torch.dtype, fraction: float) -> None:
    values = torch.randn(2, 1, 30, 31, dtype=torch.float64, generator=torch.Generator().manual_seed(1)).to(dtype)
    expected = np.quantile(values.double().flatten(1).numpy(), fraction, axis=1, method="inverted_cdf")
    # 2^-24 of a range of 8; float32 rounds the centre of an interval once more.
    assert np.allclose(frame_quantile(values, fraction).numpy(), expected, rtol=0, atol=1e-6)


def test_counts_finite_pixels_only() -> None:
    values = torch.arange(1.0, 101.0).reshape(1, 1, 10, 10).repeat(2, 1, 1, 1)
    values[0, 0, 0] = torch.tensor([torch.nan, torch.inf, -torch.inf] * 3 + [torch.nan])
    values[1] = torch.nan
    low, none = frame_quantile(values, 0.0)
    assert low == 11
    assert none.isnan()
    assert frame_quantile(values, 1.0)[0] == 100
    assert frame_quantile(values, 0.5)[0].item() == pytest.approx(55, abs=1e-5)
