"""Module that computes, without the host, all that a recording needs of its points in several frames."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor, nn

from fingerflow.engines.check import BuiltIn
from fingerflow.engines.engine import Engine, TracksWhole
from fingerflow.errors import FingerflowError
from fingerflow.graphs import AgreementGraph, DeformationGraph
from fingerflow.graphs.track import Deformed
from fingerflow.kernels.tracking_limits import MISMATCH_SHARE, ROUNDS, TrackStatus
from fingerflow.ops.filters.noise import rounding_variance
from fingerflow.ops.tracking.outliers import Neighbours
from fingerflow.ops.tracking.templates import Found, Templates

_TURNS = 6  # calls of the check: the first two are not captured
_APART = 0.01  # px, largest difference of a position from that of single calls
_KNOWN = 0.5  # least share of the points tracked in the built-in frames that must not be outliers


class TrackedPoints(NamedTuple):
    """Points tracked through K frames of B recordings; frames are in the order in which frame k of recording b is the
    k B + b th.

    Attributes:
        found: of the registration, (K B, N, ...).
        place, speed: (B, N, 2) px, px a frame, after the last frame of each recording.
        deformed: the same points without outliers, corrected for the deformation of the skin.
    """

    found: Found
    place: Tensor
    speed: Tensor
    deformed: Deformed


class PointsGraph(nn.Module):
    """Module that tracks points through frames by a kernel of Triton, marks the outliers among them, and corrects their
    positions for the deformation of the skin.

    The steps between, which the host does otherwise, are masks.
    """

    def __init__(self, window: int, forward_backward_limit: float) -> None:
        super().__init__()
        self.forward_backward_limit = forward_backward_limit
        self.agreement, self.deformation = AgreementGraph(), DeformationGraph(window)

    def forward(
        self,
        templates: Templates,
        views: Tensor,
        place: Tensor,
        speed: Tensor,
        lengths: Tensor,
        neighbours: Neighbours,
        start: Tensor,
        inverse_warp: Tensor,
    ) -> TrackedPoints:
        """Track the templates of (B, N) points through views (K B, 1, H, W), from their positions `place` and speeds
        `speed` (B, N, 2) before the first frame.

        `lengths` (B,) int32 are the numbers of frames of the recordings. `start` (B, N, 2), `neighbours` and
        `inverse_warp` (B, N, 2, 2) are as for `AgreementGraph` and `DeformationGraph`.
        """
        from fingerflow.kernels.tensors import fused_tracking  # imported here, as it needs Triton

        limits = rounding_variance(views), self.forward_backward_limit, MISMATCH_SHARE
        followed = fused_tracking.find_templates(templates, views, place, speed, None, ROUNDS, *limits, lengths)
        *of_frames, place, speed = followed
        found = Found(*(one.flatten(0, 1) for one in of_frames))
        deformed = self.judge_and_correct(found, neighbours, start, templates.numbers, inverse_warp)
        return TrackedPoints(found, place, speed, deformed)

    def judge_and_correct(
        self, found: Found, neighbours: Neighbours, start: Tensor, numbers: Tensor, inverse_warp: Tensor
    ) -> Deformed:
        """Reject the outliers among points found in K B frames, (K B, N, ...), and correct the positions of the others;
        the other tensors, (B, N, ...), are those of the B recordings.
        """
        # Those of a single recording hold for all of its frames.
        each = len(found.status) // len(start) if len(start) > 1 else 1
        starts, number, inverse, *near = (
            one if each == 1 else one.repeat(each, *[1] * (one.ndim - 1))
            for one in (start, numbers, inverse_warp, *neighbours)
        )
        judged = self._without_outliers(found, Neighbours(*near), starts)
        deformed: Deformed = self.deformation(starts, judged, number, inverse)
        return deformed

    def _without_outliers(self, found: Found, neighbours: Neighbours, start: Tensor) -> Found:
        """Return the points found with the outliers among them rejected, as `tracker.points` does on the host."""
        off_neighbours, uncertain = self.agreement(neighbours, start, found.points, found.variance.sqrt())
        tracked, status = found.status == TrackStatus.TRACKED, found.status
        for which, of in ((uncertain, TrackStatus.UNCERTAIN), (off_neighbours, TrackStatus.OFF_NEIGHBOURS)):
            status = torch.where(tracked & which, int(of), status)
        wrong = status != found.status
        return found._replace(
            points=torch.where(wrong[..., None], torch.nan, found.points),
            covariance=torch.where(wrong[..., None, None], torch.nan, found.covariance),
            status=status,
        )


def check_track(engine: Engine, frame: BuiltIn) -> None:
    """Check, in two built-in frames in turns, that an engine that tracks and corrects points in one call gives in each
    the positions that single calls give.

    Raises:
        FingerflowError: it does not.
    """
    if not isinstance(engine, TracksWhole):
        return
    templates = engine.prepare(engine.key(engine.images(frame.key[None])), frame.points)
    still, straight = np.zeros_like(frame.points), np.tile(np.eye(2, dtype=np.float32), (len(frame.points), 1, 1))
    neighbours = engine.neighbours(frame.points)
    for turn in range(_TURNS):
        shown, place = (frame.topography, frame.expected) if turn % 2 else (frame.key, frame.points)
        given = templates, engine.images(shown[None]), place, still
        tracked = engine.track(*given, neighbours, frame.points, straight)
        if tracked.corrected is None:
            return
        found = engine.follow(*given).found
        corrected = engine.correct(frame.points, found, templates.numbers, straight).found
        pairs = ((tracked.followed.found, found, 1.0), (tracked.corrected.found, corrected, _KNOWN))
        for ours, theirs, share in pairs:
            known = np.isfinite(theirs.points)
            apart = np.abs(ours.points - theirs.points)[known]
            most = np.nan_to_num(apart).max(initial=0.0)
            if np.isfinite(apart).sum() < share * len(apart) or most > _APART:
                raise FingerflowError(
                    f"engine {engine.described}: points of a frame that are tracked and corrected in one call are "
                    f"unknown, or up to {most:.2g} px off those of single calls"
                )
