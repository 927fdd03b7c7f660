"""Check whether the compiled kernels can be used for given tensors in the present state of torch."""

import functools
import os
import shutil
from collections.abc import Callable
from importlib.util import find_spec
from typing import Any, TypeVar

import torch
from torch import Tensor

from fingerflow.kernels.library import is_present

LARGEST_FUSED = 57  # px, largest side of a window of the fused kernel; with its margin it fills a tile of 64 x 64

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
    """Return whether torch ops are being traced or intercepted by a dispatch mode or functorch.

    The torch compiler does not count.
    """
    return (
        torch.jit.is_tracing()  # type: ignore[attr-defined, no-untyped-call]
        or torch._C._len_torch_dispatch_stack() > 0
        or torch._C._are_functorch_transforms_active()
    )


def fused_serves(*tensors: Tensor | None) -> bool:
    """Return whether GPU kernels of Triton (`fused_*`) can be used for the given tensors.

    They need Triton and a GPU of CUDA, compute in float32, and give no derivatives. Compilers and exporters see the
    portable form.
    """
    if torch.compiler.is_compiling() or is_recorded() or not _has_triton():
        return False
    return all(one is None or (one.dtype != torch.float64 and _is_on_gpu(one)) for one in tensors)


def fused_tracking_serves(samples: Tensor, *tensors: Tensor) -> bool:
    """Return whether the kernel of `fused_tracking` can be used for the `samples` of templates and the other tensors:
    as `fused_serves`, and the windows fit into its tiles.
    """
    return samples.shape[-1] <= LARGEST_FUSED**2 and fused_serves(samples, *tensors)


def twin_serves(*tensors: Tensor | None) -> bool:
    """Return whether a compiled kernel or one of Triton can be used in place of the portable form."""
    return serve(*tensors) or fused_serves(*tensors)


@functools.cache
def _has_triton() -> bool:
    """Return whether Triton is installed, and a C compiler with which it builds the launchers of its kernels."""
    compilers = (os.environ.get("CC"), "cc", "gcc", "clang")
    return find_spec("triton") is not None and any(name is not None and shutil.which(name) for name in compilers)


def _is_on_gpu(tensor: Tensor) -> bool:
    return tensor.is_cuda and not (tensor.requires_grad and torch.is_grad_enabled())


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
