"""Divergence, curl and strain at the tracked points by local fits, as two products of matrices."""

from typing import NamedTuple

import torch
from torch import Tensor, nn

from fingerflow.stream.finite import finite

_LEAST_POINTS = 5
_LEAST_SPREAD = 0.1  # of the support's radius in every direction, as `ops.local_gradients` asks
_TINY = 1e-20


class StreamFields(NamedTuple):
    """Since the onset of contact, at B x N points: `divergence`, `curl` (B, N), Green-Lagrange `strain` (B, N, 3) as
    (exx, eyy, exy), NaN where unknown; `median_divergence` (B,) over the points where it is known."""

    divergence: Tensor
    curl: Tensor
    strain: Tensor
    median_divergence: Tensor


class FieldsStep(nn.Module):
    """`ops.local_gradients` at the points themselves, and what follows from the gradient.

    With positions x about their mean, 1 - |x_i - x_j|^2 / R^2 is a product of (x, y, |x|^2, 1) with its counterpart,
    and the moments of all fits are the product of the weights with the monomials of x and u: no pair of points is
    visited by itself. An unfused runtime pays for every operation, so two components go through each together.

    Args:
        gauge_px: diameter of the support, px of the positions.
    """

    adjugate: Tensor
    measures: Tensor
    products: Tensor

    def __init__(self, gauge_px: float, precision: torch.dtype = torch.float32) -> None:
        super().__init__()
        self.gauge_px = gauge_px
        self.precision = precision
        # Of matrices as rows (a, b, c, d): the adjugate (d, -b, -c, a); divergence, curl and the linear parts of exx,
        # eyy, exy of a gradient (du/dx, du/dy, dv/dx, dv/dy); exx, eyy, exy of the products of its columns, halved.
        adjugate = [[0, 0, 0, 1], [0, -1, 0, 0], [0, 0, -1, 0], [1, 0, 0, 0]]
        measures = [[1, 0, 1, 0, 0], [0, -1, 0, 0, 0.5], [0, 1, 0, 0, 0.5], [1, 0, 0, 1, 0]]
        products = [[0.5, 0, 0], [0, 0, 0.25], [0, 0, 0.25], [0, 0.5, 0]]
        for name, rows in (("adjugate", adjugate), ("measures", measures), ("products", products)):
            self.register_buffer(name, torch.tensor(rows, dtype=precision))

    def forward(self, points: Tensor, reference: Tensor) -> StreamFields:
        """(B, N, 2) px each, positions now and at the onset of contact; NaN where there is none."""
        now, then = points.to(self.precision), reference.to(self.precision)
        moved = now - then
        usable = finite(moved).all(-1, keepdim=True)
        weight = usable.to(self.precision)
        both = torch.where(usable, torch.cat((then, moved), dim=2), 0.0)
        centred = (both - both.sum(1, keepdim=True) / weight.sum(1, keepdim=True).clamp_min(1)) * weight
        place, moved = centred[..., :2], centred[..., 2:]
        radius = self.gauge_px / 2
        scaled = place / radius
        norm = (scaled * scaled).sum(2, keepdim=True)
        one = torch.ones_like(norm)
        queries = torch.cat((2 * scaled, norm, one), dim=2)
        support = torch.cat((scaled, -one, one - norm), dim=2)
        near = (queries @ support.transpose(1, 2)).clamp_min(0)
        points_near = (near > 0).to(self.precision) @ weight
        # 1, x, y, the four products of x and y, u, v, and the four products of u and v with x and y.
        squares = (place[..., :, None] * place[..., None, :]).flatten(2)
        mixed = (moved[..., :, None] * place[..., None, :]).flatten(2)
        monomials = torch.cat((one, place, squares, moved, mixed), dim=2) * weight
        sums = (near * near) @ monomials
        determined = usable & (points_near > _LEAST_POINTS - 0.5)
        mean = sums[..., 1:] / torch.where(determined, sums[..., :1], 1.0)
        middle, motion = mean[..., :2], mean[..., 6:8]
        spread = mean[..., 2:6] - (middle[..., :, None] * middle[..., None, :]).flatten(2)
        cross = mean[..., 8:] - (motion[..., :, None] * middle[..., None, :]).flatten(2)
        adjugate = spread @ self.adjugate
        determinant = (spread * adjugate).sum(2, keepdim=True) / 2
        half = (spread + adjugate)[..., :1] / 2  # of the trace
        narrowest = half - (half * half - determinant).clamp_min(0).sqrt()
        determined = determined & (narrowest >= (_LEAST_SPREAD * radius) ** 2) & (determinant > _TINY)
        product = (cross.unflatten(2, (2, 2, 1)) * adjugate.unflatten(2, (1, 2, 2))).sum(3)
        gradient = product.flatten(2) / torch.where(determined, determinant, 1.0)
        gradient = torch.where(determined, gradient, torch.nan)
        linear = gradient @ self.measures
        columns = gradient.unflatten(2, (2, 2))
        quadratic = (columns[..., :, None] * columns[..., None, :]).sum(2).flatten(2) @ self.products
        spreading = linear[..., 0]
        return StreamFields(spreading, linear[..., 1], linear[..., 2:] + quadratic, _median(spreading))


def _median(values: Tensor) -> Tensor:
    """Median (B,) of what is known of (B, N), the mean of the middle two; NaN where nothing is."""
    known = finite(values)
    count = known.to(torch.int64).sum(1, keepdim=True)
    falling = torch.where(known, values, -torch.inf).topk(values.shape[1], dim=1).values
    low, high = (count - 1).clamp_min(0) // 2, count // 2
    low, high = torch.minimum(low, high), torch.maximum(low, high.clamp(max=values.shape[1] - 1))
    middle = (falling.gather(1, low) + falling.gather(1, torch.where(count % 2 == 1, low, high))) / 2
    return torch.where(count > 0, middle, torch.nan).squeeze(1)
