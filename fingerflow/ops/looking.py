"""When the values of tensors may decide what is computed."""

import torch
from torch import Tensor


def looks(*tensors: Tensor | None) -> bool:
    """Whether it is worth looking into tensors for what needs no work: where nothing is traced, so that shapes may
    depend on values, and where looking costs no wait for a device.
    """
    traced = (
        torch.compiler.is_compiling()
        or torch.jit.is_tracing()  # type: ignore[attr-defined, no-untyped-call]
        or torch._C._len_torch_dispatch_stack() > 0
        or torch._C._are_functorch_transforms_active()
    )
    return not traced and all(one is None or (type(one) is Tensor and one.is_cpu) for one in tensors)
