"""Tests of Otsu's threshold against OpenCV and of histograms against NumPy, with hard frames."""

import cv2
import numpy as np
import pytest
import torch

from fingerflow.ops.contact.otsu import histogram, otsu_threshold


def opencv_threshold(frame: np.ndarray) -> float:
    return cv2.threshold(frame, 0, 255, cv2.THRESH_BINARY | cv2.THRESH_OTSU)[0]


def two_classes(rng: np.random.Generator, shape: tuple[int, int]) -> np.ndarray:
    bright = rng.random(shape) < rng.uniform(0.1, 0.9)
    low, high = rng.uniform(30, 110), rng.uniform(130, 220)
    return np.clip(np.where(bright, high, low) + rng.normal(0, rng.uniform(8, 40), shape), 0, 255).astype(np.uint8)


def test_threshold_equals_opencv_on_random_frames() -> None:
    rng = np.random.default_rng(0)
    frames = np.stack([two_classes(rng, (64, 80)) for _ in range(60)])
    expected = [opencv_threshold(frame) for frame in frames]
    assert otsu_threshold(torch.from_numpy(frames)[:, None]).tolist() == expected
    assert len(set(expected)) > 20


@pytest.mark.parametrize("bins", [256, 100, 7])
def test_histogram_equals_numpy(bins: int) -> None:
    values = torch.rand(3, 1, 40, 50, dtype=torch.float64, generator=torch.Generator().manual_seed(5)) * 2 - 1
    expected = np.stack([np.histogram(v, bins, (-1, 1))[0] for v in values.numpy()])
    assert np.array_equal(histogram(values, bins=bins, value_range=(-1, 1)).numpy(), expected)


@pytest.mark.parametrize(("low", "high"), [(0, 1), (0, 255), (100, 101), (254, 255), (3, 200)])
def test_two_grey_levels_are_separated(low: int, high: int) -> None:
    frame = torch.full((1, 1, 8, 8), low, dtype=torch.uint8)
    frame[..., 2, 3] = high
    threshold = otsu_threshold(frame)
    assert threshold.item() == low  # the lowest of equally good thresholds
    assert torch.equal(frame > threshold.item(), frame == high)


def test_values_beyond_the_range_count_in_the_end_bins() -> None:
    frame = torch.tensor([-7.0, -1.0, 0.5, 1.0, 99.0]).reshape(1, 1, 1, 5)
    assert histogram(frame, bins=4, value_range=(-1, 1)).tolist() == [[2, 0, 1, 2]]
    counts = torch.tensor([-5, 0, 300], dtype=torch.int32).reshape(1, 1, 1, 3)
    assert histogram(counts, bins=256, value_range=(-1, 255))[0, [0, 255]].tolist() == [2, 1]
