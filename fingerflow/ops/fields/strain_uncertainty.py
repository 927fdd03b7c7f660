"""Standard deviations of divergence, curl and strain from the covariance of a displacement gradient.

The covariance (..., 2, 2, 2, 2) is that of `LocalFit`: [..., i, j, k, l] = cov(d u_i / d x_j, d u_k / d x_l).

Variances are propagated to first order: g Σ gᵀ, with the derivatives g of a quantity by the gradient (JCGM 100:2008,
equation 13). No twin of their own: `kernels/area_medians.cpp` and `fields_of_frames.cpp` compute the same.
"""

import torch
from torch import Tensor

from fingerflow.ops.fields.strain import sensitivity_parts


def divergence_std(covariance: Tensor) -> Tensor:
    """Return the standard deviation (...) of the divergence du/dx + dv/dy."""
    ux, vy = covariance[..., 0, 0, :, :], covariance[..., 1, 1, :, :]
    return _root(ux[..., 0, 0] + ux[..., 1, 1] + vy[..., 0, 0] + vy[..., 1, 1])


def curl_std(covariance: Tensor) -> Tensor:
    """Return the standard deviation (...) of the curl dv/dx - du/dy, in rad."""
    uy, vx = covariance[..., 0, 1, :, :], covariance[..., 1, 0, :, :]
    return _root(vx[..., 1, 0] - vx[..., 0, 1] - uy[..., 1, 0] + uy[..., 0, 1])


def field_std(gradient: Tensor, covariance: Tensor, measure: str = "green_lagrange") -> Tensor:
    """Return the standard deviations (..., 5) of divergence, curl, exx, eyy and exy, by first-order propagation."""
    ux, uy, vx, vy = gradient.flatten(-2).unbind(-1)
    parts = sensitivity_parts(ux, uy, vx, vy, measure)
    sensitivity = torch.stack(parts, dim=-1).unflatten(-1, (5, 2, 2))
    rows, columns = sensitivity[..., :, :, None, None], sensitivity[..., None, None, :, :]
    return _root((rows * covariance[..., None, :, :, :, :] * columns).sum((-4, -3, -2, -1)))


def _root(variance: Tensor) -> Tensor:
    """Return the square roots of variances; variances that rounding made negative count as 0."""
    return variance.clamp(min=0).sqrt()
