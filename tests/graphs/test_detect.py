"""Tests of corners spread evenly, against a plain loop over all pairs of candidates."""

import cv2
import numpy as np
import pytest
import torch
from torch import Tensor

from fingerflow.graphs.detect import DetectGraph
from fingerflow.ops.filters.noise import estimate_noise
from fingerflow.ops.tracking.corners import corner_response

SHAPE, WINDOW = (150, 190), 15
BORDER = WINDOW // 2 + 3


def texture(seed: int = 0) -> Tensor:
    """Return texture (1, 1, H, W) of uint8, ten times as strong on the left as on the right."""
    noise = cv2.GaussianBlur(np.random.default_rng(seed).normal(size=SHAPE), (0, 0), 2.0)
    contrast = np.linspace(40, 4, SHAPE[1])
    return torch.from_numpy((120 + contrast * noise / noise.std()).clip(0, 255).astype(np.uint8))[None, None]


def everywhere() -> Tensor:
    return torch.ones(1, 1, *SHAPE, dtype=torch.bool)


def places(points: Tensor) -> set[tuple[float, float]]:
    return {(x, y) for x, y in points[points.isfinite().all(-1)].tolist()}


def largest_alone(frame: Tensor, mask: Tensor, count: int, least: int) -> set[tuple[float, float]]:
    """Return the local maxima that lie furthest from a stronger one, in x or y, and more than `least` px from it."""
    response = corner_response(frame, 5)[0, 0].numpy()
    inner = np.zeros(SHAPE, bool)
    inner[BORDER:-BORDER, BORDER:-BORDER] = True
    response = np.where(inner, response, 0)
    noise = float(estimate_noise(frame.float())) ** 2 + 1 / 12
    candidate = (response == cv2.dilate(response, np.ones((3, 3)))) & mask[0, 0].numpy()
    limit = max(0.01 * response[candidate].max(), 12 / 64 * (1 + 18 / 5) * noise)
    y, x = np.nonzero(candidate & (response > limit))
    strength = response[y, x]
    apart = np.maximum(abs(x[:, None] - x), abs(y[:, None] - y)).astype(float)
    apart[strength[:, None] >= strength] = np.inf
    alone = np.minimum(apart.min(1), max(least + 1, int((SHAPE[0] * SHAPE[1] / count) ** 0.5)) + 1)
    order = np.lexsort((-strength, -alone))
    return {(float(x[i]), float(y[i])) for i in order[:count] if alone[i] > least}


@pytest.mark.parametrize("count", [20, 80, 2000])
def test_those_are_taken_that_are_the_largest_of_the_largest_squares(count: int) -> None:
    frame, mask = texture(), everywhere()
    mask[..., 60:90, 40:] = False
    points, response = DetectGraph(count, 6.0, WINDOW)(frame, mask)
    assert places(points) == largest_alone(frame, mask, count, 3)
    found = len(places(points))
    assert found == count or count == 2000
    assert (response[0, :found].diff() <= 0).all()
    assert response[0, found:].isnan().all()


def test_points_are_where_texture_is_weak_too() -> None:
    points, _ = DetectGraph(60, 6.0, WINDOW)(texture(), everywhere())
    x = np.array([x for x, _ in places(points)])
    halves = [(x < SHAPE[1] / 2).sum(), (x >= SHAPE[1] / 2).sum()]
    assert min(halves) > 0.35 * sum(halves)


def test_a_slope_that_the_mask_cuts_is_no_corner() -> None:
    mask = torch.zeros_like(everywhere())
    mask[..., 40:110, 60:130] = True
    inside = places(DetectGraph(500, 6.0, WINDOW)(texture(), mask)[0])
    all_of_them = places(DetectGraph(5000, 2.0, WINDOW)(texture(), everywhere())[0])
    assert len(inside) > 20
    assert inside <= all_of_them


def test_pixels_that_are_not_finite_spoil_their_windows_alone() -> None:
    frame = texture().float()
    frame[..., 70, 90] = torch.nan
    frame[..., 30, 30] = torch.inf
    whole, spoilt = (places(DetectGraph(3000, 6.0, WINDOW)(one, everywhere())[0]) for one in (texture().float(), frame))
    assert len(whole) > 100
    assert all(min(max(abs(x - 90), abs(y - 70)), max(abs(x - 30), abs(y - 30))) <= 7 for x, y in whole ^ spoilt)


def test_nothing_is_found_where_nothing_is() -> None:
    for frame in (torch.zeros(1, 1, *SHAPE), torch.full((1, 1, *SHAPE), torch.nan)):
        points, response = DetectGraph(10, 6.0, WINDOW)(frame, everywhere())
        assert points.isnan().all()
        assert response.isnan().all()
    points, _ = DetectGraph(10, 6.0, WINDOW)(texture(), ~everywhere())
    assert points.isnan().all()


def test_each_frame_of_a_batch_is_by_itself() -> None:
    frames = torch.cat((texture(1), texture(2)))
    together, _ = DetectGraph(40, 6.0, WINDOW)(frames, everywhere().expand(2, -1, -1, -1))
    for one, points in zip(frames.split(1), together, strict=True):
        assert places(DetectGraph(40, 6.0, WINDOW)(one, everywhere())[0]) == places(points)
