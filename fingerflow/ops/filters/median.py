"""Exact median filter of images."""

import functools
from collections.abc import Sequence
from typing import Any

import torch
from torch import Tensor
from torch.nn import functional

from fingerflow.kernels import tensors as kernels
from fingerflow.kernels.contact import LARGEST_MEDIAN
from fingerflow.kernels.median_network import MedianProgram, Operand, Step, median_program, tile_program
from fingerflow.kernels.tensors.torch_op import torch_op
from fingerflow.ops.checks import check_frames, check_window
from fingerflow.ops.pieces import frames_at_once, in_pieces

LARGEST_TRACED = 11  # px, largest window whose comparator network is traced by the torch compiler

_DTYPES = (
    torch.uint8,
    torch.int8,
    torch.int16,
    torch.int32,
    torch.int64,
    torch.float16,
    torch.bfloat16,
    torch.float32,
    torch.float64,
)


def median_filter(frames: Tensor, size: int = 9) -> Tensor:
    """Return the median of the `size` x `size` window around each pixel, computed by a network of minima and maxima.

    Args:
        frames: (B, 1, H, W), 8 to 64 bit signed integers, uint8, uint16 or floating. A frame may be smaller than the
            window.
        size: window side in pixels, odd.

    Returns:
        (B, 1, H, W) of the same dtype, at each pixel one of the input values. Outside the frame the nearest pixel
        counts (`replicate`, as in OpenCV's medianBlur and SciPy's mode "nearest"). For floating frames the result is
        NaN exactly where the window holds a NaN; infinities are ordered as numbers. The gradient belongs to the pixel
        that is the median and is shared between equal ones. The op exports with a fixed frame size.

    Raises:
        TypeError: the dtype has no order here (bool, complex, uint32, uint64).
        ValueError: `frames` is not (B, 1, H, W), or `size` is even or under 1.

    Source: Adams 2021 and Batcher's merges (`kernels.median_network`). Compiled twin: `kernels/median.cpp`.

    Convention:
        axes: rows are y down, columns x to the right.
        sign: that of the frames.
        pixel centre: the window is centred on its pixel.
        dtype: that of the input.
        NaN: in a window, makes its median NaN.
        border: the nearest pixel is repeated.
    """
    check_frames(frames)
    check_window(size)
    if size == 1 or frames.numel() == 0:
        return frames.clone()
    if frames.dtype in kernels.COUNTED_DTYPES and size <= LARGEST_MEDIAN and kernels.serve(frames):
        return kernels.median(frames, size)
    if frames.dtype == torch.uint16:  # the minimum of uint16 is not implemented in torch
        return median_filter(frames.to(torch.int32), size).to(torch.uint16)
    if frames.dtype not in _DTYPES:
        raise TypeError(f"median_filter has no order for {frames.dtype}: convert to uint8, int32 or float32 first")
    if torch.compiler.is_exporting():
        return _row_median(frames, size)
    if torch.compiler.is_compiling() and size > LARGEST_TRACED:
        return large_median(frames, size)
    return _network_median(frames, size)


def _network_median(frames: Tensor, size: int) -> Tensor:
    program = MedianProgram(*_planned(size)) if torch.compiler.is_compiling() else median_program(size)
    return in_pieces(functools.partial(_run, program), frames_at_once(frames), frames)


@kernels.constant_to_compiler
def _planned(size: int) -> Any:
    """Return the program of a median network as plain nested tuples, which the torch compiler accepts as a constant.

    The compiler must not trace the making of a program.
    """

    def plain(part: Any) -> Any:
        return tuple(map(plain, part)) if isinstance(part, tuple) else part

    return plain(median_program(size))


@torch_op(shapes=lambda frames, _: torch.empty_like(frames, memory_format=torch.contiguous_format))
def large_median(frames: Tensor, size: int) -> Tensor:
    """Compute the median filter with a large window, as a torch op that the torch compiler does not trace.

    The compiler would need minutes to trace thousands of minima and maxima.
    """
    return _network_median(frames, size).contiguous()


def _row_median(frames: Tensor, size: int) -> Tensor:
    """Compute the median filter by operations on whole rows of pixels; exported graphs contain this form.

    The tiles of `_run` have one column here. A plane then holds whole rows, which an unfused runtime copies in one
    piece.
    """
    program = _rows_program(size)
    batch, _, height, width = frames.shape
    rows, half = program.tile[0], size // 2
    down, right = program.reach
    tiles = -(-height // rows)
    grid_y, grid_x = tiles + down, width + right
    below = grid_y * rows - height - half
    padded = functional.pad(frames, (half, right - half, half, below), mode="replicate")[:, 0]
    phases = [padded[:, phase::rows].reshape(-1) for phase in range(rows)]
    medians = [
        plane.reshape(batch, grid_y, grid_x)[:, :tiles, :width]
        for plane in run_network(program.steps, program.outputs, phases, grid_x, views=False)
    ]
    return torch.stack(medians, dim=2).reshape(batch, 1, tiles * rows, width)[:, :, :height]


@functools.cache
def _rows_program(size: int) -> MedianProgram:
    orders = ["y", "yy"] if size > 4 else ["y"]
    return min((tile_program(size, order) for order in orders), key=lambda program: program.operations_per_pixel)


def _run(program: MedianProgram, frames: Tensor) -> Tensor:
    """Compute the median filter of frames (B, 1, H, W) by a program of pairwise minima and maxima on planes, each of
    which holds the pixels at one position of all tiles of the frames.

    Each step is one pass over contiguous memory.
    """
    batch, _, height, width = frames.shape
    (rows, columns), (down, right) = program.tile, program.reach
    tiles_y, tiles_x = (height + rows - 1) // rows, (width + columns - 1) // columns
    grid_y, grid_x = tiles_y + down, tiles_x + right
    half = program.size // 2
    y = (torch.arange(grid_y * rows, device=frames.device) - half).clamp(0, height - 1)
    x = (torch.arange(grid_x * columns, device=frames.device) - half).clamp(0, width - 1)
    padded = frames[:, 0].index_select(1, y).index_select(2, x)
    phases = padded.reshape(batch, grid_y, rows, grid_x, columns).permute(2, 4, 0, 1, 3).reshape(rows * columns, -1)

    medians = [
        plane.reshape(batch, grid_y, grid_x)[:, :tiles_y, :tiles_x]
        for plane in run_network(program.steps, program.outputs, phases.unbind(), grid_x)
    ]
    tiled = torch.stack(medians).reshape(rows, columns, batch, tiles_y, tiles_x).permute(2, 3, 0, 4, 1)
    return tiled.reshape(batch, 1, tiles_y * rows, tiles_x * columns)[..., :height, :width]


def run_network(
    steps: Sequence[Step], outputs: Sequence[Operand], planes: Sequence[Tensor], columns: int = 0, *, views: bool = True
) -> list[Tensor]:
    """Execute the `steps` of a median network, pairwise minima and maxima, on flat planes of pixels (one for each
    position within a tile), and return the planes that `outputs` names.

    Args:
        steps, outputs: of the program.
        planes: the inputs, all of one shape. They are flat where the program shifts them: rows of `columns` tiles,
            frame after frame.
        columns: tiles per row.
        views: read a shifted plane as a view, which is shorter by the shift. False keeps all planes at one length: an
            exported graph has no views, and combining planes of different lengths costs a copy there.

    Returns:
        Planes of that shape; their values beyond the last window of a line or frame have no meaning.
    """
    # A shift by whole tiles is an offset in the flattened plane. Reading past the end of a line or frame gives a wrong
    # value only where no window begins. Planes are dropped after their last use to save memory.
    cells = planes[0].shape[0]
    lanes = dict(enumerate(planes))
    lengths = dict.fromkeys(lanes, cells)
    pair, first, second, length = None, planes[0], planes[0], cells
    for operation, result, left, right, rows, shift, released in steps:
        offset = rows * columns + shift
        # Computed once for minimum and maximum: mostly the maximum of two planes follows their minimum.
        if pair != (left, right, offset):
            pair = (left, right, offset)
            first, second = lanes[left], lanes[right]
            if not views:
                second = _drop_first(second, offset, 0)
            else:
                length = min(lengths[left], lengths[right] - offset)
                if length < lengths[right]:
                    second = second[offset : offset + length]
                if length < lengths[left]:
                    first = first[:length]
        lanes[result] = torch.minimum(first, second) if operation == "minimum" else torch.maximum(first, second)
        lengths[result] = length
        for plane in released:
            del lanes[plane]
    return [_drop_first(lanes[plane], rows * columns + shift, cells - lengths[plane]) for plane, rows, shift in outputs]


def _drop_first(plane: Tensor, offset: int, lack: int) -> Tensor:
    """Drop the first `offset` elements of a flat plane, and append `offset` + `lack` zeros at the end."""
    return functional.pad(plane, (-offset, offset + lack)) if offset or lack else plane
