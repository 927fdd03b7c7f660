"""Tests of corners against OpenCV's response, a plain greedy loop, and squares whose corners are known."""

import math
from typing import Any

import cv2
import numpy as np
import pytest
import torch
from torch.utils._python_dispatch import TorchDispatchMode

from fingerflow.ops.tracking.corners import corner_response, detect_corners


def texture(seed: int, shape: tuple[int, int] = (120, 150), width: float = 2.5) -> np.ndarray:
    noise = cv2.GaussianBlur(np.random.default_rng(seed).normal(size=shape), (0, 0), width)
    return (120 + 40 * noise / noise.std()).clip(0, 255).astype(np.uint8)


def greedy(response: np.ndarray, least: float, count: int, distance: float) -> list[tuple[int, int]]:
    """Return corners (x, y) px chosen by OpenCV's rule, one candidate at a time."""
    y, x = np.nonzero((response == cv2.dilate(response, np.ones((3, 3)))) & (response > least))
    kept: list[tuple[int, int]] = []
    for i in np.argsort(-response[y, x], kind="stable"):
        if all((x[i] - a) ** 2 + (y[i] - b) ** 2 >= distance**2 for a, b in kept):
            kept.append((int(x[i]), int(y[i])))
    return kept[:count]


@pytest.mark.parametrize("window", [3, 7, 9])
def test_response_equals_opencv(window: int) -> None:
    frame = texture(0)
    ours = corner_response(torch.from_numpy(frame)[None, None], window)[0, 0].numpy()
    # OpenCV scales Sobel's gradient by 1 / (4 window 255) for bytes and sums over the window.
    theirs = cv2.cornerMinEigenVal(frame, window, ksize=3, borderType=cv2.BORDER_REPLICATE)
    theirs = theirs * (4 * window * 255) ** 2 / window**2 / 64
    inner = np.s_[window:-window, window:-window]
    assert np.allclose(ours[inner], theirs[inner], rtol=1e-3, atol=1e-3 * ours.max())


@pytest.mark.parametrize("distance", [0, 1.5, 4.9, 5, 23.3])
def test_selection_equals_the_greedy_rule(distance: float) -> None:
    tensor = torch.from_numpy(np.stack([texture(seed) for seed in (1, 2)]))[:, None]
    corners = detect_corners(tensor, 200, distance, quality=0.05, noise=0.0)
    response = corner_response(tensor)
    for b in range(2):
        expected = greedy(response[b, 0].numpy(), 0.05 * response[b].max().item(), 200, distance)
        found = corners.points[b][corners.valid[b]].long()
        assert found.tolist() == [list(point) for point in expected]
        x, y = found.unbind(1)
        assert torch.equal(corners.response[b][corners.valid[b]], response[b, 0, y, x])


class Operations(TorchDispatchMode):
    """Counter of torch operations. A loop over the candidates would call at least one for each corner."""

    count = 0

    def __torch_dispatch__(self, operation: Any, types: Any, arguments: Any = (), options: Any = None) -> Any:
        self.count += 1
        return operation(*arguments, **(options or {}))


@pytest.mark.parametrize("size", [128, 256, 512])
def test_corners_are_selected_together(size: int) -> None:
    frame = torch.from_numpy(texture(0, (size, size)))[None, None]
    with Operations() as operations:
        detect_corners(frame, 700)
    assert operations.count < 700


def test_mask_and_border_hold() -> None:
    frame = torch.from_numpy(texture(4))[None, None]
    mask = torch.zeros(1, 1, 120, 150, dtype=torch.bool)
    mask[..., 30:90, 40:110] = True
    inside = detect_corners(frame, 300, 5.0, mask)
    x, y = inside.points[0][inside.valid[0]].long().unbind(1)
    assert len(x) > 20
    assert mask[0, 0, y, x].all()
    framed = detect_corners(frame, 300, 5.0, border=15)
    points = framed.points[0][framed.valid[0]]
    assert points.min() >= 15
    assert (points <= torch.tensor([150, 120]) - 16).all()


@pytest.mark.parametrize("window", [3, 7, 21])
@pytest.mark.parametrize("deviation", [0.3, 3.0])
def test_pure_noise_has_no_corners(window: int, deviation: float) -> None:
    noise = torch.randn(2, 1, 300, 300, generator=torch.Generator().manual_seed(window))
    frame = (100 + deviation * noise).round().to(torch.uint8)
    assert not detect_corners(frame, 50, window=window).valid.any()
    known = math.hypot(deviation, math.sqrt(1 / 12))
    assert not detect_corners(frame, 50, window=window, noise=known).valid.any()
