"""Frames without corners, and frames with holes: none invented, none lost to a neighbour."""

import math

import cv2
import numpy as np
import pytest
import torch

from fingerflow.ops.tracking.corners import corner_response, detect_corners


@pytest.mark.parametrize("dtype", [torch.uint8, torch.uint16, torch.float32])
@pytest.mark.parametrize("level", [0, 100, 255])
def test_one_grey_level(dtype: torch.dtype, level: int) -> None:
    corners = detect_corners(torch.full((2, 1, 40, 40), level).to(dtype), 50)
    assert not corners.valid.any()
    assert corners.points.shape == (2, 50, 2)
    assert corners.points.isnan().all()
    assert corners.response.isnan().all()


@pytest.mark.parametrize("window", [3, 5, 7, 11, 21])
@pytest.mark.parametrize("deviation", [0.3, 3.0])
def test_pure_noise_has_no_corners(window: int, deviation: float) -> None:
    noise = torch.randn(2, 1, 300, 300, generator=torch.Generator().manual_seed(window))
    frame = (100 + deviation * noise).round().to(torch.uint8)
    assert not detect_corners(frame, 50, window=window).valid.any()
    known = math.hypot(deviation, math.sqrt(1 / 12))
    assert not detect_corners(frame, 50, window=window, noise=known).valid.any()


@pytest.mark.parametrize("angle", [0.0, 0.2, math.pi / 4, 1.2, math.pi / 2])
@pytest.mark.parametrize("dtype", [torch.uint8, torch.float32])
def test_one_direction_only_has_no_corners(angle: float, dtype: torch.dtype) -> None:
    y, x = torch.meshgrid(torch.arange(120.0), torch.arange(150.0), indexing="ij")
    grating = 120 + 80 * torch.sin(2 * math.pi / 13 * (x * math.cos(angle) + y * math.sin(angle)))
    frame = grating[None, None].to(dtype) if dtype.is_floating_point else grating.round()[None, None].to(dtype)
    # Replicated pixels bend the stripes at the border of the frame itself.
    assert not detect_corners(frame, 50, border=8).valid.any()


def test_one_direction_with_camera_noise_has_no_corners() -> None:
    y, x = torch.meshgrid(torch.arange(200.0), torch.arange(200.0), indexing="ij")
    grating = 120 + 60 * torch.sin(0.4 * x + 0.2 * y)
    noise = 2 * torch.randn(200, 200, generator=torch.Generator().manual_seed(0))
    frame = (grating + noise).round().to(torch.uint8)[None, None]
    assert not detect_corners(frame, 50, border=8).valid.any()


def test_saturated_spot_has_corners_only_at_its_rim() -> None:
    y, x = torch.meshgrid(torch.arange(100) - 50, torch.arange(100) - 50, indexing="ij")
    frame = torch.where((x.abs() < 30) & (y.abs() < 30), 255, 60).to(torch.uint8)[None, None]
    points = detect_corners(frame, 50, noise=1.0)
    found = points.points[0][points.valid[0]] - 50
    assert len(found) >= 4
    assert (found.abs().amin(1) >= 25).all()


@pytest.mark.parametrize("bad", [torch.nan, torch.inf, -torch.inf])
def test_a_number_that_is_none_spoils_its_windows_only(bad: float) -> None:
    noise = cv2.GaussianBlur(np.random.default_rng(1).normal(size=(100, 120)), (0, 0), 2.5)
    frame = torch.from_numpy(120 + 40 * noise / noise.std())[None, None].float()
    spoiled = frame.clone()
    spoiled[0, 0, 50, 60] = bad
    response, clean = corner_response(spoiled, 7), corner_response(frame, 7)
    expected = torch.zeros(100, 120, dtype=torch.bool)
    expected[46:55, 56:65] = True  # half a window and the gradient's pixel: 4 px
    expected[50, 60] = True
    assert torch.equal(response[0, 0].isnan(), expected)
    assert torch.equal(response[0, 0][~expected], clean[0, 0][~expected])
    corners, all_corners = detect_corners(spoiled, 500, 3.0, noise=1.0), detect_corners(frame, 500, 3.0, noise=1.0)
    x, y = corners.points[0][corners.valid[0]].long().unbind(1)
    assert not expected[y, x].any()
    lost = all_corners.valid.sum() - corners.valid.sum()
    assert 0 <= lost <= 8


def test_frame_of_nan_beside_a_textured_one() -> None:
    noise = cv2.GaussianBlur(np.random.default_rng(2).normal(size=(60, 60)), (0, 0), 2.5)
    frame = torch.from_numpy(40 * noise / noise.std())[None, None].float()
    corners = detect_corners(torch.cat([torch.full_like(frame, torch.nan), frame]), 20)
    assert not corners.valid[0].any()
    assert torch.equal(corners.points[1], detect_corners(frame, 20).points[0])


def test_fewer_than_asked_none_asked_and_empty_batch() -> None:
    frame = torch.zeros(1, 1, 40, 40)
    frame[..., 10:30, 10:30] = 100
    assert detect_corners(frame, 0).points.shape == (1, 0, 2)
    assert detect_corners(frame[:0], 7).points.shape == (0, 7, 2)
    assert not detect_corners(frame, 5, mask=torch.zeros(1, 1, 40, 40, dtype=torch.bool)).valid.any()
    assert not detect_corners(frame, 5, border=20).valid.any()


def test_frame_smaller_than_the_window() -> None:
    frame = torch.rand(1, 1, 3, 5, generator=torch.Generator().manual_seed(3))
    assert corner_response(frame, 9).isfinite().all()
    assert detect_corners(frame, 5, window=9, border=9).valid.sum() == 0
