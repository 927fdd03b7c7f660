"""Check whether the compiled kernels can be used for given tensors in the present state of torch."""

from collections.abc import Callable
from typing import Any, TypeVar

import torch
from torch import Tensor

from fingerflow.kernels.library import is_present

_F = TypeVar("_F", bound=Callable[..., Any])


def constant_to_compiler(function: _F) -> _F:
    """Mark a function whose result the torch compiler uses as a constant, without tracing the function.

    This does what `torch.compiler.assume_constant_result` does, without loading the compiler: a quarter of the start-up
    time.
    """
    function._dynamo_marked_constant = True  # type: ignore[attr-defined]
    return function


def serve(*tensors: Tensor | None) -> bool:
    """Return whether the compiled kernels can be used for the given tensors in the present state of torch.

    They may while torch compiles, as registered ops (`torch_op`), but not while it traces or exports the portable form.
    """
    if torch.compiler.is_compiling():
        if torch.compiler.is_exporting() or not _is_present():
            return False
    elif not is_present() or is_recorded():
        return False
    for tensor in tensors:  # noqa: SIM110  a generator takes half a microsecond more
        if tensor is not None and not _is_plain(tensor):
            return False
    return True


def is_recorded() -> bool:
    """Return whether torch ops are being traced, differentiated in forward mode, or intercepted by a dispatch mode or
    functorch.

    The torch compiler does not count.
    """
    return (
        torch.jit.is_tracing()  # type: ignore[attr-defined, no-untyped-call]
        or torch.autograd.forward_ad._current_level >= 0
        or torch._C._len_torch_dispatch_stack() > 0
        or torch._C._are_functorch_transforms_active()
    )


@constant_to_compiler
def _is_present() -> bool:
    return is_present()


def _is_plain(tensor: Tensor) -> bool:
    return (
        type(tensor) is Tensor
        and tensor.is_cpu
        and tensor.layout == torch.strided
        and not (tensor.requires_grad and torch.is_grad_enabled())
    )
