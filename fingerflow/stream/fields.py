"""Divergence, curl and strain at the tracked points by local fits, as two products of matrices."""

from typing import NamedTuple

import torch
from torch import Tensor, nn

from fingerflow.ops.strain import curl, divergence, green_lagrange

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
    """`ops.local_gradients` at the points themselves.

    With positions x about their mean, 1 - |x_i - x_j|^2 / R^2 is a product of (x, y, |x|^2, 1) with its counterpart,
    and the moments of all fits are the product of the weights with the monomials of x and u: no pair of points is
    visited by itself.

    Args:
        gauge_px: diameter of the support, px of the positions.
    """

    def __init__(self, gauge_px: float, precision: torch.dtype = torch.float32) -> None:
        super().__init__()
        self.gauge_px = gauge_px
        self.precision = precision

    def forward(self, points: Tensor, reference: Tensor) -> StreamFields:
        """(B, N, 2) px each, positions now and at the onset of contact; NaN where there is none."""
        now, then = points.to(self.precision), reference.to(self.precision)
        usable = (now.isfinite() & then.isfinite()).all(-1, keepdim=True)
        weight = usable.to(self.precision)
        moved = torch.where(usable, now - then, 0.0)
        count = weight.sum(1, keepdim=True).clamp_min(1)
        place = torch.where(usable, then, 0.0)
        place = (place - place.sum(1, keepdim=True) / count) * weight
        moved = (moved - moved.sum(1, keepdim=True) / count) * weight
        radius = self.gauge_px / 2
        x, y = place[..., :1], place[..., 1:]
        norm = (x * x + y * y) / radius**2
        one = torch.ones_like(x)
        queries = torch.cat((x, y, norm, one), dim=2)
        support = torch.cat((2 * x / radius**2, 2 * y / radius**2, -one, one - norm), dim=2)
        near = (queries @ support.transpose(1, 2)).clamp_min(0)
        u, v = moved[..., :1], moved[..., 1:]
        monomials = torch.cat((one, x, y, x * x, x * y, y * y, u, v, x * u, y * u, x * v, y * v), dim=2) * weight
        points_near = (near.sign() @ weight).squeeze(2)
        sums = (near * near) @ monomials
        mass = sums[..., 0]
        determined = usable.squeeze(2) & (points_near >= _LEAST_POINTS - 0.5)
        mean = sums[..., 1:] / torch.where(determined, mass, 1.0)[..., None]
        mx, my, sxx, sxy, syy, mu, mv, xu, yu, xv, yv = mean.unbind(2)
        xx, xy, yy = sxx - mx * mx, sxy - mx * my, syy - my * my
        determinant = xx * yy - xy * xy
        half = (xx - yy) / 2
        narrowest = (xx + yy) / 2 - (half * half + xy * xy).sqrt()
        determined = determined & (narrowest >= (_LEAST_SPREAD * radius) ** 2) & (determinant > _TINY)
        safe = torch.where(determined, determinant, 1.0)
        xu, yu, xv, yv = xu - mx * mu, yu - my * mu, xv - mx * mv, yv - my * mv
        gradient = torch.stack(
            (xu * yy - yu * xy, yu * xx - xu * xy, xv * yy - yv * xy, yv * xx - xv * xy), dim=2
        ) / safe.unsqueeze(2)
        gradient = gradient.masked_fill(~determined.unsqueeze(2), torch.nan).unflatten(2, (2, 2))
        spread = divergence(gradient)
        return StreamFields(spread, curl(gradient), green_lagrange(gradient), _median(spread))


def _median(values: Tensor) -> Tensor:
    """Median (B,) of what is known of (B, N), the mean of the middle two; NaN where nothing is."""
    known = values.isfinite()
    count = known.to(torch.int64).sum(1, keepdim=True)
    falling = torch.where(known, values, -torch.inf).topk(values.shape[1], dim=1).values
    low, high = (count - 1).clamp_min(0) // 2, count // 2
    low, high = torch.minimum(low, high), torch.maximum(low, high.clamp(max=values.shape[1] - 1))
    middle = (falling.gather(1, low) + falling.gather(1, torch.where(count % 2 == 1, low, high))) / 2
    return torch.where(count > 0, middle, torch.nan).squeeze(1)
