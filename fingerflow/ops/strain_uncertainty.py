"""Standard deviations of divergence, curl and strain from the covariance of a displacement gradient.

The covariance (..., 2, 2, 2, 2) is that of `LocalFit`: [..., i, j, k, l] = cov(d u_i / d x_j, d u_k / d x_l).
"""

import torch
from torch import Tensor

from fingerflow.ops.strain import STRAIN_MEASURES


def divergence_std(covariance: Tensor) -> Tensor:
    """Standard deviation (...) of du/dx + dv/dy."""
    ux, vy = covariance[..., 0, 0, :, :], covariance[..., 1, 1, :, :]
    return _root(ux[..., 0, 0] + ux[..., 1, 1] + vy[..., 0, 0] + vy[..., 1, 1])


def curl_std(covariance: Tensor) -> Tensor:
    """Standard deviation (...) of dv/dx - du/dy, in rad."""
    uy, vx = covariance[..., 0, 1, :, :], covariance[..., 1, 0, :, :]
    return _root(vx[..., 1, 0] - vx[..., 0, 1] - uy[..., 1, 0] + uy[..., 0, 1])


def strain_std(gradient: Tensor, covariance: Tensor, measure: str = "green_lagrange") -> Tensor:
    """Standard deviations (..., 3) of the (exx, eyy, exy) that `green_lagrange` gives for this gradient and measure.

    First order in the error of the gradient, which is exact for "infinitesimal". Raises ValueError for another measure.
    """
    return _deviation(strain_sensitivity(gradient, measure), covariance[..., None, :, :, :, :])


def strain_sensitivity(gradient: Tensor, measure: str = "green_lagrange") -> Tensor:
    """Derivatives (..., 3, 2, 2) of (exx, eyy, exy) by the displacement gradient, at this gradient (..., 2, 2).

    Raises ValueError for another measure.
    """
    if measure not in STRAIN_MEASURES:
        raise ValueError(f"strain measure {measure!r} is not known: choose one of {', '.join(STRAIN_MEASURES)}")
    # With F = I + gradient, the derivatives of e_ij = (F_ki F_kj - delta_ij) / 2; without the squares F is I.
    identity = torch.eye(2, dtype=gradient.dtype, device=gradient.device).expand_as(gradient)
    direct = identity if measure == "infinitesimal" else identity + gradient
    mixed = identity + gradient if measure == "green_lagrange" else identity
    none = torch.zeros_like(direct[..., 0])
    exx = torch.stack((direct[..., 0], none), dim=-1)
    eyy = torch.stack((none, direct[..., 1]), dim=-1)
    exy = torch.stack((mixed[..., 1], mixed[..., 0]), dim=-1) / 2
    return torch.stack((exx, eyy, exy), dim=-3)


def field_std(gradient: Tensor, covariance: Tensor, measure: str = "green_lagrange") -> Tensor:
    """Standard deviations (..., 5) of divergence, curl, exx, eyy and exy, to first order."""
    return _deviation(field_sensitivity(gradient, measure), covariance[..., None, :, :, :, :])


def field_sensitivity(gradient: Tensor, measure: str = "green_lagrange") -> Tensor:
    """Derivatives (..., 5, 2, 2) of divergence, curl, exx, eyy and exy by the displacement gradient."""
    rows = [[[1.0, 0.0], [0.0, 1.0]], [[0.0, -1.0], [1.0, 0.0]]]
    plain = torch.tensor(rows, dtype=gradient.dtype, device=gradient.device).expand(*gradient.shape[:-2], 2, 2, 2)
    return torch.cat((plain, strain_sensitivity(gradient, measure)), dim=-3)


def strain_covariance(slopes: Tensor, covariance: Tensor) -> Tensor:
    """What each corner of a triangle adds to the covariance of its strain: (..., 3, 4), exx, eyy, exy and exx with eyy.

    Args:
        slopes: (..., 3, 2) of `triangle_slopes`.
        covariance: (..., 3, 2, 2) of the displacement of each corner, independent of the others; the sum over corners
            is that of the strain.

    The displacement (u, v) of a corner of slope s adds s_x u to exx, s_y v to eyy and (s_y u + s_x v) / 2 to exy. Where
    skin is already stretched by some per cent, strains of all measures are off by as much more or less.
    """
    x, y = slopes.unbind(-1)
    uu, uv, vv = covariance[..., 0, 0], covariance[..., 0, 1], covariance[..., 1, 1]
    return torch.stack(strain_covariance_parts(x * x, x * y, y * y, uu, uv, vv), dim=-1)


def strain_covariance_parts(
    xx: Tensor, xy: Tensor, yy: Tensor, uu: Tensor, uv: Tensor, vv: Tensor
) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """The four numbers of `strain_covariance`, each by itself, from products of slopes and a covariance."""
    return xx * uu, yy * vv, (yy * uu + 2 * xy * uv + xx * vv) / 4, xy * uv


def _deviation(sensitivity: Tensor, covariance: Tensor) -> Tensor:
    """sqrt of s' C s for s (..., 2, 2)."""
    products = sensitivity[..., :, :, None, None] * covariance * sensitivity[..., None, None, :, :]
    return _root(products.sum((-4, -3, -2, -1)))


def _root(variance: Tensor) -> Tensor:
    """Rounding below zero counts as zero."""
    return variance.clamp(min=0).sqrt()
