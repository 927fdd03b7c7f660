"""The gross region pixel by pixel: what `ops.contact.apparent_contact` finds on cells."""

import torch
import torch.nn.functional as F
from torch import Tensor

from fingerflow.ops.contact.components import fill_holes, largest_component
from fingerflow.ops.filters.box_sum import box_sum

_LEAST_SHARE = 0.2
_BOXES = 3


def exact_region(mask: Tensor, radius: int) -> Tensor:
    """The region (B, 1, H, W) bool of a mask; all sums are whole numbers."""
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
