"""Rounding to bytes by one operation of ONNX: clamp, round and cast are a pass over the frame each."""

import torch
from torch import Tensor, library


@library.custom_op("fingerflow::nearest_byte", mutates_args=())
def nearest_byte(values: Tensor) -> Tensor:
    """The whole numbers 0 to 255 (uint8) nearest to float32 values, of two that are as near the even one.

    In a graph, QuantizeLinear with a scale of 1 (`export`).
    """
    return values.clamp(0, 255).round().to(torch.uint8)


@nearest_byte.register_fake
def _(values: Tensor) -> Tensor:
    return torch.empty_like(values, dtype=torch.uint8)
