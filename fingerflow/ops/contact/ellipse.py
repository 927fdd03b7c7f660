"""Ellipse with the same first and second moments as a mask: position, size and orientation of a contact."""

from typing import NamedTuple

import torch
from torch import Tensor

from fingerflow.ops.checks import check_mask


class FittedEllipse(NamedTuple):
    """Ellipses fitted to B masks, in float64.

    Attributes:
        center: (B, 2) px as (x, y).
        semi_axes: (B, 2) px, major first.
        angle: (B,) rad of the major axis, from the x axis towards y (down the frame), in (-pi/2, pi/2]; 0 for a circle.
        area_px: (B,) px, area of the mask.
    """

    center: Tensor
    semi_axes: Tensor
    angle: Tensor
    area_px: Tensor


def fit_ellipse(mask: Tensor) -> FittedEllipse:
    """Fit an ellipse to each mask: the filled ellipse with the first and second moments of the mask's pixels.

    A filled ellipse has the variance (semi-axis)^2 / 4 along each axis. A pixel belongs to a mask when its centre does,
    so the pixel centres sample the area regularly and their variance needs no correction. (Treating each pixel as a
    filled square would add 1/12 px^2 and lengthen a semi-axis a by the fraction 1/(6 a^2): 0.17 % at a = 10 px.) A
    single pixel has semi-axes of 0, a line has a minor semi-axis of 0.

    Args:
        mask: (B, 1, H, W) bool.

    Returns:
        `FittedEllipse`; centre, axes and angle of an empty mask are NaN, its area 0.

    Raises:
        TypeError: `mask` is not bool.
        ValueError: `mask` is not (B, 1, H, W).
    """
    check_mask(mask)
    number, x, y, xx, xy, yy = mask_moments(mask).unbind(1)
    area = number.double()
    center_x, center_y = x / area, y / area
    # Compute moments about the pixel nearest to the centre, in integers: a small mask far from the origin then loses no
    # digits.
    near_x, near_y = (center.nan_to_num(0.0).round().long() for center in (center_x, center_y))
    dx, dy = (x - number * near_x) / area, (y - number * near_y) / area
    xx = (xx - near_x * (2 * x - number * near_x)) / area - dx * dx
    yy = (yy - near_y * (2 * y - number * near_y)) / area - dy * dy
    xy = (xy - near_x * y - near_y * (x - number * near_x)) / area - dx * dy

    middle, spread = (xx + yy) / 2, torch.hypot((xx - yy) / 2, xy)
    variances = torch.stack([middle + spread, (middle - spread).clamp(min=0)], 1)
    angle = torch.atan2(2 * xy, xx - yy) / 2
    return FittedEllipse(torch.stack([center_x, center_y], 1), 2 * variances.sqrt(), angle, area)


def mask_moments(mask: Tensor) -> Tensor:
    """Compute the area and the first and second moments of masks, as exact sums over pixels.

    Args:
        mask: (B, 1, H, W) bool.

    Returns:
        (B, 6) int64, the sums of 1, x, y, x x, x y and y y, in px.

    Raises:
        TypeError: `mask` is not bool.
        ValueError: `mask` is not (B, 1, H, W).
    """
    check_mask(mask)
    filled = mask[:, 0]
    y, x = (torch.arange(length, device=mask.device) for length in filled.shape[1:])
    columns, rows = filled.sum(1), filled.sum(2)
    along = torch.where(filled, x, 0).sum(2)
    sums = columns, along, rows * y, columns * x * x, along * y, rows * y * y
    return torch.stack([some.sum(1) for some in sums], 1)
