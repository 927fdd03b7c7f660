"""Dilation and erosion of masks by a disc or a diamond, as unions of shifted horizontal runs."""

from typing import Literal

import torch
from torch import Tensor
from torch.nn import functional

from fingerflow.ops.checks import check_mask

Shape = Literal["disc", "diamond"]


def dilate(mask: Tensor, radius: int, shape: Shape = "disc") -> Tensor:
    """Dilate masks by a disc or a diamond of `radius` pixels.

    The disc holds the offsets with dx^2 + dy^2 <= radius^2, the diamond those with |dx| + |dy| <= radius. Each row of
    either is one run, so a dilation is a union of horizontally widened masks shifted up and down: about 3 radius passes
    in total.

    Args:
        mask: (B, 1, H, W) bool; outside the frame is background.
        radius: whole pixels, 0 or more.
        shape: "disc" or "diamond".

    Returns:
        (B, 1, H, W) bool.

    Raises:
        TypeError: `mask` is not bool.
        ValueError: `mask` is not (B, 1, H, W), `radius` is negative, or `shape` is unknown.
    """
    half_widths = _half_widths(mask, radius, shape)
    height = mask.shape[-2]
    padded = functional.pad(mask, (0, 0, radius, radius))
    widened, width = padded, 0
    result = torch.zeros_like(mask)
    for half_width in sorted(set(half_widths)):
        widened, width = _widen(widened, half_width - width), half_width
        for row, wanted in enumerate(half_widths):
            if wanted == half_width:
                result = result | widened[..., row : row + height, :]
    return result


def erode(mask: Tensor, radius: int, shape: Shape = "disc") -> Tensor:
    """Erode masks by a disc or a diamond: keep pixels whose neighbourhood within the frame lies in the mask.

    Pixels outside the frame do not erode (as in OpenCV): contact cut off by the frame keeps its extent on that side.
    Erosion is therefore the complement of the dilated background.

    Args, returns, raises: as `dilate`.
    """
    return ~dilate(~mask, radius, shape)


def _half_widths(mask: Tensor, radius: int, shape: Shape) -> list[int]:
    """Return half the width of each row, from -radius to radius, of a disc or diamond; also check the arguments."""
    check_mask(mask)
    if radius < 0:
        raise ValueError(f"radius is {radius} px: give 0 or more")
    rows = range(-radius, radius + 1)
    if shape == "disc":
        return [int((radius * radius - y * y) ** 0.5) for y in rows]
    if shape == "diamond":
        return [radius - abs(y) for y in rows]
    raise ValueError(f'shape is {shape!r}: "disc" or "diamond"')


def _widen(mask: Tensor, by: int) -> Tensor:
    """Widen each horizontal run of True pixels in a mask by `by` pixels at both ends."""
    covered = 0
    while covered < by:
        step = min(covered + 1, by - covered)
        both = functional.pad(mask, (step, step))
        mask = both[..., : -2 * step] | mask | both[..., 2 * step :]
        covered += step
    return mask
