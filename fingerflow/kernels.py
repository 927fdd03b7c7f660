"""The compiled twins of some ops: whether they serve, and one typed function for each.

They serve plain tensors on the processor, outside tracing, export, compilation and autograd, and give what the
portable op gives, bit for bit. `FINGERFLOW_KERNELS=0` in the environment turns them off. Where they were not built,
because no C++ compiler was there at install time, the portable ops serve and a log message of level INFO says so once.
"""

import ctypes
import functools
import importlib.util
import logging
import os

import torch
from torch import Tensor

_INTERFACE = 1  # of kernels/interface.h; a library built from other sources does not serve
MEDIAN_DTYPES = (torch.uint8, torch.uint16)
LARGEST_MEDIAN = 9

_log = logging.getLogger(__name__)


def serve(*tensors: Tensor | None) -> bool:
    """Whether the compiled kernels may take these tensors here and now."""
    return (
        _library() is not None
        and not torch.compiler.is_compiling()
        and not torch.jit.is_tracing()
        and torch._C._len_torch_dispatch_stack() == 0  # nobody records or changes what the ops do
        and not torch._C._are_functorch_transforms_active()
        and all(_is_plain(tensor) for tensor in tensors if tensor is not None)
    )


def median(frames: Tensor, size: int) -> Tensor:
    """Median of uint8 or uint16 frames (B, 1, H, W), as `ops.median.median_filter` has it.

    Raises:
        TypeError, ValueError: another dtype or shape, or a size that is even or outside 3 to 9.
    """
    _check_frames(frames, MEDIAN_DTYPES)
    if not 3 <= size <= LARGEST_MEDIAN or size % 2 == 0:
        raise ValueError(f"the compiled median has odd sizes from 3 to {LARGEST_MEDIAN}: {size} was asked for")
    frames = _rows_in_one_piece(frames)
    medians = torch.empty(frames.shape, dtype=frames.dtype)
    _call(
        "fingerflow_median",
        frames.data_ptr(),
        medians.data_ptr(),
        *_extent(frames),
        frames.element_size(),
        size,
        torch.get_num_threads(),
    )
    return medians


def limit_instruction_set(most: int) -> int:
    """For tests: use no wider set than 0 baseline, 1 AVX2, 2 AVX-512, -1 what there is; returns the one taken."""
    library = _library()
    if library is None:
        raise RuntimeError("the compiled kernels do not serve here: build them with `pip install -e .`")
    return int(library.fingerflow_limit_instruction_set(most))


@functools.cache
def _library() -> ctypes.CDLL | None:
    if os.environ.get("FINGERFLOW_KERNELS", "1") == "0":
        return None
    found = importlib.util.find_spec("fingerflow._kernels")
    if found is None or found.origin is None:
        _log.info("compiled kernels were not built (no C++ compiler at install time?): portable ops serve, more slowly")
        return None
    library = ctypes.CDLL(found.origin)
    if not hasattr(library, "fingerflow_interface") or library.fingerflow_interface() != _INTERFACE:
        _log.info("%s was built from other sources: install again; portable ops serve, more slowly", found.origin)
        return None
    count, pointer, number = ctypes.c_int64, ctypes.c_void_p, ctypes.c_int
    extent = [count] * 5
    library.fingerflow_limit_instruction_set.argtypes = [number]
    library.fingerflow_median.argtypes = [pointer, pointer, *extent, number, number, number]
    return library


def _call(name: str, *arguments: int | float | None) -> None:
    if getattr(_library(), name)(*arguments):
        raise MemoryError(f"{name}: the system gave no memory or no thread; use smaller batches or fewer threads")


def _is_plain(tensor: Tensor) -> bool:
    return (
        type(tensor) is Tensor
        and tensor.device.type == "cpu"
        and tensor.layout == torch.strided
        and not (tensor.requires_grad and torch.is_grad_enabled())
    )


def _check_frames(frames: Tensor, dtypes: tuple[torch.dtype, ...]) -> None:
    if frames.dtype not in dtypes:
        raise TypeError(f"frames are {frames.dtype}: this compiled kernel takes {' or '.join(map(str, dtypes))}")
    if frames.ndim != 4 or frames.shape[1] != 1:
        raise ValueError(f"frames have shape {tuple(frames.shape)}: give (B, 1, H, W)")


def _rows_in_one_piece(frames: Tensor) -> Tensor:
    """The frames themselves where pixels of a row are neighbours in memory, else a copy."""
    one_piece = frames.stride(3) == 1 or frames.shape[3] == 1
    return frames if one_piece else frames.contiguous()


def _extent(frames: Tensor) -> tuple[int, int, int, int, int]:
    """Batch, height, width, and the strides of a frame and of a row in pixels."""
    batch, _, height, width = frames.shape
    return batch, height, width, frames.stride(0), frames.stride(2)
