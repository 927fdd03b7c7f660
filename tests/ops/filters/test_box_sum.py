"""Tests of sums over windows against the sums of unfolded windows."""

import pytest
import torch

from fingerflow.ops.filters.box_sum import box_sum


@pytest.mark.parametrize("size", [1, 2, 3, 6, 9, 21])
def test_equals_the_sum_of_unfolded_windows(size: int) -> None:
    values = torch.randint(-100, 100, (2, 3, 25, 22), generator=torch.Generator().manual_seed(size))
    assert torch.equal(box_sum(values, size), values.unfold(2, size, 1).unfold(3, size, 1).sum((-1, -2)))
