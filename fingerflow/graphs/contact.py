"""Frames of the contact view to what touches, areas and ellipse."""

from typing import NamedTuple

import torch
from torch import Tensor, nn

from fingerflow.ops.contact.apparent_contact import apparent_contact, cell_of
from fingerflow.ops.contact.contact_threshold import contact_threshold
from fingerflow.ops.contact.light_gain import light_gain
from fingerflow.ops.contact.real_contact_mask import real_contact_mask


class Contact(NamedTuple):
    """Contact of B frames.

    Attributes:
        real_contact_mask: (B, 1, H, W) bool, the micro-junctions.
        real_area_px, gross_area_px: (B,) px, of them and of the region that they span.
        center, semi_axes: (B, 2) px, `angle` (B,) rad: of the gross region's ellipse, NaN without contact.
        density_margin: (B, 1, h, w) of the gross region on cells, from which `ops.contact.cells.covered` tells what it
            covers.
        light_gain: (B,) brightness of the lamp, 1 that of the empty glass; NaN, and 1 taken, where no glass is seen.
    """

    real_contact_mask: Tensor
    real_area_px: Tensor
    gross_area_px: Tensor
    center: Tensor
    semi_axes: Tensor
    angle: Tensor
    density_margin: Tensor
    light_gain: Tensor


class ContactGraph(nn.Module):
    """Frames of the contact view to `Contact` (Willemet et al. 2021, supplement, figure S3 A).

    A pixel touches where its count lies below black + a limit * light, `light_gain` a: no quotient is formed.

    Args:
        median_px: odd side of the median. It rounds the ends of the ridges: 3 leaves the real contact area of a
            fingertip as it is, 5 takes about 1 % of it and 9 (the paper's) about 4 %.
        gross_radius_px: half the distance between ridges, or a little more. The paper dilates the micro-junctions by
            it, which leaves the region larger by this radius all around (10 % of the area of a fingertip) where ridges
            end at its border, and not where they run along it. `apparent_contact` is what is done instead.
        cell_px: side of the cells of the gross region; None for what the radius needs.
        stride_px: of how many pixels, across and down, one is counted in `threshold`; 1 for all.
    """

    def __init__(
        self, median_px: int = 3, gross_radius_px: int = 8, cell_px: int | None = None, stride_px: int = 1
    ) -> None:
        super().__init__()
        self.median_px = median_px
        self.gross_radius_px = gross_radius_px
        self.cell_px = cell_px or cell_of(gross_radius_px)
        self.stride_px = stride_px

    def forward(self, frames: Tensor, light: Tensor, black: Tensor, limit: Tensor) -> Contact:
        """(B, 1, H, W) frames and the `Light` (of one view or B) that they are compared with, limit (B,)."""
        gain = light_gain(frames, light, black, self.gross_radius_px)
        share = limit * torch.where(gain.abs() < torch.inf, gain, 1.0)
        mask = real_contact_mask(frames, light, black, share, self.median_px)
        region = apparent_contact(mask, self.gross_radius_px, self.cell_px, light.dtype)
        return Contact(
            mask,
            region.covered_px,
            region.area_px,
            region.center,
            region.semi_axes,
            region.angle,
            region.density_margin,
            gain,
        )

    def threshold(self, frames: Tensor, light: Tensor, black: Tensor) -> Tensor:
        """(B,) relative intensity loss half-way between ridges and the skin beside them; NaN without contact."""
        gain = light_gain(frames, light, black, self.gross_radius_px)
        return contact_threshold(
            frames,
            light,
            black,
            gain,
            median_px=self.median_px,
            radius=self.gross_radius_px,
            stride_px=self.stride_px,
        )
