"""Sums over leading axes as products with ones: ONNX Runtime reduces these axes up to ten times as slowly."""

from torch import Tensor


def sum_first(values: Tensor) -> Tensor:
    """(...) of (K, ...), K fixed."""
    return sum_rows(values.flatten(1)).reshape(values.shape[1:]) if values.ndim > 2 else sum_rows(values)


def sum_rows(values: Tensor) -> Tensor:
    """(..., P) of (..., K, P), K fixed."""
    return (values.new_ones(1, values.shape[-2]) @ values).squeeze(-2)
