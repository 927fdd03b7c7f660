"""What a deformation that a template does not know does to a point found by it: E = F F_0^-1 - I of the skin since.

F = I + du/dX by local fits in the key frame. Against it a template that was prepared with another F_0 leans: to first
order a point appears displaced by D E, D the template's own (`Number.LEAN`). What varies within a window beyond F
displaces it as a whole: u(p + w) = u + F w + w'Hw / 2, and the mean of w'Hw / 2 over a square of n px, the Laplacian of
u times (n^2 - 1) / 24, is taken off. At n = 25 it is 0.02 px where the divergence of skin changes by 2 % a mm.

What E bends within the window stays in the residual, e'Qe (`Number.BENDING`), where it would count as noise: it is
taken off the covariance, of which the noise of the key frame is left at least.
"""

import torch
from torch import Tensor

from fingerflow.kernels import tensors as kernels
from fingerflow.kernels import tracking_limits as limits
from fingerflow.kernels.deformation import CorrectedPoints
from fingerflow.kernels.tracking_limits import Number
from fingerflow.ops.fields.plane_fit import Support
from fingerflow.ops.fields.point_gradients import neighbour_planes
from fingerflow.ops.tensors import finite, sum_rows

_TINY = 1e-20


def correct_points(
    start: Tensor,
    points: Tensor,
    covariance: Tensor,
    numbers: Tensor,
    inverse_warp: Tensor,
    window: int,
    gauge_px: float,
    support: Support | None = None,
) -> CorrectedPoints[Tensor]:
    """Return points of K frames, corrected for the deformation of the skin that they show.

    Args:
        start: (1 or K, N, 2) px in the key frame.
        points: (K, N, 2) px as they were found, NaN where they were not, and their covariance (K, N, 2, 2) px^2.
        covariance: see `points`.
        numbers: (1 or K, N, 32) `Templates.numbers`.
        inverse_warp: (1 or K, N, 2, 2) F_0^-1 with which the templates were prepared.
        window: px, side of a template.
        gauge_px: diameter of the local fits.
        support: `neighbours_support` of the start, if that is known.
    """
    given = start, points, covariance, numbers, inverse_warp
    if kernels.serve(*given) and all(one.dtype == torch.float32 for one in given) and len(start):
        count = len(points) if len(start) == 1 else 1  # frames a call, which are of one key frame
        each = [
            kernels.correct_points(
                *(start[k], points[k : k + count], covariance[k : k + count], numbers[k], inverse_warp[k]),
                window=window,
                gauge_px=gauge_px,
            )
            for k in range(len(start))
        ]
        return CorrectedPoints(*(torch.cat(one) for one in zip(*each, strict=True)))
    expected, gradient = neighbour_planes(start, points - start, gauge_px, support)
    _, second = neighbour_planes(start, gradient.flatten(2), gauge_px, support)
    # Components before points from here on, (K, 4, N): runtimes are slow where the last axis is short.
    second = second.flatten(2).mT
    laplacian = second[:, ::4] + second[:, 3::4]
    identity = torch.eye(2, dtype=points.dtype, device=points.device).reshape(4, 1)
    warp = identity + _or_zero(gradient.flatten(2).mT.contiguous())
    unknown = _multiplied(warp, inverse_warp.flatten(2).mT.contiguous()) - identity
    of = numbers.mT.contiguous()
    leaning = sum_rows(of[:, Number.LEAN : Number.LEAN + 8].unflatten(1, (2, 4)) * unknown[:, None]).squeeze(2)
    bulge = _or_zero(laplacian) * ((window**2 - 1) / 24)
    return CorrectedPoints(
        points - (leaning + bulge).mT,
        _less_bending(covariance, of, unknown, window),
        warp.mT.unflatten(2, (2, 2)),
        window // 2 * sum_rows(unknown * unknown).squeeze(1).sqrt(),
        start + expected,
    )


def _less_bending(covariance: Tensor, of: Tensor, unknown: Tensor, window: int) -> Tensor:
    """Covariances (K, N, 2, 2) without what the residual owes to E (K, 4, N), for numbers (K, 32, N) of templates."""
    pairs = torch.cat([unknown[:, k : k + 1] * unknown[:, k:] for k in range(4)], dim=1)
    bending = sum_rows(of[:, Number.BENDING :] * pairs)
    freedom = (window**2 - 4) * limits.VALUE_NOISE
    unit = of[:, Number.COVARIANCE_XX : Number.COVARIANCE_XX + 1]
    # All of a covariance is in proportion to the variance of a pixel: one ratio says how much of it remains.
    noise = covariance[..., 0, 0][:, None] / unit
    least = torch.minimum(noise, of[:, Number.NOISE : Number.NOISE + 1])
    remaining = torch.maximum(noise - bending / freedom, least)
    return covariance * (remaining / noise.clamp_min(_TINY)).mT[..., None]


def _multiplied(a: Tensor, b: Tensor) -> Tensor:
    """Products (K, 4, N) of matrices (K or 1, 4, N), by xx, xy, yx, yy."""
    rows, other = a.unflatten(1, (2, 2)), b.unflatten(1, (2, 2))
    result: Tensor = (rows[:, :, :1] * other[:, None, 0] + rows[:, :, 1:] * other[:, None, 1]).flatten(1, 2)
    return result


def _or_zero(values: Tensor) -> Tensor:
    """Return the values with 0 in place of those that are not finite."""
    return torch.where(finite(values), values, 0.0)
