"""Helmholtz-Hodge decomposition of a vector field on a part of the plane: divergence, curl and harmonic parts."""

import math
from typing import NamedTuple

import torch
from torch import Tensor


class Parts(NamedTuple):
    """The three Helmholtz-Hodge parts (B, 2, H, W) of a vector field, whose sum is the field; NaN outside the mask.

    Attributes:
        irrotational: without curl: the flow due to the divergence inside the mask.
        solenoidal: without divergence: the flow due to the curl inside the mask.
        harmonic: without either: due to what lies outside the mask, such as a translation.
    """

    irrotational: Tensor
    solenoidal: Tensor
    harmonic: Tensor


def helmholtz_hodge(field: Tensor, mask: Tensor | None = None) -> Parts:
    """Compute the natural Helmholtz-Hodge decomposition (without boundary conditions) of vector fields.

    Source: Bhatia, Pascucci & Bremer, IEEE TVCG 20(11), 2014. No compiled twin. No boundary condition is imposed: with
    the Green function of the whole plane, G = log|x| / 2 pi,

        irrotational(x) = int_mask grad G(x - y) div f(y) dy,   solenoidal(x) = int_mask J grad G(x - y) curl f(y) dy,

    J (u, v) = (-v, u), and the harmonic part is the remainder. Divergence and curl are central differences, one-sided
    at the border of the mask. The integral of grad G over each pixel is exact. The sum is computed by Fourier
    transforms on twice the frame, so that nothing wraps around. The error is of second order in the pixel size where
    the border of the mask follows the grid, and of first order beside a staircase border.

    The parts do not depend on the size of a pixel, which cancels between the derivative and the integral. A pixel with
    a non-finite value counts as outside the mask, as does one without a neighbour inside it along x or along y, which
    has no derivative. Computed in float32 or wider.

    Args:
        field: (B, 2, H, W) floating, (u, v) by x to the right and y down.
        mask: (B, 1, H, W) bool, all by default; a batch of 1 serves every field.

    Raises:
        TypeError: the field is not floating or the mask not bool.
        ValueError: shapes do not match.

    Convention:
        axes: channels are (u, v), u along x to the right, v along y down.
        sign: the three parts add up to the field.
        pixel centre: values lie at the centres of the pixels.
        dtype: that of the input.
        NaN: in a pixel, counts as outside the mask, where all parts are NaN.
        border: derivatives are one-sided there; no boundary condition.
    """
    _check(field, mask)
    if field.numel() == 0:
        return Parts(field.clone(), field.clone(), field.clone())
    values = field.to(torch.promote_types(torch.float32, field.dtype))
    inside = torch.isfinite(values).all(1, keepdim=True)
    if mask is not None:
        inside = inside & mask
    inside = inside & _has_neighbour(inside, 2) & _has_neighbour(inside, 3)
    values = torch.where(inside, values, 0)
    u, v = values[:, :1], values[:, 1:]
    u_x, u_y = _slope(u, inside, 3), _slope(u, inside, 2)
    v_x, v_y = _slope(v, inside, 3), _slope(v, inside, 2)
    sources = torch.cat((u_x + v_y, v_x - u_y), 1)
    height, width = field.shape[-2:]
    kernel_x, kernel_y = _kernels(height, width, values)
    size = (2 * height, 2 * width)
    spectra = torch.fft.rfft2(sources, s=size)
    along_x, along_y = (
        torch.fft.irfft2(spectra * torch.fft.rfft2(kernel), s=size)[..., :height, :width]
        for kernel in (kernel_x, kernel_y)
    )
    irrotational = torch.stack((along_x[:, 0], along_y[:, 0]), 1)
    solenoidal = torch.stack((-along_y[:, 1], along_x[:, 1]), 1)
    parts = (irrotational, solenoidal, values - irrotational - solenoidal)
    return Parts(*(torch.where(inside, part, torch.nan).to(field.dtype) for part in parts))


def _slope(values: Tensor, inside: Tensor, dim: int) -> Tensor:
    """Return the derivative per pixel along a dimension: central differences, one-sided at the border of the mask."""
    after, before = (_shifted(values, dim, step) for step in (1, -1))
    has_after, has_before = (_shifted(inside, dim, step) for step in (1, -1))
    forward, backward = torch.where(has_after, after - values, 0), torch.where(has_before, values - before, 0)
    number = has_after.to(values.dtype) + has_before.to(values.dtype)
    return torch.where(inside, (forward + backward) / number.clamp(min=1), 0)


def _has_neighbour(inside: Tensor, dim: int) -> Tensor:
    return _shifted(inside, dim, 1) | _shifted(inside, dim, -1)


def _shifted(values: Tensor, dim: int, step: int) -> Tensor:
    """Shift values so that each pixel holds the value `step` pixels further along a dimension; 0 beyond the frame."""
    size = values.shape[dim]
    edge = torch.zeros_like(values.narrow(dim, 0, 1))
    if step > 0:
        return torch.cat((values.narrow(dim, 1, size - 1), edge), dim)
    return torch.cat((edge, values.narrow(dim, 0, size - 1)), dim)


def _kernels(height: int, width: int, like: Tensor) -> tuple[Tensor, Tensor]:
    """Return two convolution kernels, for x and y: the gradient of the Green function G of the Laplacian, per pixel.

    G is the Green function of the plane (`helmholtz_hodge`); each result is (2 H, 2 W). The order is that of a Fourier
    transform: negative distances follow the positive ones.
    """
    # float64 preserves the precision of differences of the antiderivative at all distances within a frame.
    x, y = (
        torch.arange(2 * size, device=like.device, dtype=torch.float64).add(size).remainder(2 * size) - size
        for size in (width, height)
    )
    down, right = torch.meshgrid(y, x, indexing="ij")
    return _integral(right, down).to(like.dtype), _integral(down, right).to(like.dtype)


def _integral(along: Tensor, across: Tensor) -> Tensor:
    """Return the integral of a / (2 pi (a^2 + b^2)) over the unit square around (a, b) = (along, across)."""

    def antiderivative(a: Tensor, b: Tensor) -> Tensor:
        return b / 2 * torch.log(a.square() + b.square()) + a * _arctangent(b / a)

    low_a, high_a, low_b, high_b = along - 0.5, along + 0.5, across - 0.5, across + 0.5
    total = antiderivative(high_a, high_b) - antiderivative(high_a, low_b)
    total = total - antiderivative(low_a, high_b) + antiderivative(low_a, low_b)
    return total / (2 * math.pi)


def _arctangent(tangent: Tensor) -> Tensor:
    """Return the arctangent; in an exported graph that in float32 with one step of Newton's method, as ONNX Runtime has
    sine and cosine in float64, but no arctangent.
    """
    if not torch.compiler.is_exporting():
        return torch.atan(tangent)
    angle = torch.atan(tangent.float()).to(tangent.dtype)
    sine, cosine = angle.sin(), angle.cos()
    return angle + (tangent * cosine - sine) / (cosine + tangent * sine)


def _check(field: Tensor, mask: Tensor | None) -> None:
    if not field.is_floating_point():
        raise TypeError(f"the field must be floating, found {field.dtype}: convert with .float() or .double()")
    if field.dim() != 4 or field.shape[1] != 2:
        raise ValueError(f"the field must have shape (B, 2, H, W), found {tuple(field.shape)}")
    if mask is None:
        return
    if mask.dtype != torch.bool:
        raise TypeError(f"the mask must be bool, found {mask.dtype}")
    if mask.shape[1:] != (1, *field.shape[2:]) or mask.shape[0] not in (1, field.shape[0]):
        shape = (field.shape[0], 1, *field.shape[2:])
        raise ValueError(f"the mask must have shape {shape}, found {tuple(mask.shape)}")
