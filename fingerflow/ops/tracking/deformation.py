"""Correction of tracked points for the deformation of the skin since the preparation of the templates.

That deformation is E = F F_0^-1 - I. F = I + du/dX is estimated by local fits in the key frame; a template was prepared
with F_0. A fit flattens a wave of the gradient in proportion to the square of its gauge length. The difference between
fits over the gauge length and over half of it (`INNER_GAUGE`) thus gives what the latter still lacks, a third of that
difference (Richardson's extrapolation). It is added to the gradient, and its effect on the position to the covariance.
Fits over half of the gauge length have few points: what the gradient over all of it makes lean is subtracted before.

To first order E displaces the tracked point by D E, where D depends on the template (`Number.LEAN`).
Displacement that varies within a window beyond F adds a second bias: with u(p + w) = u + F w + w'Hw / 2, the mean of
w'Hw / 2 over a square of n px is the Laplacian of u times (n^2 - 1) / 24. Both are subtracted. At n = 25 the second is
0.02 px where the divergence of skin changes by 2 % per mm. Subtracting it adds 1.3 % to the error of uniform motion,
and takes a third off that of a displacement with a period of 2 to 14 windows (the star of `python -m bench curved`).

E also leaves a residual e'Qe (`Number.BENDING`) in the window, which would count as noise. It is subtracted from the
covariance, down to the contribution of the key frame's noise.

Compiled twin: `kernels/deformation.cpp`.
"""

import torch
from torch import Tensor

from fingerflow.kernels import tensors as kernels
from fingerflow.kernels import tracking_limits as limits
from fingerflow.kernels.result_records import CorrectedPoints
from fingerflow.kernels.tracking_limits import Number
from fingerflow.ops.fields.plane_fit import Support
from fingerflow.ops.fields.point_gradients import neighbour_planes, neighbours_support
from fingerflow.ops.tensors import finite, products, sum_rows

_TINY = 1e-20
_BEYOND = limits.INNER_GAUGE**2 / (1 - limits.INNER_GAUGE**2)


def correct_points(
    start: Tensor,
    points: Tensor,
    covariance: Tensor,
    numbers: Tensor,
    inverse_warp: Tensor,
    window: int,
    gauge_px: float,
    supports: tuple[Support | None, Support | None] | None = None,
) -> CorrectedPoints:
    """Correct the positions of points tracked in K frames, and their covariance, for the deformation of the skin in the
    windows of the templates, which is estimated from the points themselves.

    Args:
        start: (1 or K, N, 2) px in the key frame.
        points: (K, N, 2) px as tracked; NaN where a point was not found.
        covariance: (K, N, 2, 2) px^2 of `points`.
        numbers: (1 or K, N, 32) template statistics (`Templates.numbers`).
        inverse_warp: (1 or K, N, 2, 2) F_0^-1 with which the templates were prepared.
        window: px, side of a template.
        gauge_px: diameter of the local fits.
        supports: `fit_supports` the positions `start`, to save computing them.
    """
    given = start, points, covariance, numbers, inverse_warp
    if kernels.serve(*given) and all(one.dtype == torch.float32 for one in given) and len(start):
        count = len(points) if len(start) == 1 else 1  # number of frames per call: those that share a key frame
        each = [
            kernels.correct_points(
                *(start[k], points[k : k + count], covariance[k : k + count], numbers[k], inverse_warp[k]),
                window=window,
                gauge_px=gauge_px,
            )
            for k in range(len(start))
        ]
        return CorrectedPoints(*(torch.cat(one) for one in zip(*each, strict=True)))
    outer_support, inner_support = supports or fit_supports(start, gauge_px)
    # Put components before points, (K, 4, N): ONNX runtimes are slow if the last axis is short.
    identity = torch.eye(2, dtype=points.dtype, device=points.device).reshape(4, 1)
    inverse, of = inverse_warp.flatten(2).mT.contiguous().unflatten(1, (2, 2)), numbers.mT.contiguous()
    lean = of[:, Number.LEAN : Number.LEAN + 8].unflatten(1, (2, 4))

    def leaning(deformation: Tensor) -> Tensor:
        return sum_rows(lean * deformation[:, None]).squeeze(2).mT

    def warp_and_unknown(gradient: Tensor) -> tuple[Tensor, Tensor]:
        """Return the deformation gradient F since the key frame, and the deformation E = F F_0^-1 - I that the
        templates do not yet contain, (K, 4, N) each, for displacement gradients (K, N, 2, 2).
        """
        warp = identity + _or_zero(gradient.flatten(2).mT.contiguous())
        return warp, products(warp.unflatten(1, (2, 2)), inverse).flatten(1, 2) - identity

    moved = points - start
    expected, outer = neighbour_planes(start, moved, gauge_px, outer_support)
    moved = moved - leaning(warp_and_unknown(outer)[1])
    # Extrapolated to a gauge length of 0; the fits over the whole gauge length stand where either determines none.
    _, inner = neighbour_planes(start, moved, limits.INNER_GAUGE * gauge_px, inner_support)
    valid = finite(inner - outer)
    beyond = torch.where(valid, _BEYOND * (inner - outer), 0.0)
    gradient = torch.where(valid, inner, outer) + beyond
    # Mean over each point's window of the second-order part of the displacement.
    second = neighbour_planes(start, gradient.flatten(2), gauge_px, outer_support)[1].flatten(2).mT
    bulge = _or_zero(second[:, ::4] + second[:, 3::4]) * ((window**2 - 1) / 24)
    warp, unknown = warp_and_unknown(gradient)
    off = leaning(beyond.flatten(2).mT)
    return CorrectedPoints(
        points - leaning(unknown) - bulge.mT,
        _without_deformation_residual(covariance, of, unknown, window) + off[..., None] * off[..., None, :],
        warp.mT.unflatten(2, (2, 2)),
        window // 2 * sum_rows(unknown * unknown).squeeze(1).sqrt(),
        start + expected,
    )


def fit_supports(start: Tensor, gauge_px: float) -> tuple[Support | None, Support | None]:
    """Return the weights of points at positions (1 or B, N, 2) px in the local fits around each of them, over the gauge
    length `gauge_px` (diameter of the fit) and over its inner part; None where compiled kernels run, which do not need
    them.
    """
    return neighbours_support(start, gauge_px), neighbours_support(start, limits.INNER_GAUGE * gauge_px)


def _without_deformation_residual(covariance: Tensor, of: Tensor, unknown: Tensor, window: int) -> Tensor:
    """Return position covariances (K, N, 2, 2) without the part of the window residuals that comes from deformation of
    the skin and not from image noise.

    `unknown` is that deformation E (K, 4, N), `window` the side of a window, px. `of` (K, 32, N) are the template
    statistics.
    """
    pairs = torch.cat([unknown[:, k : k + 1] * unknown[:, k:] for k in range(4)], dim=1)
    bending = sum_rows(of[:, Number.BENDING :] * pairs)
    freedom = (window**2 - 4) * limits.VALUE_NOISE
    unit = of[:, Number.COVARIANCE_XX : Number.COVARIANCE_XX + 1]
    # A covariance is proportional to the noise variance of a pixel, so one ratio scales all components.
    noise = covariance[..., 0, 0][:, None] / unit
    least = torch.minimum(noise, of[:, Number.NOISE : Number.NOISE + 1])
    remaining = torch.maximum(noise - bending / freedom, least)
    return covariance * (remaining / noise.clamp_min(_TINY)).mT[..., None]


def _or_zero(values: Tensor) -> Tensor:
    """Return values with 0 in place of NaN and infinities."""
    return torch.where(finite(values), values, 0.0)
