"""Otsu's threshold where there are no two classes, no pixels or no numbers."""

import pytest
import torch

from fingerflow.ops.contact.otsu import class_separation, histogram, otsu_threshold


@pytest.mark.parametrize("level", [0, 9, 255])
def test_one_grey_level_has_no_threshold(level: int) -> None:
    frames = torch.full((2, 1, 8, 8), level, dtype=torch.uint8)
    threshold = otsu_threshold(frames)
    assert threshold.isnan().all()
    separation = class_separation(frames, threshold)
    assert all(part.isnan().all() for part in separation)


@pytest.mark.parametrize(("low", "high"), [(0, 1), (0, 255), (100, 101), (254, 255), (3, 200)])
def test_two_grey_levels_are_separated(low: int, high: int) -> None:
    frame = torch.full((1, 1, 8, 8), low, dtype=torch.uint8)
    frame[..., 2, 3] = high
    threshold = otsu_threshold(frame)
    assert threshold.item() == low  # the lowest of equally good ones
    assert torch.equal(frame > threshold.item(), frame == high)
    separation = class_separation(frame, threshold)
    assert separation.means[0].tolist() == [low, high]
    assert separation.deviations[0].tolist() == [0, 0]
    assert separation.separability.item() == pytest.approx(1)


@pytest.mark.parametrize("bad", [torch.nan, torch.inf, -torch.inf])
def test_what_is_not_finite_does_not_count(bad: float) -> None:
    frame = torch.rand(1, 1, 30, 30, generator=torch.Generator().manual_seed(0))
    spoiled = torch.cat([frame, torch.full_like(frame, bad)], -1)
    assert torch.equal(histogram(spoiled, value_range=(0, 1)), histogram(frame, value_range=(0, 1)))
    threshold = otsu_threshold(spoiled, value_range=(0, 1))
    assert torch.equal(threshold, otsu_threshold(frame, value_range=(0, 1)))
    for a, b in zip(class_separation(spoiled, threshold), class_separation(frame, threshold), strict=True):
        assert torch.allclose(a, b, rtol=1e-12)


def test_nothing_to_count() -> None:
    frame = torch.randint(0, 256, (1, 1, 8, 8), dtype=torch.uint8, generator=torch.Generator().manual_seed(2))
    nowhere = torch.zeros(1, 1, 8, 8, dtype=torch.bool)
    assert histogram(frame, nowhere).sum() == 0
    assert otsu_threshold(frame, nowhere).isnan().all()
    assert otsu_threshold(torch.full((1, 1, 8, 8), torch.nan), value_range=(0, 1)).isnan().all()
    assert otsu_threshold(torch.zeros(0, 1, 8, 8, dtype=torch.uint8)).shape == (0,)
    assert class_separation(torch.zeros(0, 1, 8, 8), torch.zeros(0)).separability.shape == (0,)


def test_values_beyond_the_range_count_in_the_end_bins() -> None:
    frame = torch.tensor([-7.0, -1.0, 0.5, 1.0, 99.0]).reshape(1, 1, 1, 5)
    assert histogram(frame, bins=4, value_range=(-1, 1)).tolist() == [[2, 0, 1, 2]]
    counts = torch.tensor([-5, 0, 300], dtype=torch.int32).reshape(1, 1, 1, 3)
    assert histogram(counts, bins=256, value_range=(-1, 255))[0, [0, 255]].tolist() == [2, 1]


@pytest.mark.parametrize("dtype", [torch.float16, torch.bfloat16])
def test_half_precision_counts_exactly(dtype: torch.dtype) -> None:
    frame = torch.randint(0, 256, (1, 1, 20, 20), generator=torch.Generator().manual_seed(1))
    assert torch.equal(histogram(frame.to(dtype), value_range=(-1, 255)), histogram(frame.to(torch.uint8)))
