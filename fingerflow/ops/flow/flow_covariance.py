"""Covariance of dense flow due to the noise of the images.

No compiled twin.
"""

import math

import torch
from torch import Tensor

from fingerflow.kernels import tracking_limits as limits

_RIDGE_NOISE = 0.86  # share of the noise power that passes the low-pass of the spline at a period of 15 px
_TINY = 1e-12


def flow_covariance(tensor: Tensor, variance: Tensor, alpha: Tensor, rho_square: float, of_noise: Tensor) -> Tensor:
    """Return the covariance xx, xy, yy (B, 3, h, w), px^2, of a dense flow due to image noise, from the structure
    tensor J and the smoothness weight alpha, for images of equal illumination (a gain of 1).

    It assumes that J changes little over the smoothing length. A component along which J is l has the variance of noise
    of density s^2 filtered by l K(k) / (l + alpha k^2). With the two boxes approximated by a Gaussian of variance rho^2
    along each axis this is s^2 / (4 pi alpha) (1 - z e^z E1(z)), z = rho^2 l / alpha. NaN where the texture does not
    exceed the noise.

    Args:
        tensor: (B, 3, h, w) J.
        variance: (B,) of the noise.
        alpha: (B, 1, 1, 1), or (B, 1, h, w) if it differs between cells.
        rho_square: variance of the window, px^2.
        of_noise: (B,) eigenvalue of J for noise alone.
    """
    variance, of_noise = variance[:, None, None, None], of_noise[:, None, None, None]
    xx, xy, yy = tensor[:, :1], tensor[:, 1:2], tensor[:, 2:]
    mean, half = (xx + yy) / 2, (xx - yy) / 2
    gap = (half * half + xy * xy).sqrt()
    density = 2 * variance * _RIDGE_NOISE
    of_larger, of_smaller = (
        density / (4 * math.pi * alpha) * _passed(rho_square * (eigenvalue / alpha).clamp_min(_TINY))
        for eigenvalue in (mean + gap, (mean - gap).clamp_min(0))
    )
    # Apply a function f to a symmetric matrix J:
    # f(J) = f(smaller) + (f(larger) - f(smaller)) (J - smaller) / (larger - smaller).
    slope = (of_larger - of_smaller) / (2 * gap).clamp_min(_TINY)
    textured = mean + gap > limits.TEXTURE_TO_NOISE * of_noise
    mask = torch.where(textured, 0.0, torch.nan).to(slope.dtype)
    return torch.cat((of_smaller + slope * (gap + half), slope * xy, of_smaller + slope * (gap - half)), dim=1) + mask


def _passed(z: Tensor) -> Tensor:
    """Return the share of the flow's noise variance that averaging over windows leaves, 1 - z e^z E1(z) with the
    exponential integral E1; z is window variance times structure-tensor eigenvalue over smoothness weight.

    The argument z is positive. The value is accurate to 5e-5 (Abramowitz & Stegun, 5.1.53 and 5.1.56).
    """
    small = z.clamp_max(1.0)
    series = 0.99999193 + small * (-0.24991055 + small * (0.05519968 + small * (-0.00976004 + small * 0.00107857)))
    below = small * small.exp() * (series * small - 0.57721566 - small.log())
    large = z.clamp(1.0, 1e6)
    above = (large * (large + 2.334733) + 0.250621) / (large * (large + 3.330657) + 1.681534)
    return 1 - torch.where(z < 1, below, above)
