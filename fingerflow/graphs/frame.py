"""Modules of a stream: what the key frame says of its points, one frame, and the fields that follow."""

from typing import NamedTuple

import torch
from torch import Tensor, nn

from fingerflow.graphs.contact import ContactGraph
from fingerflow.graphs.fields import Entered, FieldsGraph, GrossEllipse
from fingerflow.graphs.key import KeyGraph
from fingerflow.graphs.track import RENEWAL_PX, DeformationGraph, TrackGraph
from fingerflow.ops.cells import covered
from fingerflow.ops.entry import MOVED_IN, entries, since_entry
from fingerflow.ops.looking import looks
from fingerflow.ops.noise import estimate_noise
from fingerflow.ops.onset import touch_length
from fingerflow.ops.plane_fit import Support
from fingerflow.ops.templates import Templates, inverse_2x2, renew_templates, renewable


class Prepared(NamedTuple):
    """`Templates` of (B, N) points, and the inverse (B, N, 2, 2) of the deformation with which they were prepared."""

    template_start: Tensor
    template_samples: Tensor
    template_table: Tensor
    template_numbers: Tensor
    steepest_descent_images: Tensor | None
    template_inverse_warp: Tensor

    @classmethod
    def of(cls, templates: Templates, inverse_warp: Tensor) -> "Prepared":
        """Those of `ops.templates`."""
        return cls(*templates, inverse_warp)

    def templates(self) -> Templates:
        """Those of `ops.templates`."""
        return Templates(*self[:5])


class Held(NamedTuple):
    """What a frame needs to know of the key frame: the templates, and the `Support` of their neighbours, (B, N, N)."""

    prepared: Prepared
    neighbours_weights: Tensor | None
    neighbours_within: Tensor | None


COMPILED_DO_WITHOUT = ("steepest_descent_images", "neighbours_weights", "neighbours_within")  # of `Held`: None there


class KeyView(NamedTuple):
    """What is needed of the key frame to prepare templates anew: `ops.templates.renewable` of it (B, 1, H, W), and its
    noise (B,).
    """

    key_image: Tensor
    key_noise: Tensor


class HeldGraph(nn.Module):
    """A key frame and its points to all that the frames to come need to know of them."""

    def __init__(self, key: KeyGraph, deformation: DeformationGraph) -> None:
        super().__init__()
        self.key = key
        self.deformation = deformation

    def forward(self, topography_view: Tensor, points: Tensor) -> tuple[Held, KeyView]:
        """(B, 1, H, W), and (B, N, 2) px, NaN where there is none."""
        noise = estimate_noise(topography_view)
        templates = self.key(topography_view, points, noise)
        kind = templates.samples.dtype
        straight = torch.eye(2, dtype=kind, device=points.device).expand(*points.shape, 2)
        support = self.deformation.support(templates.start) or (None, None)
        return Held(Prepared.of(templates, straight), *support), KeyView(renewable(topography_view), noise.to(kind))


class RenewGraph(nn.Module):
    """Templates of some points prepared anew for the deformation of the skin since the key frame; settings as those of
    `KeyGraph`.
    """

    def __init__(self, window: int = 25, gain_offset: bool = True) -> None:
        super().__init__()
        self.window = window
        self.gain_offset = gain_offset

    def forward(self, key_image: Tensor, key_noise: Tensor, points: Tensor, warp: Tensor) -> Prepared:
        """`KeyView`, (B, N, 2) px and the deformation gradient (B, N, 2, 2)."""
        templates = renew_templates(key_image, key_noise, points, self.window, warp, gain_offset=self.gain_offset)
        return Prepared.of(templates, inverse_2x2(warp.to(templates.samples.dtype)))


class Followed(NamedTuple):
    """Positions `points` (B, N, 2) px of the topography view and their standard deviation a component (B, N) px, NaN
    where lost; forward-backward `error` (B, N) px; `status` (B, N) uint8 (`TrackStatus`). `warp` (B, N, 2, 2) is the
    deformation gradient since the key frame, and `stale` (B, N) uint8 says which templates are to be prepared anew with
    it. Where to look for a point that is lost: `estimate` (B, N, 2) px is where the look at it has led, `by_neighbours`
    (B, N, 2) px where its neighbours expect it, NaN where too few are known.
    """

    points: Tensor
    error: Tensor
    position_std: Tensor
    status: Tensor
    warp: Tensor
    stale: Tensor
    estimate: Tensor
    by_neighbours: Tensor


class FollowGraph(nn.Module):
    """Points of a key frame in one frame, corrected for the deformation that their templates do not know."""

    def __init__(self, window: int = 25, forward_backward_limit: float = 1.0) -> None:
        super().__init__()
        self.track = TrackGraph(forward_backward_limit)
        self.deformation = DeformationGraph(window)

    def forward(self, topography_view: Tensor, prediction: Tensor, held: Held) -> Followed:
        """(B, 1, H, W), (B, N, 2) px, and what `HeldGraph` gave."""
        templates, inverse_warp = held.prepared.templates(), held.prepared.template_inverse_warp
        weights, within = held.neighbours_weights, held.neighbours_within
        support = None if weights is None or within is None else Support(weights, within)
        found = self.track(templates, topography_view, prediction)
        deformed = self.deformation(templates.start, found, templates.numbers, inverse_warp, support)
        stale = (deformed.shift > RENEWAL_PX).to(torch.uint8)
        found = deformed.found
        whither = (found.estimate, deformed.expected)
        return Followed(found.points, found.error, found.variance.sqrt(), found.status, deformed.warp, stale, *whither)


class FrameResult(NamedTuple):
    """Contact (`graphs.Contact`) and points (`Followed`) of B frames. `covered` (B, N) uint8 says which points the
    gross contact covers, those that are lost where they were expected.
    """

    real_contact_mask: Tensor
    real_area_px: Tensor
    gross_area_px: Tensor
    center: Tensor
    semi_axes: Tensor
    angle: Tensor
    light_gain: Tensor
    points: Tensor
    error: Tensor
    position_std: Tensor
    status: Tensor
    warp: Tensor
    stale: Tensor
    estimate: Tensor
    by_neighbours: Tensor
    covered: Tensor


class FrameGraph(nn.Module):
    """Contact and points of one frame: all that needs nothing of the frames before but predictions."""

    def __init__(self, contact: ContactGraph, follow: FollowGraph) -> None:
        super().__init__()
        self.contact = contact
        self.follow = follow

    def forward(
        self,
        contact_view: Tensor,
        topography_view: Tensor,
        topography_to_contact: Tensor,
        prediction: Tensor,
        light: Tensor,
        black: Tensor,
        limit: Tensor,
        held: Held,
    ) -> FrameResult:
        """Views (B, 1, H, W), transform (2, 3), prediction (B, N, 2) px of the topography view, `Light`, and what
        `HeldGraph` gave.
        """
        contact = self.contact(contact_view, light, black, limit)
        followed = self.follow(topography_view, prediction, held)
        place = torch.where((followed.status == 0)[..., None], followed.points, prediction)
        matrix = topography_to_contact.to(place.dtype)
        x, y = (place @ matrix[:, :2].T + matrix[:, 2]).unbind(-1)
        touches = covered(contact.density_margin, x, y, self.contact.cell_px)
        shown = {name: value for name, value in contact._asdict().items() if name in FrameResult._fields}
        return FrameResult(**shown, **followed._asdict(), covered=touches.to(torch.uint8))


class SinceOnset(NamedTuple):
    """Fields of B frames since the onset of contact of each point, and what the next frame needs to know.

    `next_reference` (B, N, 2) px, where a point was when the contact reached it, NaN where that is not known;
    `next_reached` (B, N) uint8, for how many frames in a row the contact has covered it; `LASTING` once it did for so
    many; `next_entry` (B, N) uint8 of `ops.entry.entries`; `next_at_entry` (B, N, 2, 2), the gradient of the
    displacement since the choice of points, by the places then, when the contact reached a point. `moved_in` (B, N)
    uint8 is 1 for points that came into contact by moving into it.
    """

    next_reference: Tensor
    next_reached: Tensor
    next_entry: Tensor
    next_at_entry: Tensor
    moved_in: Tensor
    divergence: Tensor
    curl: Tensor
    strain: Tensor
    median_divergence: Tensor


class SinceOnsetGraph(nn.Module):
    """Onset of contact of each point, and the fields that count from there, on the glass.

    A point that is lost when the contact reaches it has no known place of onset: a later one would be taken for it.
    Points that move into the contact (`ops.entry`) have the fields since their own entry, by the places where all
    points were chosen (`ops.entry.since_entry`), and are no part of those of others: displacements from onsets so far
    apart in time have no gradient. Medians are of both.
    """

    def __init__(self, gauge_length_mm: float = 1.6) -> None:
        super().__init__()
        self.gauge_length_mm = gauge_length_mm
        self.fields = FieldsGraph(gauge_length_mm)

    def forward(
        self,
        points: Tensor,
        covered: Tensor,
        reference: Tensor,
        reached: Tensor,
        entry: Tensor,
        at_entry: Tensor,
        chosen: Tensor,
        topography_to_contact: Tensor,
        mm_per_px: Tensor,
        center: Tensor,
        semi_axes: Tensor,
        angle: Tensor,
    ) -> SinceOnset:
        """Points, covered and the ellipse of the gross contact of `FrameGraph`; reference, reached, entry and at_entry
        as the frame before gave them, NaN and 0 in the first; chosen (B, N, 2) px, where points were chosen, NaN for
        none; transform (2, 3), scale (1,) of the contact view.
        """
        kind = points.dtype
        before = reached.to(kind)
        lasts = touch_length(before, covered)[..., None]
        onset = torch.where(lasts == 1, points, torch.where(lasts > 0, reference, torch.nan))
        scale = mm_per_px.to(kind)
        turn = topography_to_contact[:, :2].to(kind) * scale
        # Displacements by themselves: of two positions on the glass the digits would be lost.
        moved, then = (points - onset) @ turn.T, onset @ turn.T
        entered = entries(entry, points @ turn.T, moved.square().sum(-1).sqrt(), lasts[..., 0], self.gauge_length_mm)
        moved_in = entered == MOVED_IN
        since, at_entry = since_entry(
            at_entry, chosen @ turn.T, (points - chosen) @ turn.T, lasts[..., 0] == 1, moved_in, self.gauge_length_mm
        )
        middle = (center.to(kind) - topography_to_contact[:, 2].to(kind)) * scale
        ellipse = GrossEllipse(middle, semi_axes.to(kind) * scale, angle.to(kind))
        some = None if looks(points) and not moved_in.any() else Entered(moved_in, since, None)
        fields = self.fields(then, moved, None, ellipse, some)
        assert fields.median is not None
        return SinceOnset(
            onset,
            lasts[..., 0].to(torch.uint8),
            entered,
            at_entry,
            moved_in.to(torch.uint8),
            fields.divergence,
            fields.curl,
            fields.strain,
            fields.median[:, 0],
        )
