"""One step of a stream: a camera frame and what is known of the ones before, to contact, points and fields."""

from typing import NamedTuple

import torch
from torch import Tensor, nn

from fingerflow.graphs.fields import SkinFieldsGraph
from fingerflow.stream.components import components_first
from fingerflow.stream.contact import ContactStep
from fingerflow.stream.finite import finite
from fingerflow.stream.key import Templates
from fingerflow.stream.track import TrackStep


class FrameResult(NamedTuple):
    """Contact (`StreamContact`) and tracks (`StreamTracks`) of B frames.

    `deviation` (B, N) px is the standard deviation of a component of the position; `covered` (B, N) uint8 says which
    points the gross contact covers, those that are lost where they were expected.
    """

    touching: Tensor
    real_area_px: Tensor
    gross_area_px: Tensor
    center: Tensor
    semi_axes: Tensor
    angle: Tensor
    points: Tensor
    error: Tensor
    deviation: Tensor
    status: Tensor
    covered: Tensor


class FrameStep(nn.Module):
    """Contact and tracking in one graph: all of a frame that needs nothing of the frames before but predictions."""

    def __init__(self, contact: ContactStep, track: TrackStep) -> None:
        super().__init__()
        self.contact = contact
        self.track = track

    def forward(
        self,
        contact_view: Tensor,
        topography_view: Tensor,
        topography_to_contact: Tensor,
        prediction: Tensor,
        limit: Tensor,
        valid: Tensor,
        templates: Templates,
    ) -> FrameResult:
        """Views (B, 1, H, W), transform (2, 3), prediction (B, N, 2) px of the topography view, limit and valid pixels
        of `BackgroundStep`, and the templates of `KeyStep`."""
        contact = self.contact(contact_view, limit, valid)
        tracks = self.track(topography_view, prediction, templates)
        # Components before points, as in the parts.
        place = torch.where((tracks.status == 0)[..., None], tracks.points, prediction.to(tracks.points.dtype))
        known = components_first(torch.where(finite(place), place, -1e4))  # a point that is none lies nowhere near
        matrix = topography_to_contact.to(place.dtype)
        cell = self.contact.region.cell
        under = matrix[:, :2] @ known + matrix[:, 2:]
        covered = _interpolate(contact.excess, (under - (cell - 1) / 2) / cell) > 0
        variance = (tracks.covariance[..., 0, 0] + tracks.covariance[..., 1, 1]) / 2
        return FrameResult(
            contact.touching,
            contact.real_area_px,
            contact.gross_area_px,
            contact.center,
            contact.semi_axes,
            contact.angle,
            tracks.points,
            tracks.error,
            variance.sqrt(),
            tracks.status,
            covered.to(torch.uint8),
        )


class SinceOnsetResult(NamedTuple):
    """Fields (`SkinFields`), and what the next frame needs to know: `next_reference` (B, N, 2) px, where a point was
    when the contact reached it, NaN where that is not known, and `next_reached` (B, N) uint8, whether it ever did."""

    next_reference: Tensor
    next_reached: Tensor
    divergence: Tensor
    curl: Tensor
    strain: Tensor
    median_divergence: Tensor


class SinceOnsetStep(nn.Module):
    """Onset of contact of each point, and the fields that count from there.

    A point that is lost when the contact reaches it has no known place of onset: a later one would be taken for it.
    """

    def __init__(self, fields: SkinFieldsGraph) -> None:
        super().__init__()
        self.fields = fields

    def forward(
        self,
        points: Tensor,
        covered: Tensor,
        reference: Tensor,
        reached: Tensor,
        topography_to_contact: Tensor,
        center: Tensor,
        semi_axes: Tensor,
        angle: Tensor,
    ) -> SinceOnsetResult:
        """Points (B, N, 2) px, NaN where lost, those that the contact covers (B, N) and its ellipse (`FrameResult`);
        reference and reached as the frame before gave them, NaN and 0 in the first."""
        now, then = (one.to(self.fields.precision) for one in (points, reference))
        arriving = torch.minimum(covered, 1 - reached)
        onset = torch.where(arriving[..., None] > 0, now, then)
        fields = self.fields(now, onset, topography_to_contact, center, semi_axes, angle)
        return SinceOnsetResult(onset, torch.maximum(reached, covered), *fields)


def _interpolate(cells: Tensor, place: Tensor) -> Tensor:
    """Bilinear (B, N) of cells (B, 1, h, w) at (B, 2, N); the nearest cell's beyond the middle of the outermost."""
    height, width = cells.shape[-2:]
    x, y = place[:, 0].clamp(0, width - 1), place[:, 1].clamp(0, height - 1)
    left, top = x.floor().clamp(max=width - 2), y.floor().clamp(max=height - 2)
    first = (top * width + left)[:, None].to(torch.int64)
    corners = torch.tensor([[0], [1], [width], [width + 1]], device=cells.device)
    values = cells.flatten(1).gather(1, (first + corners).flatten(1)).unflatten(1, (4, -1))
    right, down = (x - left)[:, None], (y - top)[:, None]
    upper_lower = values[:, ::2] * (1 - right) + values[:, 1::2] * right
    return upper_lower[:, 0] * (1 - down[:, 0]) + upper_lower[:, 1] * down[:, 0]
