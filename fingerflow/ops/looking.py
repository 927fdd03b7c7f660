"""Test whether an op may branch on tensor values, which it may not while torch traces, exports or compiles."""

import torch
from torch import Tensor

from fingerflow.kernels.tensors.serving import is_recorded


def looks(*tensors: Tensor | None) -> bool:
    """Return True if code may depend on the values of `tensors`, for branches or shapes.

    It may not while torch traces or compiles, nor for tensors off the CPU, where it would wait for the device.
    """
    traced = torch.compiler.is_compiling() or is_recorded()
    return not traced and all(one is None or (type(one) is Tensor and one.is_cpu) for one in tensors)
