"""Ellipses of masks with nothing, one pixel or one line in them."""

import math

import pytest
import torch

from fingerflow.ops.contact.ellipse import fit_ellipse


def test_empty_mask_is_nan_with_area_zero_beside_a_full_one() -> None:
    mask = torch.zeros(2, 1, 10, 12, dtype=torch.bool)
    mask[1] = True
    ellipse = fit_ellipse(mask)
    assert ellipse.area_px.tolist() == [0, 120]
    for part in (ellipse.center, ellipse.semi_axes, ellipse.angle):
        assert part[0].isnan().all()
        assert part[1].isfinite().all()
    assert ellipse.center[1].tolist() == [5.5, 4.5]
    # n equally spaced points have the variance (n^2 - 1) / 12.
    assert ellipse.semi_axes[1].tolist() == pytest.approx([2 * math.sqrt(143 / 12), 2 * math.sqrt(99 / 12)])


def test_one_pixel_and_one_line() -> None:
    mask = torch.zeros(3, 1, 9, 9, dtype=torch.bool)
    mask[0, 0, 3, 5] = True
    mask[1, 0, 4] = True
    mask[2, 0, :, 4] = True
    ellipse = fit_ellipse(mask)
    assert ellipse.center[0].tolist() == [5, 3]
    assert ellipse.semi_axes[0].tolist() == [0, 0]
    assert ellipse.semi_axes[1:, 1].tolist() == [0, 0]
    assert ellipse.semi_axes[1:, 0].tolist() == pytest.approx([2 * math.sqrt(80 / 12)] * 2)
    assert ellipse.angle.tolist() == pytest.approx([0, 0, math.pi / 2])


def test_circle_has_angle_zero() -> None:
    y, x = torch.meshgrid(torch.arange(41) - 20, torch.arange(41) - 20, indexing="ij")
    ellipse = fit_ellipse((x**2 + y**2 <= 225)[None, None])
    assert ellipse.angle.item() == 0
    assert ellipse.semi_axes[0, 0] == ellipse.semi_axes[0, 1]


def test_empty_batch() -> None:
    ellipse = fit_ellipse(torch.zeros(0, 1, 5, 5, dtype=torch.bool))
    assert [tuple(part.shape) for part in ellipse] == [(0, 2), (0, 2), (0,), (0,)]
