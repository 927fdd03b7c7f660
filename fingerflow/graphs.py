"""Torch modules made of ops: exactly what runs for a batch of frames, for any device, without hidden state."""

from typing import NamedTuple

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from fingerflow.ops.box_sum import box_sum
from fingerflow.ops.components import fill_holes, largest_component
from fingerflow.ops.ellipse import Ellipse, fit_ellipse
from fingerflow.ops.illumination import contact_signal, dequantize, normalize_illumination, quantize
from fingerflow.ops.local_fit import local_gradients
from fingerflow.ops.median import median_above, median_filter
from fingerflow.ops.otsu import class_separation, otsu_threshold
from fingerflow.ops.strain import curl, divergence, green_lagrange
from fingerflow.ops.strain_uncertainty import divergence_deviation
from fingerflow.ops.tracking import Tracks, track_points

_LEAST_DENSITY = 0.2  # share of a contact that touches at least; fingertips show 0.3 to 0.6


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
        median_px: odd side of the median.
        gross_radius_px: half the distance between ridges, or a little more. The paper dilates the micro-junctions by
        it,
            which leaves the region larger by this radius all around (10 % of the area of a fingertip) where ridges
            end at its
            border, and not where they run along it; see :meth:`gross` for what is done instead.
    """

    def __init__(self, median_px: int = 9, gross_radius_px: int = 8) -> None:
        super().__init__()
        self.median_px = median_px
        self.gross_radius_px = gross_radius_px

    def forward(
        self, frames: Tensor, reference: Tensor, dark: Tensor | None = None, threshold: Tensor | None = None
    ) -> Contact:
        """(B, 1, H, W) frames, (1, 1, H, W) reference and dark; ``threshold`` (B,) or None for Otsu's of each frame."""
        levels, _ = self.levels(frames, reference, dark)
        if threshold is None:
            threshold = self.otsu(frames, reference, dark)
        real = median_above(levels.float(), _level(threshold), self.median_px)
        gross = self.gross(real)
        area = gross.sum((1, 2, 3), dtype=torch.float64)
        return Contact(real, gross, real.sum((1, 2, 3), dtype=torch.float64), area, fit_ellipse(gross), threshold)

    def levels(self, frames: Tensor, reference: Tensor, dark: Tensor | None) -> tuple[Tensor, Tensor]:
        """The share of light lost in one byte, and where the glass is lit."""
        normalized = normalize_illumination(frames, reference, dark)
        return quantize(contact_signal(normalized)), normalized.valid

    def otsu(self, frames: Tensor, reference: Tensor, dark: Tensor | None = None) -> Tensor:
        """(B,) Otsu's threshold of the median-filtered signal; NaN where a frame shows no two classes."""
        levels, valid = self.levels(frames, reference, dark)
        smooth = median_filter(levels, self.median_px)
        threshold = otsu_threshold(smooth, valid)
        classes = class_separation(smooth, threshold, valid)
        distance = dequantize(classes.means[:, 1]) - dequantize(classes.means[:, 0])
        # Contact takes at least a twentieth of the light; two halves of noise lie closer together.
        apart = distance > torch.maximum(torch.tensor(0.05), 6 * classes.deviations[:, 0] * (1.25 / 255))
        # Otsu's threshold is the highest level of the darker class, and empty levels above it split as well: the
        # middle between the two means is where a blurred edge has its true place.
        middle = (dequantize(classes.means[:, 1]) + dequantize(classes.means[:, 0])) / 2
        return torch.where(apart & threshold.isfinite(), middle, torch.nan)

    def gross(self, real: Tensor) -> Tensor:
        """The region that the micro-junctions span: where their density exceeds half of what it is inside.

        The density is their mean over about two ridges (three box means). At a straight border of the region the
        smoothed
        density has fallen to one half, whatever the ridges' direction, so the border is found without bias.
        """
        side = 2 * self.gross_radius_px + 1
        density = real.float()
        for _ in range(3):
            density = box_sum(F.pad(density, (self.gross_radius_px,) * 4), side) / side**2
        # The density inside follows from the region, and the region from it: a fixed point, near after three rounds.
        inside = torch.full_like(density[:, :, :1, :1], 0.5)
        region = density > inside / 2
        for _ in range(3):
            share = (real & region).sum((2, 3), keepdim=True) / region.sum((2, 3), keepdim=True).clamp_min(1)
            inside = share.clamp(_LEAST_DENSITY, 1.0)
            region = density > inside / 2
        return largest_component(fill_holes(region))


class TrackGraph(nn.Module):
    """Points of one frame of the topography view found in another; settings as in ``ops.track_points``."""

    def __init__(
        self, window: int = 21, forward_backward_limit: float = 1.0, search: int = 0, gain_offset: bool = False
    ) -> None:
        super().__init__()
        self.window = window
        self.forward_backward_limit = forward_backward_limit
        self.search = search
        self.gain_offset = gain_offset

    def forward(
        self,
        previous: Tensor,
        current: Tensor,
        points: Tensor,
        initial: Tensor | None = None,
        warp: Tensor | None = None,
    ) -> Tracks:
        """(B, 1, H, W) images, (B, N, 2) points and predictions, (B, N, 2, 2) deformation gradients."""
        return track_points(
            previous,
            current,
            points,
            self.window,
            initial=initial,
            warp=warp,
            gain_offset=self.gain_offset,
            search=self.search,
            forward_backward_limit=self.forward_backward_limit,
        )


class Fields(NamedTuple):
    """Fields at Q places of B frames: divergence, curl (B, Q), strain (B, Q, 3), standard deviation of divergence (B,
    Q)."""

    divergence: Tensor
    curl: Tensor
    strain: Tensor
    divergence_std: Tensor


class FieldsGraph(nn.Module):
    """Displacements of scattered points to divergence, curl and strain by local fits over ``gauge_length``."""

    def __init__(self, gauge_length: float, measure: str = "green_lagrange") -> None:
        super().__init__()
        self.gauge_length = gauge_length
        self.measure = measure

    def forward(
        self, reference: Tensor, displacement: Tensor, variance: Tensor, queries: Tensor | None = None
    ) -> Fields:
        """(B, N, 2) reference positions and displacements of one unit, variance (B, N) of a component in its square."""
        fit = local_gradients(reference, displacement, queries, gauge_length=self.gauge_length, variance=variance)
        assert fit.covariance is not None  # a variance was given
        return Fields(
            divergence(fit.gradient),
            curl(fit.gradient),
            green_lagrange(fit.gradient, self.measure),
            divergence_deviation(fit.covariance),
        )


def _level(threshold: Tensor) -> Tensor:
    """The threshold of the signal in levels of :func:`quantize`, between two of them."""
    return (threshold - (-0.25)) * (255 / 1.25)
