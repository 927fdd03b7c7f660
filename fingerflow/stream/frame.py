"""One step of a stream: a camera frame and what is known of the ones before, to contact, points and fields."""

from typing import NamedTuple

import torch
from torch import Tensor, nn

from fingerflow.stream.contact import ContactStep
from fingerflow.stream.fields import FieldsStep
from fingerflow.stream.finite import finite
from fingerflow.stream.key import Templates
from fingerflow.stream.region import CELL
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
        matrix = topography_to_contact.to(tracks.points.dtype)
        seen = torch.where(finite(tracks.points), tracks.points, -1e4)
        under = seen @ matrix[:, :2].T + matrix[:, 2]
        covered = _interpolate(contact.excess, (under - (CELL - 1) / 2) / CELL) > 0
        arriving = ~finite(reference) & (covered & finite(tracks.points).all(-1))[..., None]
        next_reference = torch.where(arriving, tracks.points, reference.to(tracks.points.dtype))
        fields = self.fields(tracks.points, next_reference)
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
            torch.where(finite(tracks.points), tracks.points, prediction.to(tracks.points.dtype)),
            next_reference,
            *fields,
        )


def _interpolate(cells: Tensor, place: Tensor) -> Tensor:
    """Bilinear (B, N) of cells (B, 1, h, w) at (B, N, 2); the nearest cell's beyond the middle of the outermost."""
    height, width = cells.shape[-2:]
    x, y = place[..., 0].clamp(0, width - 1), place[..., 1].clamp(0, height - 1)
    left, top = x.floor().clamp(max=width - 2), y.floor().clamp(max=height - 2)
    flat = cells.flatten(1)
    first = (top * width + left).to(torch.int64)
    right, down = x - left, y - top
    upper = flat.gather(1, first) * (1 - right) + flat.gather(1, first + 1) * right
    lower = flat.gather(1, first + width) * (1 - right) + flat.gather(1, first + width + 1) * right
    return upper * (1 - down) + lower * down
