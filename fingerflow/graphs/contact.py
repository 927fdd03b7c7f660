"""Frames of the contact view to masks, areas and ellipse."""

from typing import NamedTuple

import torch
from torch import Tensor, nn

from fingerflow.ops.contact_above import contact_above
from fingerflow.ops.contact_classes import contact_classes
from fingerflow.ops.dense_region import dense_region
from fingerflow.ops.ellipse import Ellipse, fit_ellipse, mask_moments
from fingerflow.ops.illumination import dequantize
from fingerflow.ops.otsu import histogram
from fingerflow.ops.quantile import median_of_counts


class Contact(NamedTuple):
    """Contact of B frames.

    Attributes:
        real: (B, 1, H, W) bool, the micro-junctions.
        gross: (B, 1, H, W) bool, the region that they span.
        real_area_px, gross_area_px: (B,) float64 px.
        ellipse: of the gross region, px.
        threshold: (B,) share of light lost that counts as contact.
    """

    real: Tensor
    gross: Tensor
    real_area_px: Tensor
    gross_area_px: Tensor
    ellipse: Ellipse
    threshold: Tensor


class ContactGraph(nn.Module):
    """Frames of the contact view to contact masks, areas and ellipse (Willemet et al. 2021, supplement, figure S3 A).

    Args:
        median_px: odd side of the median. It rounds the ends of the ridges: 3 leaves the real contact area of a
            fingertip as it is, 5 takes about 1 % of it and 9 (the paper's) about 4 %.
        gross_radius_px: half the distance between ridges, or a little more. The paper dilates the micro-junctions by
            it, which leaves the region larger by this radius all around (10 % of the area of a fingertip) where ridges
            end at its border, and not where they run along it. `dense_region` is what is done instead.
    """

    def __init__(self, median_px: int = 3, gross_radius_px: int = 8) -> None:
        super().__init__()
        self.median_px = median_px
        self.gross_radius_px = gross_radius_px

    def forward(
        self, frames: Tensor, reference: Tensor, dark: Tensor | None = None, threshold: Tensor | None = None
    ) -> Contact:
        """(B, 1, H, W) frames, (1, 1, H, W) reference and dark; ``threshold`` (B,), or None for each frame's own."""
        if threshold is None:
            threshold = self.threshold(frames, reference, dark)
        real = contact_above(frames, reference, dark, threshold=threshold, median_px=self.median_px)
        gross = dense_region(real, self.gross_radius_px)
        ellipse = fit_ellipse(gross)
        return Contact(real, gross, mask_moments(real)[:, 0].double(), ellipse.area_px, ellipse, threshold)

    def threshold(self, frames: Tensor, reference: Tensor, dark: Tensor | None = None) -> Tensor:
        """(B,) share of light lost half-way between touching ridges and the skin beside them; NaN without contact.

        Otsu's threshold of the median-filtered signal splits the pixels into classes, and so finds the gross region.
        Most of the rest is empty glass, brighter than the skin between ridges, which pulls Otsu's threshold down
        and the area up by 2 %. Half-way between the medians of the two classes inside the gross region is where the
        blurred edge of a ridge has its true place.
        """
        contact = contact_classes(frames, reference, dark, median_px=self.median_px)
        low, high = dequantize(contact.classes.means).unbind(1)
        # Contact takes at least a twentieth of the light; two halves of noise lie closer together. Frames that are
        # brighter than the background (another exposure or bit depth) have classes, but no contact.
        noise = contact.classes.deviations[:, 0] * (1.25 / 255)
        apart = (high > 0.05) & (high - low > (6 * noise).clamp(min=0.05))
        gross = dense_region(contact.touching, self.gross_radius_px)
        counts = histogram(contact.smooth, gross & contact.valid)
        touching = torch.arange(counts.shape[1], device=counts.device) > contact.threshold[:, None]
        ridges, valleys = median_of_counts(torch.cat([counts * touching, counts * ~touching])).chunk(2)
        # Contact without gaps has no valleys: the empty glass stands for them.
        valleys = torch.where(valleys.isfinite(), valleys, contact.classes.means[:, 0])
        return torch.where(apart & contact.threshold.isfinite(), dequantize((ridges + valleys) / 2), torch.nan)
