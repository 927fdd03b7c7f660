"""Small things that ONNX Runtime does several times as fast in another form."""

import math

import torch
from torch import Tensor


def components_first(points: Tensor) -> Tensor:
    """(B, N, K) to (B, K, N); one that is NaN in a component is so in all.

    A product, which takes the transposition into itself: alone it would be moved behind all that follows. Runtimes are
    slow where the last axis is short.
    """
    return torch.eye(points.shape[2], dtype=points.dtype, device=points.device) @ points.transpose(1, 2)


def finite(values: Tensor) -> Tensor:
    """(...) bool of floating values: two operations where `isfinite` takes four."""
    return values.abs() < math.inf


def sum_rows(values: Tensor) -> Tensor:
    """(..., 1, P) of (..., K, P), K fixed, as a product with ones: a sum over such an axis is ten times as slow."""
    return values.new_ones(1, values.shape[-2]) @ values


def bytes_of(mask: Tensor) -> Tensor:
    """Return a mask (...) bool as uint8, 0 or 1: a view of the same memory, or a cast while a graph is exported."""
    return mask.to(torch.uint8) if torch.compiler.is_exporting() else mask.view(torch.uint8)
