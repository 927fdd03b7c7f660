"""When the values of tensors may decide what is computed."""

import torch
from torch import Tensor

from fingerflow.kernels.tensors.serving import is_recorded


def looks(*tensors: Tensor | None) -> bool:
    """Whether it is worth looking into tensors for what needs no work: where nothing is traced, so that shapes may
    depend on values, and where looking costs no wait for a device.
    """
    traced = torch.compiler.is_compiling() or is_recorded()
    return not traced and all(one is None or (type(one) is Tensor and one.is_cpu) for one in tensors)
