"""Points worth tracking, found without a search."""

import torch
from torch import Tensor, nn
from torch.nn import functional

from fingerflow.ops.noise import estimate_noise

_BOX = 5  # px, of the structure tensor: a corner must be local (as `stages.tracking` has it)
_QUALITY = 0.01  # least share of the strongest response
_NOISE = 12 / 64 * (1 + 18 / _BOX)  # response of pure noise of variance 1 that no window reaches (`ops.corners`)


class DetectGraph(nn.Module):
    """The strongest local maxima of the smaller eigenvalue of the structure tensor (Shi & Tomasi 1994).

    `ops.detect_corners` takes the strongest first and drops what lies too near, one after the other. Here a corner is
    the largest of a square around it, of a side of that distance: half as far apart where they crowd, and as far on
    average.

    Args:
        points: N, the number of corners.
        min_distance_px: side of that square.
        border_px: without corners, at each side.
    """

    def __init__(
        self, points: int, min_distance_px: float = 6.0, border_px: int = 13, precision: torch.dtype = torch.float32
    ) -> None:
        super().__init__()
        self.points = points
        self.beside = max(1, round(min_distance_px / 2))
        self.border_px = border_px
        self.precision = precision

    def forward(self, topography_view: Tensor, mask: Tensor) -> tuple[Tensor, Tensor]:
        """(B, 1, H, W) view and bool mask. Returns points (B, N, 2) px, NaN beyond those that were found, and their
        response (B, N)."""
        view = topography_view.to(self.precision)
        height, width = view.shape[-2:]
        response = _response(view)
        noise = estimate_noise(view).square().reshape(-1, 1, 1, 1)
        if not topography_view.is_floating_point():
            noise = noise + 1 / 12  # of rounding
        edge = self.border_px
        inside = functional.pad(response[..., edge : height - edge, edge : width - edge], (edge,) * 4)
        inside = torch.where(mask, inside, 0.0)
        limit = torch.maximum(_QUALITY * inside.amax((2, 3), keepdim=True), _NOISE * noise)
        largest = functional.max_pool2d(inside, 2 * self.beside + 1, 1, self.beside)
        corner = torch.where((inside >= largest) & (inside > limit), inside, 0.0)
        strongest = corner.flatten(1).topk(self.points, dim=1)
        row = (strongest.indices // width).to(self.precision)
        column = (strongest.indices % width).to(self.precision)
        missing = strongest.values <= 0
        points = torch.stack((column, row), dim=2).masked_fill(missing[..., None], torch.nan)
        return points, strongest.values.masked_fill(missing, torch.nan)


def _response(view: Tensor) -> Tensor:
    """Smaller eigenvalue of the structure tensor, (B, 1, H, W), as `ops.corner_response`; 0 at the frame's edge."""
    smooth_x = (view[..., :-2] + 2 * view[..., 1:-1] + view[..., 2:]) / 4
    smooth_y = (view[..., :-2, :] + 2 * view[..., 1:-1, :] + view[..., 2:, :]) / 4
    x = (smooth_y[..., 2:] - smooth_y[..., :-2]) / 2
    y = (smooth_x[..., 2:, :] - smooth_x[..., :-2, :]) / 2
    xx, xy, yy = (functional.avg_pool2d(product, _BOX, 1) for product in (x * x, x * y, y * y))
    half = (xx - yy) / 2
    smaller = (xx + yy) / 2 - (half * half + xy * xy).sqrt()
    edge = 1 + _BOX // 2
    return functional.pad(smaller.clamp_min(0), (edge,) * 4)
