"""Whether numbers are finite, in two operations of ONNX where `isfinite` takes four."""

import math

from torch import Tensor


def finite(values: Tensor) -> Tensor:
    """(...) bool of floating values."""
    return values.abs() < math.inf
