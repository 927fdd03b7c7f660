"""What the key frame says about its points, computed when it is chosen."""

from typing import NamedTuple

import torch
from torch import Tensor, nn

from fingerflow.ops.tracking_limits import GRADIENT_NOISE as _GRADIENT_NOISE
from fingerflow.ops.tracking_limits import TEXTURE_TO_NOISE
from fingerflow.stream.components import components_first
from fingerflow.stream.finite import finite
from fingerflow.stream.noise import noise_variance
from fingerflow.stream.spline_features import feature_bends, features_and_slopes
from fingerflow.stream.windows import Windows

_TINY = 1e-20


class Templates(NamedTuple):
    """Templates of B x N points in windows of n px: what a frame needs to know of the key frame.

    Attributes:
        template_start: (B, N, 2) px, NaN where there is no point.
        template_values: (B, N, n n) grey levels.
        template_level: (B, N) their mean.
        template_noise: (B, N) variance of a pixel.
        template_products: (B, 11, N). xx, xy, yy of the inverse of the structure tensor; sum of the squares of the
            values less their mean; sums of gx, then of gy, times the derivatives to xx / 2, xy and yy / 2; 1 where the
            texture stands out of the noise, else 0.
        template_gradients: (B, N, 2, n n), gx and gy.
        template_pixels: (B, N, 2, m m), the same as weights of the patch of m x m px around a window without a shift.
        template_table: (B, 98, N) at reach 1, sums of gx and gy times the window shifted in the key frame
            (`Windows.table_of`, of a reach one px wider than in a frame).
    """

    template_start: Tensor
    template_values: Tensor
    template_level: Tensor
    template_noise: Tensor
    template_products: Tensor
    template_gradients: Tensor
    template_pixels: Tensor
    template_table: Tensor


class KeyStep(nn.Module):
    """Points of a topography view to their templates."""

    def __init__(self, window: int = 21, reach: int = 1, precision: torch.dtype = torch.float32) -> None:
        super().__init__()
        self.in_frame = Windows(window, reach, precision)
        # A window of a frame lies up to half a pixel beside its point, and the point as far beside its own pixel.
        self.windows = Windows(window, reach + 1, precision)

    def forward(self, topography_view: Tensor, points: Tensor) -> Templates:
        """(B, 1, H, W) and (B, N, 2) px; a NaN point has a template that matches nothing."""
        windows, count = self.windows, points.shape[1]
        start = torch.where(finite(points), points.to(windows.precision), torch.nan)
        known = components_first(torch.where(finite(start), start, 0.0))
        center = known.round()
        patches = windows.patches(topography_view, center)
        # Less their mean, so that what is flat has no gradient in any precision.
        base = patches.mean((1, 2), keepdim=True)
        shift = known - center
        functions = (*features_and_slopes(shift, windows.reach), feature_bends(shift, windows.reach))
        by_x, by_y = ([one[:, :, axis].transpose(1, 2).flatten(0, 1) for one in functions] for axis in range(2))
        lines = [windows.at_y(one) @ (patches - base) for one in by_y]
        across = [windows.at_x(one) for one in by_x]
        # By order of the derivative: along x first.
        orders = ((0, 0), (1, 0), (0, 1), (2, 0), (1, 1), (0, 2))
        above, x, y, xx, xy, yy = ((lines[along] @ across[by]).flatten(1) for by, along in orders)
        values = above + base.flatten(1)
        level = values.mean(1, keepdim=True)
        above = values - level
        noise = noise_variance(topography_view.to(windows.precision))
        inverse, textured = _structure(x, y, noise.repeat_interleave(count), topography_view.is_floating_point())
        bends = [(slope * bend).sum(1) for slope in (x, y) for bend in (xx / 2, xy, yy / 2)]
        products = torch.stack((*inverse, (above * above).sum(1), *bends, textured))
        gradients = torch.stack((x, y), dim=1)
        square = gradients.unflatten(2, (windows.size, windows.size))
        table = windows.along_y(patches) @ windows.table_of(square).transpose(1, 2)
        # By function in y, function in x, gradient.
        table = table.unflatten(2, (2, -1)).transpose(2, 3)
        return Templates(
            start,
            values.unflatten(0, (-1, count)),
            level.reshape(-1, count),
            noise[:, None].expand(-1, count),
            products.unflatten(1, (-1, count)).transpose(0, 1),
            gradients.unflatten(0, (-1, count)),
            self.in_frame.in_the_middle(square).flatten(2).unflatten(0, (-1, count)),
            table.flatten(1).unflatten(0, (-1, count)).transpose(1, 2),
        )


def _structure(x: Tensor, y: Tensor, noise: Tensor, floating: bool) -> tuple[tuple[Tensor, ...], Tensor]:
    """xx, xy, yy of the inverse of the structure tensor of gradients (P, samples), and 1 where there is texture (P)."""
    xx, xy, yy = ((one * two).sum(1) for one, two in ((x, x), (x, y), (y, y)))
    determinant = xx * yy - xy * xy
    regular = determinant > _TINY
    some = torch.where(regular, determinant, 1.0)
    mean, half = (xx + yy) / 2, (xx - yy) / 2
    smaller = mean - (half * half + xy * xy).sqrt()
    rounding = 0.0 if floating else 1 / 12
    floor = noise.clamp_min(rounding) * (TEXTURE_TO_NOISE * x.shape[1] * _GRADIENT_NOISE)
    textured = regular & (smaller > torch.maximum(floor, 1e-4 * mean))
    return (yy / some, -xy / some, xx / some), textured.to(x.dtype)
