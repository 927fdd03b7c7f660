"""Elementary tensor operations in forms that ONNX Runtime executes several times as fast."""

import math

import torch
from torch import Tensor


def components_first(points: Tensor) -> Tensor:
    """Transpose points (B, N, K) to (B, K, N); a point with NaN in one component becomes NaN in all.

    Runtimes are slow where the last axis is short. The transposition is part of a matrix product, because an optimiser
    would move a separate transposition behind the operations that follow.
    """
    return torch.eye(points.shape[2], dtype=points.dtype, device=points.device) @ points.transpose(1, 2)


def finite(values: Tensor) -> Tensor:
    """Return True for finite values: two operations where `isfinite` takes four."""
    return values.abs() < math.inf


def sum_rows(values: Tensor) -> Tensor:
    """Return the sum of a tensor (..., K, P) over its axis of K elements, (..., 1, P); K is a fixed number.

    It is a product with ones: a reduction over such an axis takes ten times as long.
    """
    return values.new_ones(1, values.shape[-2]) @ values


def symmetric(three: Tensor) -> Tensor:
    """Return symmetric matrices (B, 2, 2, Q) from their elements xx, xy, yy (B, 3, Q)."""
    xx, xy, yy = three.split(1, dim=1)
    result: Tensor = torch.cat((xx, xy, xy, yy), dim=1).unflatten(1, (2, 2))
    return result


def products(left: Tensor, right: Tensor) -> Tensor:
    """Return the matrix products (..., I, K, Q) of matrices (..., I, 2, Q) and (..., 2, K, Q).

    Written out, since batched products of small matrices take longer.
    """
    first, second = left.split(1, dim=-2)
    upper, lower = right.split(1, dim=-3)
    result: Tensor = first * upper + second * lower
    return result


def bytes_of(mask: Tensor) -> Tensor:
    """Return a mask (...) bool as uint8, 0 or 1: a view of the same memory, or a cast while a graph is exported."""
    return mask.to(torch.uint8) if torch.compiler.is_exporting() else mask.view(torch.uint8)
