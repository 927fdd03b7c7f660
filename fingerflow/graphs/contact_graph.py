"""Contact mask, contact areas and contact ellipse from frames of the contact view."""

import torch
from torch import Tensor, nn

from fingerflow.kernels.result_records import FrameContact
from fingerflow.ops.contact.apparent_contact import apparent_contact, cell_of
from fingerflow.ops.contact.contact_threshold import contact_threshold
from fingerflow.ops.contact.illumination_gain import illumination_gain
from fingerflow.ops.contact.real_contact_mask import real_contact_mask
from fingerflow.ops.full_precision import without_autocast


class ContactGraph(nn.Module):
    """Module that segments the contact in frames of the contact view.

    The method follows Willemet and others, 2021 (supplement, figure S3 A). A pixel is in contact where its count lies
    below black + a limit light, with the illumination gain a (`illumination_gain`). No quotient of images is formed.

    Args:
        median_px: odd side of the median window. The median rounds the ends of the ridges: 3 preserves the real
            contact area of a fingertip, 5 removes about 1 % of it and 9 (used in the paper) about 4 %.
        gross_radius_px: half the distance between ridges, or slightly more. The paper dilates the micro-junctions by
            this radius. Where ridges end at the border, that enlarges the region by the radius (10 % of the area of a
            fingertip); where ridges run along the border, it does not. `apparent_contact` replaces the dilation.
        cell_px: side of the cells of the apparent contact; None derives it from the radius (`cell_of`).
        stride_px: step between the lines of pixels that `threshold` reads; 1 reads all.
    """

    def __init__(
        self, median_px: int = 3, gross_radius_px: int = 8, cell_px: int | None = None, stride_px: int = 1
    ) -> None:
        super().__init__()
        self.median_px = median_px
        self.gross_radius_px = gross_radius_px
        self.cell_px = cell_px or cell_of(gross_radius_px)
        self.stride_px = stride_px

    @without_autocast
    def forward(self, frames: Tensor, light: Tensor, black: Tensor, limit: Tensor) -> FrameContact:
        """Segment the contact in frames (B, 1, H, W) of the contact view.

        `light` and `black` (1 or B, 1, H, W) are those of `ops.filters.illumination.glass_light`; `limit` (B,) is the
        share of the light below which a pixel is in contact: 1 - threshold, NaN for no contact.
        """
        gain = illumination_gain(frames, light, black, self.gross_radius_px)
        share = limit * torch.where(gain.abs() < torch.inf, gain, 1.0)
        mask = real_contact_mask(frames, light, black, share, self.median_px)
        region = apparent_contact(mask, self.gross_radius_px, self.cell_px, light.dtype)
        return region._replace(illumination_gain=gain)

    @without_autocast
    def threshold(self, frames: Tensor, light: Tensor, black: Tensor) -> Tensor:
        """Measure the contact threshold (B,): the relative intensity loss at the edges of ridges in contact.

        It is NaN without contact.
        """
        gain = illumination_gain(frames, light, black, self.gross_radius_px)
        return contact_threshold(
            frames, light, black, gain, median_px=self.median_px, radius=self.gross_radius_px, stride_px=self.stride_px
        )
