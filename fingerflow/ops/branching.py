"""Test whether an op may branch on tensor values, which it may not while torch traces, exports or compiles."""

import torch
from torch import Tensor

from fingerflow.kernels.tensors.serving import is_recorded


def may_branch(*tensors: Tensor | None) -> bool:
    """Return whether Python code may read the values of `tensors` to choose a branch or a shape: only while torch
    neither traces, compiles nor exports, and if all tensors lie on the CPU.

    It must not while torch traces or compiles, nor for tensors off the CPU, where it would wait for the device.
    """
    traced = torch.compiler.is_compiling() or is_recorded()
    return not traced and all(tensor is None or (type(tensor) is Tensor and tensor.is_cpu) for tensor in tensors)
