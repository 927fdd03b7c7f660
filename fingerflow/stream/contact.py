"""Contact of one frame where the threshold is known."""

from typing import NamedTuple

import torch
from torch import Tensor, nn

from fingerflow.stream.median_planes import majority
from fingerflow.stream.region import RegionStep


class StreamContact(NamedTuple):
    """Contact of B frames.

    `touching` (B, 1, H, W) uint8; areas (B,) px; `center` and `semi_axes` (B, 2) px, `angle` (B,) rad of the gross
    region's ellipse; `excess` (B, 1, h, w) of the gross region (`Region`).
    """

    touching: Tensor
    real_area_px: Tensor
    gross_area_px: Tensor
    center: Tensor
    semi_axes: Tensor
    angle: Tensor
    excess: Tensor


class ContactStep(nn.Module):
    """Pixels darker than a limit of their own, the majority in every window of the median, and the region they span.

    The median of an odd number of levels lies above a threshold where most of them do, and a level does where its count
    lies below the pixel's limit: no quotient is formed and no level.

    Args:
        median_px: odd side of the median.
        median_type: type that carries the median: uint8, or one that the runtime has minima and comparisons of.
        cell_px: of the gross region (`RegionStep`).
    """

    def __init__(
        self,
        median_px: int = 3,
        median_type: torch.dtype = torch.uint8,
        precision: torch.dtype = torch.float32,
        cell_px: int = 4,
    ) -> None:
        super().__init__()
        self.median_px = median_px
        self.median_type = median_type
        self.region = RegionStep(precision, cell_px)

    def forward(self, contact_view: Tensor, limit: Tensor, valid: Tensor) -> StreamContact:
        """(B, 1, H, W) frames, the limit and the valid pixels of `BackgroundStep`."""
        if limit.dtype == torch.uint8 and self.median_type == torch.uint8:
            below = contact_view < limit
        else:
            below = contact_view.to(torch.float32) < limit.to(torch.float32)
        if self.median_px == 1:  # nothing lies below the limit of a pixel that is not valid
            return span(self.region, below.to(torch.uint8))
        most = majority(below.to(self.median_type), self.median_px)
        return span(self.region, torch.minimum(most, valid))


def span(region: RegionStep, touching: Tensor) -> StreamContact:
    """Areas and ellipse of touching pixels (B, 1, H, W), uint8."""
    found = region(touching)
    return StreamContact(
        touching, found.real_area_px, found.area_px, found.center, found.semi_axes, found.angle, found.excess
    )
