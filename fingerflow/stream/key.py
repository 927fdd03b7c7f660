"""What the key frame says about its points, computed when it is chosen."""

from typing import NamedTuple

import torch
from torch import Tensor, nn

from fingerflow.stream.finite import finite
from fingerflow.stream.noise import noise_variance
from fingerflow.stream.windows import Windows


class Templates(NamedTuple):
    """Templates of B x N points in windows of n px: what a frame needs to know of the key frame.

    Attributes:
        template_start: (B, N, 2) px, NaN where there is no point.
        template_values: (B, N, n, n) grey levels, less the level.
        template_level: (B, N) mean grey level.
        template_noise: (B, N) variance of a pixel.
        template_products: (B, 6, N), sums of gx gx, gx gy, gy gy, gx t, gy t and t t.
        template_gradients: (B, N, (n + 6) (n + 2), 10) at reach 1, for the table in a frame: smoothed, so that it is a
            table of pixels.
        template_rows: (B, N, (n + 4) n, 5) at reach 1, for the table of the way back.
    """

    template_start: Tensor
    template_values: Tensor
    template_level: Tensor
    template_noise: Tensor
    template_products: Tensor
    template_gradients: Tensor
    template_rows: Tensor


class KeyStep(nn.Module):
    """Points of a topography view to their templates."""

    def __init__(self, window: int = 21, reach: int = 1, precision: torch.dtype = torch.float32) -> None:
        super().__init__()
        self.windows = Windows(window, reach, precision)

    def forward(self, topography_view: Tensor, points: Tensor) -> Templates:
        """(B, 1, H, W) and (B, N, 2) px; a NaN point has a template that matches nothing."""
        windows, n = self.windows, self.windows.size
        start = torch.where(finite(points), points.to(windows.precision), torch.nan)
        known = torch.where(finite(start), start, 0.0)
        center = known.round()
        patches = windows.patches(topography_view, center)
        sampled = windows.sample(patches, (known - center).reshape(1, -1, 2).transpose(1, 2))
        values, x, y = sampled[:, :n, :n], sampled[:, :n, n:], sampled[:, n:, :n]
        level = values.mean((1, 2), keepdim=True)
        t = values - level
        products = [(a * b).sum((1, 2)) for a, b in ((x, x), (x, y), (y, y), (x, t), (y, t), (t, t))]
        gradient = nn.functional.pad(torch.stack((x, y), dim=1), (2, 2, 2, 2))
        noise = noise_variance(topography_view.to(windows.precision))
        gradients = windows.shifted_gradients(windows.smooth(gradient)).transpose(1, 2)
        rows = windows.shifted_rows(windows.smooth(patches - level)).transpose(1, 2)
        count = start.shape[1]
        return Templates(
            start,
            t.unflatten(0, (-1, count)),
            level.reshape(-1, count),
            noise[:, None].expand(-1, count),
            torch.stack(products).unflatten(1, (-1, count)).transpose(0, 1),
            gradients.unflatten(0, (-1, count)),
            rows.unflatten(0, (-1, count)),
        )
