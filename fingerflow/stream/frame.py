"""One step of a stream: a camera frame and what is known of the ones before, to contact, points and fields."""

from typing import NamedTuple

import torch
from torch import Tensor, nn

from fingerflow.stream.components import components_first
from fingerflow.stream.contact import ContactStep
from fingerflow.stream.fields import FieldsStep
from fingerflow.stream.finite import finite
from fingerflow.stream.key import Templates
from fingerflow.stream.track import TrackStep


class FrameResult(NamedTuple):
    """Contact (`StreamContact`), tracks (`StreamTracks`) and fields (`StreamFields`) of B frames.

    `deviation` (B, N) px is the standard deviation of a component of the position. `next_prediction` and
    `next_reference` (B, N, 2) go into the next step: where a point was seen last, and where it was when the contact
    reached it.
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
    next_prediction: Tensor
    next_reference: Tensor
    divergence: Tensor
    curl: Tensor
    strain: Tensor
    median_divergence: Tensor


class FrameStep(nn.Module):
    """Contact, tracking, onset and fields in one graph."""

    def __init__(self, contact: ContactStep, track: TrackStep, fields: FieldsStep) -> None:
        super().__init__()
        self.contact = contact
        self.track = track
        self.fields = fields

    def forward(
        self,
        contact_view: Tensor,
        topography_view: Tensor,
        topography_to_contact: Tensor,
        prediction: Tensor,
        reference: Tensor,
        limit: Tensor,
        valid: Tensor,
        templates: Templates,
    ) -> FrameResult:
        """Views (B, 1, H, W), transform (2, 3), prediction and reference (B, N, 2) px of the topography view, limit and
        valid pixels of `BackgroundStep`, and the templates of `KeyStep`."""
        contact = self.contact(contact_view, limit, valid)
        tracks = self.track(topography_view, prediction, templates)
        # Components before points, as in the parts.
        points = components_first(tracks.points)
        kind = points.dtype
        tracked = (tracks.status == 0)[:, None]
        matrix = topography_to_contact.to(kind)
        cell = self.contact.region.cell
        # In cells; a point that is lost lies nowhere near.
        under = matrix[:, :2] @ torch.where(tracked, points, -1e4) + matrix[:, 2:]
        covered = _interpolate(contact.excess, (under - (cell - 1) / 2) / cell) > 0
        earlier = components_first(reference.to(kind))
        arriving = ~finite(earlier) & (covered[:, None] & tracked)
        onset = torch.where(arriving, points, earlier)
        fields = self.fields.of_components(points, onset)
        expected = components_first(prediction.to(kind))
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
            torch.where(tracked, points, expected).transpose(1, 2),
            onset.transpose(1, 2),
            *fields,
        )


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
