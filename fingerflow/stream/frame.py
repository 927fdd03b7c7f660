"""One step of a stream: a camera frame and what is known of the ones before, to contact, points and fields."""

from typing import NamedTuple

import torch
from torch import Tensor, nn

from fingerflow.graphs.contact import ContactGraph
from fingerflow.graphs.fields import SkinFieldsGraph
from fingerflow.ops.cells import covered
from fingerflow.stream.components import components_first
from fingerflow.stream.finite import finite
from fingerflow.stream.key import Templates
from fingerflow.stream.track import TrackStep


class FrameResult(NamedTuple):
    """Contact (`graphs.Contact`) and tracks (`StreamTracks`) of B frames.

    `deviation` (B, N) px is the standard deviation of a component of the position; `covered` (B, N) uint8 says which
    points the gross contact covers, those that are lost where they were expected.
    """

    touching: Tensor
    real_area_px: Tensor
    gross_area_px: Tensor
    center: Tensor
    semi_axes: Tensor
    angle: Tensor
    light_gain: Tensor
    points: Tensor
    error: Tensor
    deviation: Tensor
    status: Tensor
    covered: Tensor


class FrameStep(nn.Module):
    """Contact and tracking in one graph: all of a frame that needs nothing of the frames before but predictions."""

    def __init__(self, contact: ContactGraph, track: TrackStep) -> None:
        super().__init__()
        self.contact = contact
        self.track = track

    def forward(
        self,
        contact_view: Tensor,
        topography_view: Tensor,
        topography_to_contact: Tensor,
        prediction: Tensor,
        light: Tensor,
        black: Tensor,
        limit: Tensor,
        templates: Templates,
    ) -> FrameResult:
        """Views (B, 1, H, W), transform (2, 3), prediction (B, N, 2) px of the topography view, the `Light` of
        `LightGraph`, and the templates of `KeyStep`."""
        contact = self.contact(contact_view, light, black, limit)
        tracks = self.track(topography_view, prediction, templates)
        # Components before points, as in the parts.
        place = torch.where((tracks.status == 0)[..., None], tracks.points, prediction.to(tracks.points.dtype))
        known = components_first(torch.where(finite(place), place, -1e4))  # a point that is none lies nowhere near
        matrix = topography_to_contact.to(place.dtype)
        under = matrix[:, :2] @ known + matrix[:, 2:]
        touches = covered(contact.excess, under[:, 0], under[:, 1], self.contact.cell_px)
        variance = (tracks.covariance[..., 0, 0] + tracks.covariance[..., 1, 1]) / 2
        return FrameResult(
            contact.touching,
            contact.real_area_px,
            contact.gross_area_px,
            contact.center,
            contact.semi_axes,
            contact.angle,
            contact.light_gain,
            tracks.points,
            tracks.error,
            variance.sqrt(),
            tracks.status,
            touches.to(torch.uint8),
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
