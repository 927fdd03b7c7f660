"""What the key frame says about its points, computed when it is chosen."""

from typing import NamedTuple

import torch
from torch import Tensor, nn

from fingerflow.stream.finite import finite
from fingerflow.stream.noise import noise_variance
from fingerflow.stream.spline_features import feature_bends, feature_slopes, features
from fingerflow.stream.windows import Windows


class Templates(NamedTuple):
    """Templates of B x N points in windows of n px: what a frame needs to know of the key frame.

    Attributes:
        template_start: (B, N, 2) px, NaN where there is no point.
        template_values: (B, N, n n) grey levels.
        template_level: (B, N) their mean.
        template_noise: (B, N) variance of a pixel.
        template_products: (B, 6, N), sums of gx gx, gx gy, gy gy, gx v, gy v, and of v v less the level.
        template_gradients: (B, N, n (n + 6), 10) at reach 1, for the table in a frame (`Windows.table_of`).
        template_slopes: (B, N, 5, n n) derivatives to x, y, xx / 2, xy and yy / 2, for the way back.
    """

    template_start: Tensor
    template_values: Tensor
    template_level: Tensor
    template_noise: Tensor
    template_products: Tensor
    template_gradients: Tensor
    template_slopes: Tensor


class KeyStep(nn.Module):
    """Points of a topography view to their templates."""

    def __init__(self, window: int = 21, reach: int = 1, precision: torch.dtype = torch.float32) -> None:
        super().__init__()
        self.windows = Windows(window, reach, precision)

    def forward(self, topography_view: Tensor, points: Tensor) -> Templates:
        """(B, 1, H, W) and (B, N, 2) px; a NaN point has a template that matches nothing."""
        windows = self.windows
        start = torch.where(finite(points), points.to(windows.precision), torch.nan)
        known = torch.where(finite(start), start, 0.0).reshape(-1, 2).T
        center = known.round()
        patches = windows.patches(topography_view, center)
        # Less their mean, so that what is flat has no gradient in any precision.
        base = patches.mean((1, 2), keepdim=True)
        along_y = windows.along_y(patches - base)
        shift = known - center
        functions = [make(shift, windows.reach).transpose(0, 2) for make in (features, feature_slopes, feature_bends)]
        lines = [windows.at_y(along_y, one[:, 1:])[:, 0] for one in functions]
        across = [windows.at_x(one[:, 0]) for one in functions]
        # By order of the derivative: along x first.
        orders = ((0, 0), (1, 0), (0, 1), (2, 0), (1, 1), (0, 2))
        above, x, y, xx, xy, yy = ((lines[along] @ across[by]).flatten(1) for by, along in orders)
        values = above + base.flatten(1)
        level = values.mean(1, keepdim=True)
        above = values - level
        pairs = ((x, x), (x, y), (y, y), (x, values), (y, values), (above, above))
        products = torch.stack([(a * b).sum(1) for a, b in pairs])
        gradient = torch.stack((x, y), dim=1).unflatten(2, (windows.size, windows.size))
        noise = noise_variance(topography_view.to(windows.precision))
        count = start.shape[1]
        return Templates(
            start,
            values.unflatten(0, (-1, count)),
            level.reshape(-1, count),
            noise[:, None].expand(-1, count),
            products.unflatten(1, (-1, count)).transpose(0, 1),
            windows.table_of(gradient).unflatten(0, (-1, count)),
            torch.stack((x, y, xx / 2, xy, yy / 2), dim=1).unflatten(0, (-1, count)),
        )
