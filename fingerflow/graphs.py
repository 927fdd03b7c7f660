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
from fingerflow.ops.otsu import class_separation, histogram, otsu_threshold
from fingerflow.ops.quantile import median_of_counts
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
        median_px: odd side of the median. It rounds the ends of the ridges: 3 leaves the real contact area of a
            fingertip as it is, 5 takes about 1 % of it and 9 (the paper's) about 4 %.
        gross_radius_px: half the distance between ridges, or a little more. The paper dilates the micro-junctions by
            it, which leaves the region larger by this radius all around (10 % of the area of a fingertip) where ridges
            end at its border, and not where they run along it; see :meth:`gross` for what is done instead.
    """

    def __init__(self, median_px: int = 3, gross_radius_px: int = 8) -> None:
        super().__init__()
        self.median_px = median_px
        self.gross_radius_px = gross_radius_px

    def forward(
        self, frames: Tensor, reference: Tensor, dark: Tensor | None = None, threshold: Tensor | None = None
    ) -> Contact:
        """(B, 1, H, W) frames, (1, 1, H, W) reference and dark; ``threshold`` (B,), or None for each frame's own."""
        normalized = normalize_illumination(frames, reference, dark)
        signal = contact_signal(normalized)
        if threshold is None:
            threshold = self._threshold(signal, normalized.valid)
        real = median_above(signal, threshold, self.median_px) & normalized.valid
        gross = self.gross(real)
        area = gross.sum((1, 2, 3), dtype=torch.float64)
        return Contact(real, gross, real.sum((1, 2, 3), dtype=torch.float64), area, fit_ellipse(gross), threshold)

    def threshold(self, frames: Tensor, reference: Tensor, dark: Tensor | None = None) -> Tensor:
        """(B,) share of light lost half-way between touching ridges and the skin beside them; NaN without contact.

        Otsu's threshold of the median-filtered signal splits the pixels into classes, and so finds the gross region.
        Most of the rest is empty glass, brighter than the skin between ridges, which pulls Otsu's threshold down
        and the area up by 2 %. Half-way between the medians of the two classes inside the gross region is where the
        blurred edge of a ridge has its true place.
        """
        normalized = normalize_illumination(frames, reference, dark)
        return self._threshold(contact_signal(normalized), normalized.valid)

    def gross(self, real: Tensor) -> Tensor:
        """The region that the micro-junctions span: where their density exceeds about half of what it is inside.

        The density is their mean over about two ridges (three box means). At a straight border the smoothed density
        has fallen to one half of that inside, whatever the ridges' direction; at a border curved outwards to less.
        How much less is read from the region itself, smoothed in the same way. The region and the density inside
        depend on each other: a fixed point, near after few rounds.
        """
        density = self._smooth(real)
        region = density > 0.25
        for _ in range(2):
            region = density > _inside(real, region) / 2
        neighbours = box_sum(F.pad(region.float(), (1,) * 4), 3)
        level = _mean(self._smooth(region), (neighbours > 0) & (neighbours < 9)).clamp(0.25, 0.5)
        for _ in range(2):
            region = density > _inside(real, region) * level
        return largest_component(fill_holes(region))

    def _threshold(self, signal: Tensor, valid: Tensor) -> Tensor:
        smooth = median_filter(quantize(signal), self.median_px)
        otsu = otsu_threshold(smooth, valid)
        classes = class_separation(smooth, otsu, valid)
        distance = dequantize(classes.means[:, 1]) - dequantize(classes.means[:, 0])
        # Contact takes at least a twentieth of the light; two halves of noise lie closer together. Frames that are
        # brighter than the background (another exposure or bit depth) have classes, but no contact.
        apart = (dequantize(classes.means[:, 1]) > 0.05) & (
            distance > torch.maximum(torch.tensor(0.05), 6 * classes.deviations[:, 0] * (1.25 / 255))
        )
        real = smooth > otsu.reshape(-1, 1, 1, 1)
        gross = self.gross(real) & valid
        ridges = median_of_counts(histogram(smooth, gross & real))
        valleys = median_of_counts(histogram(smooth, gross & ~real))
        # Contact without gaps has no valleys: the empty glass stands for them.
        valleys = torch.where(valleys.isfinite(), valleys, classes.means[:, 0])
        return torch.where(apart & otsu.isfinite(), dequantize((ridges + valleys) / 2), torch.nan)

    def _smooth(self, mask: Tensor) -> Tensor:
        """Three box means of side 2 r + 1, zero beyond the frame."""
        side = 2 * self.gross_radius_px + 1
        density = mask.float()
        for _ in range(3):
            density = box_sum(F.pad(density, (self.gross_radius_px,) * 4), side) / side**2
        return density


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
    """Fields at Q places of B frames.

    Attributes:
        displacement: (B, Q, 2), unit of the positions.
        divergence, curl: (B, Q).
        strain: (B, Q, 3) as (exx, eyy, exy).
        divergence_std: (B, Q).
    """

    displacement: Tensor
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
        """(B, N, 2) reference positions and displacements of one unit, variance (B, N) of a component in its square.

        ``queries`` (B, Q, 2) are reference positions too; the points themselves by default.
        """
        fit = local_gradients(reference, displacement, queries, gauge_length=self.gauge_length, variance=variance)
        assert fit.covariance is not None  # a variance was given
        return Fields(
            fit.value,
            divergence(fit.gradient),
            curl(fit.gradient),
            green_lagrange(fit.gradient, self.measure),
            divergence_deviation(fit.covariance),
        )


def _inside(real: Tensor, region: Tensor) -> Tensor:
    """Share (B, 1, 1, 1) of the region that touches."""
    return _mean(real.float(), region).clamp(_LEAST_DENSITY, 1.0)


def _mean(values: Tensor, mask: Tensor) -> Tensor:
    """Mean (B, 1, 1, 1) of the values where the mask holds; 0 where it holds nowhere."""
    return (values * mask).sum((2, 3), keepdim=True) / mask.sum((2, 3), keepdim=True).clamp_min(1)
