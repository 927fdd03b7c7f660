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

from fingerflow.ops.median_rows import COMPILED_SIZES, median_table

_INTERFACE = 2  # of kernels/interface.h; a library built from other sources does not serve
MEDIAN_DTYPES = (torch.uint8, torch.uint16)
FRAME_KINDS = {torch.uint8: 0, torch.uint16: 1, torch.int32: 2, torch.float32: 3}  # of kernels/pixels.h
LARGEST_MEDIAN = 31

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
        TypeError, ValueError: another dtype or shape, or a size that is even or outside 3 to 31.
    """
    _check_frames(frames, MEDIAN_DTYPES)
    if not 3 <= size <= LARGEST_MEDIAN or size % 2 == 0:
        raise ValueError(f"the compiled median has odd sizes from 3 to {LARGEST_MEDIAN}: {size} was asked for")
    frames = _rows_in_one_piece(frames)
    table = None if size in COMPILED_SIZES else _table(size)
    medians = torch.empty(frames.shape, dtype=frames.dtype)
    _call(
        "fingerflow_median",
        frames.data_ptr(),
        medians.data_ptr(),
        *_extent(frames),
        frames.element_size(),
        size,
        None if table is None else ctypes.addressof(table),
        torch.get_num_threads(),
    )
    return medians


def track_points(
    coefficients: tuple[Tensor, Tensor],
    image_index: Tensor,
    noise: Tensor,
    start: Tensor,
    guess: Tensor,
    back_guess: Tensor | None,
    warp: Tensor | None,
    *,
    window: int,
    gain_offset: bool,
    rounding: float,
    forward_backward_limit: float,
    mismatch_limit: float,
) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """P points there and back by cubic splines, as `ops.tracking` has it, float32.

    Coefficients are (B, 1, H, W), image_index (P,) int64, noise (P,), points (P, 2), warp (P, 2, 2). Returns points,
    forward-backward error, covariance and status.

    Raises:
        TypeError, ValueError: another dtype, or shapes that do not belong together.
    """
    count = len(start)
    height, width = coefficients[0].shape[-2:]
    expected = {
        "noise": (count,),
        "start": (count, 2),
        "guess": (count, 2),
        "back_guess": (count, 2),
        "warp": (count, 2, 2),
    }
    given = {"noise": noise, "start": start, "guess": guess, "back_guess": back_guess, "warp": warp}
    for name, tensor in (("coefficients", coefficients[0]), ("coefficients", coefficients[1]), *given.items()):
        if tensor is not None and tensor.dtype != torch.float32:
            raise TypeError(f"{name} is {tensor.dtype}: the compiled tracker takes torch.float32")
        if tensor is not None and name in expected and tuple(tensor.shape) != expected[name]:
            raise ValueError(f"{name} has shape {tuple(tensor.shape)} for {count} points: {expected[name]} is needed")
    if coefficients[0].shape != coefficients[1].shape or coefficients[0].shape[1] != 1 or min(height, width) < 4:
        raise ValueError(f"coefficients {[tuple(c.shape) for c in coefficients]}: two (B, 1, H, W) of 4 px and more")
    if image_index.dtype != torch.int64 or tuple(image_index.shape) != (count,):
        raise ValueError(f"image_index is {image_index.dtype} {tuple(image_index.shape)}: int64 ({count},) is needed")
    if count and not 0 <= int(image_index.min()) <= int(image_index.max()) < len(coefficients[0]):
        raise ValueError(f"image_index goes from {image_index.min()} to {image_index.max()} of {len(coefficients[0])}")
    if window < 5 or window % 2 == 0:
        raise ValueError(f"window must be odd and at least 5 px, not {window}")
    given = {name: None if tensor is None else tensor.contiguous() for name, tensor in given.items()}
    images = [image.contiguous() for image in coefficients]
    index = image_index.contiguous()
    points, error, covariance = torch.empty(count, 2), torch.empty(count), torch.empty(count, 2, 2)
    status = torch.empty(count, dtype=torch.uint8)
    _call(
        "fingerflow_track_points",
        *(image.data_ptr() for image in images),
        height,
        width,
        index.data_ptr(),
        *(None if tensor is None else tensor.data_ptr() for tensor in given.values()),
        count,
        window,
        int(gain_offset),
        rounding,
        forward_backward_limit,
        mismatch_limit,
        *(result.data_ptr() for result in (points, error, covariance, status)),
        torch.get_num_threads(),
    )
    return points, error, covariance, status


def spline_coefficients(frames: Tensor) -> Tensor:
    """Coefficients (B, 1, H, W) float32, as `ops.spline` has them, of frames of FRAME_KINDS, H and W at least 3."""
    coefficients = torch.empty(frames.shape)
    _per_frame("fingerflow_spline_coefficients", frames, coefficients)
    return coefficients


def mean_response(frames: Tensor) -> Tensor:
    """Mean absolute response (B,) float64 of the mask of `ops.noise`, frames as for `spline_coefficients`."""
    means = torch.empty(len(frames), dtype=torch.float64)
    _per_frame("fingerflow_mean_response", frames, means)
    return means


def limit_instruction_set(most: int) -> int:
    """For tests: use no wider set than 0 baseline, 1 AVX2, 2 AVX-512, -1 what there is; returns the one taken."""
    library = _library()
    if library is None:
        raise RuntimeError("the compiled kernels do not serve here: build them with `pip install -e .`")
    return int(library.fingerflow_limit_instruction_set(most))


@functools.cache
def _table(size: int) -> ctypes.Array[ctypes.c_uint16]:
    numbers = median_table(size)
    return (ctypes.c_uint16 * len(numbers))(*numbers)


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
    library.fingerflow_median.argtypes = [pointer, pointer, *extent, number, number, pointer, number]
    library.fingerflow_spline_coefficients.argtypes = [pointer, pointer, *extent, number, number]
    library.fingerflow_mean_response.argtypes = [pointer, pointer, *extent, number, number]
    real = ctypes.c_float
    library.fingerflow_track_points.argtypes = [
        *[pointer] * 2,
        *[count] * 2,
        *[pointer] * 6,
        count,
        *[number] * 2,
        *[real] * 3,
        *[pointer] * 4,
        number,
    ]
    return library


def _per_frame(name: str, frames: Tensor, result: Tensor) -> None:
    _check_frames(frames, tuple(FRAME_KINDS))
    if min(frames.shape[2:]) < 3:
        raise ValueError(f"frames of {tuple(frames.shape[2:])} px: this compiled kernel needs at least 3 x 3")
    frames = _rows_in_one_piece(frames)
    _call(
        name,
        frames.data_ptr(),
        result.data_ptr(),
        *_extent(frames),
        FRAME_KINDS[frames.dtype],
        torch.get_num_threads(),
    )


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
