"""Templates followed from frame to frame, each frame expected where the speed of its points leads."""

from collections.abc import Callable
from typing import NamedTuple

import torch
from torch import Tensor

from fingerflow import kernels
from fingerflow.ops import tracking_limits as limits
from fingerflow.ops.templates import ROUNDING, Found, Templates, compiled, further_rounds
from fingerflow.ops.tracking_limits import TrackStatus


class Followed(NamedTuple):
    """Points of one recording in K frames.

    Attributes:
        found: :class:`~fingerflow.ops.templates.Found` of (K, N, ...).
        place, speed: (1, N, 2) px and px a frame after the last frame: from them the next one goes on.
    """

    found: Found
    place: Tensor
    speed: Tensor


def follow_templates(
    find: Callable[[Templates, Tensor, Tensor], Found],
    templates: Templates,
    frames: Tensor,
    place: Tensor,
    speed: Tensor,
    *,
    rounds: int,
    forward_backward_limit: float = 1.0,
    mismatch_limit: float = limits.MISMATCH_SHARE,
) -> Followed:
    """Finds the templates of N points (B = 1) in K frames, one after the other.

    A point is expected at its place and on at its speed. The speed is the mean of the displacements seen, the latest
    with half the weight: that of two positions alone would carry their noise on. A point that is lost is expected on
    where its speed leads, for some four frames.

    Args:
        find: `find_templates` with these limits, or what does the same, of templates, image and predictions; it is not
            called for templates that the compiled twin has prepared, where that twin does all in one call.
        frames: (K, 1, H, W).
        place, speed: (1, N, 2) px, px a frame, in the frame before the first.
        rounds, forward_backward_limit, mismatch_limit: as for `find_templates`.
    """
    if templates.pixels is None and compiled(templates, frames, place, speed):
        rounding = 0.0 if frames.is_floating_point() else ROUNDING
        settings = (rounds, rounding, forward_backward_limit, mismatch_limit)
        followed = kernels.find_templates(templates[:4], frames, place, speed, None, *settings)
        return Followed(Found(*[one[:, 0] for one in followed[:5]]), followed.place, followed.speed)
    every = []
    seen = torch.ones_like(place[..., :1], dtype=torch.bool)
    for frame in frames.split(1):

        def look(some: Templates, near: Tensor, frame: Tensor = frame) -> Found:
            return find(some, frame, near)

        guess = place + speed
        found = further_rounds(look, templates, look(templates, guess), guess, rounds)
        every.append(found)
        place, speed, seen = expected(place, speed, seen, found)
    return Followed(Found.joined(every), place, speed)


def expected(place: Tensor, speed: Tensor, seen: Tensor, found: Found) -> tuple[Tensor, Tensor, Tensor]:
    """Place, speed (1, N, 2) and whether a point is seen (1, N, 1) after a frame."""
    tracked = (found.status == TrackStatus.TRACKED)[..., None]
    # One that was lost may be found beside where it was expected, which is no motion.
    faster = torch.where(tracked & seen, limits.SPEED_WEIGHT * (found.estimate - place - speed), 0.0)
    lasting = torch.where(tracked, 1.0, 1 - 1 / limits.SPEED_FRAMES)
    return torch.where(tracked, found.estimate, place + speed), speed * lasting + faster, tracked
