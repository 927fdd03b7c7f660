"""Tests that medians at every n-th pixel equal those of the full filter."""

import pytest
import torch

from fingerflow.ops.filters.median import median_filter
from fingerflow.ops.filters.strided_median import median_at


@pytest.mark.parametrize("size", [1, 3, 15])
@pytest.mark.parametrize("step", [1, 3, 8])
@pytest.mark.parametrize("kind", [torch.uint8, torch.float32, torch.float16])
def test_every_so_many_of_all_medians(size: int, step: int, kind: torch.dtype) -> None:
    for shape in ((2, 1, 61, 47), (1, 1, 48, 50), (1, 1, 5, 7)):  # frames smaller than a window, too
        frames = torch.randint(0, 256, shape, dtype=torch.uint8, generator=torch.Generator().manual_seed(size))
        expected = median_filter(frames, size)[..., ::step, ::step]
        assert torch.equal(median_at(frames.to(kind), size, step), expected.to(kind))
