"""Points worth tracking, found without a search."""

import math

import torch
from torch import Tensor, nn
from torch.nn import functional

from fingerflow.kernels.detection_limits import BOX, NOISE, QUALITY
from fingerflow.ops.contact.cells import widest
from fingerflow.ops.contact.mask_bounds import mask_bounds
from fingerflow.ops.filters.box_sum import box_sum
from fingerflow.ops.filters.noise import estimate_noise
from fingerflow.ops.tensors import finite

_TINY = 1e-30
_MARGIN = 2 + BOX // 2  # px beyond a pixel on which it depends whether its response is the largest around


class DetectGraph(nn.Module):
    """Local maxima of the smaller eigenvalue of the structure tensor (Shi & Tomasi 1994), spread evenly.

    The strongest alone crowd where skin has texture, and leave holes in which no field is known. So those are taken
    that have no stronger one in the largest square around them, the stronger first among equals (adaptive non-maximal
    suppression, Brown, Szeliski & Winder 2005). Of fewer points all are among more.

    Args:
        points: N, the number of corners.
        min_distance_px: side of the square in which a corner is the largest at least.
        window_px: side of the window with which the points are tracked: it stays in the view.
    """

    def __init__(
        self, points: int, min_distance_px: float = 6.0, window_px: int = 25, precision: torch.dtype = torch.float32
    ) -> None:
        super().__init__()
        self.points = points
        self.beside = max(1, round(min_distance_px / 2))
        self.border_px = window_px // 2 + 3
        self.precision = precision

    def forward(self, topography_view: Tensor, mask: Tensor) -> tuple[Tensor, Tensor]:
        """(B, 1, H, W) view and bool mask. Returns points (B, N, 2) px, those with the largest response first and
        NaN beyond those that were found, and their response (B, N).
        """
        view = topography_view.to(self.precision)
        height, width = view.shape[-2:]
        noise = estimate_noise(view).square().reshape(-1, 1, 1, 1)
        if not topography_view.is_floating_point():
            noise = noise + 1 / 12  # of rounding
        edge = min(self.border_px, (min(height, width) - 1) // 2)
        count = min(self.points, height * width)
        # Nothing is chosen beyond the mask: there only what decides on a local maximum is looked at.
        (top, bottom), (left, right) = mask_bounds(mask, _MARGIN, count)
        mask = mask[..., top:bottom, left:right]
        response = _response(view[..., top:bottom, left:right])
        above, below = _beyond(edge, height, top, bottom)
        before, behind = _beyond(edge, width, left, right)
        inside = response[..., above : bottom - top - below, before : right - left - behind]
        inside = functional.pad(torch.where(finite(inside), inside, 0.0), (before, behind, above, below))
        # At the mask's edge a slope would be the largest.
        inside = torch.where(mask & (inside >= widest(inside)), inside, 0.0)
        strongest = inside.amax((2, 3), keepdim=True)
        limit = torch.maximum(QUALITY * strongest, NOISE * noise)
        corners = torch.where(inside > limit, inside, 0.0)
        largest = corners
        for _ in range(self.beside - 1):
            largest = widest(largest)
        alone = torch.zeros_like(corners)  # px to a stronger one, less what is asked for at least
        # N squares of a larger side do not fit into the view.
        for _ in range(self.beside, max(self.beside + 1, math.isqrt(height * width // count))):
            largest = widest(largest)
            alone = alone + (corners >= largest).to(alone.dtype)
        corners = torch.where(alone > 0, corners, 0.0)
        rank = torch.where(corners > 0, alone + corners / strongest.clamp_min(_TINY), 0.0)
        chosen = rank.flatten(1).topk(count, dim=1).indices
        falling = corners.flatten(1).gather(1, chosen).topk(count, dim=1)
        place = chosen.gather(1, falling.indices)
        row = (place // (right - left) + top).to(self.precision)
        column = (place % (right - left) + left).to(self.precision)
        missing = falling.values <= 0
        points = torch.stack((column, row), dim=2).masked_fill(missing[..., None], torch.nan)
        return points, falling.values.masked_fill(missing, torch.nan)


def _beyond(edge: int, length: int, first: int, last: int) -> tuple[int, int]:
    """How many of the pixels from `first` to before `last` lie in the edge at the start of an axis, and at its end."""
    start = min(max(edge - first, 0), last - first)
    return start, min(max(last - (length - edge), 0), last - first - start)


def _response(view: Tensor) -> Tensor:
    """Smaller eigenvalue of the structure tensor, (B, 1, H, W), as `ops.corner_response`; 0 at the frame's edge."""
    smooth_x = (view[..., :-2] + 2 * view[..., 1:-1] + view[..., 2:]) / 4
    smooth_y = (view[..., :-2, :] + 2 * view[..., 1:-1, :] + view[..., 2:, :]) / 4
    x = (smooth_y[..., 2:] - smooth_y[..., :-2]) / 2
    y = (smooth_x[..., 2:, :] - smooth_x[..., :-2, :]) / 2
    xx, xy, yy = (box_sum(product, BOX) / BOX**2 for product in (x * x, x * y, y * y))
    half = (xx - yy) / 2
    smaller = (xx + yy) / 2 - (half * half + xy * xy).sqrt()
    edge = 1 + BOX // 2
    return functional.pad(smaller.clamp_min(0), (edge,) * 4)
