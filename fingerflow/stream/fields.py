"""Divergence, curl and strain at the tracked points by local fits, as two products of matrices."""

from typing import NamedTuple

import torch
from torch import Tensor, nn

from fingerflow.stream.components import components_first
from fingerflow.stream.finite import finite
from fingerflow.stream.sums import sum_rows

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
    visited by itself.

    Args:
        gauge_px: diameter of the support, px of the positions.
    """

    measures: Tensor
    products: Tensor

    def __init__(self, gauge_px: float, precision: torch.dtype = torch.float32) -> None:
        super().__init__()
        self.gauge_px = gauge_px
        self.precision = precision
        # From a gradient (du/dx, du/dy, dv/dx, dv/dy): divergence, curl and the linear parts of exx, eyy, exy; from its
        # products of columns (u_x u_x, u_x u_y, u_y u_y, the same of v): the rest of exx, eyy, exy.
        measures = [[1, 0, 0, 1], [0, -1, 1, 0], [1, 0, 0, 0], [0, 0, 0, 1], [0, 0.5, 0.5, 0]]
        products = [[0.5, 0, 0, 0.5, 0, 0], [0, 0, 0.5, 0, 0, 0.5], [0, 0.5, 0, 0, 0.5, 0]]
        for name, rows in (("measures", measures), ("products", products)):
            self.register_buffer(name, torch.tensor(rows, dtype=precision))

    def forward(self, points: Tensor, reference: Tensor) -> StreamFields:
        """(B, N, 2) px each, positions now and at the onset of contact; NaN where there is none."""
        return self.of_components(*(components_first(one.to(self.precision)) for one in (points, reference)))

    def of_components(self, now: Tensor, then: Tensor) -> StreamFields:
        """The same of (B, 2, N): runtimes are slow where the last axis is short."""
        moved = now - then
        usable = finite(sum_rows(moved))
        weight = usable.to(self.precision)  # (B, 1, N)
        both = torch.where(usable, torch.cat((then, moved), dim=1), 0.0)
        centred = (both - both.sum(2, keepdim=True) / weight.sum(2, keepdim=True).clamp_min(1)) * weight
        place, moved = centred[:, :2], centred[:, 2:]
        radius = self.gauge_px / 2
        scaled = place / radius
        norm = sum_rows(scaled * scaled)
        one = torch.ones_like(norm)
        queries = torch.cat((2 * scaled, norm, one), dim=1)
        support = torch.cat((scaled, -one, one - norm), dim=1)
        near = (queries.transpose(1, 2) @ support).clamp_min(0)
        points_near = weight @ (near > 0).to(self.precision)
        # 1, x, y, the products xx, xy, yy, u, v, and ux, uy, vx, vy. Weights are the same both ways: columns serve.
        squares, mixed = _squares(place), _mixed(moved, place)
        monomials = torch.cat((one, place, squares, moved, mixed), dim=1) * weight
        sums = monomials @ (near * near)
        determined = usable & (points_near > _LEAST_POINTS - 0.5)
        mean = sums / torch.where(determined, sums[:, :1], 1.0)
        middle, motion = mean[:, 1:3], mean[:, 6:8]
        spread = mean[:, 3:6] - _squares(middle)
        cross = mean[:, 8:] - _mixed(motion, middle)  # ux, uy, vx, vy
        xx, xy, yy = spread[:, :1], spread[:, 1:2], spread[:, 2:]
        determinant = xx * yy - xy * xy
        half = (xx + yy) / 2  # of the trace
        narrowest = half - (half * half - determinant).clamp_min(0).sqrt()
        determined = determined & (narrowest >= (_LEAST_SPREAD * radius) ** 2) & (determinant > _TINY)
        by_x, by_y = cross[:, ::2], cross[:, 1::2]  # of u and of v
        slopes = torch.stack((by_x * yy - by_y * xy, by_y * xx - by_x * xy), dim=2).flatten(1, 2)
        gradient = slopes / torch.where(determined, determinant, torch.nan)
        linear = self.measures @ gradient
        strain = linear[:, 2:] + self.products @ torch.cat(
            (_squares(gradient[:, :2]), _squares(gradient[:, 2:])), dim=1
        )
        return StreamFields(linear[:, 0], linear[:, 1], strain.transpose(1, 2), _median(linear[:, 0]))


def _squares(pair: Tensor) -> Tensor:
    """(B, 3, N) products aa, ab, bb of pairs (B, 2, N)."""
    return torch.cat((pair[:, :1] * pair, pair[:, 1:] * pair[:, 1:]), dim=1)


def _mixed(pair: Tensor, other: Tensor) -> Tensor:
    """(B, 4, N) products ac, ad, bc, bd of pairs (B, 2, N)."""
    return torch.cat((pair[:, :1] * other, pair[:, 1:] * other), dim=1)


def _median(values: Tensor) -> Tensor:
    """Median (B,) of what is known of (B, N), the mean of the middle two; NaN where nothing is."""
    known = finite(values)
    count = known.to(values.dtype).sum(1, keepdim=True)
    falling = torch.where(known, values, -torch.inf).topk(values.shape[1], dim=1).values
    # The same place twice where the count is odd.
    middle = torch.cat(((count - 1).clamp_min(0) / 2, count / 2), dim=1).floor().clamp_max(values.shape[1] - 1)
    return torch.where(count > 0, falling.gather(1, middle.to(torch.int64)).mean(1, keepdim=True), torch.nan).squeeze(1)
