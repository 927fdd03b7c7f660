"""Sums over leading axes as products with ones: ONNX Runtime reduces these axes up to ten times as slowly."""

from torch import Tensor


def sum_rows(values: Tensor) -> Tensor:
    """(..., 1, P) of (..., K, P), K fixed."""
    return values.new_ones(1, values.shape[-2]) @ values
