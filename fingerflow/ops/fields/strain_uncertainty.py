"""Standard deviations of divergence, curl and strain from the covariance of a displacement gradient.

The covariance (..., 2, 2, 2, 2) is that of `LocalFit`: [..., i, j, k, l] = cov(d u_i / d x_j, d u_k / d x_l).
"""

import torch
from torch import Tensor

from fingerflow.ops.fields.strain import STRAIN_MEASURES


def divergence_std(covariance: Tensor) -> Tensor:
    """Return the standard deviation (...) of the divergence du/dx + dv/dy."""
    ux, vy = covariance[..., 0, 0, :, :], covariance[..., 1, 1, :, :]
    return _root(ux[..., 0, 0] + ux[..., 1, 1] + vy[..., 0, 0] + vy[..., 1, 1])


def curl_std(covariance: Tensor) -> Tensor:
    """Return the standard deviation (...) of the curl dv/dx - du/dy, in rad."""
    uy, vx = covariance[..., 0, 1, :, :], covariance[..., 1, 0, :, :]
    return _root(vx[..., 1, 0] - vx[..., 0, 1] - uy[..., 1, 0] + uy[..., 0, 1])


def sensitivity_parts(ux: Tensor, uy: Tensor, vx: Tensor, vy: Tensor, measure: str) -> list[Tensor]:
    """Return the derivatives of divergence, curl, exx, eyy and exy with respect to the elements du/dx, du/dy, dv/dx and
    dv/dy of a displacement gradient: 20 separate tensors, four of each field in turn.

    The elements of the gradient are separate tensors, too.
    """
    if measure not in STRAIN_MEASURES:
        raise ValueError(f"strain measure {measure!r} is not known: choose one of {', '.join(STRAIN_MEASURES)}")
    none, unit = torch.zeros_like(ux), torch.ones_like(ux)
    # Derivatives of e_ij = (F_ki F_kj - delta_ij) / 2 with F = I + gradient; for infinitesimal strain F is I.
    identity, moved = (unit, none, none, unit), (1 + ux, uy, vx, 1 + vy)
    xx, xy, yx, yy = identity if measure == "infinitesimal" else moved
    divergence, curl = (unit, none, none, unit), (none, -unit, unit, none)
    exx, eyy = (xx, none, yx, none), (none, xy, none, yy)
    xx, xy, yx, yy = (part / 2 for part in (moved if measure == "green_lagrange" else identity))
    return [*divergence, *curl, *exx, *eyy, xy, xx, yy, yx]


def field_std(gradient: Tensor, covariance: Tensor, measure: str = "green_lagrange") -> Tensor:
    """Return the standard deviations (..., 5) of divergence, curl, exx, eyy and exy, by first-order propagation."""
    (ux, uy), (vx, vy) = (row.unbind(-1) for row in gradient.unbind(-2))
    sensitivity = torch.stack(sensitivity_parts(ux, uy, vx, vy, measure), dim=-1).unflatten(-1, (5, 2, 2))
    rows, columns = sensitivity[..., :, :, None, None], sensitivity[..., None, None, :, :]
    return _root((rows * covariance[..., None, :, :, :, :] * columns).sum((-4, -3, -2, -1)))


def strain_covariance_parts(
    xx: Tensor, xy: Tensor, yy: Tensor, uu: Tensor, uv: Tensor, vv: Tensor
) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Return the variances of exx, eyy and exy, and the covariance of exx and eyy, that the displacement error at one
    corner of a triangle causes in the triangle's strain.

    The displacement (u, v) of a corner of slope s adds s_x u to exx, s_y v to eyy and (s_y u + s_x v) / 2 to exy. Skin
    that is already stretched by some per cent makes this wrong by about as much, for all measures.

    Args:
        xx, xy, yy: products of the components of the corner's slope (`triangle_slopes`).
        uu, uv, vv: covariance of the corner's displacement, independent of the other corners; the sum over corners is
            the covariance of the strain.
    """
    return xx * uu, yy * vv, (yy * uu + 2 * xy * uv + xx * vv) / 4, xy * uv


def _root(variance: Tensor) -> Tensor:
    """Return the square roots of variances; variances that rounding made negative count as 0."""
    return variance.clamp(min=0).sqrt()
