"""Spline interpolation of images: uniform cubic B-splines on binomially smoothed samples.

An image is represented as S(x, y) = sum_kl c[l, k] b(x - k) b(y - l), b the centred B-spline. The coefficients c are
the samples smoothed once by [1 2 1]/4 in x and y. There is no inverse filter, so S is the image after one fixed
low-pass filter. It is the same for both images of a pair and therefore does not change their shift. It has two
advantages over an exact interpolant:

- With exact cubic interpolation the noise of the template and of its own gradient correlate at fractional positions.
  That biases the estimate: 0.04 px at noise of 2 grey levels, 0.26 px at 5 on ridge texture. The low-pass removes the
  bias.
- The gradient has at most 1/30 of the noise variance. The estimate stays at the Cramer-Rao bound at 5 grey levels, and
  no recursive filter has to run over the frame.

Compiled twin, of the coefficients: `kernels/spline.cpp`.
"""

import torch
import torch.nn.functional as F
from torch import Tensor

from fingerflow.kernels.tensors import Twin, twin

_compiled: Twin[Tensor] = twin("spline_coefficients")


def spline_coefficients(images: Tensor) -> Tensor:
    """Compute the cubic B-spline coefficients of images.

    Args:
        images: (B, 1, H, W), any real dtype; H and W at least 2. Beyond the border the nearest pixel counts.

    Returns:
        (B, 1, H, W), float64 for float64 images, else float32.
    """
    if _compiled.serves(images):
        return _compiled(images)
    x = images if images.dtype in (torch.float32, torch.float64) else images.to(torch.float32)
    x = F.pad(x, (1, 1, 1, 1), mode="replicate") if x.shape[0] else x.new_zeros((0, 1, x.shape[2] + 2, x.shape[3] + 2))
    x = x[..., :-2, :] + 2 * x[..., 1:-1, :] + x[..., 2:, :]
    return (x[..., :-2] + 2 * x[..., 1:-1] + x[..., 2:]) / 16


def spline_weights(fraction: Tensor) -> tuple[tuple[Tensor, ...], tuple[Tensor, ...]]:
    """Compute the weights of the four cubic B-spline coefficients around a position on one axis: those that give the
    value of the spline, and those that give its derivative.

    Args:
        fraction: position minus its floor, any shape, in [0, 1).

    Returns:
        Two tuples of four tensors; the first is for the coefficient at ``floor - 1``.
    """
    rest = 1 - fraction
    # Evaluate the four pieces of the cubic B-spline (Unser 1999), from b3(1 + t) at one end to b3(2 - t) at the other.
    square, rest_square = fraction * fraction, rest * rest
    value = (
        rest_square * rest / 6,
        2 / 3 + square * (fraction / 2 - 1),
        2 / 3 + rest_square * (rest / 2 - 1),
        square * fraction / 6,
    )
    slope = (rest_square / -2, fraction * (1.5 * fraction - 2), rest * (2 - 1.5 * rest), square / 2)
    return value, slope
