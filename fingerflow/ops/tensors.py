"""Elementary tensor operations, written in forms that ONNX Runtime executes fast."""

import math
from functools import cache

import torch
from torch import Tensor


def components_first(points: Tensor) -> Tensor:
    """Transpose points (B, N, K) to components first, (B, K, N); NaN in one component makes the whole point NaN.

    Runtimes are slow where the last axis is short. The transposition is part of a matrix product, because an optimiser
    would move a separate transposition behind the operations that follow.
    """
    return torch.eye(points.shape[2], dtype=points.dtype, device=points.device) @ points.transpose(1, 2)


def finite(values: Tensor) -> Tensor:
    """Return a mask of the finite values, as `torch.isfinite`, but with two operations instead of four."""
    return values.abs() < math.inf


def sum_rows(values: Tensor) -> Tensor:
    """Sum a tensor (..., K, P) over the second-last axis, of fixed length K: return (..., 1, P).

    It is a product with ones: a reduction over such an axis takes ten times as long.
    """
    return values.new_ones(1, values.shape[-2]) @ values


def scalar_products(left: Tensor, right: Tensor) -> Tensor:
    """Return the scalar products (B, K, L) of K and L vectors of M elements, (B, K, M) and (B, L, M).

    An exported graph multiplies a matrix with one vector at a time: ONNX runtimes pack the factors of a product of
    two matrices, which takes twice the time where K and L are small.
    """
    if torch.compiler.is_exporting():
        return (left[:, None] @ right[..., None]).squeeze(3).mT
    return left @ right.mT


def symmetric(three: Tensor) -> Tensor:
    """Return symmetric 2 x 2 matrices (B, 2, 2, Q), given the elements xx, xy and yy (B, 3, Q)."""
    xx, xy, yy = three.split(1, dim=1)
    return torch.cat((xx, xy, xy, yy), dim=1).unflatten(1, (2, 2))


def half_angle(y: Tensor, x: Tensor) -> Tensor:
    """Return half the angle of vectors (x, y), rad, from -pi/2 to pi/2: half of `torch.atan2(y, x)`.

    An exported graph takes three more halves of the angle by square roots, and a power series of the rest, to 1e-6 rad:
    ONNX Runtime has no arctangent for a GPU.
    """
    if not torch.compiler.is_exporting():
        return torch.atan2(y, x) / 2
    length = (x * x + y * y).sqrt().clamp_min(torch.finfo(x.dtype).tiny ** 0.5)
    larger = ((1 + x.abs() / length) / 2).sqrt()  # the larger one of cosine and sine of half the angle
    smaller = y.abs() / length / (2 * larger)
    tangent = torch.where(x < 0, larger / (1 + smaller), smaller / (1 + larger))  # of a fourth of the angle
    for _ in range(2):
        tangent = tangent / (1 + (1 + tangent * tangent).sqrt())
    square = tangent * tangent
    series = 1 - square * (1 / 3 - square * (1 / 5 - square * (1 / 7 - square / 9)))
    return torch.where(y < 0, -8.0, 8.0) * tangent * series


def hypotenuse(x: Tensor, y: Tensor) -> Tensor:
    """Return the lengths (...) of vectors with components x and y (...), as `torch.hypot`.

    ONNX has no such operator. An exported graph takes the root of the sum of squares, relative to the larger component
    so that no square overflows.
    """
    if not torch.compiler.is_exporting():
        return torch.hypot(x, y)
    larger, smaller = torch.maximum(x.abs(), y.abs()), torch.minimum(x.abs(), y.abs())
    ratio = smaller / larger.clamp_min(torch.finfo(x.dtype).tiny)
    return larger * (1 + ratio * ratio).sqrt()


def products(left: Tensor, right: Tensor) -> Tensor:
    """Return the matrix products (..., I, K, Q) of matrices (..., I, 2, Q) and (..., 2, K, Q).

    Written out, since batched products of small matrices take longer.
    """
    first, second = left.split(1, dim=-2)
    upper, lower = right.split(1, dim=-3)
    return first * upper + second * lower


def bordered(image: Tensor, border: int) -> Tensor:
    """Extend an image (B, 1, H, W) of any dtype by `border` replicated pixels on every side.

    Neither torch nor GPU runtimes pad bytes.
    """
    for dim in (2, 3):
        ends = image.narrow(dim, 0, 1), image.narrow(dim, image.shape[dim] - 1, 1)
        shape = [border if k == dim else -1 for k in range(4)]
        before, after = (end.expand(shape) for end in ends)
        image = torch.cat((before, image, after), dim=dim)
    return image


def count_bytes(mask: Tensor) -> Tensor:
    """Convert a bool mask to uint8 (0 or 1), without a copy unless a graph is exported."""
    return mask.to(torch.uint8) if torch.compiler.is_exporting() else mask.view(torch.uint8)


def constant_like(constant: Tensor, like: Tensor) -> Tensor:
    """Return a constant on the device and with the dtype of another tensor; copies on a device are cached."""
    if like.device == constant.device or torch.compiler.is_compiling():
        return constant.to(like)
    return _copy_to(constant, like.device, like.dtype)


@cache
def _copy_to(constant: Tensor, device: torch.device, dtype: torch.dtype) -> Tensor:
    with torch.inference_mode(False):  # otherwise autograd could not use the constant later
        return constant.to(device, dtype)
