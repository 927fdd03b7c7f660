"""When the values of tensors may decide what is computed."""

import torch
from torch import Tensor

from fingerflow.kernels import tensors as kernels


def looks(*tensors: Tensor) -> bool:
    """Whether it is worth looking into tensors for what needs no work: where nothing is traced, so that shapes may
    depend on values, and where looking costs no wait for a device.
    """
    return kernels.serve(*tensors) and not torch.compiler.is_compiling()
