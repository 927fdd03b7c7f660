"""What a deformation that a template does not know does to a point found by it: E = F F_0^-1 - I of the skin since.

To first order a point appears displaced by D E, D the template's own (`Number.LEAN`). What E bends within the window
stays in the residual, e'Qe (`Number.BENDING`), where it would count as noise.

Everything has its components before points, (B, K, N): runtimes are slow where the last axis is short.
"""

import torch
from torch import Tensor

from fingerflow.kernels import tracking_limits as limits
from fingerflow.kernels.tracking_limits import Number
from fingerflow.ops.tensors import sum_rows

_TINY = 1e-20


def displaced(numbers: Tensor, unknown: Tensor) -> Tensor:
    """px (B, 2, N) by which points appear displaced, for `Templates.numbers` (B, 32, N) and E (B, 4, N)."""
    lean = numbers[:, Number.LEAN : Number.LEAN + 8].unflatten(1, (2, 4))
    return sum_rows(lean * unknown[:, None]).squeeze(2)


def edge_shift(unknown: Tensor, window: int) -> Tensor:
    """px (B, N) by which E (B, 4, N) moves the edge of a window."""
    return window // 2 * sum_rows(unknown * unknown).squeeze(1).sqrt()


def less_bending(covariance: Tensor, numbers: Tensor, unknown: Tensor, window: int) -> Tensor:
    """Covariances (B, N, 2, 2) px^2 without what the residual owes to E (B, 4, N); of the noise of the key frame they
    keep what is due at least.
    """
    pairs = torch.cat([unknown[:, k : k + 1] * unknown[:, k:] for k in range(4)], dim=1)
    bending = sum_rows(numbers[:, Number.BENDING :] * pairs)
    freedom = (window**2 - 4) * limits.VALUE_NOISE
    unit = numbers[:, Number.COVARIANCE_XX : Number.COVARIANCE_XX + 1]
    # All of a covariance is in proportion to the variance of a pixel: one ratio says how much of it remains.
    noise = covariance[..., 0, 0][:, None] / unit
    least = torch.minimum(noise, numbers[:, Number.NOISE : Number.NOISE + 1])
    remaining = torch.maximum(noise - bending / freedom, least)
    return covariance * (remaining / noise.clamp_min(_TINY)).mT[..., None]
