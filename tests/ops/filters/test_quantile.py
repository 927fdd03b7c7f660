"""Tests of quantiles against the inverse of the empirical distribution, which NumPy computes by sorting."""

import numpy as np
import pytest
import torch

from fingerflow.ops.filters.quantile import frame_quantile


@pytest.mark.parametrize("fraction", [0.0, 0.01, 0.3, 0.5, 0.99, 1.0])
@pytest.mark.parametrize("name", ["uint8", "int16", "uint16", "int32", "float16", "float32", "float64"])
def test_every_dtype_exactly(name: str, fraction: float) -> None:
    values = (250 * torch.rand(3, 1, 17, 23, generator=torch.Generator().manual_seed(0))).to(getattr(torch, name))
    expected = np.quantile(values.double(), fraction, axis=(1, 2, 3), method="inverted_cdf")
    assert np.array_equal(frame_quantile(values, fraction).numpy(), expected)


def test_counts_finite_pixels_only() -> None:
    values = torch.arange(1.0, 101).repeat(2).reshape(2, 1, 10, 10)
    values[0, 0, 0] = torch.tensor([torch.nan, torch.inf, -torch.inf] * 3 + [torch.nan])
    values[1] = torch.nan
    for fraction, expected in ((0.0, 11), (0.5, 55), (1.0, 100)):
        assert frame_quantile(values, fraction).nan_to_num(-1).tolist() == [expected, -1]
