"""Tests of the moments of rasterised ellipses against the ellipses themselves."""

import math

import pytest
import torch

from fingerflow.ops.contact.ellipse import fit_ellipse


def rasterise(
    center: tuple[float, float], axes: tuple[float, float], angle: float, shape: tuple[int, int] = (512, 640)
) -> torch.Tensor:
    y, x = torch.meshgrid(*(torch.arange(n, dtype=torch.float64) for n in shape), indexing="ij")
    dx, dy = x - center[0], y - center[1]
    along = dx * math.cos(angle) + dy * math.sin(angle)
    across = -dx * math.sin(angle) + dy * math.cos(angle)
    return ((along / axes[0]) ** 2 + (across / axes[1]) ** 2 <= 1)[None, None]


@pytest.mark.parametrize("angle", [0.3, math.pi / 2, -0.7])
@pytest.mark.parametrize(("center", "axes"), [((320.3, 251.8), (240.0, 190.0)), ((200.2, 300.4), (110.0, 60.0))])
def test_rasterised_ellipse_to_a_thousandth(
    angle: float, center: tuple[float, float], axes: tuple[float, float]
) -> None:
    """Axes and area are found to 0.1 %, the centre to 0.1 px: the error of counting pixel centres.

    Each of about 540 border pixels is in or out by up to half a pixel, variance 1/12. At a = 110, b = 60 the standard
    errors are 0.028 px in the centre and 0.03 % in the axes, less for larger ellipses.
    """
    ellipse = fit_ellipse(rasterise(center, axes, angle))
    assert ellipse.center[0].tolist() == pytest.approx(center, abs=0.1)
    assert ellipse.semi_axes[0].tolist() == pytest.approx(axes, rel=1e-3)
    assert math.sin(ellipse.angle.item() - angle) == pytest.approx(0, abs=1e-3)  # the axis has no direction
    assert ellipse.area_px.item() == pytest.approx(math.pi * axes[0] * axes[1], rel=1e-3)


def test_pixels_are_points_and_not_squares() -> None:
    """The mean axis of 400 small discs at random positions has no bias: pixels count as points. Pixels counted as
    squares would add a variance of 1/12 px^2, 0.0167 px of the axis.
    """
    generator = torch.Generator().manual_seed(0)
    offsets = torch.rand(400, 2, generator=generator, dtype=torch.float64)
    masks = torch.cat([rasterise((20 + x, 20 + y), (10, 10), 0, (41, 41)) for x, y in offsets.tolist()])
    variance = fit_ellipse(masks).semi_axes.square().mean() / 4
    assert variance.item() == pytest.approx(25, abs=0.02)


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
