"""The region that a pattern spans: stripes or dots with what lies between them, up to where the pattern ends."""

import torch
import torch.nn.functional as F
from torch import Tensor

from fingerflow import kernels
from fingerflow.ops.box_sum import box_sum
from fingerflow.ops.components import fill_holes, largest_component

_LEAST_SHARE = 0.2  # of a region that its pattern covers at least
_BOXES = 3


def dense_region(mask: Tensor, radius: int) -> Tensor:
    """The largest part of a frame, without holes, where the mask is about half as dense as inside of it.

    The density is the mean of the mask over about two periods (three box means). At a straight border it has fallen to
    one half of that inside, whatever the direction of the pattern; at a border curved outwards to less. How much less
    is read from the region itself, smoothed in the same way. The region and the density inside depend on each other: a
    fixed point, near after few rounds. All sums are whole numbers, so that every device finds the same pixels.

    Args:
        mask: (B, 1, H, W) bool.
        radius: px, half the period of the pattern or a little more, up to 255. Boxes have the side 2 radius + 1 and
            see nothing beyond the frame.

    Returns:
        (B, 1, H, W) bool, empty where the mask is.

    Raises:
        TypeError: `mask` is not bool.
        ValueError: `mask` is not (B, 1, H, W), or `radius` lies outside 1 to 255.
    """
    if mask.dtype != torch.bool:
        raise TypeError(f"the mask is {mask.dtype}: compare it with a threshold to make it bool")
    if mask.ndim != 4 or mask.shape[1] != 1:
        raise ValueError(f"the mask has shape {tuple(mask.shape)}: give (B, 1, H, W)")
    if not 1 <= radius <= 255:
        raise ValueError(f"a radius of {radius} px: give 1 to 255")
    if mask.numel() == 0:
        return mask.clone()
    if radius <= kernels.LARGEST_DENSITY_RADIUS and kernels.serve(mask):
        return kernels.dense_region(mask, radius)
    density = _smooth(mask, radius)
    full = (2 * radius + 1) ** (2 * _BOXES)  # density where all is covered

    def denser_than(level: Tensor) -> Tensor:
        return density > (full * level).floor().to(density.dtype)

    region = denser_than(torch.full((len(mask), 1, 1, 1), 0.25, dtype=torch.float64, device=mask.device))
    for _ in range(2):
        region = denser_than(_share(mask, region) * 0.5)
    neighbours = box_sum(F.pad(region.to(torch.uint8), (1,) * 4), 3)
    border = (neighbours > 0) & (neighbours < 9)
    at_border = torch.where(border, _smooth(region, radius), 0).sum((2, 3), keepdim=True)
    level = (at_border.double() / (full * border.sum((2, 3), keepdim=True).clamp(min=1)).double()).clamp(0.25, 0.5)
    for _ in range(2):
        region = denser_than(_share(mask, region) * level)
    return largest_component(fill_holes(region))


def _share(mask: Tensor, region: Tensor) -> Tensor:
    """Share (B, 1, 1, 1) float64 of the region that the mask covers."""
    covered = (mask & region).sum((2, 3), keepdim=True).double()
    return (covered / region.sum((2, 3), keepdim=True).clamp(min=1).double()).clamp(_LEAST_SHARE, 1.0)


def _smooth(mask: Tensor, radius: int) -> Tensor:
    """Three box sums of side 2 radius + 1: up to (2 radius + 1)^6, exact."""
    side = 2 * radius + 1
    density = mask.to(torch.int32 if side ** (2 * _BOXES) < 2**31 else torch.int64)
    for _ in range(_BOXES):
        density = box_sum(F.pad(density, (radius,) * 4), side)
    return density
