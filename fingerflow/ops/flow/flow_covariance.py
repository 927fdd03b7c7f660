"""What noise leaves in dense flow."""

import math

import torch
from torch import Tensor

from fingerflow.kernels import tensors as kernels
from fingerflow.kernels import tracking_limits as limits

_RIDGE_NOISE = 0.86  # share of the variance of noise that the low-pass of the spline leaves at a period of 15 px
_TINY = 1e-12


def flow_covariance(tensor: Tensor, variance: Tensor, alpha: Tensor, rho_square: float, of_noise: Tensor) -> Tensor:
    """(B, 3, h, w) xx, xy, yy of the noise of both images, in the same light.

    Where J changes little within its reach, a component along which J is l has the variance of noise of density s^2
    that passed through l K(k) / (l + alpha k^2): with the two boxes as a Gaussian of variance rho^2 each way,
    s^2 / (4 pi alpha) (1 - z e^z E1(z)), z = rho^2 l / alpha. `alpha` may differ from cell to cell, (B, 1, h, w), or is
    (B, 1, 1, 1); the variance of noise is (B,), as the eigenvalues of J that noise alone has.
    """
    if (
        tensor.dtype == torch.float32
        and alpha.numel() == len(alpha)
        and kernels.serve(tensor, alpha, variance, of_noise)
    ):
        density, textured = 2 * variance * _RIDGE_NOISE, limits.TEXTURE_TO_NOISE * of_noise
        return kernels.flow_covariance(tensor, density, alpha.flatten(), textured, rho_square)
    variance, of_noise = variance[:, None, None, None], of_noise[:, None, None, None]
    xx, xy, yy = tensor[:, :1], tensor[:, 1:2], tensor[:, 2:]
    mean, half = (xx + yy) / 2, (xx - yy) / 2
    apart = (half * half + xy * xy).sqrt()
    density = 2 * variance * _RIDGE_NOISE
    of_larger, of_smaller = (
        density / (4 * math.pi * alpha) * _passed(rho_square * (one / alpha).clamp_min(_TINY))
        for one in (mean + apart, (mean - apart).clamp_min(0))
    )
    # A function of a symmetric matrix: f(J) = f(smaller) + (f(larger) - f(smaller)) (J - smaller) / (larger - smaller).
    slope = (of_larger - of_smaller) / (2 * apart).clamp_min(_TINY)
    textured = mean + apart > limits.TEXTURE_TO_NOISE * of_noise
    known = torch.where(textured, 0.0, torch.nan).to(slope.dtype)
    return (
        torch.cat((of_smaller + slope * (apart + half), slope * xy, of_smaller + slope * (apart - half)), dim=1) + known
    )


def _passed(z: Tensor) -> Tensor:
    """1 - z e^z E1(z) for z > 0, to 5e-5 (Abramowitz & Stegun, 5.1.53 and 5.1.56)."""
    small = z.clamp_max(1.0)
    series = 0.99999193 + small * (-0.24991055 + small * (0.05519968 + small * (-0.00976004 + small * 0.00107857)))
    below = small * small.exp() * (series * small - 0.57721566 - small.log())
    large = z.clamp(1.0, 1e6)
    above = (large * (large + 2.334733) + 0.250621) / (large * (large + 3.330657) + 1.681534)
    return 1 - torch.where(z < 1, below, above)
