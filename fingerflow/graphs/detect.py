"""Detection of corners to track, with a fixed number of tensor operations."""

import math

import torch
from torch import Tensor, nn
from torch.nn import functional

from fingerflow.kernels.detection_limits import BOX, NOISE, QUALITY
from fingerflow.ops.contact.cells import largest_around
from fingerflow.ops.contact.mask_bounds import mask_bounds
from fingerflow.ops.filters.box_sum import box_sum
from fingerflow.ops.filters.noise import estimate_noise, rounding_variance
from fingerflow.ops.full_precision import without_autocast
from fingerflow.ops.tensors import finite

_TINY = 1e-30
_MARGIN = 2 + BOX // 2  # px around a pixel that decide whether its corner response is a local maximum


class DetectGraph(nn.Module):
    """Detector of evenly spread corners: local maxima of the smaller structure-tensor eigenvalue (Shi & Tomasi 1994).

    The strongest corners alone crowd where skin has texture and leave holes in which no field is known. Corners are
    therefore ranked by the side of the largest square in which no other corner is stronger, and by strength among equal
    squares (adaptive non-maximal suppression, Brown, Szeliski & Winder 2005). The corners chosen for a smaller N are
    among those chosen for a larger N.

    Args:
        points: N, the number of corners.
        min_distance_px: side of the square around a corner in which it must be the strongest; half of it is rounded to
            whole px.
        window_px: side of the tracking window, which must lie inside the view.
        precision: dtype of the computation and of the results.
    """

    def __init__(
        self, points: int, min_distance_px: float = 6.0, window_px: int = 25, precision: torch.dtype = torch.float32
    ) -> None:
        super().__init__()
        self.points = points
        self.beside = max(1, round(min_distance_px / 2))
        self.border_px = window_px // 2 + 3
        self.precision = precision

    @without_autocast
    def forward(self, topography_view: Tensor, mask: Tensor) -> tuple[Tensor, Tensor]:
        """Detect corners in a view (B, 1, H, W) inside a bool mask: positions (B, N, 2) px and responses (B, N).

        Corners are sorted by falling response; entries beyond those found are NaN. N is at most H W.
        """
        view = topography_view.to(self.precision)
        height, width = view.shape[-2:]
        noise = estimate_noise(view).square().reshape(-1, 1, 1, 1) + rounding_variance(topography_view)
        edge = min(self.border_px, (min(height, width) - 1) // 2)
        count = min(self.points, height * width)
        # No corner lies outside the mask: crop to the mask and the margin that decides on local maxima.
        (top, bottom), (left, right) = mask_bounds(mask, _MARGIN, count)
        mask = mask[..., top:bottom, left:right]
        response = _response(view[..., top:bottom, left:right])
        above, below = _beyond(edge, height, top, bottom)
        before, behind = _beyond(edge, width, left, right)
        inside = response[..., above : bottom - top - below, before : right - left - behind]
        inside = functional.pad(torch.where(finite(inside), inside, 0.0), (before, behind, above, below))
        # Find maxima before masking: at the edge of the mask any slope would be a maximum.
        inside = torch.where(mask & (inside >= largest_around(inside)), inside, 0.0)
        strongest = inside.amax((2, 3), keepdim=True)
        limit = torch.maximum(QUALITY * strongest, NOISE * noise)
        corners = torch.where(inside > limit, inside, 0.0)
        largest = corners
        for _ in range(self.beside - 1):
            largest = largest_around(largest)
        # Chebyshev distance, px, to the nearest stronger corner beyond the minimum distance.
        alone = torch.zeros_like(corners)
        # Larger squares are not tested: `count` of them do not fit into the view.
        for _ in range(self.beside, max(self.beside + 1, math.isqrt(height * width // count))):
            largest = largest_around(largest)
            alone = alone + (corners >= largest).to(alone.dtype)
        corners = torch.where(alone > 0, corners, 0.0)
        rank = torch.where(corners > 0, alone + corners / strongest.clamp_min(_TINY), 0.0)
        chosen = rank.flatten(1).topk(count, dim=1).indices
        falling = corners.flatten(1).gather(1, chosen).topk(count, dim=1)
        index = chosen.gather(1, falling.indices)
        points = torch.stack((index % (right - left) + left, index // (right - left) + top), dim=2).to(self.precision)
        missing = falling.values <= 0
        return points.masked_fill(missing[..., None], torch.nan), falling.values.masked_fill(missing, torch.nan)


def _beyond(edge: int, length: int, first: int, last: int) -> tuple[int, int]:
    """Return how many pixels of the range [first, last) on an axis of `length` pixels lie within `edge` px of the start
    of the axis, and how many within `edge` px of its end.
    """
    start = min(max(edge - first, 0), last - first)
    return start, min(max(last - (length - edge), 0), last - first - start)


def _response(view: Tensor) -> Tensor:
    """Compute the corner response (B, 1, H, W), the smaller eigenvalue of the structure tensor.

    It is defined as in `ops.tracking.corners.corner_response`. It is 0 where the box, or the pixel around it that the
    gradient needs, reaches beyond the frame.
    """
    smooth_x = (view[..., :-2] + 2 * view[..., 1:-1] + view[..., 2:]) / 4
    smooth_y = (view[..., :-2, :] + 2 * view[..., 1:-1, :] + view[..., 2:, :]) / 4
    x = (smooth_y[..., 2:] - smooth_y[..., :-2]) / 2
    y = (smooth_x[..., 2:, :] - smooth_x[..., :-2, :]) / 2
    xx, xy, yy = (box_sum(product, BOX) / BOX**2 for product in (x * x, x * y, y * y))
    half = (xx - yy) / 2
    smaller = (xx + yy) / 2 - (half * half + xy * xy).sqrt()
    edge = 1 + BOX // 2
    return functional.pad(smaller.clamp_min(0), (edge,) * 4)
