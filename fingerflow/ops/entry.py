"""How skin comes into contact, covered by a contact that grows or moving in over its border, and its gradient since."""

import torch
from torch import Tensor

from fingerflow.ops.local_fit import local_gradients
from fingerflow.ops.looking import looks
from fingerflow.ops.point_gradients import point_gradients
from fingerflow.ops.tensors import finite, sum_rows

#: Gauge lengths by which skin that touches has moved where its neighbours move in: a contact that grows over skin is
#: faster.
MOVED = 1 / 8
#: Gauge lengths within which points are neighbours.
NEAR = 1 / 2
_AT_FIRST, MOVED_IN = 0, 2  # of `entries`; 1 for what came later over skin
_LEAST_VOTES = 2


def entries(before: Tensor, place: Tensor, moved: Tensor, length: Tensor, gauge_length: float) -> Tensor:
    """How each point has come into contact, frame after frame.

    A point has moved in where, as it begins to touch, the neighbours that touch already have moved by more than `MOVED`
    since they did, in the median. And so has one that began to touch after the first, at any time, once most of its
    neighbours of which that is so have: skin enters along a stretch of the border, slowly at first. Counted from its
    own onset such a point lies beside others that count from long before, and a fit over both shows no strain but how
    far these have moved.

    `stages.entered_skin` knows where each point was before, and tells it by the ways of border and point; a slide of 72
    frames has the same to a tenth of the points by both.

    Args:
        before: (B, N) what the frame before gave, 0 in the first.
        place: (B, N, 2) L now, NaN where a point is lost.
        moved: (B, N) L, how far it is from where it began to touch; NaN where that is not known.
        length: (B, N) of `touch_length` in this frame.
        gauge_length: L, of the fits.

    Returns:
        (B, N) uint8, `MOVED_IN` where it has moved in; 0 or 1 else.
    """
    begins, touches = length == 1, length > 0
    touched = touches & ~begins
    later = (begins & touched.any(1, keepdim=True)) | ((before > _AT_FIRST) & touched)
    entered = (before == MOVED_IN) & touched
    known = finite(sum_rows(place.mT))[:, 0]
    some = looks(place, moved)
    if not some or begins.any():
        # NaN, of a point whose onset is not known, is on neither side.
        far, near = (touched & known & one for one in (moved > MOVED * gauge_length, moved <= MOVED * gauge_length))
        asked = begins & known
        entered = entered | (asked & _are_most(asked, far, near, place, gauge_length, 1, some))
    if not some or entered.any():
        asked = later & known & ~entered
        entered = entered | (asked & _are_most(asked, entered & known, asked, place, gauge_length, _LEAST_VOTES, some))
    kind = place.dtype  # ONNX Runtime adds no uint8
    return (later.to(kind) + entered.to(kind)).to(torch.uint8)  # what has moved in came later


def since_entry(
    at_entry: Tensor, chosen: Tensor, moved: Tensor, begins: Tensor, entered: Tensor, gauge_length: float
) -> tuple[Tensor, Tensor]:
    """Gradient of the displacement of each point since its own entry, its neighbours counted from that moment.

    With F = I + G the gradient of position by the place where points were chosen, all in one frame, it is
    F(t) F(entry)^-1 - I = (G(t) - G(entry)) F(entry)^-1: it does not depend on what frame that is.
    `stages.entered_skin.EntryGradients` has the same of a recording.

    Args:
        at_entry: (B, N, 2, 2) what the frame before gave, NaN in the first.
        chosen: (B, N, 2) L, where points were chosen; NaN for none.
        moved: (B, N, 2) L, the displacement since then; NaN where a point is lost.
        begins: (B, N) bool, whether it begins to touch in this frame.
        entered: (B, N) bool, of which points it is asked.
        gauge_length: L, of the fits.

    Returns:
        (B, N, 2, 2), NaN where it is not known or nobody asked, and `at_entry` for the next frame.
    """
    some = looks(chosen, moved)
    unknown = torch.full_like(at_entry, torch.nan)
    if some:
        rows = (begins | entered).any(0).nonzero()[:, 0]
        if not len(rows):
            return unknown, at_entry
        fit = local_gradients(chosen, moved, chosen[:, rows], gauge_length=gauge_length)
        now = unknown.index_copy(1, rows, torch.where(finite(moved[:, rows])[..., None], fit.gradient, torch.nan))
    else:
        now, _ = point_gradients(chosen, moved, gauge_length)
    at_entry = torch.where(begins[..., None, None], now, at_entry)
    if some and not entered.any():
        return unknown, at_entry
    return torch.where(entered[..., None, None], _since(at_entry, now), unknown), at_entry


def _since(before: Tensor, now: Tensor) -> Tensor:
    """(I + now) (I + before)^-1 - I of gradients (B, N, 2, 2), with no digits lost; NaN passes."""
    # Components before points: runtimes are slow where the last axis is short.
    gone = before.flatten(2).mT
    xx, xy, yx, yy = gone.split(1, dim=1)
    ux, uy, vx, vy = (now.flatten(2).mT - gone).split(1, dim=1)
    first, last = 1 + xx, 1 + yy
    rows = (ux * last - uy * yx, uy * first - ux * xy, vx * last - vy * yx, vy * first - vx * xy)
    result: Tensor = (torch.cat(rows, dim=1) / (first * last - xy * yx)).mT.unflatten(2, (2, 2))
    return result


def _are_most(
    asked: Tensor, those: Tensor, others: Tensor, place: Tensor, gauge_length: float, least: int, some: bool
) -> Tensor:
    """(B, N) whether at least so many, and most, of the neighbours that are `those` or `others`, all of them known, are
    `those`; where a point is not asked about, or with `some` of no frame, anything.
    """
    rows = asked.any(0).nonzero()[:, 0] if some else slice(None)
    columns = torch.stack((those, others), dim=-1).to(place.dtype)
    known = (those | others | asked)[..., None]
    middle = torch.where(known, place, 0.0).sum(1, keepdim=True) / known.sum(1, keepdim=True).clamp_min(1)
    here = torch.where(known, place - middle, 0.0)  # so that the digits of distances are not lost
    square = here.square().sum(-1)
    apart = square[:, rows, None] + square[:, None] - 2 * (here[:, rows] @ here.mT)
    beside = (apart < (NEAR * gauge_length) ** 2).to(place.dtype)
    more, less = (beside @ columns - columns[:, rows]).unbind(-1)
    most = (more >= least) & (more > less)
    if not some:
        return most
    result = torch.zeros_like(asked)
    result[:, rows] = most
    return result
