"""Tests of sums over windows against the sums of unfolded windows."""

import pytest
import torch

from fingerflow.ops.filters.box_sum import box_sum


@pytest.mark.parametrize("size", [1, 2, 3, 5, 6, 7, 8, 9, 21])
def test_equals_the_sum_of_unfolded_windows(size: int) -> None:
    values = torch.randint(-100, 100, (2, 3, 25, 22), generator=torch.Generator().manual_seed(size))
    assert torch.equal(box_sum(values, size), values.unfold(2, size, 1).unfold(3, size, 1).sum((-1, -2)))


def test_nan_stays_in_its_windows() -> None:
    values = torch.zeros(1, 1, 9, 9)
    values[0, 0, 4, 4] = torch.nan
    spoiled = torch.zeros(7, 7, dtype=torch.bool)
    spoiled[2:5, 2:5] = True
    assert torch.equal(box_sum(values, 3)[0, 0].isnan(), spoiled)
